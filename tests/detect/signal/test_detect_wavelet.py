"""The bank is pywt's transform, exactly the same however scans are chunked, and honest about its borders."""

import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from touches import pieces, splits

from tactiled import tomlfile
from tactiled.array import Array, FloatArray, load_array
from tactiled.detect.signal.wavelet import (
    BankParams,
    SwtBank,
    WaveletCoefficients,
    border_scans,
    coefficients,
    delay_scans,
    error_volts,
    kink_response,
    taps,
)
from tactiled.errors import ConfigError
from tactiled.samples.block import Gap, ScanBlock, regular_block

LEVELS = range(1, 7)
ARRAY = load_array("wang2019-3x3")
PAIR = load_array("normal-4x4")


def swt(volts: FloatArray, level: int) -> FloatArray:
    """Detail of a level, by pywt: coarsest first in its list."""
    return np.asarray(pywt.swt(volts, "coif1", level=6, axis=0)[6 - level][1])


def noise(n: int, array: Array, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(0, 3, size=(n, array.n_channels))


def joined(bank: SwtBank, blocks: list[ScanBlock]) -> WaveletCoefficients:
    parts = [bank.process(block) for block in blocks]
    return WaveletCoefficients(
        np.concatenate([p.volts for p in parts]), np.concatenate([p.usable for p in parts])
    )


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("seed", range(3))
def test_equals_pywt_away_from_the_border_at_the_stated_delay(level: int, seed: int) -> None:
    volts = noise(1024, ARRAY, seed)
    ours = coefficients(ARRAY, regular_block(volts, 100.0)).volts[border_scans(level) :, level - 1]
    first = border_scans(level) - delay_scans(level)
    theirs = swt(volts, level)[first : first + len(ours)]
    assert np.abs(ours - theirs).max() <= error_volts(level, ARRAY)
    assert np.abs(ours - theirs).std() < 1e-6


@pytest.mark.parametrize("level", LEVELS)
def test_answers_an_impulse_as_pywt_does(level: int) -> None:
    volts = np.zeros((1024, PAIR.n_channels))
    volts[500, 3] = 1.0
    ours = coefficients(PAIR, regular_block(volts, 100.0)).volts[:, level - 1]
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
    ours = coefficients(PAIR, regular_block(steps * grid, 100.0), BankParams(levels=(level,))).volts[:, 0]
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
    whole = joined(SwtBank(ARRAY), [block])
    parts = joined(SwtBank(ARRAY), pieces(block, data.draw(splits(n))))
    assert np.array_equal(whole.volts, parts.volts)
    assert np.array_equal(whole.usable, parts.usable)


def test_long_blocks_and_many_short_ones_agree_past_the_ring() -> None:
    block = regular_block(noise(5000, PAIR), 100.0)
    whole = joined(SwtBank(PAIR), [block])
    parts = joined(SwtBank(PAIR), pieces(block, range(3, 5000, 3)))
    assert np.array_equal(whole.volts, parts.volts)


@given(st.floats(-8, 8), st.floats(-1e-3, 1e-3))
@settings(max_examples=30, deadline=None)
def test_constants_and_ramps_give_exactly_zero(level_volts: float, ramp: float) -> None:
    grid = 8.0 / 2**23
    constant = np.full((400, PAIR.n_channels), level_volts)
    assert np.all(coefficients(PAIR, regular_block(constant, 100.0)).volts == 0)
    ramps = np.arange(400)[:, np.newaxis] * np.round(ramp / grid) * grid + np.zeros(PAIR.n_channels)
    assert np.all(coefficients(PAIR, regular_block(ramps, 100.0)).volts[border_scans(6) :] == 0)


def test_nothing_is_usable_before_the_stated_border() -> None:
    usable = coefficients(PAIR, regular_block(noise(400, PAIR), 100.0)).usable
    for level in LEVELS:
        assert not usable[: border_scans(level), level - 1].any()
        assert usable[border_scans(level) :, level - 1].all()


@given(st.integers(330, 400), st.sampled_from([np.nan, np.inf, -np.inf, 9.0, 1e308, -1e300]))
@settings(max_examples=20, deadline=None)
def test_a_bad_reading_taints_what_sees_it_and_nothing_else(at: int, bad: float) -> None:
    volts = noise(800, PAIR)
    spoilt = volts.copy()
    spoilt[at, 5] = bad
    clean = coefficients(PAIR, regular_block(volts, 100.0))
    tainted = coefficients(PAIR, regular_block(spoilt, 100.0))
    assert np.isfinite(tainted.volts).all()
    for level in LEVELS:
        sees = np.zeros(800, dtype=np.bool_)
        sees[at : at + border_scans(level) + 1] = True
        expected = clean.usable[:, level - 1].copy()
        expected[sees, 5] = False
        assert np.array_equal(tainted.usable[:, level - 1], expected)
        agree = tainted.volts[:, level - 1] == clean.volts[:, level - 1]
        assert agree[tainted.usable[:, level - 1]].all()


def test_a_bad_reading_is_held_at_the_last_good_one() -> None:
    volts = noise(400, PAIR)
    held = volts.copy()
    held[200:230, 1] = volts[199, 1]
    volts[200:230, 1] = np.nan
    assert np.array_equal(
        coefficients(PAIR, regular_block(volts, 100.0)).volts,
        coefficients(PAIR, regular_block(held, 100.0)).volts,
    )


def test_reset_and_gap_equal_new() -> None:
    before, after = regular_block(noise(400, PAIR), 100.0), regular_block(noise(400, PAIR, 1), 100.0)
    expected = SwtBank(PAIR).process(after)
    bank = SwtBank(PAIR)
    bank.process(before)
    bank.reset()
    assert np.array_equal(bank.process(after).volts, expected.volts)
    gap = bank.process(Gap(3, "missing", 403))
    assert gap.volts.shape == (0, 6, PAIR.n_channels)
    again = bank.process(after)
    assert np.array_equal(again.volts, expected.volts)
    assert np.array_equal(again.usable, expected.usable)


def test_kink_gains_are_those_of_the_published_filters() -> None:
    # Peak coefficient for one volt per second at 100 Hz: seconds, levels 1 to 6.
    gains = [kink_response(level).max() / 100 for level in LEVELS]
    assert gains == pytest.approx([0.0048, 0.012, 0.032, 0.090, 0.255, 0.72], rel=0.02)


@pytest.mark.parametrize("levels", [[], [0], [7], [2, 1], [3, 3]])
def test_impossible_levels_are_refused(levels: list[int]) -> None:
    with pytest.raises(ConfigError, match="levels"):
        tomlfile.parse({"levels": levels}, BankParams, "test")
