"""Tables, aims and the picture, of trials made by hand."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.report import aims_table
from bench.texture.aims import AIMS
from bench.texture.picture import draw_texture
from bench.texture.tables import (
    TrialSet,
    band_table,
    curve_table,
    drawn_table,
    misfit_table,
    noise_table,
    over_bound_table,
    plate_error_table,
    published_table,
    standing_answers,
    threshold_table,
    two_wave_table,
    within,
)
from bench.texture.trials import CURVE_TIMES_S, Estimate, Trial

NAN = float("nan")


def trial(name: str = "joint", *, over_bound: float = 1.0, over_sd: float = 1.0, known: bool = True) -> Trial:
    """Answer over 1.2 mm at 30 degrees, in a window of 2 s with five periods at 20 dB."""
    period = Estimate(1.2, 1e-3 * over_bound, 1e-3 * abs(over_bound) / over_sd, 1e-3)
    angle = Estimate(30, 0.1 * over_bound, 0.1 * abs(over_bound) / over_sd, 0.1)
    return Trial(name, 0, 2.0, known, "ok", period, angle, snr_db=20.0, periods=5.0)


def off(base: Trial, period_mm: float, angle_deg: float, sd_deg: float = 0.1) -> Trial:
    """Put other errors into an answer."""
    angle = replace(base.angle, error=angle_deg, sd=sd_deg)
    return replace(base, period=replace(base.period, error=period_mm), angle=angle)


def refused(base: Trial, status: str = "ambiguous") -> Trial:
    return replace(off(base, NAN, NAN, NAN), status=status)


RIGHT = trial()
WRONG = replace(RIGHT, is_wrong=True)
FIRST = replace(trial("balanced"), after_s=2.4, window_s=NAN)


def rows(text: str) -> list[list[str]]:
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_wrong_answers_are_counted_and_not_averaged() -> None:
    wrong = off(WRONG, 1e4, 1e4)
    found = TrialSet([RIGHT, trial(over_bound=-1.0), wrong, refused(RIGHT)])
    assert (len(found.all), len(found.ok), found.n_wrong) == (4, 3, 1)
    assert (found.over_bound("angle"), found.over_bound("period")) == (1.0, 1.0)
    assert within([trial(over_sd=3.0), RIGHT], "period") == 0.5
    assert found.refused == "ambiguous 1"


def test_rate_that_is_not_excluded() -> None:
    # No error in n answers: 1 - 0.05^(1/n), near 3 / n.
    assert TrialSet([RIGHT] * 1000).most_wrong == pytest.approx(2.99e-3, abs=1e-5)
    assert TrialSet([]).most_wrong == 1.0


def test_tables_of_the_grid() -> None:
    trials = [RIGHT, trial(over_bound=-1.0), WRONG, refused(RIGHT)]
    assert rows(over_bound_table(trials, True))[2] == ["2 s", "1.00 / 1.00 (75 %)"]
    assert rows(over_bound_table(trials, False))[2] == ["2 s", "-"]
    assert rows(over_bound_table([WRONG], True))[2] == ["2 s", "all 1 wrong"]
    assert rows(band_table(trials))[-1] == ["all", "4", "3 (75 %)", "1.00", "1.00", "100.0 %", "100.0 %", "1"]
    assert rows(threshold_table(trials))[2] == ["2 s", "none", "none"]
    assert rows(threshold_table(trials[:2]))[2] == ["2 s", "20 dB", "none"]


def test_table_of_noises() -> None:
    coloured = [replace(t, name="AR(1), 0.9") for t in (RIGHT, WRONG, WRONG)]
    found = rows(noise_table([RIGHT], coloured))
    assert found[5][:5] == ["AR(1), 0.9: 1 to 2 s, 10 to 20 dB", "known", "3", "3 (100 %)", "2"]


def plates(procedure: tuple[float, float], joint: tuple[float, float]) -> list[Trial]:
    """One window of each method over the plate, with errors of period (mm) and angle (degrees)."""
    methods = {"procedure": procedure, "joint, 10 s": joint, "joint, 2 s": joint}
    return [off(trial(name), *error) for name, error in methods.items()]


def test_tables_of_plates() -> None:
    procedure, ten, two = plates((0.01, 1.0), (0.001, 0.1))
    trials = [procedure, procedure, refused(procedure), ten, refused(two)]
    found = rows(published_table(trials))[2]
    assert found[2] == "1.30 mm, 29.90 deg"
    assert found[3:] == [
        "1.2100 ± 0.0000 mm, 31.000 ± 0.000 deg (2/3)",
        "1.2010 ± 0.0000 mm, 30.100 ± 0.000 deg (1/1)",
        "- (0/1)",
    ]
    assert rows(plate_error_table(trials))[2][-2:] == ["10, 10 times", "-"]


def test_table_of_misfits() -> None:
    right = off(trial("x"), 0.001, 0.1, 0.04)
    wrong = replace(off(right, 9.0, 9.0), is_wrong=True)
    unknown = refused(replace(right, is_speed_known=False))
    assert rows(misfit_table([right, wrong, unknown]))[2] == [
        "x", "2 of 2", "1", "1 um, 0.1 deg", "100 %, 0 %", "0 of 1", "0", "-", "-", "ambiguous 1",
    ]  # fmt: skip


def test_table_of_two_waves() -> None:
    right = off(trial("x"), 5e-4, 0.3)
    trials = [right, replace(right, is_wrong=True), refused(right)]
    assert rows(two_wave_table(trials, 4.0))[2] == [
        "x", "2 of 3", "1", "100 %, 0 %", "0 of 0", "0", "-", "ambiguous 1",
    ]  # fmt: skip
    short = [replace(t, window_s=4.0) for t in trials]
    assert rows(two_wave_table(short, 4.0))[2][:3] == ["x, in 4 s", "2 of 3", "1"]


def a_slide() -> list[Trial]:
    standing = [replace(trial("quick"), window_s=time_s) for time_s in CURVE_TIMES_S]
    standing[:3] = [refused(t, "none") for t in standing[:3]]
    return [*standing, replace(FIRST, name="quick", after_s=2.0)]


def test_curve_of_slides() -> None:
    times = standing_answers(a_slide() + a_slide())["quick"]
    assert [len(times[time_s].ok) for time_s in CURVE_TIMES_S[:4]] == [0, 0, 0, 2]
    assert times[CURVE_TIMES_S[3]].error("period") == pytest.approx(1e-3)
    found = rows(curve_table(a_slide()))
    assert ["2 s", "1.00 um, 0.1000 deg (100 %)", "1.00 um, 0.1000 deg"] in found
    assert ["0.5 s", "-", "1.00 um, 0.1000 deg"] in found
    assert found[-1] == ["quick", "2.0 s", "2.0 s", "2.0 s", "1.00 um, 0.100 deg", "1 of 1"]


def aims(grid: Sequence[Trial], **parts: Sequence[Trial]) -> Mapping[str, str]:
    """Measured words by aim; the grid stands for speed known and not, and for coloured noise."""
    found: dict[str, Sequence[Trial]] = {
        "grid": [*grid, *(replace(t, is_speed_known=False) for t in grid)],
        "coloured noise": [replace(t, name=name) for t in grid for name in ("AR(1), 0.9", "AR(1), 0.97")],
        "plates": [],
        "drawn plates": [],
        "misfits": [],
        "two waves": [],
        "tracks": [replace(t, name="white noise, 20 dB") for t in grid],
        "strays": [],
        "changes": [],
    }
    found |= {name.replace("_", " "): trials for name, trials in parts.items()}
    return {row[0]: row[2] for row in rows(aims_table(AIMS, {"measured": found}))}


def test_aims_that_are_met() -> None:
    held = [trial(over_sd=3.0 if k % 20 == 0 else 0.5) for k in range(3000)]
    words = aims(held, plates=[*plates((0.01, 1.0), (0.001, 0.1)), FIRST])
    assert words["error of the angle over its bound, speed known"] == "met: 1.00 (2 s); all 1.00"
    assert words["95 % intervals of the angle hold, white noise, speed known"] == "met: 95.0 %"
    assert words["wrong answers, AR(1), 0.9"] == "met: 0 of 3000 (95 %: below 1.00 in 1000)"
    assert words["error of the angle over its bound, followed slides"] == "met: 1.00 (3000 windows)"
    assert words["wrong answers, followed slides"] == "met: 0 of 3000"
    assert words["1.2 mm at 30 deg, balanced: first answer after slip began"] == "met: 2.4 s, latest of 1"
    assert not any("MISSED" in measured for measured in words.values())


def test_few_windows_leave_aims_open() -> None:
    words = aims([trial(over_bound=1.3)] * 4)
    assert words["error of the angle over its bound, speed known"].startswith("open")
    assert words["wrong answers, AR(1), 0.97"].startswith("open")
    name = "errors of the period smaller than the procedure's of 10 s: joint, 2 s"
    assert words[name] == "open: no plate answered by both"


def test_aims_that_are_missed() -> None:
    far = [trial(over_bound=1.3, over_sd=2.5)] * 500 + [WRONG] * 2
    flat = replace(WRONG, name="flat plate")
    words = aims(far, plates=plates((0.01, 1.0), (0.002, 0.05)), misfits=[flat])
    assert words["error of the angle over its bound, speed known"].startswith("MISSED")
    assert words["95 % intervals of the angle hold, white noise, speed known"].startswith("MISSED")
    assert words["wrong answers, white noise"].startswith("MISSED")
    assert words["wrong answers, followed slides"].startswith("MISSED")
    late = aims(far, changes=[replace(RIGHT, after_s=after_s) for after_s in (0.8, 2.0)])
    assert late["grooves that change are noticed"] == "MISSED: latest 2.0 s, 1 of 2 later"
    name = "errors of the {} smaller than the procedure's of 10 s: joint, 10 s"
    assert words[name.format("period")] == "MISSED: 5.0 times (1.2 mm, 30 deg; 1 of 1 plates)"
    assert words["plates without grooves: answered"] == "MISSED: 1 of 1"
    exact = aims([RIGHT], plates=plates((0.01, 0.0), (0.002, 0.05)))
    assert exact[name.format("angle")] == "open: no plate answered by both"


def test_strayed_channels_must_be_answered_at_either_speed() -> None:
    name = "strays of 0.13 rad: answered"
    known = replace(RIGHT, name="channels 0.13, taxels 0 rad")
    unknown = replace(known, is_speed_known=False)
    met = aims([RIGHT], strays=[known] * 100 + [unknown] * 100)[name]
    assert met == "met: 100 % of 200 (speed known 100 %, speed unknown 100 %)"
    missed = aims([RIGHT], strays=[known] * 100 + [unknown] * 50 + [refused(unknown)] * 50)[name]
    assert missed == "MISSED: 75 % of 200 (speed known 100 %, speed unknown 50 %)"


def test_plates_drawn_at_random_must_be_answered() -> None:
    right = replace(off(trial("drawn plate"), 1e-4, 0.1, 0.02), window_s=10.0)
    short = refused(replace(right, window_s=4.0), "too-few-periods")
    none, wrong = refused(right), replace(right, is_wrong=True)
    name = "plates drawn at random: windows of 10 s refused"
    assert aims([RIGHT], drawn_plates=[right] * 50 + [short] * 10)[name] == "met: 0 of 50"
    words = aims([RIGHT], drawn_plates=[right] * 40 + [none] * 10 + [wrong])
    assert words[name] == "MISSED: 10 of 51"
    assert words["plates drawn at random: wrong answers"] == "MISSED: 1 of 41"
    late = replace(refused(FIRST), after_s=np.inf)
    text = drawn_table([right, right, none, wrong, short, FIRST, late])
    assert rows(text)[2] == ["10 s", "known", "3 of 4", "1", "0.1 um, 0.1 deg", "100 %, 0 %", "ambiguous 1"]
    assert "2.4 s after the true onset (1 of 2 plates)" in text


def test_the_picture_is_written(tmp_path: Path) -> None:
    cells = [(w, snr, known) for w in (1.0, 2.0) for snr in (0.0, 20.0) for known in (True, False)]
    grid = [replace(trial(known=known), window_s=w, snr_db=snr) for w, snr, known in cells]
    procedure, ten, _ = plates((0.01, 1.0), (0.001, 0.1))
    trials = {"grid": grid, "plates": [procedure, refused(ten)], "slides": a_slide()}
    draw_texture(tmp_path / "texture.png", trials)
    assert (tmp_path / "texture.png").stat().st_size > 1000
