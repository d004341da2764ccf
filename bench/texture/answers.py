"""The two estimators behind one question: what is this window's grating?"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.texture.bound import FloatArray
from bench.texture.signal import RATE_HZ, Case
from tactiled.array import Array, load_array
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveFit, WaveMotion, WaveParams, channel_layout
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.wang2019 import grooves
from tactiled.detect.wang2019.grooves import GrooveParams, SlidingMotion


@dataclass(frozen=True)
class Answer:
    """A grating and its sigmas; zeros where `status` is not "ok"."""

    status: str
    period_mm: float = 0.0
    period_sd_mm: float = 0.0
    angle_deg: float = 0.0
    angle_sd_deg: float = 0.0


Estimate = Callable[[Case, FloatArray, bool], Answer]


def faithful(case: Case, volts: FloatArray, is_speed_known: bool) -> Answer:
    """The published procedure on R1 of the first column; it must be told the speed."""
    if not is_speed_known:
        return Answer("no-slip")
    array = load_array("wang2019-3x3")
    taxels = array.columns()[0]
    channels = np.array([np.flatnonzero(array.channel_taxel == taxel)[0] for taxel in taxels])
    found = grooves.estimate(
        volts[:, channels],
        RATE_HZ,
        Quantiser(array).volts_per_step,
        array.y_mm[taxels],
        case.sensed.offset_s[channels],
        SlidingMotion(case.wave.speed_mm_s, 0.0, case.wave.direction_deg, 0.0),
        GrooveParams(max_angle_deg=75.0),
    )
    return Answer(found.status, found.period_mm, found.period_sd_mm, found.angle_deg, found.angle_sd_deg)


def joint(case: Case, volts: FloatArray, is_speed_known: bool) -> Answer:
    """The joint fit on all channels; it is told the direction of the motion, and the speed where known."""
    speed_mm_s = case.wave.speed_mm_s if is_speed_known else 0.0
    motion = SlidingMotion(speed_mm_s, 0.0, case.wave.direction_deg, 0.0)
    fit = joint_fit(load_array("wang2019-3x3"), volts, RATE_HZ, case.sensed.offset_s, motion)
    return Answer(fit.status, fit.period_mm, fit.period_sd_mm, fit.angle_deg, fit.angle_sd_deg)


def joint_fit(
    array: Array,
    volts: FloatArray,
    rate_hz: float,
    offset_s: FloatArray,
    motion: SlidingMotion,
) -> WaveFit:
    """The core of the joint estimator on one window (n, channels)."""
    return fit_wave(
        volts,
        np.arange(len(volts)) / rate_hz,
        offset_s,
        channel_layout(array),
        WaveMotion(motion.speed_mm_s, motion.speed_sd_mm_s, motion.direction_deg, motion.direction_sd_deg),
        WaveParams(),
    )
