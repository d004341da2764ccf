"""Readings of an array that slides over gratings modelled as plane waves, and their joint fit."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from tactiled.array import Array, ArrayFile, FloatArray, Grid, TaxelChannel, build, load_array
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import ChannelLayout, WaveMotion, channel_layout
from tactiled.detect.grooves.outcome import GrooveAnswer, Outcome, Refusal
from tactiled.detect.grooves.params import WaveParams
from tactiled.detect.grooves.window import DetrendedWindow, FitWindow, detrended

ARRAY = load_array("wang2019-3x3")
SIDES = [TaxelChannel(name=f"R{k + 1}", kind="side", azimuth_deg=180.0 + 90 * k) for k in range(4)]


def grid(x_mm: list[float], y_mm: list[float]) -> Array:
    """Taxels of four sides each."""
    return build(ArrayFile(name="grid", grids=[Grid(x_mm=x_mm, y_mm=y_mm)], taxel_channels=SIDES))


@dataclass(frozen=True)
class Grating:
    """A periodic surface and the response of a taxel to it."""

    period_mm: float = 1.2
    angle_deg: float = 20.0
    amplitude: float = 0.05
    harmonics: tuple[float, ...] = (1.0,)
    phase_rad: float = 0.0


@dataclass(frozen=True)
class Slide:
    """A slide over gratings; each channel has its own gain, each kind of channel its own phase."""

    gratings: tuple[Grating, ...] = field(default=(Grating(),))
    speed_mm_s: float = 2.0
    acceleration_mm_s2: float = 0.0
    direction_deg: float = 0.0
    duration_s: float = 4.0
    rate_hz: float = 100.0
    noise: float = 0.005
    level: float = 1.0
    seed: int = 0

    def times(self) -> FloatArray:
        return np.arange(round(self.duration_s * self.rate_hz)) / self.rate_hz

    def volts(self, array: Array, offsets_s: FloatArray | None = None) -> FloatArray:
        rng = np.random.default_rng(self.seed)
        t = self.times()[:, np.newaxis] + (np.zeros(array.n_channels) if offsets_s is None else offsets_s)
        theta = np.radians(self.direction_deg)
        travel = self.speed_mm_s * t + self.acceleration_mm_s2 * t**2 / 2
        x = array.x_mm[array.channel_taxel] + travel * np.cos(theta)
        y = array.y_mm[array.channel_taxel] + travel * np.sin(theta)
        azimuth = np.nan_to_num(array.azimuth_deg)
        volts = np.full(t.shape, self.level)
        for grating in self.gratings:
            gain = grating.amplitude * rng.uniform(0.6, 1.4, array.n_channels)
            a = np.radians(grating.angle_deg)
            phase = 2 * np.pi * (x * np.cos(a) + y * np.sin(a)) / grating.period_mm + grating.phase_rad
            for h, part in enumerate(grating.harmonics, start=1):
                volts = volts + part * gain * np.cos(h * phase + np.sin(3 * h + azimuth))
        noisy: FloatArray = volts + self.noise * rng.normal(size=t.shape)
        return noisy


def known(slide: Slide) -> WaveMotion:
    return WaveMotion(slide.speed_mm_s, 0.0, slide.direction_deg, 0.0)


def unknown(slide: Slide) -> WaveMotion:
    return WaveMotion(direction_deg=slide.direction_deg, direction_sd_deg=0.0)


def fit(
    slide: Slide,
    motion: WaveMotion,
    array: Array = ARRAY,
    volts: FloatArray | None = None,
    params: WaveParams | None = None,
) -> GrooveAnswer | Refusal:
    offsets_s = np.linspace(0, 0.007, array.n_channels)
    volts = slide.volts(array, offsets_s) if volts is None else volts
    layout = channel_layout(array)
    return fit_wave(FitWindow(volts, slide.times(), offsets_s, layout, motion, params or WaveParams()))


def prepared(
    volts: FloatArray, time_s: FloatArray, layout: ChannelLayout, motion: WaveMotion | None = None
) -> DetrendedWindow:
    """A window whose channels are sampled at once, as the steps of a fit see it."""
    offsets_s = np.zeros(volts.shape[1])
    window = detrended(FitWindow(volts, time_s, offsets_s, layout, motion or WaveMotion(), WaveParams()))
    assert not isinstance(window, Refusal)
    return window


def numbers(found: Outcome) -> FloatArray:
    """All numbers of an outcome but those of its candidates."""
    values = [value for name, value in vars(found).items() if name not in ("status", "candidates", "wave")]
    return np.concatenate([np.ravel(np.asarray(value, dtype=np.float64)) for value in values])


def answer(found: Outcome | None) -> GrooveAnswer:
    assert isinstance(found, GrooveAnswer), found
    return found


def off(found: GrooveAnswer, grating: Grating) -> tuple[float, float]:
    """Errors of period (mm) and angle (degrees)."""
    return found.period_mm - grating.period_mm, (found.angle_deg - grating.angle_deg + 90) % 180 - 90


def is_near(found: Outcome, grating: Grating) -> bool:
    """Whether an answer is that grating, and no other reading of its phases."""
    if not isinstance(found, GrooveAnswer):
        return False
    by_mm, by_deg = off(found, grating)
    return abs(by_mm) < 0.05 * grating.period_mm and abs(by_deg) < 5


def assert_right(outcome: Outcome | None, grating: Grating, sigmas: float = 5.0) -> None:
    found = answer(outcome)
    by_mm, by_deg = off(found, grating)
    assert abs(by_mm) < sigmas * found.period_sd_mm + 1e-9
    assert abs(by_deg) < sigmas * found.angle_sd_deg + 1e-9


def assert_refused(found: Outcome, *reasons: str) -> None:
    assert isinstance(found, Refusal)
    assert found.status in reasons


MotionOf = Callable[[Slide], WaveMotion]
motions = pytest.mark.parametrize("motion_of", [known, unknown])
