"""Threshold rules on wavelet coefficients: the plain sliding window, and others to draw the curve from.

A rule turns the coefficients of one level into one number a scan, in units of what noise alone makes of one
channel's coefficient. Coefficients come from the causal bank, which equals the newest coefficients of
`pywt.swt` on a sliding window that its circular border has not touched (`window_coefficients`, the plain
form; a test holds the two together).
"""

from collections.abc import Callable

import numpy as np
import pywt
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.bench.slip_scenes import read_sd_v
from tactiled.detect.wavelet import BankParams, SwtBank, border_scans, delay_scans, taps
from tactiled.events.types import UNKNOWN_SD_DEG, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock

LEVELS = (1, 2, 3, 4, 5, 6)
# An alarm is one as long as crossings follow each other within this: the same for every rule and the oracle.
HOLD_OFF_S = 0.2

Rule = Callable[[Array, FloatArray], FloatArray]


def any_channel(array: Array, coefficients: FloatArray) -> FloatArray:
    """Largest channel, as published: (n, channels) to (n,)."""
    del array
    return np.asarray(np.abs(coefficients).max(axis=1))


def opposed_channel(array: Array, coefficients: FloatArray) -> FloatArray:
    """Largest channel where, over all taxels, pairs move against each other more than together: the paper's
    second peak as `detect.slip_wavelet` reads it."""
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
    return out


def window_coefficients(window: FloatArray, level: int) -> FloatArray:
    """Newest coefficient of each channel that the border of a window (n, channels) has not touched.

    The plain way: the whole transform of the window at each scan. `pywt.swt` wants a length that 2^level
    divides; its coefficient `delay_scans` before the end is the last that the circular border leaves alone.
    """
    details = [pywt.swt(channel, "coif1", level=level)[0][1] for channel in window.T]
    return np.array([detail[-1 - delay_scans(level)] for detail in details])


class WindowRule:
    """A slip event whenever any channel's coefficient is large, told nothing of contact: a `Detector`.

    Parameters
    ----------
    array : Array
    level : int
    threshold_volts : float
    """

    def __init__(self, array: Array, level: int, threshold_volts: float) -> None:
        self._array = array
        self._level = level
        self._threshold_volts = threshold_volts
        self._weights = array.shear_weights().sum(axis=1)
        self._bank = SwtBank(array, BankParams(levels=(level,)))
        self.reset()

    def reset(self) -> None:
        """Forget everything seen."""
        self._bank.reset()
        self._crossed_s = -np.inf

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """One onset for each run of crossings."""
        answer = self._bank.process(item)
        if isinstance(item, Gap):
            self._crossed_s = -np.inf
            return []
        volts = np.where(answer.usable[:, 0], answer.volts[:, 0], 0.0)
        events: list[Event] = []
        for n in np.flatnonzero(np.abs(volts).max(axis=1) >= self._threshold_volts):
            now_s = float(item.time_s[n])
            if now_s - self._crossed_s > HOLD_OFF_S:
                events.append(self._onset(now_s, item.rate_hz, volts[n]))
            self._crossed_s = now_s
        return events

    def _onset(self, now_s: float, rate_hz: float, volts: FloatArray) -> SlipEvent:
        x, y = self._weights @ volts
        size = np.abs(volts)
        back_s = border_scans(self._level) / rate_hz  # the onset is anywhere in the filter
        return SlipEvent(
            time_s=now_s - back_s / 2,
            state="onset",
            kind="gross",
            onset_s=now_s - back_s / 2,
            onset_sd_s=back_s / np.sqrt(12),
            direction_deg=float(np.rad2deg(np.arctan2(y, x))),
            direction_sd_deg=UNKNOWN_SD_DEG,
            confidence=0.5,
            taxels=tuple(np.unique(self._array.channel_taxel[size >= self._threshold_volts]).tolist()),
            detector="pywt-swt-window",
            statistic=float(size.max()),
            threshold=self._threshold_volts,
            valid=True,
            detected_s=now_s,
        )


def crossings(trace: NDArray[np.float64], threshold: float, rate_hz: float) -> int:
    """Runs of crossings in a trace, as `WindowRule` counts them."""
    at = np.flatnonzero(trace >= threshold)
    return int(len(at) > 0) + int((np.diff(at) > HOLD_OFF_S * rate_hz).sum())
