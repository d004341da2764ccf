"""Threshold rules on wavelet coefficients: the plain sliding window, and others to draw the curve from.

A rule turns the coefficients of one level into one number a scan, in units of what noise alone makes of one
channel's coefficient. Coefficients come from the causal bank, which equals the newest coefficients of
`pywt.swt` on a sliding window that its circular border has not touched (`window_coefficients`, the plain
form; a test holds the two together).
"""

from collections.abc import Callable

import numpy as np
import pywt

from bench.slip.levels import COHERENT_LEVELS, CoherentLevels
from bench.slip.scenes import read_sd_v
from tactiled.array import Array, FloatArray
from tactiled.detect.signal.wavelet import (
    BankParams,
    SwtBank,
    WaveletCoefficients,
    border_scans,
    delay_scans,
    taps,
)
from tactiled.events.types import UNKNOWN_SD_DEG, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock

LEVELS = (1, 2, 3, 4, 5, 6)
# An alarm is one as long as crossings follow each other within this: the same for every rule and the oracle.
HOLD_OFF_S = 0.2

Rule = Callable[[Array, FloatArray], FloatArray]
Statistic = Callable[[WaveletCoefficients], FloatArray]


def any_channel(array: Array, coefficients: FloatArray) -> FloatArray:
    """Largest channel, as published: (n, channels) to (n,)."""
    del array
    return np.asarray(np.abs(coefficients).max(axis=1))


def opposed_channel(array: Array, coefficients: FloatArray) -> FloatArray:
    """Largest channel where, over all taxels, pairs move against each other more than together.

    This is the paper's second peak.
    """
    shear, normal = array.shear_weights(), array.normal_weights()
    against = np.hypot(*(coefficients @ (shear.sum(axis=1) / np.abs(shear).sum(axis=(1, 2))[:, None]).T).T)
    together = np.abs((coefficients @ normal.T).mean(axis=1))
    return np.asarray(any_channel(array, coefficients) * (against > together))


def strongest_pair(array: Array, coefficients: FloatArray) -> FloatArray:
    """Largest R1 - R3 or R2 - R4 of any taxel."""
    weights = array.shear_weights().reshape(-1, array.n_channels)
    weights = weights[(weights != 0).any(axis=1)]
    scaled = weights / np.linalg.norm(weights, axis=1, keepdims=True)
    return np.asarray(np.abs(coefficients @ scaled.T).max(axis=1))


def whole_array(array: Array, coefficients: FloatArray) -> FloatArray:
    """Length of the vector (R1 - R3, R2 - R4), summed over all taxels: one common direction."""
    weights = array.shear_weights().sum(axis=1)
    scaled = weights / np.linalg.norm(weights, axis=1, keepdims=True)
    return np.asarray(np.hypot(*(coefficients @ scaled.T).T))


RULES: dict[str, Rule] = {
    "any channel": any_channel,
    "opposed channel": opposed_channel,
    "strongest pair": strongest_pair,
    "whole array": whole_array,
}


COHERENT = ("coherent levels", 0)  # the key of `slip_levels`, which is of no one level


def coefficient_sd_v(level: int, noise_v: float) -> float:
    """Sigma of a channel's coefficient in a hold: white noise through the level's filter."""
    return read_sd_v(noise_v) * float(np.linalg.norm(taps(level)))


def traces(array: Array, block: ScanBlock, noise_v: float) -> dict[tuple[str, int], FloatArray]:
    """Every rule at every level, (n,) each, in units of sigma; 0 where the filter does not see scans only."""
    answer = SwtBank(array, BankParams(levels=LEVELS)).process(block)
    out = {}
    for k, level in enumerate(LEVELS):
        scaled = answer.volts[:, k] / coefficient_sd_v(level, noise_v)
        scaled = np.where(answer.usable[:, k], scaled, 0.0)
        for name, rule in RULES.items():
            out[name, level] = rule(array, scaled)
    out[COHERENT] = CoherentLevels(array, read_sd_v(noise_v)).score(answer)
    return out


def window_coefficients(window: FloatArray, level: int) -> FloatArray:
    """Newest coefficient of each channel that the border of a window (n, channels) has not touched.

    The plain way: the whole transform of the window at each scan. `pywt.swt` wants a length that 2^level
    divides; its coefficient `delay_scans` before the end is the last that the circular border leaves alone.
    """
    details = [pywt.swt(channel, "coif1", level=level)[0][1] for channel in window.T]
    return np.array([detail[-1 - delay_scans(level)] for detail in details])


class ThresholdRule:
    """A slip event whenever a rule's statistic is large, told nothing of contact: a `Detector`.

    Parameters
    ----------
    array : Array
    levels : tuple of int
        Of the bank; the last says where in the past an onset may lie.
    begin : callable
        Begins anew: what then makes one number a scan, (n,), of the bank's answers in turn.
    threshold : float
    name : str
    """

    def __init__(
        self,
        array: Array,
        levels: tuple[int, ...],
        begin: Callable[[], Statistic],
        threshold: float,
        name: str,
    ) -> None:
        self._begin, self._threshold, self._name = begin, threshold, name
        self._levels = levels
        self._weights = array.shear_weights().sum(axis=1)
        self._bank = SwtBank(array, BankParams(levels=levels))
        self.reset()

    def reset(self) -> None:
        """Forget everything seen."""
        self._bank.reset()
        self._statistic = self._begin()
        self._crossed_s = -np.inf

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """One onset for each run of crossings."""
        answer = self._bank.process(item)
        if isinstance(item, Gap):
            self.reset()
            return []
        statistic = self._statistic(answer)
        events: list[Event] = []
        for n in np.flatnonzero(statistic >= self._threshold):
            now_s = float(item.time_s[n])
            if now_s - self._crossed_s > HOLD_OFF_S:
                events.append(self._onset(now_s, item.rate_hz, answer.volts[n, -1], float(statistic[n])))
            self._crossed_s = now_s
        return events

    def _onset(self, now_s: float, rate_hz: float, volts: FloatArray, statistic: float) -> SlipEvent:
        x, y = self._weights @ volts
        back_s = border_scans(self._levels[-1]) / rate_hz  # the onset is anywhere in the filter
        return SlipEvent(
            time_s=now_s - back_s / 2,
            state="onset",
            kind="gross",
            onset_s=now_s - back_s / 2,
            onset_sd_s=back_s / np.sqrt(12),
            direction_deg=float(np.rad2deg(np.arctan2(y, x))),
            direction_sd_deg=UNKNOWN_SD_DEG,
            confidence=0.5,
            taxels=(),
            detector=self._name,
            statistic=statistic,
            threshold=self._threshold,
            valid=True,
            detected_s=now_s,
        )


def window_rule(array: Array, level: int, threshold_volts: float) -> ThresholdRule:
    """Any channel at one level: the plain sliding window."""

    def largest(answer: WaveletCoefficients) -> FloatArray:
        return any_channel(array, np.where(answer.usable[:, 0], answer.volts[:, 0], 0.0))

    return ThresholdRule(array, (level,), lambda: largest, threshold_volts, "pywt-swt-window")


def coherent_rule(array: Array, noise_v: float, threshold: float) -> ThresholdRule:
    """All of `COHERENT_LEVELS` at once, told the noise."""

    def begin() -> Statistic:
        return CoherentLevels(array, read_sd_v(noise_v)).score

    return ThresholdRule(array, COHERENT_LEVELS, begin, threshold, "coherent-levels")
