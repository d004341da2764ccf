"""Answers are compared with the truth, and the same seed gives the same trial."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.texture import trials
from bench.texture.grooveless import SURFACES
from bench.texture.signal import Grating, Wave, bound, draw_grating
from bench.texture.tables import TrialSet
from bench.texture.trials import Trial, compare, grid_trial, grooveless_trial, turns_off
from tactiled.array import load_array
from tactiled.detect.grooves.outcome import GrooveAnswer, Refusal

ARRAY = load_array("wang2019-3x3")


def grating(seed: int = 0, window_s: float = 2.0) -> Grating:
    return draw_grating(np.random.default_rng(seed), window_s, 20.0, 3.0)


def answer(wave: Wave, period_mm: float = 0.0, angle_deg: float = 0.0) -> GrooveAnswer:
    """Answer that is off the truth by so much, its sigmas 0.001 mm and 0.01 degrees."""
    return GrooveAnswer(
        frequency_hz=wave.frequency_hz,
        snr_db=20.0,
        period_mm=wave.period_mm + period_mm,
        angle_deg=wave.angle_deg + angle_deg,
        speed_mm_s=wave.speed_mm_s,
        covariance=np.diag([0.001, np.radians(0.01), 0.0]) ** 2,
        uses_given_speed=True,
    )


def compared(found: GrooveAnswer | Refusal, of: Grating) -> Trial:
    least = bound(of.wave, of.sensed, of.time_s, is_speed_known=True)
    return compare(found, of.wave, least, window_s=2.0, is_speed_known=True)


def test_the_truth_has_no_error() -> None:
    of = grating()
    found = compared(answer(of.wave), of)
    assert (found.angle.error, found.period.error, found.is_wrong) == (0.0, 0.0, False)
    assert of.periods >= 3


def test_errors_stand_beside_bound_and_stated_sigma() -> None:
    of = grating()
    least = bound(of.wave, of.sensed, of.time_s, is_speed_known=True)
    found = compared(answer(of.wave, 3 * least.period_sd_mm, -2 * least.angle_sd_deg), of)
    assert found.period.error / found.period.bound == pytest.approx(3)
    assert found.angle.error / found.angle.bound == pytest.approx(-2)
    assert (found.period.sd, found.angle.sd) == pytest.approx((0.001, 0.01))
    assert not found.is_wrong


def test_another_lobe_is_wrong_and_a_refusal_is_not() -> None:
    of = grating()
    # A wave vector that differs by a turn over the gap of 3.5 mm along y.
    angle = np.radians(of.wave.angle_deg)
    per_mm = np.array([np.cos(angle), np.sin(angle)]) / of.wave.period_mm + [0.0, 1 / 3.5]
    lobe = replace(
        answer(of.wave),
        period_mm=float(1 / np.hypot(*per_mm)),
        angle_deg=float(np.degrees(np.arctan2(per_mm[1], per_mm[0]))),
    )
    assert compared(lobe, of).is_wrong
    refused = compared(Refusal("ambiguous"), of)
    assert (refused.status, refused.is_wrong) == ("ambiguous", False)
    assert np.isnan(refused.period.error)


@given(period_mm=st.floats(0.6, 6.0), angle_deg=st.floats(-75, 75))
def test_turns_off_knows_no_sense_of_the_normal(period_mm: float, angle_deg: float) -> None:
    wave = Wave(period_mm, angle_deg, 1.0)
    assert turns_off(wave, period_mm, angle_deg) == 0
    assert turns_off(wave, period_mm, angle_deg + 180) == pytest.approx(0, abs=1e-9)
    assert turns_off(wave, period_mm, angle_deg + 60) > 0.25


def test_the_same_seed_is_the_same_trial() -> None:
    first = grid_trial(1.0, 20.0, True, 3)
    assert first == grid_trial(1.0, 20.0, True, 3)
    assert first != grid_trial(1.0, 20.0, True, 4)


def test_clean_windows_are_answered_near_the_bound() -> None:
    cells = [(known, seed) for known in (True, False) for seed in range(4)]
    found = TrialSet(grid_trial(2.0, 20.0, known, seed) for known, seed in cells)
    assert len(found.right) == len(found.all)
    # 16 errors of a sigma each: twice that is beyond any luck.
    assert found.over_bound("angle") < 2
    assert found.over_bound("period") < 2


def test_an_answer_without_grooves_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as answered:
        answered.setattr(trials, "joint", lambda *_, **__: answer(grating().wave))
        found = grooveless_trial(next(iter(SURFACES)), True, 0)
    assert (found.status, found.is_wrong) == ("ok", True)
    for name in SURFACES:
        found = grooveless_trial(name, True, 0)
        assert found.status != "ok"
        assert not found.is_wrong


def test_slow_lines_of_fine_sand_paper_are_no_grooves() -> None:
    """A Hann spectrum alone takes this one for a grating of few periods."""
    assert not grooveless_trial("sand paper, grain 0.3 mm", True, 27).is_wrong
