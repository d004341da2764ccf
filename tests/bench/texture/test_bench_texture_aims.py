"""What is counted where an answer can be wrong, and what the table of aims makes of it."""

from dataclasses import replace

import numpy as np
import pytest

from bench.texture.aims import aims_table
from bench.texture.count import FIRST_SEED, Counted, count_table, counted
from bench.texture.drawn import ANGLES_DEG, PERIODS_MM, Drawn, drawn_table, plate
from bench.texture.grid import Trial, turns_off
from bench.texture.misfit import Spoiled
from bench.texture.paper import Answered, First
from bench.texture.plates import MISFITS
from bench.texture.signal import draw_case, readings
from bench.texture.two import TWO, Twofold, two_table, twofold
from bench.texture.window import perfect
from tactiled.array import load_array

ARRAY = load_array("wang2019-3x3")
RIGHT = Trial(2.0, 20.0, True, 0, 5.0, 1.2, 30.0, "ok", 1.0, -1.0, 1.0, 1.0)


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.97])
def test_noise_remembers_and_keeps_its_size(memory: float) -> None:
    case = draw_case(ARRAY, np.random.default_rng(0), 20.0, 0.0)
    still = replace(
        case, sensed=replace(case.sensed, amplitude_volts=np.zeros((36, 1))), drift=np.zeros((36, 2))
    )
    noise = readings(still, np.random.default_rng(1), memory) / case.sensed.noise_volts
    assert np.sqrt((noise**2).mean()) == pytest.approx(1, abs=0.1)
    assert (noise[1:] * noise[:-1]).mean() == pytest.approx(memory, abs=0.1)
    assert np.sqrt((noise[0] ** 2).mean()) == pytest.approx(1, abs=0.4)  # steady from the first scan on


def test_counted_windows_are_slow_ripples_of_three_periods() -> None:
    found = [counted(0.9, seed).trial for seed in range(100_001, 100_009)]
    assert found[0] == counted(0.9, 100_001).trial
    assert all(t.periods >= 3 for t in found)
    assert all(t.periods / t.window_s < 5 for t in found)
    assert [t.is_speed_known for t in found] == [True, False] * 4


@pytest.mark.parametrize("ratio", [1.7, 2.0, 3.0])
def test_second_ripples_are_so_many_times_faster(ratio: float) -> None:
    words = {1.7: "1.7 times", 2.0: "twice", 3.0: "three times"}[ratio]
    (name,) = (name for name in TWO if words in name)
    window = perfect(ARRAY, np.random.default_rng(3), 10.0)
    TWO[name](window, np.random.default_rng(4))
    assert window.beside is not None
    assert window.beside.frequency_hz / window.wave.frequency_hz == pytest.approx(ratio)
    seen_hz = np.fft.rfftfreq(8 * 1000, 0.01)[
        np.abs(np.fft.rfft(window.added_volts[:, 0], 8 * 1000)).argmax()
    ]
    assert seen_hz == pytest.approx(window.beside.frequency_hz, abs=0.05)
    assert np.sqrt(2) * window.added_volts.std() == pytest.approx(0.01, rel=0.05)


def test_crossed_gratings_share_frequency_and_period() -> None:
    window = perfect(ARRAY, np.random.default_rng(3), 10.0)
    TWO["crossed, alike"](window, np.random.default_rng(4))
    assert window.beside is not None
    assert window.beside.frequency_hz == pytest.approx(window.wave.frequency_hz)
    assert window.beside.period_mm == window.wave.period_mm
    assert window.beside.angle_deg == -window.wave.angle_deg
    assert (
        turns_off(ARRAY.x_mm, ARRAY.y_mm, window.wave, window.beside.period_mm, window.beside.angle_deg)
        > 0.25
    )


def test_what_is_in_step_has_no_phase_over_the_array() -> None:
    window = perfect(ARRAY, np.random.default_rng(3), 10.0)
    TWO["all in step at the grooves' frequency, at 30 %"](window, np.random.default_rng(4))
    assert window.beside is None
    # Channels differ by when they are sampled alone: 3.5 ms of a second or so.
    assert np.ptp(window.added_volts, axis=1).max() < 0.05 * np.ptp(window.added_volts)


def test_both_gratings_are_found_where_frequencies_differ() -> None:
    found = twofold("second of 1.7 times the frequency, at 50 %", True, 1001)
    assert (found.status, found.is_wrong, found.names_both) == ("ok", False, True)
    assert abs(found.angle_over_sd) < 6


def test_strays_of_taxels_are_alike_in_their_channels() -> None:
    window = perfect(ARRAY, np.random.default_rng(0), 1.0)
    MISFITS["the same, channels of a taxel alike"](window, np.random.default_rng(1))
    by_taxel = window.phase_off_rad.reshape(9, 4)
    assert np.ptp(by_taxel, axis=1).max() < 1e-6
    assert 0.03 < by_taxel[:, 0].std() < 0.3


def test_table_of_two() -> None:
    both = Twofold("x", True, 0, "ok", True, False, True, 0.5, -3.0)
    rows = [both, replace(both, is_wrong=True, names_both=False), replace(both, status="ambiguous")]
    assert "| 2 of 3          | 1     | 2                 | 100 %, 0 %" in two_table(rows)
    assert "| ambiguous 1" in two_table(rows)
    assert "| -                 |" in two_table([replace(both, has_second=False)])


