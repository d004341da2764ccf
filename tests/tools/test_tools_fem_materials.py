"""Materials: the paper's stress formula, energy as a potential, the stable range, extremes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.stability import any_state_limit, stable_range
from tactiled.errors import ContractError
from tools.fem.materials import PDMS, RTV, RUBBER, Yeoh

RUBBERS = (RUBBER, RTV, PDMS)
constants = st.tuples(st.floats(0.1, 2.0), st.floats(-0.5, 0.5), st.floats(-0.1, 0.1))


def published_stress(rubber: Yeoh, a: FloatArray) -> FloatArray:
    """The paper's polynomial in the stretch, term by term."""
    first = a - a**-2.0
    second = a**3 - 3 * a + 1 + 3 * a**-2.0 - 2 * a**-3.0
    third = a**5 - 6 * a**3 + 3 * a**2 + 9 * a - 6 - 9 * a**-2.0 + 12 * a**-3.0 - 4 * a**-4.0
    return np.asarray(2 * rubber.c1_mpa * first + 4 * rubber.c2_mpa * second + 6 * rubber.c3_mpa * third)


def range_of(rubber: Yeoh) -> tuple[tuple[float, float], tuple[float, float]]:
    found = stable_range(rubber.c1_mpa, rubber.c2_mpa, rubber.c3_mpa)
    return found.elliptic, found.rising


@pytest.mark.parametrize("rubber", RUBBERS, ids=lambda rubber: rubber.name)
def test_stress_is_the_published_polynomial_up_to_the_continuation(rubber: Yeoh) -> None:
    stretch = np.linspace(0.3, 2.5, 221)
    answer = rubber.uniaxial(stretch)
    inside = ~answer.continued
    np.testing.assert_allclose(
        answer.stress_mpa[inside], published_stress(rubber, stretch[inside]), rtol=1e-11, atol=1e-12
    )
    assert inside.sum() > 80


@pytest.mark.parametrize("material", RUBBERS, ids=lambda material: material.name)
def test_tangent_is_the_slope_of_stress_and_stress_that_of_energy(material: Yeoh) -> None:
    stretch, h = np.linspace(0.25, 3.0, 311), 1e-6
    answer = material.uniaxial(stretch)
    rise = (material.uniaxial(stretch + h).stress_mpa - material.uniaxial(stretch - h).stress_mpa) / (2 * h)
    np.testing.assert_allclose(answer.tangent_mpa, rise, rtol=1e-5, atol=1e-5)
    energy = [material.energy(a**2 + 2 / a - 3) for a in (stretch + h, stretch - h)]
    np.testing.assert_allclose(answer.stress_mpa, (energy[0] - energy[1]) / (2 * h), rtol=1e-6, atol=1e-7)


def test_small_strain_is_linear_elasticity() -> None:
    for rubber in RUBBERS:
        young = float(rubber.uniaxial(1.0).tangent_mpa)
        assert young == pytest.approx(6 * rubber.c1_mpa)
        shear, bulk = rubber.shear_mpa, rubber.bulk_mpa
        assert (3 * bulk - 2 * shear) / (2 * (3 * bulk + shear)) == pytest.approx(rubber.poisson)


@pytest.mark.parametrize(
    ("rubber", "elliptic", "rising"),
    [(RUBBER, (0.375, 2.08), (0.358, 2.01)), (PDMS, (0.295, 2.40), (0.281, 2.35))],
    ids=["rubber", "PDMS"],
)
def test_stable_range_is_the_known_one(
    rubber: Yeoh, elliptic: tuple[float, float], rising: tuple[float, float]
) -> None:
    # Found before on a grid: its last digit is as far as it goes.
    found_elliptic, found_rising = range_of(rubber)
    assert found_elliptic == pytest.approx(elliptic, abs=0.003)
    assert found_rising == pytest.approx(rising, abs=0.003)


def test_rtv_is_stable_everywhere() -> None:
    assert range_of(RTV) == ((0.0, np.inf), (0.0, np.inf))
    assert not RTV.uniaxial([0.1, 3.0]).continued.any()


