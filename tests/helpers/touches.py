"""Touches with known truth, from a few lines of arithmetic: no emulator, no detector code."""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from tactiled.array import Array, FloatArray
from tactiled.detect.base import Detector
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.suite import DetectParams, Suite, build_suite, factories
from tactiled.events.types import ContactEvent, Event, SlipEvent, TextureEvent
from tactiled.samples.block import ScanBlock, regular_block

LSB = 3.0 / 4096  # of the 12-bit converter


def assert_sound(events: Sequence[Event]) -> None:
    """Check that numbers are finite, and that no slip begins after it was told."""
    for event in events:
        for field in dataclasses.fields(event):
            value = getattr(event, field.name)
            assert value is not None
            if isinstance(value, float):
                assert math.isfinite(value), f"{field.name} of {event}"
        if isinstance(event, SlipEvent):
            assert event.onset_s <= event.time_s <= event.detected_s + 1e-9, event
            assert event.onset_sd_s >= 0, event
            assert 0 <= event.confidence <= 1, event


@dataclass(frozen=True)
class Touch:
    """Rest, press, hold, slide, stop, lift; instants in seconds."""

    press_s: float = 0.5
    press_takes_s: float = 1.0
    slide_s: float = 4.0
    stop_s: float = 8.0
    lift_s: float = 10.0
    end_s: float = 11.0
    more_s: float = np.inf  # when the load grows by half, within a second
    level: float = 1.2  # of the pressure response
    shear: float = 0.6  # by which an opposed channel moves when sliding fully
    shear_takes_s: float = 0.1  # time constant in which it does
    shear_kept: float = 0.6  # part of it that stays after the stop
    direction_deg: float = 0.0
    grooves: tuple[float, float] | None = None  # period (mm) and angle (degrees)
    ripple: float = 0.05
    speed_mm_s: float = 1.0
    uneven: float = 0.0  # standard deviation of a taxel's friction along the surface, over its mean
    noise: float = 0.3e-3
    seed: int = 0

    def volts(self, array: Array, rate_hz: float, offsets_s: FloatArray | None = None) -> FloatArray:
        offsets = np.zeros(array.n_channels) if offsets_s is None else offsets_s
        t = np.arange(round(self.end_s * rate_hz))[:, np.newaxis] / rate_hz + offsets
        pressed = self.level * np.clip((t - self.press_s) / self.press_takes_s, 0, 1) * (t < self.lift_s)
        pressed = pressed * (1 + 0.5 * np.clip(t - self.more_s, 0, 1))
        slid = np.clip(t - self.slide_s, 0, self.stop_s - self.slide_s)
        stopped = np.clip(t - self.stop_s, 0, None)
        state = 1 - np.exp(-slid / self.shear_takes_s)
        state = state * (self.shear_kept + (1 - self.shear_kept) * np.exp(-stopped / 0.3)) * (t < self.lift_s)
        motion = self.shear * state * _answers(array, self.direction_deg)
        if self.uneven:
            motion = motion * (1 + uneven_friction(array, slid / self.shear_takes_s, self.uneven))
        pressure = np.where([kind in ("side", "normal") for kind in array.channel_kind], pressed, 0.0)
        if self.grooves is not None:
            pressure = pressure * (1 + self._wave(array, slid) * (slid > 0))
        noise = self.noise * np.random.default_rng(self.seed).normal(size=t.shape)
        volts: FloatArray = np.floor((pressure + motion + noise) / LSB + 0.5) * LSB
        return volts

    def _wave(self, array: Array, slid: FloatArray) -> FloatArray:
        assert self.grooves is not None
        period_mm, angle_deg = self.grooves
        theta, a = np.radians(self.direction_deg), np.radians(angle_deg)
        x = array.x_mm[array.channel_taxel] + self.speed_mm_s * slid * np.cos(theta)
        y = array.y_mm[array.channel_taxel] + self.speed_mm_s * slid * np.sin(theta)
        wave: FloatArray = self.ripple * np.cos(2 * np.pi * (x * np.cos(a) + y * np.sin(a)) / period_mm)
        return wave

    def block(self, array: Array, rate_hz: float = 100.0, offsets_s: FloatArray | None = None) -> ScanBlock:
        volts = self.volts(array, rate_hz, offsets_s)
        return regular_block(volts, rate_hz, start_s=100.0, index=7, channel_offset_s=offsets_s)