def test_table_of_counts() -> None:
    wrong = replace(RIGHT, is_wrong=True)
    words = count_table([RIGHT], [Counted(0.9, RIGHT), Counted(0.9, wrong), Counted(0.9, wrong)])
    assert "| known   | 3       | 3 (100 %) | 2 " in words
    assert FIRST_SEED > 5000


def aims(
    grid: list[Trial],
    *,
    plates: list[Answered] | None = None,
    drawn: list[Drawn] | None = None,
    misfits: list[Spoiled] | None = None,
) -> str:
    unknown = [replace(t, is_speed_known=False) for t in grid]
    firsts = [First((1.2, 30), "balanced", 0, 2.4)]
    return aims_table(
        grid + unknown, [Counted(0.9, t) for t in grid], plates or [], firsts, drawn or [], misfits or [], []
    )


def line(words: str, begins: str) -> str:
    (found,) = (row for row in words.splitlines() if row.startswith(f"| {begins}"))
    return " ".join(found.split())


def test_aims_that_are_met() -> None:
    off = [3.0 * (k % 20 == 0) for k in range(3000)]
    held = [replace(RIGHT, angle_over_sd=sds, period_over_sd=sds) for sds in off]
    words = aims(held)
    assert "MISSED" not in words
    assert line(words, "error of the angle over its bound, speed known").endswith(
        "| 1.00 (2 s); all 1.00 | met |"
    )
    assert "95.0 % | met |" in line(words, "95 % intervals of the angle hold, white noise, speed known")
    assert "0 of 3000 (95 %: below 1.00 in 1000) | met |" in line(words, "wrong of those that say ok, noise")
    assert "2.4 s, latest of 1 | met |" in line(words, "1.2 mm at 30 deg")


def test_plates_drawn_at_random_must_be_answered() -> None:
    right = Drawn(0, 1.2, 30.0, 10.0, True, "ok", False, 1e-4, 1e-3, 0.1, 0.02)
    short = replace(right, window_s=4.0, status="too-few-periods")
    refused, wrong = replace(right, status="ambiguous"), replace(right, is_wrong=True)
    words = aims([RIGHT], drawn=[right] * 50 + [short] * 10)
    assert line(words, "plates drawn at random: windows of 10 s refused").endswith("| 0 of 50 | met |")
    words = aims([RIGHT], drawn=[right] * 40 + [refused] * 10 + [wrong])
    assert line(words, "plates drawn at random: windows of 10 s refused").endswith("| 10 of 51 | MISSED |")
    assert line(words, "plates drawn at random: wrong of those").endswith("| 1 of 41 | MISSED |")
    firsts = [First((1.2, 30.0), "balanced", 0, 2.4), First((1.3, 20.0), "balanced", 1)]
    words = drawn_table([right, right, refused, wrong, short], firsts)
    assert "| 10 s   | known   | 3 of 4   | 1     | 0.1 um, 0.1 deg | 100 %, 0 %" in words
    assert "too-few-periods 1" in words
    assert "2.4 s after the true onset (1 of 2 plates)" in words


def test_plates_are_drawn_anew_for_each_seed() -> None:
    plates = [plate(seed) for seed in range(50)]
    assert len(set(plates)) == 50
    for (period_mm, angle_deg), again in zip(plates, map(plate, range(50)), strict=True):
        assert (period_mm, angle_deg) == again
        assert PERIODS_MM[0] <= period_mm <= PERIODS_MM[1]
        assert ANGLES_DEG[0] <= angle_deg <= ANGLES_DEG[1]


def test_few_windows_leave_aims_open() -> None:
    words = aims([replace(RIGHT, angle_over_bound=1.3)] * 4)
    assert line(words, "error of the angle over its bound, speed known").endswith("| open |")
    assert line(words, "wrong of those that say ok, noise").endswith("| open |")
    assert line(words, "errors of the period smaller than the procedure's of 10 s: joint, 2 s").endswith(
        "| open |"
    )


def test_aims_that_are_missed() -> None:
    far = [replace(RIGHT, angle_over_bound=1.3, angle_over_sd=2.5)] * 500
    words = aims(far + [replace(RIGHT, is_wrong=True)] * 2)
    assert line(words, "error of the angle over its bound, speed known").endswith("| MISSED |")
    assert line(words, "95 % intervals of the angle hold, white noise, speed known").endswith("| MISSED |")
    assert line(words, "wrong of those that say ok, noise").endswith("| MISSED |")
    plates = [
        Answered((1.2, 30), "procedure", 1, [(1.21, 31.0)]),
        Answered((1.2, 30), "joint, 10 s", 1, [(1.202, 30.05)]),
    ]
    plates.append(replace(plates[1], method="joint, 2 s"))
    words = aims([RIGHT], plates=plates)
    assert "5.0 times (1.2 mm, 30 deg; 1 of 1 plates) | MISSED |" in line(
        words, "errors of the period smaller than the procedure's of 10 s: joint, 10 s"
    )
    lucky = [replace(plates[0], said=[(1.21, 30.0)]), *plates[1:]]
    assert "no plate answered by both | open |" in line(
        aims([RIGHT], plates=lucky), "errors of the angle smaller than the procedure's of 10 s: joint, 10 s"
    )
    bare = aims([RIGHT], misfits=[Spoiled("flat plate", True, 0, "ok", is_wrong=True)])
    assert line(bare, "plates without grooves: answered").endswith("| 1 of 1 | MISSED |")
