"""How windows are scored, and what the tables make of the scores."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.texture.answers import Answer, faithful
from bench.texture.bench import _plain
from bench.texture.bound import Wave, bound
from bench.texture.grid import Trial, scored, summary, trial, turns_off
from bench.texture.paper import Answered, errors2, table2
from bench.texture.signal import ANGLES_DEG, PERIODS_MM, Case, draw_case, draw_wave, readings
from bench.texture.tables import by_band, over_bound, refusals, threshold, wrong_rate
from tactiled.array import load_array

ARRAY = load_array("wang2019-3x3")


def case(seed: int = 0, window_s: float = 2.0) -> Case:
    return draw_case(ARRAY, np.random.default_rng(seed), window_s, 20.0, 3.0)


def right(of: Case) -> Answer:
    return Answer("ok", of.wave.period_mm, 0.001, of.wave.angle_deg, 0.01)


def test_the_truth_has_no_error() -> None:
    of = case()
    found = scored(of, right(of), 2.0, 20.0, True, 0)
    assert (found.angle_over_bound, found.period_over_bound, found.is_wrong) == (0.0, 0.0, False)
    assert found.periods >= 3


def test_errors_count_over_bound_and_over_stated_sigma() -> None:
    of = case()
    least = bound(of.wave, of.sensed, of.time_s, is_speed_known=True)
    off = replace(
        right(of),
        period_mm=of.wave.period_mm + 3 * least.period_sd_mm,
        angle_deg=of.wave.angle_deg - 2 * least.angle_sd_deg,
    )
    found = scored(of, off, 2.0, 20.0, True, 0)
    assert found.period_over_bound == pytest.approx(3)
    assert found.angle_over_bound == pytest.approx(-2)
    assert found.period_over_sd == pytest.approx(3 * least.period_sd_mm / 0.001)
    assert found.angle_over_sd == pytest.approx(-2 * least.angle_sd_deg / 0.01)
    assert not found.is_wrong


def test_another_lobe_is_wrong_and_a_refusal_is_not() -> None:
    of = case()
    # A wave vector that differs by a turn over the gap of 3.5 mm along y.
    angle = np.radians(of.wave.angle_deg)
    per_mm = np.array([np.cos(angle), np.sin(angle)]) / of.wave.period_mm + [0.0, 1 / 3.5]
    lobe = replace(
        right(of),
        period_mm=float(1 / np.hypot(*per_mm)),
        angle_deg=float(np.degrees(np.arctan2(per_mm[1], per_mm[0]))),
    )
    assert scored(of, lobe, 2.0, 20.0, True, 0).is_wrong
    assert not scored(of, Answer("ambiguous"), 2.0, 20.0, True, 0).is_wrong


@given(period_mm=st.floats(0.6, 6.0), angle_deg=st.floats(-75, 75))
def test_turns_off_knows_no_sense_of_the_normal(period_mm: float, angle_deg: float) -> None:
    x, y = ARRAY.x_mm, ARRAY.y_mm
    wave = Wave(period_mm, angle_deg, 1.0)
    assert turns_off(x, y, wave, period_mm, angle_deg) == 0
    assert turns_off(x, y, wave, period_mm, angle_deg + 180) == pytest.approx(0, abs=1e-9)
    assert turns_off(x, y, wave, period_mm, angle_deg + 60) > 0.25


@given(st.integers(0, 500))
def test_gratings_are_those_of_the_grid(seed: int) -> None:
    wave = draw_wave(np.random.default_rng(seed))
    assert PERIODS_MM[0] <= wave.period_mm <= PERIODS_MM[1]
    assert abs(wave.angle_deg - wave.direction_deg) <= ANGLES_DEG[1]
    assert 0 < wave.frequency_hz < 20  # 75 degrees or less: the skin crosses grooves forwards


def test_the_same_seed_is_the_same_trial() -> None:
    first = trial("joint", 1.0, 20.0, True, 3)
    assert first == trial("joint", 1.0, 20.0, True, 3)
    assert first != trial("joint", 1.0, 20.0, True, 4)


def test_clean_windows_are_answered_near_the_bound() -> None:
    found = [trial("joint", 2.0, 20.0, known, seed) for known in (True, False) for seed in range(4)]
    assert all(t.is_ok and not t.is_wrong for t in found)
    # 16 errors of a sigma each: twice that is beyond any luck.
    assert summary(found).angle < 2
    assert summary(found).period < 2


def test_procedure_needs_the_speed() -> None:
    of = case(1, 10.0)
    volts = readings(of, np.random.default_rng(0))
    assert faithful(of, volts, False).status == "no-slip"
    assert faithful(of, volts, True).status != "no-slip"


def some_trials() -> list[Trial]:
    known = Trial(2.0, 20.0, True, 0, 5.0, 1.2, 30.0, "ok", 1.0, -2.0, 1.0, 3.0)
    wrong = replace(known, angle_over_bound=1e5, is_wrong=True)
    return [known, replace(known, angle_over_bound=-1.0), wrong, replace(known, status="ambiguous")]


def test_wrong_answers_are_counted_and_not_averaged() -> None:
    found = summary(some_trials())
    assert (found.trials, found.ok, found.wrong) == (4, 3, 1)
    assert (found.angle, found.period) == (1.0, 2.0)
    assert (found.angle_within, found.period_within) == (1.0, 0.0)
    assert wrong_rate(some_trials()).startswith("Wrong ambiguity: 1 of 3 ")
    assert refusals(some_trials()) == "Refused: ambiguous 1."


def test_rate_that_is_not_excluded() -> None:
    # No error in n answers: 1 - 0.05^(1/n), near 3 / n.
    ok = some_trials()[0]
    assert "below 2.99 in 1000" in wrong_rate([ok] * 1000)
    assert "below 1000.00 in 1000" in wrong_rate([])


def test_tables_of_trials() -> None:
    trials = some_trials()
    assert "| 2 s    | 1.00 / 2.00 (75 %) |" in over_bound(trials, True)
    assert "| 2 s    | -" in over_bound(trials, False)
    assert "| all " in by_band(trials)
    assert "none" in threshold(trials)
    assert "20 dB" in threshold(trials[:2])


def test_tables_of_plates() -> None:
    plate = (1.2, 30)
    rows = [
        Answered(plate, "procedure", 3, [(1.21, 31.0), (1.21, 31.0)]),
        Answered(plate, "joint, 10 s", 3, [(1.201, 30.1)]),
        Answered(plate, "joint, 2 s", 19, []),
    ]
    assert list(rows[0].errors()) == pytest.approx([0.01, 1.0])
    assert "1.2100 ± 0.0000 mm, 31.000 ± 0.000 deg (2/3)" in table2(rows)
    assert "1.30 mm, 29.90 deg" in table2(rows)
    assert "| 10, 10 times    | - " in errors2(rows)


def test_numbers_survive_json() -> None:
    plain = _plain({"a": (np.float64(1.5), float("nan")), "b": [np.inf, np.int64(2)], "c": {"d": True}})
    assert json.loads(json.dumps(plain, allow_nan=False)) == {
        "a": [1.5, None],
        "b": [None, 2],
        "c": {"d": True},
    }
