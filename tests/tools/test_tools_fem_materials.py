"""Materials: the paper's stress formula, and the range in which its constants are valid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.array import FloatArray
from tools.fem.materials import PDMS, RTV, RUBBER, Yeoh
from tools.yeoh import any_state_limit, stable_range

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
def test_stress_is_the_published_polynomial_and_its_slope_at_rest_linear_elasticity(rubber: Yeoh) -> None:
    stretch, h = np.linspace(0.3, 2.5, 221), 1e-6
    np.testing.assert_allclose(rubber.uniaxial_mpa(stretch), published_stress(rubber, stretch), atol=1e-11)
    low, high = rubber.uniaxial_mpa(np.array([1 - h, 1 + h]))
    assert (high - low) / (2 * h) == pytest.approx(3 * rubber.shear_mpa)
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