def smallest_ellipticity(slope: float, curvature: float, stretches: FloatArray) -> float:
    """W' n.bn + 2 W'' (m.bn)^2 over directions in the plane of two principal axes, by brute force."""
    turn = np.linspace(0, np.pi, 721)
    first, second = stretches[0] ** 2, stretches[1] ** 2
    along = first * np.cos(turn) ** 2 + second * np.sin(turn) ** 2
    across = (second - first) * np.sin(turn) * np.cos(turn)
    return float(np.min(slope * along + 2 * curvature * across**2))


@pytest.mark.parametrize("rubber", [RUBBER, PDMS], ids=["rubber", "PDMS"])
def test_ellipticity_is_lost_where_a_search_over_directions_finds_it(rubber: Yeoh) -> None:
    def margin(stretch: float) -> float:
        x = stretch**2 + 2 / stretch - 3
        slope = rubber.c1_mpa + 2 * rubber.c2_mpa * x + 3 * rubber.c3_mpa * x**2
        curvature = 2 * rubber.c2_mpa + 6 * rubber.c3_mpa * x
        return smallest_ellipticity(slope, curvature, np.array([stretch, stretch**-0.5]))

    low, high = range_of(rubber)[0]
    assert margin(low * 1.002) > 0 > margin(low * 0.998)
    assert margin(high * 0.998) > 0 > margin(high * 1.002)


@given(constants, st.floats(0.2, 4.0), st.floats(0.2, 4.0))
def test_the_continued_energy_is_elliptic_in_any_state(
    c: tuple[float, float, float], first: float, second: float
) -> None:
    rubber = Yeoh("any", *c, 0.47)
    third = 1 / (first * second)
    excess = max(first**2 + second**2 + third**2 - 3, 0.0)
    slope, curvature = float(rubber.slope(excess)), float(rubber.curvature(excess))
    scale = slope * max(first, second, third) ** 2
    for pair in ((first, second), (second, third), (first, third)):
        assert smallest_ellipticity(slope, curvature, np.array(pair)) > -1e-9 * scale
    assert slope > 0


@given(constants, st.floats(0.0, 50.0))
def test_any_state_limit_bounds_the_uniaxial_range(c: tuple[float, float, float], excess: float) -> None:
    limit = any_state_limit(*c)
    low, high = stable_range(*c).elliptic
    if np.isinf(limit):
        assert (low, high) == (0.0, np.inf)
    for end in (low, high):
        if 0.0 < end < np.inf:
            assert end**2 + 2 / end - 3 >= limit * (1 - 1e-9)
    if excess < limit:
        assert c[0] + 6 * c[1] * excess + 15 * c[2] * excess**2 > 0


@given(constants)
def test_extremes_give_rising_finite_stress(c: tuple[float, float, float]) -> None:
    stretch = np.linspace(0.1, 3.0, 2901)
    answer = Yeoh("any", *c, 0.47).uniaxial(stretch)
    assert np.all(np.isfinite(answer.stress_mpa))
    assert np.all(np.isfinite(answer.tangent_mpa))
    if not np.isinf(any_state_limit(*c)):
        assert np.all(np.diff(answer.stress_mpa) > 0)


@pytest.mark.parametrize("rubber", [RUBBER, PDMS], ids=["rubber", "PDMS"])
def test_the_continuation_is_flagged_and_joins_without_a_step(rubber: Yeoh) -> None:
    assert rubber.uniaxial([0.1, 3.0]).continued.tolist() == [True, True]
    assert not rubber.uniaxial([0.77, 1.3]).continued.any()
    limit = rubber.excess_limit
    for law in (rubber.energy, rubber.slope, rubber.curvature):
        assert float(law(limit * (1 + 1e-9))) == pytest.approx(float(law(limit * (1 - 1e-9))), abs=1e-7)
    assert limit < any_state_limit(rubber.c1_mpa, rubber.c2_mpa, rubber.c3_mpa)


@pytest.mark.parametrize("stretch", [0.0, -0.5, float("nan"), float("inf")])
def test_stretches_that_are_not_positive_are_refused(stretch: float) -> None:
    with pytest.raises(ContractError, match="stretch"):
        RUBBER.uniaxial([1.0, stretch])
