"""Tables and aims, of trials made by hand."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import pytest

from bench.texture import tables
from bench.texture.tables import TrialSet
from bench.texture.trials import Estimate, Trial

NAN = float("nan")


def trial(*, over_bound: float = 1.0, over_sd: float = 1.0) -> Trial:
    """Answer in a window of 2 s with five periods at 20 dB."""
    period = Estimate(1e-3 * over_bound, 1e-3 * abs(over_bound) / over_sd, 1e-3)
    angle = Estimate(0.1 * over_bound, 0.1 * abs(over_bound) / over_sd, 0.1)
    return Trial(2.0, True, "ok", period, angle, snr_db=20.0, periods=5.0)


def off(base: Trial, period_mm: float, angle_deg: float, sd_deg: float = 0.1) -> Trial:
    """Put other errors into an answer."""
    angle = replace(base.angle, error=angle_deg, sd=sd_deg)
    return replace(base, period=replace(base.period, error=period_mm), angle=angle)


def refused(base: Trial, status: str = "ambiguous") -> Trial:
    return replace(off(base, NAN, NAN, NAN), status=status)


RIGHT = trial()
WRONG = replace(RIGHT, is_wrong=True)


def test_wrong_answers_are_counted_and_not_averaged() -> None:
    wrong = off(WRONG, 1e4, 1e4)
    found = TrialSet([RIGHT, trial(over_bound=-1.0), wrong, refused(RIGHT)])
    assert (len(found.all), len(found.ok), found.n_wrong) == (4, 3, 1)
    assert (found.over_bound("angle"), found.over_bound("period")) == (1.0, 1.0)
    assert TrialSet([trial(over_sd=3.0), RIGHT]).within("period") == 0.5


def test_rate_that_is_not_excluded() -> None:
    # No error in n answers: 1 - 0.05^(1/n), near 3 / n.
    assert TrialSet([RIGHT] * 1000).most_wrong == pytest.approx(2.99e-3, abs=1e-5)
    assert TrialSet([]).most_wrong == 1.0


def aims(grid: Sequence[Trial], grooveless: Sequence[Trial] = ()) -> Mapping[str, str]:
    """Measured words by aim; the grid stands for speed known and not."""
    found = {"grid": [*grid, *(replace(t, is_speed_known=False) for t in grid)], "grooveless": grooveless}
    return {aim.name: f"{aim.verdict}: {aim.words}" for aim in tables.aims(found)}


def test_aims_that_are_met() -> None:
    held = [trial(over_sd=3.0 if k % 20 == 0 else 0.5) for k in range(3000)]
    words = aims(held)
    assert words["angle: error over its bound, speed known"] == "met: 1.00 (2 s; all 1.00)"
    assert words["angle: truth within 95 % intervals, speed known"] == "met: 95.0 %"
    assert words["wrong answers, white noise"] == "met: 0 of 6000 (95 %: below 0.50 in 1000)"
    assert not any("MISSED" in measured for measured in words.values())


def test_aims_without_answers_are_open() -> None:
    assert all(words.startswith("open") for words in aims([refused(RIGHT)] * 40).values())


def test_few_windows_leave_aims_open() -> None:
    words = aims([trial(over_bound=1.3)] * 4)
    assert words["angle: error over its bound, speed known"].startswith("open")
    assert words["wrong answers, white noise"].startswith("open")


def test_aims_that_are_missed() -> None:
    far = [trial(over_bound=1.3, over_sd=2.5)] * 500 + [WRONG] * 2
    words = aims(far, grooveless=[WRONG])
    assert words["angle: error over its bound, speed known"].startswith("MISSED")
    assert words["angle: truth within 95 % intervals, speed known"].startswith("MISSED")
    assert words["wrong answers, white noise"].startswith("MISSED")
    assert words["surfaces without grooves: answered"] == "MISSED: 1 of 1"
