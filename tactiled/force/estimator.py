"""Force events from scans: zero, model, standard deviations, flags."""

import itertools
import math
from collections import deque
from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.events.types import UNKNOWN_SD_N, ForceEvent, new_event
from tactiled.force.calibration import AXES, CalibrationFile
from tactiled.force.model import build_model, times_each
from tactiled.samples.block import Gap, ScanBlock

# Rubber filled with carbon changes by 0.1 to 1 % a kelvin, and an object in the hand brings some 10 K in half
# an hour: 3 % at 0.3 % a kelvin. It cannot be observed in contact, so the standard deviation grows by it.
_WARMING, _WARMING_S = 0.03, 1800.0
_MISSING_PART = 0.5  # of what a channel without a reading would add to the force is uncertain
# Of the largest calibrated reading: an invalid reading above is saturated, one below is a fault.
_AT_LIMIT = 0.9
_TOLERATED_MISSING = 0.25  # part of the channels beyond which a force means nothing
_BEYOND = 1.1  # times the largest calibrated reading or force: above, the model is extrapolated
# Relative standard deviation for each e-fold beyond. The curve of the model of pairs is physics; squares bend
# either way, so that nothing but the size is known.
_BEYOND_PAIRS, _BEYOND_SMOOTH = 0.25, 2.0
# A normal force below so many standard deviations of that on a free array has no centre of pressure. An error
# of all taxels together does not move the centre.
_NO_CENTRE_SDS = 3.0

# A scan without contact has every channel nearer to its zero than this: five standard deviations of its
# noise, which one of 36 channels exceeds by chance once in 50,000 scans, and at least this part of the range.
_QUIET_NOISES = 5.0
_LEAST_QUIET = 1 / 2048
# Fastest drift that is followed, as a part of the largest calibrated reading per second: 1 % in 50 s. A press
# that grows more slowly cannot be told from drift; every faster one is left alone.
_FASTEST_DRIFT_PER_S = 2e-4
_FOLLOW_S = 2.0  # averaging time of the zero: noise falls to a twentieth at 100 Hz
_HOLD_BACK_S = 1.0  # a contact begins before it is noticed: the zero of so long ago is used from then on
_SNAPSHOTS = 4  # within the time above
# A contact is over where all channels stay below this part of its largest reading, and below what drift can
# have made of the zero meanwhile. A touch that goes on with less than that is taken for drift.
_LEFT = 0.02
# Random walk of the zero while it cannot be followed, part of the largest calibrated reading per root second:
# 0.1 % in an hour, as of a divider with resistors of 100 ppm/K in a room that changes by 10 K.
_WALK_PER_ROOT_S = 1.7e-5


class DriftZero:
    """Offset of each channel from the zero that was set, and its standard deviation.

    Parameters
    ----------
    largest : (channels,) float64
        Largest reading of each channel in the calibration; the scale of drift.
    noise, sd : float
        Standard deviations of a reading, and of the zero after a tare, in the unit of the array.
    """

    def __init__(self, array: Array, largest: FloatArray, noise: float, sd: float) -> None:
        self._scale = float(np.median(largest)) or array.full_scale
        self._level = max(_QUIET_NOISES * noise, _LEAST_QUIET * self._scale)
        self._sd = sd
        self._n = array.n_channels
        self.reset()

    def reset(self) -> None:
        """Forget all drift, as after a tare."""
        self.offset = np.zeros(self._n)  # of readings that are relative to the zero that was set
        self.touching = False  # True while contact cannot be excluded
        self.touched_s = 0.0  # time since the zero was last followed
        self._snapshots = deque([self.offset.copy()], maxlen=_SNAPSHOTS)
        self._since_s = 0.0
        self._margin = 0.0
        self._peak = self._calm_s = 0.0

    def step(self, readings: FloatArray, step_s: float, *, is_complete: bool) -> FloatArray:
        """Return the readings (channels,) of a scan relative to the drifted zero, and follow the drift."""
        relative = readings - self.offset
        size = max(float(relative.max()), -float(relative.min()))
        if not (is_complete and size < self._level + self._margin):
            if not self.touching:  # the beginning of the contact may have moved the zero
                self.offset = self._snapshots[0].copy()
                self.touching = True
                relative = readings - self.offset
            self.touched_s += step_s
            self._look_for_release(size, step_s, is_complete=is_complete)
            return relative
        most = _FASTEST_DRIFT_PER_S * self._scale * step_s
        self.touching = False
        self.touched_s = self._peak = self._calm_s = 0.0
        self._margin = max(self._margin - most, 0.0)
        self.offset += np.minimum(np.maximum(relative * min(1.0, step_s / _FOLLOW_S), -most), most)
        self._since_s += step_s
        if self._since_s >= _HOLD_BACK_S / _SNAPSHOTS:
            self._since_s = 0.0
            self._snapshots.append(self.offset.copy())
        return relative

    def _look_for_release(self, size: float, step_s: float, *, is_complete: bool) -> None:
        """Notice the end of a contact in which the zero has drifted beyond the level of a free array."""
        self._peak = max(self._peak, size)
        left = min(_LEFT * self._peak, _FASTEST_DRIFT_PER_S * self._scale * self.touched_s)
        self._calm_s = self._calm_s + step_s if is_complete and size < self._level + left else 0.0
        if self._calm_s >= _HOLD_BACK_S:
            self._margin = left

    def variance(self, touched_s: float) -> float:
        """Return the variance of the zero at a value of `touched_s`, in the unit of the array squared."""
        walk = _WALK_PER_ROOT_S * self._scale
        return self._sd**2 + walk * walk * touched_s


