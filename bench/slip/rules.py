"""Threshold rules on wavelet coefficients: the plain sliding window, and others for the curves.

A rule makes one number of each scan from the coefficients of one level, in units of the noise of one
channel's coefficient. The coefficients are those of the causal bank, which equal the newest coefficients of
`pywt.swt` on a sliding window that the circular border does not affect (`window_coefficients`, the plain
form; a test compares the two).
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
# Crossings that follow each other within this are one alarm: the same for every rule and the oracle.
HOLD_OFF_S = 0.2

Rule = Callable[[Array, FloatArray], FloatArray]
Statistic = Callable[[WaveletCoefficients], FloatArray]


def any_channel(array: Array, coefficients: FloatArray) -> FloatArray:
    """Largest channel (n,) of coefficients (n, channels), as published."""
    del array
    return np.asarray(np.abs(coefficients).max(axis=1))


def opposed_channel(array: Array, coefficients: FloatArray) -> FloatArray:
    """Largest channel where, over all taxels, pairs change more in opposition than together.

    This is the paper's second peak, as `detect.wang2019.slip` takes it.
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
    """Length of the vector (R1 - R3, R2 - R4) summed over all taxels, which have one common direction."""
    weights = array.shear_weights().sum(axis=1)
    scaled = weights / np.linalg.norm(weights, axis=1, keepdims=True)
    return np.asarray(np.hypot(*(coefficients @ scaled.T).T))


RULES: dict[str, Rule] = {
    "any channel": any_channel,
    "opposed channel": opposed_channel,
    "strongest pair": strongest_pair,
    "whole array": whole_array,
}

COHERENT = ("coherent levels", 0)  # key of `CoherentLevels`, which has no single level


def coefficient_sd_v(level: int, noise_v: float) -> float:
    """Sigma of a channel's coefficient in a hold: white noise through the level's filter."""
    return read_sd_v(noise_v) * float(np.linalg.norm(taps(level)))


def traces(array: Array, block: ScanBlock, noise_v: float) -> dict[tuple[str, int], FloatArray]:
    """Every rule at every level, (n,) each, in units of sigma; 0 where the filter is not filled."""
    found = SwtBank(array, BankParams(levels=LEVELS)).process(block)
    out = {}
    for k, level in enumerate(LEVELS):
        scaled = found.volts[:, k] / coefficient_sd_v(level, noise_v)
        scaled = np.where(found.usable[:, k], scaled, 0.0)
        for name, rule in RULES.items():
            out[name, level] = rule(array, scaled)
    out[COHERENT] = CoherentLevels(array, read_sd_v(noise_v)).score(found)
    return out


def window_coefficients(window: FloatArray, level: int) -> FloatArray:
    """Newest coefficient of each channel that the border of a window (n, channels) does not affect.

    This is the plain way: the whole transform of the window at each scan. `pywt.swt` needs a length that
    2^level divides; its coefficient `delay_scans` before the end is the last without the circular border.
    """
    details = [pywt.swt(channel, "coif1", level=level)[0][1] for channel in window.T]
    return np.array([detail[-1 - delay_scans(level)] for detail in details])


class ThresholdRule:
    """Detector that reports a slip where a rule's statistic is large, in contact or not.

    Parameters
    ----------
    levels : tuple of int
        Of the bank; the filter of the last one bounds the stated onset.
    new_statistic : callable
        Makes a function from successive outputs of the bank to one number for each scan, (n,).
    """

    def __init__(
        self,
        array: Array,
        levels: tuple[int, ...],
        new_statistic: Callable[[], Statistic],
        threshold: float,
        name: str,
    ) -> None:
        self._new_statistic, self._threshold, self._name = new_statistic, threshold, name
        self._levels = levels
        self._weights = array.shear_weights().sum(axis=1)
        self._bank = SwtBank(array, BankParams(levels=levels))
        self.reset()

    def reset(self) -> None:
        """Return to the initial state."""
        self._bank.reset()
        self._statistic = self._new_statistic()
        self._crossed_s = -np.inf

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Report one onset for each run of crossings."""
        coefficients = self._bank.process(item)
        if isinstance(item, Gap):
            self.reset()
            return []
        statistic = self._statistic(coefficients)
        events: list[Event] = []
        for n in np.flatnonzero(statistic >= self._threshold):
            now_s = float(item.time_s[n])
            if now_s - self._crossed_s > HOLD_OFF_S:
                events.append(
                    self._onset(now_s, item.rate_hz, coefficients.volts[n, -1], float(statistic[n]))
                )
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
    """Detector of the plain sliding window: any channel at one level."""

    def largest(found: WaveletCoefficients) -> FloatArray:
        return any_channel(array, np.where(found.usable[:, 0], found.volts[:, 0], 0.0))

    return ThresholdRule(array, (level,), lambda: largest, threshold_volts, "pywt-swt-window")


def coherent_rule(array: Array, noise_v: float, threshold: float) -> ThresholdRule:
    """Detector on all of `COHERENT_LEVELS` at once, for a known noise."""

    def new_statistic() -> Statistic:
        return CoherentLevels(array, read_sd_v(noise_v)).score

    return ThresholdRule(array, COHERENT_LEVELS, new_statistic, threshold, "coherent-levels")
