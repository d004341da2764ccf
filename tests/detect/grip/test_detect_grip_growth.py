"""Evidence from the course of a growth: a fast rise that stays, Mindlin's curve, an even load."""

import numpy as np
import pytest

from tactiled.array import FloatArray
from tactiled.detect.grip.growth import GrowthEvidence

STEP_S, LOOK_S = 0.01, 0.02


def told(course: FloatArray, noise: float = 1e-3) -> list[float]:
    """Log odds up to each look of a course (n,) of the ratio."""
    growth, out = GrowthEvidence(), [0.0]
    for k, size in enumerate(course):
        growth.take(float(size), STEP_S)
        if k % 2:
            out.append(out[-1] + growth.log_odds(noise, STEP_S))
    return out


def rise(took_s: float, *, slides: bool, rest_s: float = 1.0) -> FloatArray:
    """Ratio that rests, grows evenly or by Mindlin's curve, and stays at 0.6."""
    x = np.clip(np.arange(-0.3, took_s + rest_s, STEP_S) / took_s, 0.0, 1.0)
    return np.asarray(0.6 * (1 - (1 - x) ** 1.5 if slides else x))


@pytest.mark.parametrize("slides", [False, True])
def test_the_faster_a_ratio_grew_the_more_it_speaks_for_sliding(slides: bool) -> None:
    peaks = [max(told(rise(took_s, slides=slides))) for took_s in (0.03, 0.1, 0.3)]
    assert peaks[0] > peaks[1] > peaks[2]
    assert peaks[0] > 2.0


@pytest.mark.parametrize("took_s", [0.2, 0.4, 0.8])
def test_mindlins_curve_speaks_for_sliding_more_than_an_even_growth(took_s: float) -> None:
    slide, even = (told(rise(took_s, slides=slides)) for slides in (True, False))
    assert max(slide) > max(max(even), 0.0) + 1.0


def test_nothing_is_told_while_the_ratio_grows_or_swings() -> None:
    time_s = np.arange(0, 4, STEP_S)
    assert not any(told(0.2 * time_s))
    assert not any(told(0.4 * np.abs(np.sin(2 * np.pi * 0.8 * time_s))))


@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 2.5])
def test_swings_are_no_growths_that_stay_though_readings_are_noisy(rate_hz: float) -> None:
    rng, time_s = np.random.default_rng(1), np.arange(0, 4, STEP_S)
    swing = 0.6 * np.abs(np.sin(2 * np.pi * rate_hz * time_s)) + 3e-3 * rng.standard_normal(len(time_s))
    assert max(told(swing, noise=3e-3)) < 1.0


def test_a_growth_counts_once_and_the_next_one_again() -> None:
    one = rise(0.03, slides=True, rest_s=3.0)
    odds = told(one)
    assert odds[-1] == pytest.approx(max(odds), abs=0.1)
    again = told(np.concatenate([one, np.linspace(0.6, 0.1, 30), one + 0.1]))
    assert again[-1] > odds[-1] + 1.0
