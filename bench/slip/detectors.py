"""Detectors that ``./run bench slip`` compares.

To add one, add a line to `compared_detectors`. A detector that takes a rate of false alarms is set to its
own; one with a bare threshold gets the threshold that white noise exceeds `PER_HOUR`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bench.slip.noise import NoiseTail
from bench.slip.rules import COHERENT, coefficient_sd_v, coherent_rule, window_rule
from tactiled.array import Array
from tactiled.detect.base import Detector
from tactiled.detect.grip.detector import GripParams
from tactiled.detect.grip.slip_detector import GripSlip
from tactiled.detect.slip.detector import SETTINGS, CoherentParams, CoherentSlip
from tactiled.detect.wang2019.slip import SlipParams, WaveletSlip

PER_HOUR = 1.0  # false alarms in a hold at which latencies are compared
SWEEP_PER_HOUR = (10.0, 30.0, 70.0, 130.0, 200.0, 270.0)  # the range of `detect.slip.alarm_rate`
SWEEP_NOISE_V = 0.3e-3  # the board's own
CONTACT_MODEL = "contact model"
PAPER_LEVEL = 3  # at 100 Hz: `detect.wang2019.slip.level_at`


@dataclass(frozen=True)
class ComparedDetector:
    """A detector of the comparison.

    Attributes
    ----------
    build : callable
        Array and noise (volts) to a new detector.
    per_hour : callable
        Noise (volts) to the false alarms an hour in a hold at which the detector is set.
    is_setting : bool
        Users choose among these; their false alarms are counted over more hours than those of the others.
    """

    build: Callable[[Array, float], Detector]
    per_hour: Callable[[float], float] = lambda _: PER_HOUR
    is_setting: bool = False


@dataclass(frozen=True)
class Tuning:
    """Values that were set on other scenes and seeds than are reported.

    Attributes
    ----------
    tails : mapping of (rule, level) to NoiseTail
    window_level : mapping of noise (volts) to the fastest level of the plain window
    """

    tails: Mapping[tuple[str, int], NoiseTail]
    window_level: Mapping[float, int]


def compared_detectors(tuning: Tuning) -> dict[str, ComparedDetector]:
    """Detectors by name."""

    def volts(rule: str, level: int, noise_v: float) -> float:
        return tuning.tails[rule, level].threshold(PER_HOUR) * coefficient_sd_v(level, noise_v)

    def tuned_paper(array: Array, noise_v: float) -> Detector:
        threshold_volts = volts("opposed channel", PAPER_LEVEL, noise_v)
        return WaveletSlip(array, SlipParams(threshold_volts=threshold_volts))

    def window(array: Array, noise_v: float) -> Detector:
        level = tuning.window_level[noise_v]
        return window_rule(array, level, volts("any channel", level, noise_v))

    def levels(array: Array, noise_v: float) -> Detector:
        return coherent_rule(array, noise_v, tuning.tails[COHERENT].threshold(PER_HOUR))

    def paper_per_hour(noise_v: float) -> float:
        threshold = SlipParams().threshold_volts / coefficient_sd_v(PAPER_LEVEL, noise_v)
        return float(tuning.tails["opposed channel", PAPER_LEVEL].per_hour(np.array(threshold)))

    return {
        "paper, 0.002 V": ComparedDetector(lambda array, _: WaveletSlip(array), paper_per_hour),
        "paper, threshold tuned": ComparedDetector(tuned_paper),
        "pywt.swt window": ComparedDetector(window),
        "coherent, coif1 levels": ComparedDetector(levels),
        **{f"coherent, {name}": _coherent(params, is_setting=True) for name, params in SETTINGS.items()},
        CONTACT_MODEL: ComparedDetector(lambda array, _: GripSlip(array, GripParams()), is_setting=True),
    }


def sweep() -> dict[str, ComparedDetector]:
    """The coherent detector at every rate of `SWEEP_PER_HOUR`: the curve on which the settings lie."""
    return {
        f"coherent, {per_hour:g} an hour": _coherent(CoherentParams(false_alarms_per_hour=per_hour))
        for per_hour in SWEEP_PER_HOUR
    }


def detectors_at(tuning: Tuning, noise_v: float, names: tuple[str, ...]) -> dict[str, ComparedDetector]:
    """Detectors of these names, those of `sweep` at the noise at which it is drawn."""
    known = compared_detectors(tuning) | (sweep() if noise_v == SWEEP_NOISE_V else {})
    return {name: detector for name, detector in known.items() if name in names}


def _coherent(params: CoherentParams, *, is_setting: bool = False) -> ComparedDetector:
    return ComparedDetector(
        lambda array, _: CoherentSlip(array, params), lambda _: params.noise_per_hour, is_setting
    )
