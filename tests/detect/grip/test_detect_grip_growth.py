"""Evidence from the course of a growth: a fast rise that stays, Mindlin's curve, an even load."""

import numpy as np
import pytest

from tactiled.array import FloatArray
from tactiled.detect.grip.growth import GrowthEvidence

STEP_S, LOOK_S = 0.01, 0.02


def told(course: FloatArray) -> list[float]:
    """Log odds at each look of a course (n,) of the ratio."""
    growth, out = GrowthEvidence(), []
    for k, size in enumerate(course):
        growth.take(float(size), STEP_S)
        if k % 2:
            out.append(growth.log_odds(1e-3, STEP_S, LOOK_S))
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


def test_the_evidence_fades_and_ends_with_the_level() -> None:
    course = np.concatenate([rise(0.03, slides=True, rest_s=3.0), np.linspace(0.6, 0.3, 30)])
    odds = told(course)
    peak = int(np.argmax(odds))
    assert np.all(np.diff(odds[peak : peak + 60]) <= 0)
    assert odds[peak + 60] < odds[peak] - 1.0
    assert odds[-1] == 0.0
