"""Signs of sliding: definitions on small contacts, and the wavelet transform."""

import math

import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import FloatArray
from tactiled.detect.contact import signs
from tactiled.detect.contact.signs import LOOK_S, NAMES, Signs
from tactiled.detect.signal.wavelet import exact_taps

X, Y = [-1.0, 0.0, 1.0] * 3, [-1.0] * 3 + [0.0] * 3 + [1.0] * 3
NO_ZERO = np.zeros(18)


def shown(readings: FloatArray, noise: float = 0.01, look_s: float = 0.02) -> tuple[FloatArray, Signs]:
    """Rows of signs (n, signs) of readings (n, 3, 9), one scan a look."""
    contact = Signs(X, Y, look_s)
    rows = []
    for reading in readings:
        contact.take(np.ascontiguousarray(reading.ravel()), NO_ZERO)
        contact.look(noise, math.nan)
        rows.append(np.array(contact.row))
    return np.array(rows), contact


def held(n: int, ratio: float = 0.4) -> FloatArray:
    """Readings (n, 3, 9) of a contact that holds, with uneven loads and shear in proportion along x."""
    load = np.array([0.6, 1.2, 0.6, 1.2, 1.8, 1.2, 0.6, 1.2, 0.6])  # a pull along x does not turn it
    return np.tile(np.stack([load, ratio * load, 0 * load]), (n, 1, 1))


def sign(rows: FloatArray, name: str) -> FloatArray:
    return np.asarray(rows[:, NAMES.index(name)])


def test_a_contact_that_holds_shows_its_ratio_and_no_change() -> None:
    rows, contact = shown(held(60))
    assert contact.ratio == pytest.approx(0.4)
    assert sign(rows, "ratio")[-1] == pytest.approx(0.4)
    assert sign(rows, "loaded_part")[-1] == 1.0
    assert sign(rows, "own_ratio_sd")[-1] == pytest.approx(0.0, abs=1e-6)
    assert sign(rows, "shear_load_correlation")[-1] == pytest.approx(1.0)
    still = ("change", "wander", "detail", "turn", "above", "below_most", "ripple", "moves")
    for name in NAMES:
        if any(word in name for word in still):
            assert sign(rows, name)[-1] == pytest.approx(0.0, abs=1e-9), name
    assert sign(rows, "since_below_98_s")[-1] == 1.0  # as long as is remembered
    assert np.isnan(sign(rows, "log_growth_s")[-1])


@pytest.mark.parametrize(("rise", "slows"), [("even", 0.0), ("sliding", 0.54)])
def test_the_course_of_a_growth_is_kept_while_the_ratio_stays(rise: str, slows: float) -> None:
    """From half of the ratio to 0.95 of it, and the time of its end over that of an even growth."""
    n, grows = 100, 40
    x = np.clip((np.arange(n) - 10) / grows, 0, 1)
    part = x if rise == "even" else 1 - (1 - x) ** 1.5  # Mindlin's curve
    readings = held(n)
    readings[:, 1] *= part[:, np.newaxis]
    rows, _ = shown(readings)
    took_s = LOOK_S * grows * (0.45 if rise == "even" else 0.5 ** (2 / 3) - 0.05 ** (2 / 3))
    for look in (60, 99):
        assert np.exp(sign(rows, "log_growth_s")[look]) == pytest.approx(took_s, rel=0.03)
        assert sign(rows, "growth_slows")[look] == pytest.approx(slows, abs=0.05)
    since_s = LOOK_S * (60 - 10 - grows * (0.5 if rise == "even" else 1 - 0.5 ** (2 / 3)))
    assert sign(rows, "since_below_50_s")[60] == pytest.approx(since_s, abs=0.002)


@pytest.mark.parametrize("rate_hz", [10, 20, 30, 50])
def test_times_since_a_lower_ratio_do_not_fall_while_the_ratio_stays(rate_hz: int) -> None:
    readings = held(5 * rate_hz)
    readings[:rate_hz, 1] *= 0.2
    rows, _ = shown(readings, look_s=1 / rate_hz)
    since_s = sign(rows, "since_below_50_s")[rate_hz:]
    assert np.diff(since_s).min() >= 0.0
    assert since_s[-1] == 1.0


def test_another_ratio_forgets_the_course_of_the_growth() -> None:
    readings = held(220)
    readings[:, 1] *= np.clip(np.arange(220) / 40, 0, 1)[:, np.newaxis]
    readings[150:, 1] *= 0.8
    rows, _ = shown(readings)
    assert np.isfinite(sign(rows, "log_growth_s")[149])
    assert np.isnan(sign(rows, "log_growth_s")[219])


