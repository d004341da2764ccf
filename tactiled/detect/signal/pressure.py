"""Readings as whole steps, and the pressure of the taxels: the contact gate's part of a scan.

`quantise` and `contact` make these objects for an array. The file is plain Python, which Cython compiles with
the types of `pressure.pxd`, with the same bits (`tactiled.compiled`). Arrays are dense and flat.
"""

from array import array
from typing import Any

from tactiled.array import FloatArray
from tactiled.detect.signal.front_end import Flags, Reals, Whole

# derived: a number of less than 2^51, plus and minus this one, is rounded to the nearest whole number, halves
# to even.
_TO_WHOLE = 1.5 * 2.0**52
_INFINITE = float("inf")
# choice: a side is clipped to this multiple of the mean of the other sides of its taxel. With two sides fully
# relieved and their load on the third, the multiple would be three.
_ONE_SIDE = 5.0
_LEAST_SIDES = 3  # derived: of two readings that differ, the wrong one cannot be identified


class Hold:
    """Readings rounded to whole steps; one that is not ok is the last good one of its channel, or zero.

    Parameters
    ----------
    limit, steps_per_unit : float
        Readings beyond the limit are not ok.
    """

    def __init__(self, n_channels: int, limit: float, steps_per_unit: float) -> None:
        self.n_channels, self.limit, self.steps_per_unit = n_channels, limit, steps_per_unit
        self.last = array("d", bytes(8 * n_channels))

    def take(self, n: int, first: int, readings: FloatArray, valid: Flags, steps: Reals, ok: Any) -> bool:
        """Round n scans, from `first` of `readings` on, to `steps`; mark what is `ok`; True if all is."""
        at, n_bad = 0, 0
        for _ in range(n):
            for c in range(self.n_channels):
                reading = readings[first + at]
                if valid[first + at] != 0 and abs(reading) <= self.limit:  # no NaN is
                    self.last[c] = reading * self.steps_per_unit + _TO_WHOLE - _TO_WHOLE
                    ok[at] = 1
                else:
                    ok[at] = 0
                    n_bad += 1
                steps[at] = self.last[c]
                at += 1
        return n_bad == 0


class Pressure:
    """Pressure of the taxels, and how fast that of the array rises.

    A soft skin keeps a part of its deformation for a while after a press, its set. It follows the pressure as
    in a standard linear solid, and only what is beyond it is compared with the levels.

    Parameters
    ----------
    own : (taxels * sides,) int64
        Channels of each taxel; taxels with fewer repeat them.
    counts : (taxels,) int64
        Number of them.
    sign, total_weights : (channels,) float64
        Sign of the pressure; whole weights of the array's pressure.
    line : (n,) float64
        Whole weights of a least-squares slope.
    is_field : bool
        The readings are those of a magnetic field, which a press may raise or lower.
    set_of_load, set_per_scan : float
        Part of a load that a press of any length leaves, and the part of the way to it in a scan.
    """

    def __init__(
        self,
        own: Whole,
        counts: Whole,
        sign: FloatArray,
        total_weights: FloatArray,
        line: FloatArray,
        volts_per_step: float,
        slope_scale: float,
        is_field: bool,
        set_of_load: float,
        set_per_scan: float,
    ) -> None:
        self.n_channels, self.n_taxels, self.n_sides = len(sign), len(counts), len(own) // len(counts)
        self.own, self.counts, self.sign = array("q", own), array("q", counts), array("d", sign)
        self.total_weights, self.line = array("d", total_weights), array("d", line)
        self.volts_per_step, self.slope_scale = volts_per_step, slope_scale
        self.totals = array("d", bytes(8 * (len(line) - 1)))
        self.is_field, self.set_of_load, self.set_per_scan = is_field, set_of_load, set_per_scan
        self.set = array("d", bytes(8 * len(counts)))
        self.is_begun = False

    def interrupt(self, kept: float) -> None:
        """Pass over missing scans, after which a part of the set is left."""
        self.is_begun = False
        for t in range(self.n_taxels):
            self.set[t] *= kept

    def take(
        self, n: int, steps: FloatArray, held: FloatArray, levels: FloatArray, reals: FloatArray, flags: Flags
    ) -> None:
        """Take n scans.

        Parameters
        ----------
        steps, held : (n * channels,) float64
            Readings, 0 where there is none; the slope is that of the held ones.
        levels : (3 * taxels,) or (3 * n * taxels,) float64
            Readings of a taxel, level of contact, level of release; of all scans or of each.
        reals : ((2 + taxels) * n,) float64
            Taxels in contact (at least 1), slope, pressures beyond the set (n, taxels).
        flags : ((2 + taxels) * n,) uint8
            Some taxel touches, all are released, taxels that touch (n, taxels).
        """
        channels, taxels, n_line = self.n_channels, self.n_taxels, len(self.line)
        each = 0 if len(levels) == 3 * taxels else taxels
        kind = len(levels) // 3
        for i in range(n):
            row, n_touching, n_released, array_total = i * channels, 0, 0, 0.0
            for t in range(taxels):
                total, largest, smallest, held_total = 0.0, -_INFINITE, _INFINITE, 0.0
                for s in range(t * self.n_sides, t * self.n_sides + self.counts[t]):
                    c = self.own[s]
                    one = steps[row + c] * self.sign[c]
                    total += one
                    largest, smallest = max(largest, one), min(smallest, one)
                    held_total += held[row + c] * self.total_weights[c]
                array_total += abs(held_total) if self.is_field else held_total
                level = i * each + t
                n_read = levels[level]
                if self.is_field and total < 0.0:
                    total, largest = -total, -smallest
                rest = total - largest
                if n_read >= _LEAST_SIDES:
                    total = rest + min(largest, _ONE_SIDE / max(n_read - 1.0, 1.0) * rest)
                pressure = total * self.volts_per_step / max(n_read, 1.0)
                self.set[t] += self.set_per_scan * (self.set_of_load * max(pressure, 0.0) - self.set[t])
                pressure -= self.set[t]
                at = 2 * n + i * taxels + t
                reals[at] = pressure
                touches = pressure > levels[kind + level]
                flags[at] = 1 if touches else 0
                n_touching += 1 if touches else 0
                n_released += 1 if pressure < levels[2 * kind + level] else 0
            if not self.is_begun:
                self.is_begun = True
                for k in range(n_line - 1):
                    self.totals[k] = array_total
            risen = array_total * self.line[n_line - 1]
            for k in range(n_line - 1):
                risen += self.totals[k] * self.line[k]
                self.totals[k] = self.totals[k + 1] if k < n_line - 2 else array_total
            flags[i] = 1 if n_touching > 0 else 0
            flags[n + i] = 1 if n_released == taxels else 0
            reals[i] = max(1.0, 1.0 * n_touching)
            reals[n + i] = risen * self.slope_scale / reals[i]
