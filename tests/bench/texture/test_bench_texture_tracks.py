"""Slides that the bench follows: their windows, bounds and changes."""

import numpy as np
import pytest

from bench.texture.tracks import NOTICED_S, TrackKind, change_trials, track_trials


def test_every_answer_of_a_slide_is_a_window_and_some_have_a_bound() -> None:
    trials = track_trials(TrackKind(30.0), 1)
    ends_s = [t.window_s for t in trials]
    assert np.diff(ends_s) == pytest.approx(np.full(len(ends_s) - 1, 0.2))
    assert ends_s[-1] == pytest.approx(12.2)  # the answer comes 0.4 s later
    bounded = [t for t in trials if np.isfinite(t.angle.bound)]
    assert {t.window_s for t in bounded} == {2.0, 5.0, 8.0, 12.0}
    for trial in bounded:
        assert not trial.is_wrong
        assert abs(trial.angle.error) < 5 * trial.angle.bound
        assert trial.angle.sd == pytest.approx(trial.angle.bound, rel=0.3)
    assert track_trials(TrackKind(30.0), 1) == trials


def test_a_change_is_withdrawn_in_time_and_answered_anew() -> None:
    (trial,) = change_trials("angle 10 degrees more", 1)
    assert 0.0 < trial.after_s <= NOTICED_S
    assert trial.status == "ok"
    assert not trial.is_wrong
    assert abs(trial.angle.error) < 1.0