def test_changes_are_those_of_the_time_in_their_name() -> None:
    readings = held(80)
    readings[:, 1] *= (1 + 0.01 * np.arange(80))[:, np.newaxis]
    rows, _ = shown(readings)
    for name, looks in (("40ms", 2), ("160ms", 8), ("500ms", 25)):
        assert sign(rows, f"ratio_change_{name}")[-1] == pytest.approx(0.4 * 0.01 * looks)
    assert sign(rows, "since_largest_s")[-1] == 0.0
    assert sign(rows, "log_ratio_of_largest")[-1] == 0.0


def test_taxels_that_move_on_their_own_wander_and_a_common_change_does_not() -> None:
    common = held(60)
    common[30:, 1] *= 1.2
    alone = held(60)
    alone[30:, 1] += 0.1 * np.resize([1.0, -1.0, 0.0], 9)
    for name in ("wander_80ms", "detail_1"):
        assert sign(shown(common)[0], name)[31:34].max() < 1e-9
        assert sign(shown(alone)[0], name)[31:34].max() > 0.02


def test_load_that_moves_shows_and_a_firmer_press_does_not() -> None:
    firmer, moved = held(60), held(60)
    firmer[30:] *= 1.5
    moved[30:, 0] += 0.2 * np.array(X)
    names = ("load_moves_80ms", "load_moves_noises_500ms")
    for name in names:
        assert sign(shown(firmer)[0], name).max() < 1e-9
    parts = 0.2 * math.sqrt(6) / 9  # six taxels of nine, of a load of 9
    rows = [sign(shown(moved, noise=0.02)[0], name) for name in names]
    assert rows[0][31] == pytest.approx(parts)
    assert rows[0][36] == pytest.approx(0.0, abs=1e-9)
    assert rows[1][50] == pytest.approx(parts * 9 / 3 / 0.02)


def test_a_wave_that_goes_over_the_taxels_travels_and_a_common_ripple_does_not() -> None:
    t = np.arange(200) * 0.02
    wave, common = held(200), held(200)
    phase = 2 * np.pi * (2.0 * t[:, np.newaxis] - 0.2 * np.array(X))
    wave[:, 0] *= 1 + 0.1 * np.sin(phase)
    common[:, 0] *= 1 + 0.1 * np.sin(2 * np.pi * 2.0 * t)[:, np.newaxis]
    common[:, 0, 0] *= 1 + 0.1 * np.sin(2 * np.pi * 2.0 * t)  # one taxel more than the others
    travels = [float(sign(shown(one)[0], "ripple_travels")[-1]) for one in (wave, common)]
    assert travels[0] > 3 * travels[1]


@pytest.mark.parametrize("level", signs.LEVELS)
def test_details_are_those_of_the_stationary_transform(level: int) -> None:
    """Away from the borders: the online filter is that of `pywt.swt`, up to its delay."""
    values = np.random.default_rng(level).normal(size=256)
    taps = np.array(exact_taps(level, math.sqrt(2.0)))
    online = np.convolve(values, taps)[: len(values)]
    batch = pywt.swt(values, "coif1", level=level, norm=True)[0][1]
    found = [np.abs(online[128:200] - np.roll(batch, shift)[128:200]).max() for shift in range(64)]
    assert min(found) < 1e-12


def test_a_restart_forgets_the_windows_and_keeps_nothing_of_the_course() -> None:
    _, contact = shown(held(40, 0.8))
    contact.restart()
    contact.take(held(1)[0].ravel(), NO_ZERO)
    contact.look(0.01, math.nan)
    fresh, _ = shown(held(1))
    assert np.array_equal(np.array(contact.row), fresh[0], equal_nan=True)


@given(st.integers(0, 2**32), st.sampled_from([1e-300, 1e-9, 1.0, 1e100]))
@settings(max_examples=20, deadline=None)
def test_any_finite_readings_give_finite_signs(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    rows, _ = shown(size * rng.normal(size=(30, 3, 9)), noise=size * float(rng.choice([0.0, 1e-3])))
    may_be_unknown = [NAMES.index(name) for name in ("acceleration", "log_growth_s", "growth_slows")]
    assert np.isfinite(np.delete(rows, may_be_unknown, axis=1)).all()
    assert not np.isinf(rows).any()


def test_a_turn_on_the_spot_is_borne_like_a_pull() -> None:
    load, pull = np.ones(9), 0.3
    turned = np.stack([load, -pull * np.array(Y), pull * np.array(X)])
    rows, contact = shown(np.tile(turned, (30, 1, 1)))
    mean_square = float(np.mean(np.square(X) + np.square(Y)))
    assert (contact.ratio_x, contact.ratio_y) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert contact.ratio == pytest.approx(pull * mean_square)
    assert sign(rows, "moment")[-1] == pytest.approx(contact.ratio)


def test_loads_that_are_equal_say_nothing_of_the_shears() -> None:
    even = held(30)
    even[:, 0] = 1.0
    rows, _ = shown(even)
    assert np.isnan(sign(rows, "shear_load_correlation")).all()
    assert np.isnan(sign(rows, "shear_on_load")).all()
