"""Slides that the bench follows: their windows, bounds and changes."""

import dataclasses
import math

import numpy as np
import pytest

from bench.texture.tables import change_table, track_table
from bench.texture.tracks import CHANGES, NOTICED_S, TrackKind, change_trials, track_trials
from bench.texture.trials import Estimate, Trial


def test_every_answer_of_a_slide_is_a_window_and_some_have_a_bound() -> None:
    trials = track_trials(TrackKind(30.0), [1])
    ends_s = [t.window_s for t in trials]
    assert np.diff(ends_s) == pytest.approx(np.full(len(ends_s) - 1, 0.2))
    assert ends_s[-1] == pytest.approx(12.2)  # the answer comes 0.4 s later
    bounded = [t for t in trials if np.isfinite(t.angle.bound)]
    assert {t.window_s for t in bounded} == {2.0, 5.0, 8.0, 12.0}
    for trial in bounded:
        assert not trial.is_wrong
        assert abs(trial.angle.error) < 5 * trial.angle.bound
        assert trial.angle.sd == pytest.approx(trial.angle.bound, rel=0.3)
    assert track_trials(TrackKind(30.0), [1]) == trials


def test_a_change_is_withdrawn_in_time_and_answered_anew() -> None:
    (trial,) = change_trials("angle 10 degrees more", [1])
    assert 0.0 < trial.after_s <= NOTICED_S
    assert trial.status == "ok"
    assert not trial.is_wrong
    assert abs(trial.angle.error) < 1.0


def test_tables_count_slides_and_say_when_a_change_was_noticed() -> None:
    right = Trial("white noise, 20 dB", 0, 2.0, True, "ok", Estimate(1.0, 0.0, 1.0), Estimate(0.0, 0.0, 1.0))
    wrong = dataclasses.replace(right, seed=1, is_wrong=True)
    row = track_table([right, right, wrong]).splitlines()[-1]
    assert "2 of 2" in row
    assert "1 (in 1 slides)" in row
    bounded = dataclasses.replace(
        right, angle=Estimate(0.0, 0.2, 1.0, 0.1), period=Estimate(1.0, 0.3, 1.0, 0.1)
    )
    assert "| 2.00, 3.00 " in track_table([right, bounded])  # of those that have a bound
    late = [dataclasses.replace(right, name=next(iter(CHANGES)), after_s=s) for s in (0.4, 0.8, math.inf)]
    assert "0.8 s, inf s, inf s" in change_table(late).splitlines()[-1]
