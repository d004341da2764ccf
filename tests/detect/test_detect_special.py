"""Special functions against scipy."""

import numpy as np
import pytest
import scipy.special
from hypothesis import example, given
from hypothesis import strategies as st

from tactiled.detect import special

CHANCES = st.floats(1e-12, 0.5)
# `solve.mismatch_variance` asks for 1e-3 degrees of freedom.
SMALL, LARGE = 1e-3, 1e4


@given(st.floats(SMALL, LARGE), CHANCES)
@example(SMALL, 0.5)
@example(SMALL, 1e-12)
@example(1.0, 0.5)
def test_chi_square_quantiles_are_those_of_scipy(freedom: float, chance: float) -> None:
    expected = scipy.special.chdtri(freedom, chance)
    # scipy itself has a relative error of 1e-12 below one degree of freedom.
    assert special.chi_square_quantile(freedom, chance) == pytest.approx(expected, rel=1e-11, abs=1e-290)


@given(st.floats(1.0, 1e3), st.floats(1e-12, 0.4))
@example(1.0, 1e-12)
def test_student_quantiles_are_those_of_scipy(freedom: float, chance: float) -> None:
    expected = -scipy.special.stdtrit(freedom, chance)
    assert special.student_quantile(freedom, chance) == pytest.approx(expected, rel=1e-11, abs=1e-11)


@given(CHANCES)
def test_normal_quantiles_are_those_of_scipy(chance: float) -> None:
    expected = -scipy.special.ndtri(chance)
    assert special.normal_quantile(chance) == pytest.approx(expected, rel=1e-12, abs=1e-15)


@given(st.integers(1, 400), st.floats(1e-10, 0.5))
def test_interpolated_gamma_quantiles_are_those_of_scipy(largest: int, chance: float) -> None:
    shapes = np.geomspace(1, largest, 50)
    expected = scipy.special.gammainccinv(shapes, chance)
    np.testing.assert_allclose(special.gamma_quantiles(shapes, largest, chance), expected, rtol=1e-10, atol=0)


def test_digamma_is_that_of_scipy() -> None:
    x = np.geomspace(1e-3, 1e6, 2000)
    np.testing.assert_allclose(special.digamma(x), scipy.special.digamma(x), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("order", [0, 1, 2, 7])
def test_legendre_polynomials_have_the_bits_of_numpy(order: int) -> None:
    x = np.linspace(-1, 1, 50)
    np.testing.assert_array_equal(special.legendre(x, order), np.polynomial.legendre.legvander(x, order))


@pytest.mark.parametrize("axis", [None, 0, (0, 1), -1])
def test_sums_of_exponentials_are_those_of_scipy(axis: int | tuple[int, ...] | None) -> None:
    x = 300 * np.random.default_rng(0).standard_normal((4, 5, 6))
    np.testing.assert_allclose(
        special.log_sum_exp(x, axis), scipy.special.logsumexp(x, axis=axis), rtol=1e-14
    )
    np.testing.assert_allclose(special.softmax(x), scipy.special.softmax(x), rtol=1e-13, atol=0)


@given(st.floats(-1e4, 1e4))
def test_the_logistic_function_is_that_of_scipy(x: float) -> None:
    assert special.logistic(x) == pytest.approx(scipy.special.expit(x), rel=1e-13)