def _answers(array: Array, direction_deg: float) -> FloatArray:
    """How each channel moves with motion in a direction: R1 (180 degrees) rises with motion along +x."""
    theta = np.radians(direction_deg)
    answers = np.zeros(array.n_channels)
    for c, kind in enumerate(array.channel_kind):
        if kind == "side":
            answers[c] = -np.cos(theta - np.radians(array.azimuth_deg[c]))
        elif kind == "shear_x":
            answers[c] = np.cos(theta)
        elif kind == "shear_y":
            answers[c] = np.sin(theta)
        elif not array.has_shear:  # a plain pad feels the load shift from its one half to the other
            answers[c] = 1.0 if array.x_mm[array.channel_taxel[c]] > array.x_mm.mean() else -1.0
    return answers


def uneven_friction(array: Array, travel: FloatArray, sd: float) -> FloatArray:
    """Return by how much friction differs at the channels (n, channels) from its mean, after some travel.

    Each taxel meets three waves of its own: the surface under it is not that under the others. The mean over
    the taxels, which a change of friction as a whole would be, is zero. It begins with the travel.
    """
    rng, waves = np.random.default_rng(5), np.zeros((len(travel), array.n_taxels))
    for _ in range(3):
        cycles, phase = rng.uniform(0.1, 0.6, array.n_taxels), rng.uniform(0, 2 * np.pi, array.n_taxels)
        waves += np.sin(2 * np.pi * cycles * travel[:, :1] + phase) * np.sqrt(2 / 3)
    waves -= waves.mean(axis=1, keepdims=True)
    return np.asarray(sd * np.clip(travel[:, :1], 0, 1) * waves[:, array.channel_taxel])


def splits(n: int) -> st.SearchStrategy[list[int]]:
    """Places to cut n scans at: few, many, or every one."""
    some = st.lists(st.integers(1, n - 1), max_size=12, unique=True).map(sorted)
    return some | st.just(list(range(1, n))) | st.integers(2, 17).map(lambda step: list(range(step, n, step)))


def pieces(block: ScanBlock, cuts: Sequence[int]) -> list[ScanBlock]:
    bounds = [0, *cuts, len(block)]
    return [block[a:b] for a, b in itertools.pairwise(bounds)]


def run(detector: Detector, blocks: Sequence[ScanBlock]) -> list[Event]:
    return [event for block in blocks for event in detector.process(block)]


def slips(events: Sequence[Event]) -> list[SlipEvent]:
    return [event for event in events if isinstance(event, SlipEvent)]


def onsets(events: Sequence[Event]) -> list[SlipEvent]:
    return [event for event in slips(events) if event.state == "onset"]


def textures(events: Sequence[Event]) -> list[TextureEvent]:
    return [event for event in events if isinstance(event, TextureEvent)]


def contact_states(events: Sequence[Event]) -> list[str]:
    return [event.state for event in events if isinstance(event, ContactEvent)]


def published(array: Array, speed_mm_s: float = 0.0) -> Suite:
    """The methods of the paper."""
    return build_suite(array, DetectParams(setting="wang2019", texture=JointParams(speed_mm_s=speed_mm_s)))


def slip_detector(array: Array, setting: str = "balanced", friction: float | None = None) -> Detector:
    """Make the slip detector of a setting, which sees every gap and publishes no grip messages.

    A friction, in shear reading over load, is known to 10 % beforehand. Without one, it has the wide prior.
    """
    grip: dict[str, float | bool] = {"publish": False}
    if friction is not None:
        grip |= {"friction": friction, "friction_log_sd": 0.1}
    params = DetectParams.model_validate({"setting": setting, "grip": grip})
    return factories(params.setting).slip(array, params)
