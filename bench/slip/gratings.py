"""Slides over gratings on an even, smooth surface: only the ripple of the ridges shows that the skin slides.

Shear grows by Mindlin's curve to the friction limit and stays there, each channel with the ripple of a plane
wave. What is asked is whether the slide is told, and whether the groove estimator gets a window that it
answers.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bench.report import ratio
from tactiled.array import FloatArray, load_array
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.events.types import GripEvent, TextureEvent
from tactiled.samples.block import ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
RATE_HZ, LENGTH_S = 100.0, 20.0
GRATINGS_FROM = 0  # seeds
_PERIODS = 4  # that the narrowest window holds
_RIGHT = 0.02  # of the period, within which an answer is right


@dataclass(frozen=True)
class GratingSlide:
    """Scans of a slide and its truth."""

    block: ScanBlock
    start_s: float  # from which all of the contact slides, to the end
    speed_mm_s: float
    period_mm: float
    # ripple_hz, ripple_db: frequency of the ripple, and its power over that of the noise in a scan
    ripple_hz: float
    ripple_db: float


@dataclass(frozen=True)
class GratingAnswer:
    """Answers of the detectors to a slide over a grating that takes `slide_s`, in `periods` of the ripple."""

    slide_s: float
    periods: float
    told_s: float
    is_answered: bool
    is_wrong: bool


def draw_slide(seed: int) -> GratingSlide:
    """Draw a slide: 5 to 24 dB, 1 to 3 mm, 0.6 to 2.5 mm/s, directions at random."""
    rng = np.random.default_rng([27, seed])
    ripple_db, noise = rng.uniform(5, 24), rng.uniform(5e-4, 2e-3)
    amplitude = noise * math.sqrt(2 * 10 ** (ripple_db / 10))
    speed_mm_s, period_mm = rng.uniform(0.6, 2.5), rng.uniform(1.0, 3.0)
    grooves, motion = np.radians(rng.uniform(-60, 60)), np.radians(rng.uniform(-180, 180))
    pull_s, takes_s = rng.uniform(2.0, 4.0), rng.uniform(0.2, 1.0)
    friction, load = rng.uniform(0.3, 1.0), rng.uniform(0.6, 1.5)
    time_s = np.arange(round(LENGTH_S * RATE_HZ)) / RATE_HZ
    pressed = load * np.clip((time_s - 0.5) / 0.4, 0, 1)
    used = 1 - (1 - np.clip((time_s - pull_s) / takes_s, 0, 1)) ** 1.5
    part = np.repeat(1 + 0.15 * rng.normal(size=ARRAY.n_taxels), 4) * (1 + 0.05 * rng.normal(size=36))
    along = np.array([np.cos(motion), np.sin(motion)]) @ np.sign(ARRAY.shear_weights().sum(axis=1))
    start_s = pull_s + takes_s
    travel_mm = speed_mm_s * np.maximum(time_s - start_s, 0.0)
    x_mm, y_mm = (places[ARRAY.channel_taxel] for places in (ARRAY.x_mm, ARRAY.y_mm))
    across_mm = np.cos(grooves) * x_mm + np.sin(grooves) * y_mm
    moved_mm = np.cos(motion - grooves) * travel_mm[:, np.newaxis]
    # Sides of a taxel feel a ridge one after the other: each kind of side has a phase of its own.
    phase = 2 * np.pi * (across_mm + moved_mm) / period_mm + np.tile(rng.uniform(0, 2 * np.pi, 4), 9)
    ripple = amplitude * rng.uniform(0.6, 1.4, 36) * np.cos(phase) * (pressed / load)[:, np.newaxis]
    volts: FloatArray = pressed[:, np.newaxis] * part * (1 + (used * friction / 2)[:, np.newaxis] * along)
    volts = volts + ripple + noise * rng.normal(size=ripple.shape)
    ripple_hz = abs(speed_mm_s * np.cos(motion - grooves) / period_mm)
    return GratingSlide(
        regular_block(volts, RATE_HZ), start_s, speed_mm_s, period_mm, float(ripple_hz), ripple_db
    )


def read_grating(seed: int) -> GratingAnswer:
    """Run the detectors over a slide whose speed is known."""
    slide = draw_slide(seed)
    suite = build_suite(ARRAY, DetectParams())
    assert suite.texture is not None  # it is asked for
    suite.texture.set_speed(slide.speed_mm_s, 0)
    events = suite.process(slide.block)
    gross = [event for event in events if isinstance(event, GripEvent) and event.state == "gross"]
    periods_mm = [
        event.period_mm for event in events if isinstance(event, TextureEvent) and event.status == "ok"
    ]
    is_right = [abs(period_mm / slide.period_mm - 1) < _RIGHT for period_mm in periods_mm]
    told_s = sum(event.time_s > slide.start_s for event in gross) / RATE_HZ
    slide_s = LENGTH_S - slide.start_s
    return GratingAnswer(slide_s, slide.ripple_hz * slide_s, told_s, any(is_right), not all(is_right))


def rows(found: Sequence[GratingAnswer]) -> Iterator[dict[str, str]]:
    """Yield the rows of the table, by the number of periods in the slide."""
    for name, low, high in (
        (f"fewer than {_PERIODS} periods", 0, _PERIODS),
        (f"{_PERIODS} to {2 * _PERIODS}", _PERIODS, 2 * _PERIODS),
        (f"more than {2 * _PERIODS}", 2 * _PERIODS, math.inf),
        ("all", 0, math.inf),
    ):
        some = [one for one in found if low <= one.periods < high]
        if some:
            whole_s = sum(one.slide_s for one in some)
            yield {
                "slides": name,
                "number": f"{len(some)}",
                "reported as gross": ratio([one.told_s > 0 for one in some]),
                "part of their time": f"{sum(one.told_s for one in some) / whole_s:.2f}",
                "grooves answered": ratio([one.is_answered for one in some]),
                "wrong": ratio([one.is_wrong for one in some]),
            }
