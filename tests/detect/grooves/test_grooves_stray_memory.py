"""What slides tell of the strays of an array, beside strays that were drawn."""

import dataclasses

import numpy as np
import pytest

from bench.texture.learnt import SLIDES, LearntKind, learnt_trials
from tactiled.array import load_array
from tactiled.detect.grooves.model import ChannelLayout, WaveMotion, channel_layout
from tactiled.detect.grooves.stray_memory import LOG_PRIOR, MOST_MODELS, LearntStrays
from tactiled.detect.grooves.strays import StrayPosterior, weigh_waves

LAYOUT = channel_layout(load_array("wang2019-3x3"))
UNKNOWN = WaveMotion(0.0, 0.0, 0.0, 1.5)
ALONG_X = WaveMotion(2.0, 0.0, 0.0, 1.5)
NOISE = 0.01
OMEGA = 12.0


def centred(x_mm: np.ndarray, y_mm: np.ndarray) -> ChannelLayout:
    return ChannelLayout(x_mm - x_mm.mean(), y_mm - y_mm.mean(), LAYOUT.kind)


SKIN = centred(LAYOUT.x_mm, LAYOUT.y_mm)


def places(layout: ChannelLayout) -> np.ndarray:
    return np.stack([layout.x_mm, layout.y_mm], axis=1)


def slide(
    rng: np.random.Generator,
    layout: ChannelLayout,
    k: np.ndarray,
    stray: np.ndarray,
    motion: WaveMotion = UNKNOWN,
    omega: float = OMEGA,
) -> StrayPosterior:
    """Weigh the first of some waves, which is true, against the others."""
    z = np.exp(1j * (places(layout) @ k[0] + layout.kind + stray))
    z = z + NOISE * (rng.normal(size=36) + 1j * rng.normal(size=36))
    return weigh_waves(z, np.full(36, NOISE**2), layout, k, motion, float(k[0, 0]), 0.05, omega)


def draw_waves(rng: np.random.Generator, pitch_mm: float = 3.65) -> np.ndarray:
    """Draw a wave, with its rivals along x and y."""
    k = np.array([rng.uniform(2, 6), rng.uniform(-3, 3)])
    steps = np.array([[0, 0], [1, 0], [0, 1], [0, -1], [1, 1], [1, -1]])
    return np.asarray(k + 2 * np.pi / pitch_mm * steps)


def after(layout: ChannelLayout, found: StrayPosterior) -> ChannelLayout:
    return dataclasses.replace(layout, strays=found.learn())


def test_a_slide_at_known_speed_settles_the_next_ones_without_it() -> None:
    rng = np.random.default_rng(1)
    alone, later = [], []
    for _ in range(20):
        stray = 0.25 * rng.normal(size=36)
        known = slide(rng, SKIN, draw_waves(rng)[:2], stray, ALONG_X)
        k = draw_waves(rng)
        alone.append(slide(rng, SKIN, k, stray).weights[0])
        later.append((slide(rng, after(SKIN, known), k, stray).weights[0], known.weights[0]))
    sure = [weight for weight, before in later if before > 0.99]
    assert np.mean(np.array(alone) > 0.99) < 0.2
    assert len(sure) > 5
    assert min(sure) > 0.98


def test_an_alias_that_nothing_tells_apart_stays_as_likely_however_often_strays_repeat() -> None:
    """On a regular array, strays that were computed from the alias repeat just as well."""
    rng, regular = np.random.default_rng(2), centred(3.5 * np.round(LAYOUT.x_mm / 3.6), LAYOUT.y_mm)
    layout, stray = regular, 0.05 * rng.normal(size=36)
    for _ in range(4):
        k = draw_waves(rng, 3.5)[:2]
        found = slide(rng, layout, k, stray, WaveMotion())
        assert found.weights.max() < 0.6
        layout = after(layout, found)


def test_strays_that_are_redrawn_are_not_believed_to_repeat() -> None:
    rng = np.random.default_rng(3)
    layout = SKIN
    for _ in range(5):
        found = slide(rng, layout, draw_waves(rng)[:1], 0.1 * rng.normal(size=36))
        layout = after(layout, found)
    assert layout.strays is not None
    assert layout.strays.repeat < 0.05
    # The next slide is weighed as if only the standard deviations were known.
    only = dataclasses.replace(SKIN, strays=dataclasses.replace(layout.strays, models=()))
    k, stray = draw_waves(rng), 0.13 * rng.normal(size=36)
    weights = [slide(np.random.default_rng(4), each, k, stray).weights for each in (layout, only)]
    assert weights[0] == pytest.approx(weights[1], abs=1e-3)


@pytest.mark.parametrize("cause", ["phase", "offset", "delay"])
def test_the_cause_is_found_and_foretells_strays_of_another_slide(cause: str) -> None:
    """Apart from phases of kinds and gradients, which each slide absorbs."""
    rng = np.random.default_rng(5)
    one, other = 0.12 * rng.normal(size=(2, 36))

    def stray(k: np.ndarray, omega: float) -> np.ndarray:
        along = (one * k[0] + other * k[1]) / 4
        return np.asarray({"phase": one, "offset": along, "delay": one * omega / OMEGA}[cause])

    layout = SKIN
    for omega in (8.0, 20.0, 12.0, 30.0):
        k = draw_waves(rng)[:1]
        layout = after(layout, slide(rng, layout, k, stray(k[0], omega), omega=omega))
    assert layout.strays is not None
    best = max(layout.strays.models, key=lambda model: model.log_weight)
    k, omega = np.array([3.0, 2.5]), 25.0
    design = np.concatenate([SKIN.is_kind, places(SKIN)], axis=1)
    free = np.eye(36) - design @ np.linalg.pinv(design)
    expected = best.mean(np.array([[1.0, *k, omega]]))[:, 0]
    left = free @ (expected - stray(k, omega))
    assert np.linalg.norm(left) < 0.25 * np.linalg.norm(free @ stray(k, omega))


def test_channels_that_were_not_seen_before_begin_anew() -> None:
    found = slide(np.random.default_rng(6), SKIN, draw_waves(np.random.default_rng(6))[:1], np.zeros(36))
    learnt = found.learn()
    some = learnt.among(np.arange(0, 36, 2))
    assert len(some.models) == len(learnt.models) > 0
    assert some.models[0].constants == pytest.approx(learnt.models[0].constants[::2])
    assert not some.among(np.arange(36)).models
    assert not LearntStrays(np.arange(5), LOG_PRIOR).among(np.arange(3, 9)).models


def test_slides_of_the_bench_after_one_at_known_speed_are_answered_and_right() -> None:
    kind = LearntKind("phase", 0.2, "turned", "speed known once")
    trials = learnt_trials(kind, [3])
    assert len(trials) == SLIDES
    assert not any(trial.is_wrong for trial in trials)
    assert sum(trial.status == "ok" for trial in trials) >= SLIDES - 3


def test_hypotheses_stay_bounded_over_many_slides() -> None:
    rng = np.random.default_rng(7)
    stray, layout = 0.1 * rng.normal(size=36), SKIN
    for _ in range(150):
        layout = after(layout, slide(rng, layout, draw_waves(rng)[:2], stray))
    learnt = layout.strays
    assert learnt is not None
    assert 0 < len(learnt.models) <= MOST_MODELS
    assert sum(np.exp(model.log_weight) for model in learnt.models) == pytest.approx(1)
    for model in learnt.models:
        assert (np.diag(model.covariance) <= model.prior * (1 + 1e-9)).all()
        assert np.linalg.eigvalsh(model.covariance).min() > -1e-9
        assert np.abs(model.constants).max() < 1