def _numbered(names: Sequence[Hashable]) -> NDArray[np.int64]:
    """Return the number of each name (n,), in the order in which the names first come."""
    number = {name: k for k, name in enumerate(dict.fromkeys(names))}
    return np.array([number[name] for name in names], dtype=np.int64)


class UncalibratedForce:
    """Force events of an array without a calibration: every force is unknown."""

    def process(self, item: ScanBlock | Gap) -> list[ForceEvent]:
        """Return an event for each scan."""
        if isinstance(item, Gap):
            return []
        return [ForceEvent(time_s=time_s) for time_s in item.time_s.tolist()]

    def reset(self) -> None:
        """Forget nothing: there is no state."""

    def tared(self) -> None:
        """Ignore the tare."""


class _Estimate(NamedTuple):
    """Estimate of one scan."""

    # (outputs + errors,): forces and moments, then what the standard deviations are made of
    values: FloatArray
    excess: float  # largest reading over the largest calibrated one
    touched_s: float  # see `DriftZero`
    missing2: list[float]  # variances of fx, fy and fz by channels without a reading
    n_missing: int


class ForceEstimator:
    """Forces on an array, for each scan; `ConfigError` if the calibration is of another array.

    Examples
    --------
    One newton on each taxel is 0.2 V on its resistors, by the published sensitivity:

    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> from tactiled.force.calibration import load_calibration
    >>> from tactiled.samples.block import regular_block
    >>> estimator = ForceEstimator(load_array("wang2019-3x3"), load_calibration("wang2019-3x3"))
    >>> force = estimator.process(regular_block(np.full((1, 36), 0.201), 100.0))[0]
    >>> f"{force.fz_n:.2f} ± {force.fz_sd_n:.1f} N at ({force.x_mm:.1f}, {force.y_mm:.1f}) mm"
    '9.00 ± 5.7 N at (3.6, 3.6) mm'
    """

    def __init__(self, array: Array, file: CalibrationFile) -> None:
        self._model = build_model(array, file)
        self._n_taxels = array.n_taxels
        self._array = array
        self._largest = np.maximum(np.array(file.largest_reading), 1e-12)
        uncertainty = file.uncertainty
        self._zero = DriftZero(array, self._largest, uncertainty.noise, uncertainty.zero_sd)
        self._name = "nominal" if file.nominal else file.name
        self._known = [axis in file.axes for axis in AXES]
        rows = [self._model.weights]
        self._n_outputs = len(self._model.weights)
        self._rank = [len(factor) for factor in uncertainty.factor] or [0, 0, 0]
        rows += [np.array(factor) for factor in uncertainty.factor if factor]
        self._matrix = np.ascontiguousarray(np.concatenate(rows))
        self._floor2 = [value**2 for value in uncertainty.floor_n]
        self._own2 = [value**2 for value in uncertainty.own]
        self._of_normal2 = [value**2 for value in uncertainty.of_normal]
        self._walk2 = [value**2 for value in uncertainty.walk_n]
        self._per_unit2 = [value**2 for value in uncertainty.n_per_unit]
        self._limit = self._largest * _BEYOND
        least_n, most_n = file.range.fz_n
        self._most_fz_n = max(-least_n, most_n, 1e-9) * _BEYOND if self._known[2] else math.inf
        self._beyond2 = (_BEYOND_SMOOTH if file.pairs is None else _BEYOND_PAIRS) ** 2
        self._most_missing = _TOLERATED_MISSING * array.n_channels
        groups = list(zip(array.channel_taxel.tolist(), array.channel_kind, strict=True))
        self._group, self._kind = _numbered(groups), _numbered(array.channel_kind)
        self._centre_mm = (float(array.x_mm.mean()), float(array.y_mm.mean()))
        self.reset()

    def reset(self) -> None:
        """Forget zero, creep and contact; keep the calibration."""
        self.tared()
        self._last_s: float | None = None

    def tared(self) -> None:
        """Take the present zero of the readings as exact and as free of creep: a tare has just set it."""
        self._model.reset()
        self._zero.reset()
        self._previous = np.zeros(self._array.n_channels)

    def process(self, item: ScanBlock | Gap) -> list[ForceEvent]:
        """Return an event for each scan."""
        if isinstance(item, Gap):
            return []  # stamps are of the host: the next one tells how long it was
        n = len(item)
        steps_s = self._steps_s(item)
        complete: list[bool] = np.all(item.valid, axis=1).tolist()
        relative = np.empty_like(item.volts)
        touched_s: list[float] = []
        n_missing, saturated = [0] * n, [False] * n
        for scan, step_s in enumerate(steps_s):
            readings = item.volts[scan]
            if not complete[scan]:
                valid = item.valid[scan]
                at_limit = self._at_limit(readings, valid)
                saturated[scan] = bool(at_limit.any())
                n_missing[scan] = int(np.count_nonzero(~valid))
                readings = self._filled(readings, valid | at_limit)
            self._previous = readings
            # A contact loads more than a few missing channels do not show.
            is_told = not saturated[scan] and n_missing[scan] <= self._most_missing
            relative[scan] = self._zero.step(readings, step_s, is_complete=is_told)
            touched_s.append(self._zero.touched_s)
        features = self._model.features(relative, steps_s)
        values = times_each(self._matrix, features)
        excess: list[float] = np.abs(relative / self._limit).max(axis=1).tolist()
        times: list[float] = item.time_s.tolist()
        late: list[bool] = item.late.tolist()
        events: list[ForceEvent] = []
        for scan, time_s in enumerate(times):
            missing2 = [0.0, 0.0, 0.0]
            if not complete[scan]:
                missing2 = self._missing_variance(features[scan], item.valid[scan])
            estimate = _Estimate(values[scan], excess[scan], touched_s[scan], missing2, n_missing[scan])
            events.append(self._event(time_s, estimate, saturated=saturated[scan], is_late=late[scan]))
        return events

    def _steps_s(self, item: ScanBlock) -> list[float]:
        """Time of each scan since the one before; of a first scan the period."""
        times_s: list[float] = item.time_s.tolist()
        before_s = times_s[0] - 1.0 / item.rate_hz if self._last_s is None else self._last_s
        self._last_s = times_s[-1]
        # Stamps of a clock that was corrected can go back by less than a period.
        return [max(b - a, 0.0) for a, b in itertools.pairwise([before_s, *times_s])]

    def _event(self, time_s: float, estimate: _Estimate, *, saturated: bool, is_late: bool) -> ForceEvent:
        """Make the event of a scan."""
        outputs: list[float] = estimate.values[: self._n_outputs].tolist()
        fx, fy, fz, tx, ty, tz = outputs[:6]
        excess = estimate.excess
        excess = max(excess, abs(fz) / self._most_fz_n)
        zero2 = self._zero.variance(estimate.touched_s)
        sd = self._sd(estimate, outputs, excess, zero2)
        x_mm, y_mm = self._centre_mm
        if fz > _NO_CENTRE_SDS * math.sqrt(self._floor2[2] + self._per_unit2[2] * zero2):
            x_mm, y_mm = -ty / fz, tx / fz
        n = self._n_taxels
        return new_event(
            ForceEvent,
            time_s=time_s,
            fx_n=fx if self._known[0] else 0.0,
            fy_n=fy if self._known[1] else 0.0,
            fz_n=fz if self._known[2] else 0.0,
            fx_sd_n=sd[0],
            fy_sd_n=sd[1],
            fz_sd_n=sd[2],
            tx_nmm=tx,
            ty_nmm=ty,
            tz_nmm=tz,
            x_mm=x_mm,
            y_mm=y_mm,
            taxel_fx_n=tuple(outputs[6 : 6 + n]),
            taxel_fy_n=tuple(outputs[6 + n : 6 + 2 * n]),
            taxel_fz_n=tuple(outputs[6 + 2 * n :]),
            calibration=self._name,
            saturated=saturated,
            beyond_range=excess > 1.0,
            channels_missing=estimate.n_missing,
            valid=not is_late and estimate.n_missing <= self._most_missing,
            late=is_late,
        )

    def _sd(self, estimate: _Estimate, outputs: list[float], excess: float, zero2: float) -> list[float]:
        """Return the standard deviations of fx, fy and fz."""
        gain2 = _WARMING**2 * min(estimate.touched_s / _WARMING_S, 1.0)
        if excess > 1.0:
            gain2 += self._beyond2 * math.log(_BEYOND * excess) ** 2
        normal2 = outputs[2] ** 2
        sd: list[float] = []
        at = self._n_outputs
        for axis, rank in enumerate(self._rank):
            errors = estimate.values[at : at + rank]
            at += rank
            if not self._known[axis] or estimate.n_missing == self._array.n_channels:
                sd.append(UNKNOWN_SD_N)
                continue
            variance = (
                self._floor2[axis]
                + (self._own2[axis] + gain2) * outputs[axis] ** 2
                + self._of_normal2[axis] * normal2
                + self._per_unit2[axis] * zero2
                + self._walk2[axis] * estimate.touched_s
                + estimate.missing2[axis]
            )
            sd.append(math.sqrt(variance + float((errors * errors).sum())))
        return sd

    def _at_limit(self, readings: FloatArray, valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Flag channels (channels,) whose reading is not valid because it is as large as it can be."""
        if not valid.any():  # the whole scan is flagged
            return np.zeros(len(valid), dtype=np.bool_)
        return np.asarray(~valid & (np.abs(readings) >= _AT_LIMIT * self._largest))

    def _filled(self, readings: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
        """Replace readings that are not usable by the mean of the others of their kind on their taxel.

        Where there are none, a channel keeps its reading of the scan before. A saturated reading stays as it
        is: it is the least that the load can be.
        """
        known = np.where(usable, readings, 0.0)
        count = np.bincount(self._group, usable)[self._group]
        mean = np.bincount(self._group, known)[self._group] / np.maximum(count, 1.0)
        return np.where(usable, readings, np.where(count > 0, mean, self._previous))

    def _missing_variance(self, features: FloatArray, valid: NDArray[np.bool_]) -> list[float]:
        """Variance of fx, fy and fz by the channels that were replaced or are saturated.

        A channel that nothing replaces keeps an older reading, which may be one of a free array: what the
        others of its kind add on average is the least.
        """
        is_alone = ~valid & (np.bincount(self._group, valid)[self._group] == 0)
        first, second = self._model.channels
        variances: list[float] = []
        for part in self._model.weights[:3] * features:
            own = np.bincount(first, part, len(valid))
            own += np.bincount(second, np.where(first == second, 0.0, part), len(valid))
            power = (_MISSING_PART * own) ** 2
            usual = np.bincount(self._kind, power * valid) / np.maximum(np.bincount(self._kind, valid), 1.0)
            power = np.maximum(power, np.where(is_alone, usual[self._kind], 0.0))
            variances.append(float(power[~valid].sum()))
        return variances


ForceSource = ForceEstimator | UncalibratedForce
"""Maker of a force event from each scan."""
