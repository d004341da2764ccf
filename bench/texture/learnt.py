"""Slide after slide with one array: what is learnt of the strays of its channels, and whether that misleads.

The strays of an array are constants of its skin, by one of these causes, or none of them:

- phase: a loss angle of the rubber, the same at every frequency (radians)
- offset: each channel is misplaced (mm, along x and y); the phase is the wave vector times the offset
- chip offset: the same with one offset for all channels of a taxel
- delay: a time constant (s), whose phase is proportional to the frequency of the ripple
- half phase: half of the variance is a phase, the other half is drawn anew for each slide
- redrawn: all strays are drawn anew for each slide; there is nothing to learn

Offsets and delays are drawn so that phases stray by the stated radians at a period of 1.5 mm and at 3 Hz.
Windows are of 2 to 5 s at 10 to 30 dB. The ways from slide to slide:

- one direction: another grating at another speed; motion and groove normal keep their directions
- turned: another grating at another speed, and the array is turned anew

The direction that is given has the error that it states.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Literal, NamedTuple

import numpy as np

from bench.texture.signal import ANGLES_DEG, FloatArray, Grating, Wave, draw_grating, readings
from bench.texture.trials import ARRAY, DIRECTION_SD_DEG, MIN_PERIODS, Trial, compare
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveMotion, WaveParams, channel_layout

Cause = Literal["phase", "offset", "chip offset", "delay", "half phase", "redrawn"]
Way = Literal["one direction", "turned"]
SpeedKnown = Literal["speed known", "speed unknown", "speed known once"]
SLIDES = 11
SHOWN = (0, 1, 3, 10)  # slides before
_AT_MM, _AT_HZ = 1.5, 3.0
_WINDOWS_S, _SNRS_DB, _GAINS = (2.0, 5.0), (10.0, 30.0), (0.7, 1.3)
_ALL_ROUND_DEG = 180.0
_MOST_HZ = 20.0  # as `draw_grating` has it


class LearntKind(NamedTuple):
    """Strays of an array and how it slides."""

    cause: Cause
    stray_rad: float
    way: Way
    speed: SpeedKnown

    @property
    def name(self) -> str:
        """Words for a table."""
        return f"{self.cause}, {self.stray_rad:g} rad, {self.way}, {self.speed}"


_RADS = (0.05, 0.1, 0.13, 0.2, 0.3)
_WAYS: tuple[Way, ...] = ("one direction", "turned")
_CAUSES: tuple[Cause, ...] = ("phase", "offset", "chip offset", "delay", "half phase", "redrawn")
_SPEEDS: tuple[SpeedKnown, ...] = ("speed known", "speed unknown", "speed known once")
LEARNT_KINDS = tuple(LearntKind(*each) for each in product(_CAUSES, _RADS, _WAYS, _SPEEDS))


class _Skin(NamedTuple):
    """Draws of standard deviation 1 for each channel: (channels,)."""

    one: FloatArray
    other: FloatArray


def learnt_trials(kind: LearntKind, seeds: Sequence[int]) -> list[Trial]:
    """`SLIDES` slides of one array for each seed; `after_s` holds the number of slides before."""
    trials = []
    for seed in seeds:
        # Each kind has arrays of its own; the way the speed is known does not change the slides.
        words = f"{kind.cause} {kind.stray_rad:g} {kind.way}"
        rng = np.random.default_rng([seed, *words.encode()])
        skin = _draw_skin(rng, kind.cause)
        gain = rng.uniform(*_GAINS, (ARRAY.n_channels, 1))
        layout, first = channel_layout(ARRAY), None
        for before in range(SLIDES):
            grating = _draw_slide(rng, first, kind.way)
            first = first or grating.wave
            skin = _redrawn(skin, rng, kind.cause)
            grating = _with_strays(grating, gain, kind.stray_rad * _strays(kind.cause, skin, grating.wave))
            wave, volts = grating.wave, readings(grating, rng)
            is_known = kind.speed == "speed known" or (kind.speed == "speed known once" and not before)
            direction_deg = wave.direction_deg + DIRECTION_SD_DEG * rng.standard_normal()
            motion = WaveMotion(wave.speed_mm_s if is_known else 0.0, 0.0, direction_deg, DIRECTION_SD_DEG)
            fit = fit_wave(volts, grating.time_s, grating.sensed.offset_s, layout, motion, WaveParams())
            if fit.strays is not None:
                layout = replace(layout, strays=fit.strays)
            fields = {"name": kind.name, "seed": seed, "is_speed_known": is_known}
            fields |= {"window_s": float(grating.time_s[-1]), "periods": grating.periods}
            trials.append(compare(fit, wave, after_s=float(before), **fields))
    return trials


def _draw_skin(rng: np.random.Generator, cause: Cause) -> _Skin:
    draws = rng.standard_normal((2, ARRAY.n_channels))
    if cause == "chip offset":
        draws = rng.standard_normal((2, len(ARRAY.x_mm)))[:, ARRAY.channel_taxel]
    return _Skin(*draws)


def _redrawn(skin: _Skin, rng: np.random.Generator, cause: Cause) -> _Skin:
    """Draw anew what does not repeat: all of it, half of the variance (as `other`), or nothing."""
    if cause == "redrawn":
        return _draw_skin(rng, cause)
    return skin._replace(other=rng.standard_normal(ARRAY.n_channels)) if cause == "half phase" else skin


def _draw_slide(rng: np.random.Generator, first: Wave | None, way: Way) -> Grating:
    """Draw a slide after the first, or the first itself; drawn again until the board can follow it."""
    while True:
        window_s = float(rng.uniform(*_WINDOWS_S))
        grating = draw_grating(ARRAY, rng, window_s, float(rng.uniform(*_SNRS_DB)), MIN_PERIODS)
        wave = _next_wave(rng, grating.wave, first, way)
        is_across = abs(wave.angle_deg - wave.direction_deg) <= ANGLES_DEG[1]
        if is_across and MIN_PERIODS / window_s <= wave.frequency_hz < _MOST_HZ:
            return replace(grating, wave=wave)


def _next_wave(rng: np.random.Generator, drawn: Wave, first: Wave | None, way: Way) -> Wave:
    if way == "turned":
        turned_deg = float(rng.uniform(-_ALL_ROUND_DEG, _ALL_ROUND_DEG))
        return replace(
            drawn, angle_deg=drawn.angle_deg + turned_deg, direction_deg=drawn.direction_deg + turned_deg
        )
    if first is None:
        return drawn
    return replace(drawn, angle_deg=first.angle_deg, direction_deg=first.direction_deg)


def _strays(cause: Cause, skin: _Skin, wave: Wave) -> FloatArray:
    """Strays of the channels on a slide, of standard deviation 1 where they are stated: (channels,)."""
    if cause in ("offset", "chip offset"):
        angle = np.radians(wave.angle_deg)
        along = np.cos(angle) * skin.one + np.sin(angle) * skin.other
        return np.asarray(along * _AT_MM / wave.period_mm)
    if cause == "delay":
        return skin.one * abs(wave.frequency_hz) / _AT_HZ
    return (skin.one + skin.other) / np.sqrt(2) if cause == "half phase" else skin.one


def _with_strays(grating: Grating, gain: FloatArray, stray_rad: FloatArray) -> Grating:
    sensed = grating.sensed
    sensed = replace(
        sensed,
        amplitude_volts=gain * sensed.amplitude_volts,
        kind=np.arange(ARRAY.n_channels),
        phase_rad=sensed.phase_rad[sensed.kind] + stray_rad[:, np.newaxis],
    )
    return replace(grating, sensed=sensed)
