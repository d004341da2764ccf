"""The bank is pywt's transform, exactly the same however scans are chunked, and honest about its borders."""

from collections.abc import Iterable

import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter
from touches import pieces, splits

from tactiled.array import Array, FloatArray, load_array
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.wavelet import border_scans, taps
from tactiled.samples.block import ScanBlock, regular_block
from tactiled.wang2019.bank import SwtBank, kink_response

LEVELS = range(1, 7)
ARRAY = load_array("wang2019-3x3")
PAIR = load_array("normal-4x4")


def swt(volts: FloatArray, level: int) -> FloatArray:
    """Detail of a level, by pywt: coarsest first in its list."""
    return np.asarray(pywt.swt(volts, "coif1", level=6, axis=0)[6 - level][1])


def noise(n: int, array: Array, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(0, 3, size=(n, array.n_channels))


def delay_scans(level: int) -> int:
    """Scans by which the bank trails the coefficient that `pywt.swt` gives the same name."""
    return 3 * ((1 << level) - 1)


def filtered(array: Array, level: int, blocks: Iterable[ScanBlock]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Coefficients of consecutive blocks, and which of them are usable."""
    grid, bank = Quantiser(array), SwtBank(array, level)
    volts, usable = zip(*(bank.filter(grid.process(block)) for block in blocks), strict=True)
    return np.concatenate(volts), np.concatenate(usable)


def coefficients(array: Array, level: int, volts: FloatArray) -> FloatArray:
    return filtered(array, level, [regular_block(volts, 100.0)])[0]


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("seed", range(3))
def test_equals_pywt_away_from_the_border_at_the_stated_delay(level: int, seed: int) -> None:
    volts = noise(1024, ARRAY, seed)
    ours = coefficients(ARRAY, level, volts)[border_scans(level) :]
    first = border_scans(level) - delay_scans(level)
    theirs = swt(volts, level)[first : first + len(ours)]
    # Of readings within 8 V, each tap is off by a unit of 2^-24 at most on average.
    assert np.abs(ours - theirs).max() <= len(taps(level)) * 8.0 * 2.0**-24
    assert np.abs(ours - theirs).std() < 1e-6


@pytest.mark.parametrize("level", LEVELS)
def test_answers_an_impulse_as_pywt_does(level: int) -> None:
    volts = np.zeros((1024, PAIR.n_channels))
    volts[500, 3] = 1.0
    ours = coefficients(PAIR, level, volts)
    theirs = np.roll(swt(volts, level), delay_scans(level), axis=0)
    assert np.abs(ours - theirs).max() < 2 * 2.0**-24
    assert np.all(ours[:, np.arange(PAIR.n_channels) != 3] == 0)
    answered = np.flatnonzero(np.abs(theirs[:, 3]) > 1e-9)
    assert answered[0] >= 500
    assert answered[-1] <= 500 + border_scans(level)


@pytest.mark.parametrize("level", LEVELS)
def test_is_the_same_bits_as_scipy_and_as_integer_arithmetic(level: int) -> None:
    grid = 8.0 / 2**23
    steps = (
        np.random.default_rng(level).integers(-(2**23), 2**23, size=(700, PAIR.n_channels)).astype(np.float64)
    )
    ours = coefficients(PAIR, level, steps * grid)
    after = slice(border_scans(level), None)
    assert np.array_equal(ours[after], lfilter(taps(level), [1.0], steps * grid, axis=0)[after])
    whole_taps = [int(tap) for tap in taps(level) * 2**24]
    for scan in (border_scans(level), 699):
        exact = sum(tap * int(steps[scan - k, 2]) for k, tap in enumerate(whole_taps))
        assert abs(exact) < 2**53
        assert ours[scan, 2] == exact * grid / 2**24


@given(st.data())
@settings(max_examples=30, deadline=None)
def test_any_chunking_gives_the_same_bits(data: st.DataObject) -> None:
    n = data.draw(st.integers(2, 500))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    volts = rng.uniform(-9, 9, size=(n, ARRAY.n_channels))
    volts[rng.random(volts.shape) < 0.01] = np.nan
    block = regular_block(volts, 100.0, valid=rng.random(volts.shape) > 0.01)
    level = data.draw(st.sampled_from(LEVELS))
    whole = filtered(ARRAY, level, [block])
    parts = filtered(ARRAY, level, pieces(block, data.draw(splits(n))))
    assert np.array_equal(whole[0], parts[0])
    assert np.array_equal(whole[1], parts[1])


@given(st.floats(-8, 8), st.floats(-1e-3, 1e-3))
@settings(max_examples=30, deadline=None)
def test_constants_and_ramps_give_exactly_zero(level_volts: float, ramp: float) -> None:
    grid = 8.0 / 2**23
    constant = np.full((400, PAIR.n_channels), level_volts)
    assert all(np.all(coefficients(PAIR, level, constant) == 0) for level in LEVELS)
    ramps = np.arange(400)[:, np.newaxis] * np.round(ramp / grid) * grid + np.zeros(PAIR.n_channels)
    assert all(np.all(coefficients(PAIR, level, ramps)[border_scans(level) :] == 0) for level in LEVELS)


def test_nothing_is_usable_before_the_stated_border() -> None:
    for level in LEVELS:
        _, usable = filtered(PAIR, level, [regular_block(noise(400, PAIR), 100.0)])
        assert not usable[: border_scans(level)].any()
        assert usable[border_scans(level) :].all()


@given(st.integers(330, 400), st.sampled_from([np.nan, np.inf, -np.inf, 9.0, 1e308, -1e300]))
@settings(max_examples=20, deadline=None)
def test_a_bad_reading_taints_what_sees_it_and_nothing_else(at: int, bad: float) -> None:
    volts = noise(800, PAIR)
    spoilt = volts.copy()
    spoilt[at, 5] = bad
    for level in LEVELS:
        clean, is_clean = filtered(PAIR, level, [regular_block(volts, 100.0)])
        tainted, usable = filtered(PAIR, level, [regular_block(spoilt, 100.0)])
        assert np.isfinite(tainted).all()
        sees = np.zeros(800, dtype=np.bool_)
        sees[at : at + border_scans(level) + 1] = True
        expected = is_clean.copy()
        expected[sees, 5] = False
        assert np.array_equal(usable, expected)
        assert (tainted == clean)[usable].all()


def test_a_bad_reading_is_held_at_the_last_good_one() -> None:
    volts = noise(400, PAIR)
    held = volts.copy()
    held[200:230, 1] = volts[199, 1]
    volts[200:230, 1] = np.nan
    assert np.array_equal(coefficients(PAIR, 3, volts), coefficients(PAIR, 3, held))


def test_kink_gains_are_those_of_the_published_filters() -> None:
    # Peak coefficient for one volt per second at 100 Hz: seconds, levels 1 to 6.
    gains = [kink_response(level).max() / 100 for level in LEVELS]
    assert gains == pytest.approx([0.0048, 0.012, 0.032, 0.090, 0.255, 0.72], rel=0.02)
