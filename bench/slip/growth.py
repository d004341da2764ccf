"""Bound on every detector of growing shear: in its first milliseconds a slip looks like motion without slip.

By some latency after the tangential load began to grow, shear has grown by some part of the pressure; half
of all slips have grown by the median of it or more. A detector that reports half of them by then must
respond to that growth. Scenes without slip exceed the same growth within the same time so many times an
hour: each detector that uses the growth of shear over pressure alone has so many false alarms at that
latency, without any noise. The rest of a signal of one or two scans (its shape, the taxels' shares) comes
from the same elastic loading in both cases.

Growths are noise-free, of the array's mean shear (or turn) from one scan to a later one. Presses, growth with
a larger change of pressure, and partial slip are excluded.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.slip.scenes import RATE_HZ, SCAN_SPAN_S, PlayedScene
from bench.slip.score import GRACE_S
from tactiled.array import Array, FloatArray

LATENCIES_S = (
    0.01, 0.0125, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0,
)  # fmt: skip
GROWTHS = np.geomspace(1e-3, 1.0, 61)  # thresholds at which false alarms are counted, 12 % apart
_APART_S = 0.5  # crossings closer than this are one alarm: fewer than any detector would raise


@dataclass(frozen=True, eq=False)
class Exceedances:
    """Number of times that scenes without slip exceed a growth.

    Attributes
    ----------
    hours : float
    times : (latencies, growths) int64
    """

    hours: float
    times: NDArray[np.int64]

    def __add__(self, other: "Exceedances") -> "Exceedances":
        return Exceedances(self.hours + other.hours, self.times + other.times)


def growth_after(array: Array, played: PlayedScene, shear_s: float) -> FloatArray:
    """Growth of shear over pressure since an instant, by the scans complete at each of `LATENCIES_S`."""
    motion, pressure = _motion_and_pressure(array, played)
    complete_s = shear_s - SCAN_SPAN_S
    first = int(np.ceil(complete_s * RATE_HZ)) - 1
    scans = np.floor((complete_s + np.array(LATENCIES_S)) * RATE_HZ).astype(int).clip(first, len(motion) - 1)
    grown = np.linalg.norm(motion[scans] - motion[first], axis=1) / pressure[scans]
    return np.asarray(np.maximum.accumulate(grown))


def count_exceedances(array: Array, played: PlayedScene) -> Exceedances:
    """Count how often a scene without gross slip exceeds each of `GROWTHS` within each of `LATENCIES_S`."""
    motion, pressure = _motion_and_pressure(array, played)
    start = int(np.ceil(played.press_end_s * RATE_HZ)) + 1
    time_s = np.arange(len(motion)) / RATE_HZ
    counts = time_s >= played.press_end_s
    for begin_s, end_s in played.slipping:
        counts &= (time_s < begin_s) | (time_s > end_s + GRACE_S)
    best, rows, done = np.zeros(len(motion)), [], 0
    for latency_s in LATENCIES_S:
        for back in range(done + 1, int(latency_s * RATE_HZ + 1e-9) + 1):
            done = back
            change = np.linalg.norm(motion[start + back :] - motion[start:-back], axis=1)
            press = np.abs(pressure[start + back :] - pressure[start:-back])
            grown = np.where(change > press, change / np.maximum(pressure[start + back :], 1e-9), 0.0)
            best[start + back :] = np.maximum(best[start + back :], grown)
        rows.append([_n_alarms(time_s[counts & (best >= growth)]) for growth in GROWTHS])
    return Exceedances(played.duration_s / 3600, np.array(rows))


def alarms_per_hour(families: Sequence[Exceedances], latency_s: float, growth: float) -> float:
    """False alarms an hour at a growth and a latency, the mean of families of equal weight.

    Between two of `LATENCIES_S` the shorter counts, between two of `GROWTHS` the larger: both are fewer
    alarms.
    """
    row = max(int(np.searchsorted(LATENCIES_S, latency_s + 1e-9)) - 1, 0)
    column = int(np.searchsorted(GROWTHS, growth))
    if column == len(GROWTHS):
        return 0.0
    return float(np.mean([one.times[row, column] / one.hours for one in families]))


def _n_alarms(at_s: FloatArray) -> int:
    return int(len(at_s) > 0) + int((np.diff(at_s) > _APART_S).sum())


def _motion_and_pressure(array: Array, played: PlayedScene) -> tuple[FloatArray, FloatArray]:
    """Mean shear along x, y and in turn (n, 3), and mean pressure (n,), volts."""
    x_mm, y_mm = array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()
    shear_x, shear_y = (played.volts @ weights.T for weights in array.shear_weights())
    turn = (shear_y * x_mm - shear_x * y_mm).mean(axis=1) / np.hypot(x_mm, y_mm).mean()
    motion = np.stack([shear_x.mean(axis=1), shear_y.mean(axis=1), turn], axis=1)
    return motion, (played.volts @ array.normal_weights().T).mean(axis=1)
