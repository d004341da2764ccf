"""Models of an array: features of a scan, and the weights that make forces of them.

Both models are linear in their weights, so that the standard deviation of a force follows from the covariance
of the weights. Scans are taken one by one with arrays of fixed shapes: results do not depend on how scans
were chunked. A product of a matrix with several scans would be rounded otherwise than with one, and BLAS
rounds otherwise on another kind of processor.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.errors import ConfigError
from tactiled.force.calibration import (
    CalibrationFile,
    Curve,
    PairsModelParams,
    SmoothFeatures,
    SmoothModelParams,
)

N_KINDS = 3  # features of a channel in the model of pairs: load, reading, load times the taxel's load
_NEIGHBOUR_PITCHES = 1.5  # taxels nearer than this, in units of the smallest distance, are neighbours
_LEAST_PART = 0.01  # of the reading without a load: the least for a curve
_STRETCH = 20.0  # time constants that are summed at once: exp(20) of the oldest weight leaves it 7 digits
_RELEASED = 0.02  # of the largest load since touch, below which a contact has ended


def times(matrix: FloatArray, scan: FloatArray) -> FloatArray:
    """Product (rows,) of a matrix (rows, columns) with a scan (columns,), summed in one order everywhere."""
    return np.asarray((matrix * scan).sum(axis=1))


def times_each(matrix: FloatArray, scans: FloatArray) -> FloatArray:
    """Product (n, rows) of a matrix (rows, columns) with each of n scans (n, columns) by itself."""
    out = np.empty((len(scans), len(matrix)))
    for scan, row in zip(scans, out, strict=True):
        row[:] = times(matrix, scan)
    return out


def taxel_means(array: Array) -> FloatArray:
    """Matrix (channels, channels) that replaces each channel by the mean of its taxel."""
    among = np.equal.outer(array.channel_taxel, array.channel_taxel).astype(np.float64)
    return np.asarray(among / among.sum(axis=1, keepdims=True))


def neighbour_means(array: Array) -> FloatArray:
    """Matrix (channels, channels) from readings to the mean reading of the neighbouring taxels."""
    x, y, pad = array.x_mm, array.y_mm, array.pad
    distance = np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y))
    distance[np.not_equal.outer(pad, pad)] = np.inf
    np.fill_diagonal(distance, np.inf)
    least = distance.min(initial=np.inf)
    near = (distance < _NEIGHBOUR_PITCHES * least) & np.isfinite(distance)  # none where places coincide
    of_channel = near[array.channel_taxel][:, array.channel_taxel].astype(np.float64)
    return np.asarray(of_channel / np.maximum(of_channel.sum(axis=1, keepdims=True), 1.0))


def uncoupling(array: Array, taxel_crosstalk: float, neighbour_crosstalk: float) -> FloatArray:
    """Matrix (channels, channels) that removes crosstalk from readings.

    Readings are ``v + a (mean of the taxel - v) + b (mean of the neighbouring taxels - v)``.
    """
    one = np.eye(array.n_channels)
    neighbours = neighbour_means(array)
    own = np.diag(neighbours.sum(axis=1))  # a taxel without neighbours loses nothing to them
    mixing = one + taxel_crosstalk * (taxel_means(array) - one) + neighbour_crosstalk * (neighbours - own)
    return np.asarray(np.linalg.inv(mixing), dtype=np.float64)


def output_weights(array: Array, taxel_weights: FloatArray) -> FloatArray:
    """Weights of totals and taxels from the weights (channels, 3, kinds) of each channel's taxel.

    Moments are about the origin of the array frame: ``tx = y fz``, ``ty = -x fz``, ``tz = x fy - y fx``.
    """
    channels, _, kinds = taxel_weights.shape
    flat = taxel_weights.transpose(1, 2, 0).reshape(3, kinds * channels)
    x = np.tile(array.x_mm[array.channel_taxel], kinds)
    y = np.tile(array.y_mm[array.channel_taxel], kinds)
    fx, fy, fz = flat
    totals = np.stack([fx, fy, fz, y * fz, -x * fz, x * fy - y * fx])
    own = np.equal.outer(np.arange(array.n_taxels), np.tile(array.channel_taxel, kinds))
    taxels = [own * component for component in flat]
    return np.ascontiguousarray(np.concatenate([totals, *taxels]))


class PairsModel:
    """Taxels with side electrodes: crosstalk, load curve, creep, and a map that depends on load.

    Attributes
    ----------
    weights : (6 + 3 taxels, features) float64
        fx, fy, fz, tx, ty, tz, then fx, fy, fz of all taxels.
    channels : (2, features) int64
        Channels that each feature is of, twice the same one but for products.
    """

    def __init__(self, array: Array, params: PairsModelParams) -> None:
        n = array.n_channels
        taxel_weights = np.array(params.weights).reshape(n, N_KINDS, 3).transpose(0, 2, 1)
        self.weights = output_weights(array, taxel_weights)
        has_crosstalk = bool(params.taxel_crosstalk or params.neighbour_crosstalk)
        self._uncouple: FloatArray | None = (
            uncoupling(array, params.taxel_crosstalk, params.neighbour_crosstalk) if has_crosstalk else None
        )
        self._mean = taxel_means(array)
        self.channels = np.tile(np.arange(n), (2, N_KINDS))
        self._reading, self._load = np.array(params.curve.reading), np.array(params.curve.load)
        self._slope = float(np.diff(self._load)[-1] / np.diff(self._reading)[-1])  # beyond the curve
        self._time_s = np.array([state.time_s for state in params.creep])[:, np.newaxis]
        self._gain = np.array([state.gain for state in params.creep])
        self._unloading = params.unloading
        self.reset()

    def reset(self) -> None:
        """Forget the state of creep."""
        n = len(self._mean)
        self._relaxed = np.zeros((len(self._gain), n))
        self._peak = np.zeros(n)

    def features(self, readings: FloatArray, steps_s: Sequence[float]) -> FloatArray:
        """Return features (n, 3 channels) of the next scans: load, reading, load times the taxel's mean load.

        Readings (n, channels) are finite and relative to zero; `steps_s` is the time of each scan since the
        one before.
        """
        reading = readings if self._uncouple is None else times_each(self._uncouple, readings)
        load = np.interp(reading, self._reading, self._load)
        load += self._slope * np.maximum(reading - self._reading[-1], 0.0)
        if self._unloading:
            for scan in load:
                self._unload(scan)
        if len(self._gain):
            mean = np.empty_like(load)
            for scan, own, step_s in zip(load, mean, steps_s, strict=True):
                self._creep(scan, own, step_s)
        else:
            mean = times_each(self._mean, load)
        return np.concatenate([load, reading, load * mean], axis=1)

    def _unload(self, load: FloatArray) -> None:
        """Correct the loads (channels,) of a scan for the largest ones since the touch began."""
        own = times(self._mean, load)
        np.maximum(self._peak, own, out=self._peak)
        self._peak[own < _RELEASED * self._peak] = 0.0
        part = np.where(self._peak > 0.0, own / np.maximum(self._peak, 1e-9), 1.0)
        load /= 1.0 + self._unloading * (1.0 - part)

    def _creep(self, load: FloatArray, mean: FloatArray, step_s: float) -> None:
        """Correct the loads (channels,) of a scan for creep, and set the means of their taxels."""
        load /= 1.0 + (self._gain[:, np.newaxis] * self._relaxed).sum(axis=0)
        mean[:] = times(self._mean, load)
        self._relaxed -= np.expm1(-step_s / self._time_s) * (mean - self._relaxed)


class FeatureMaker:
    """Features of the smooth model: readings, their squares and products, and low-passed copies.

    Attributes
    ----------
    channels : (2, features) int64
        See `PairsModel`.
    taxel : (features,) int64
        Taxel that each feature belongs to.
    """

    def __init__(self, array: Array, params: SmoothFeatures) -> None:
        self._scale = np.array(params.scale)
        self._curve, self._zero = params.curve, np.array(params.zero)
        self._squares = params.has_squares
        self._pairs = product_pairs(array) if params.has_products else np.zeros((0, 2), dtype=np.int64)
        self._time_s = np.array(params.creep_s)[:, np.newaxis]
        self._n_states = len(params.creep_s)
        each = np.tile(np.arange(array.n_channels), (2, 1))
        own = [each] * (2 if self._squares else 1)
        self.channels = np.concatenate([*own, self._pairs.T, *[each] * self._n_states], axis=1)
        self.taxel = array.channel_taxel[self.channels[0]]
        self._relaxed = np.zeros((self._n_states, array.n_channels))

    def reset(self) -> None:
        """Forget the low-passed readings."""
        self._relaxed[:] = 0.0

    def features(self, readings: FloatArray, steps_s: Sequence[float]) -> FloatArray:
        """Return the features (n, features) of the next scans; see `PairsModel`."""
        scaled = bent(readings, self._curve, self._zero) / self._scale
        parts = [scaled]
        if self._squares:
            parts.append(scaled * scaled)
        if len(self._pairs):
            parts.append(scaled[:, self._pairs[:, 0]] * scaled[:, self._pairs[:, 1]])
        if self._n_states:
            parts.append(np.stack([self._relax(*scan) for scan in zip(scaled, steps_s, strict=True)]))
        return np.concatenate(parts, axis=1)

    def _relax(self, scaled: FloatArray, step_s: float) -> FloatArray:
        """Return the low-passed readings (states channels,) of the next scan."""
        self._relaxed -= np.expm1(-step_s / self._time_s) * (scaled - self._relaxed)
        return self._relaxed.flatten()


class SmoothModel:
    """Ridge regression on the features of `FeatureMaker`."""

    def __init__(self, array: Array, params: SmoothModelParams) -> None:
        maker = FeatureMaker(array, params)
        totals = np.array(params.weights)
        own = np.equal.outer(np.arange(array.n_taxels), maker.taxel)
        self.weights = np.ascontiguousarray(np.concatenate([totals, *(own * row for row in totals[:3])]))
        self.reset, self.features, self.channels = maker.reset, maker.features, maker.channels


def bent(readings: FloatArray, curve: Curve, zero: FloatArray) -> FloatArray:
    """Put readings (n, channels), which are relative to `zero` (channels,), through a curve.

    The absolute reading is held above a hundredth of its zero: nearer to 0 curves grow beyond all bounds.
    """
    if curve == "linear":
        return readings
    part = np.maximum(1.0 + readings / zero, _LEAST_PART)
    return np.log(part) if curve == "log" else (1.0 / part - 1.0) / zero


def low_passed(values: FloatArray, steps_s: FloatArray, time_s: float) -> FloatArray:
    """Exponential average (n, channels) of values (n, channels) that are `steps_s` (n,) apart.

    ``y[k] = y[k-1] + (1 - exp(-steps_s[k] / time_s)) (values[k] - y[k-1])``, which is what `FeatureMaker`
    keeps scan by scan. The sum is taken over stretches of time constants, beyond which weights overflow.
    """
    steps = steps_s / time_s
    stretch = (np.cumsum(steps) // _STRETCH).astype(np.int64)
    starts = np.flatnonzero(np.diff(stretch, prepend=-1))
    out = np.empty_like(values)
    state = np.zeros(values.shape[1])
    for a, b in itertools.pairwise([*starts.tolist(), len(values)]):
        since = np.cumsum(steps[a:b])[:, np.newaxis] - steps[a]
        grown = -np.expm1(-steps[a:b])[:, np.newaxis] * np.exp(since) * values[a:b]
        out[a:b] = np.exp(-since) * (np.cumsum(grown, axis=0) + math.exp(-steps[a]) * state)
        state = out[b - 1]
    return out


def product_pairs(array: Array) -> NDArray[np.int64]:
    """Pairs (pairs, 2) of different channels of one taxel."""
    first, second = np.triu_indices(array.n_channels, 1)
    same = array.channel_taxel[first] == array.channel_taxel[second]
    return np.stack([first[same], second[same]], axis=1)


ForceModel = PairsModel | SmoothModel


def build_model(array: Array, file: CalibrationFile) -> ForceModel:
    """Make the model of a calibration file for its array.

    `ConfigError` if the file is of another array, or has weights of other features.
    """
    file.check_array(array)
    if file.smooth is not None:
        n_features, weights = len(FeatureMaker(array, file.smooth).taxel), file.smooth.weights
    else:
        n_features, weights = N_KINDS * array.n_channels, []  # the schema checks those of pairs
    tables = {"smooth.weights": weights, "uncertainty.factor": itertools.chain(*file.uncertainty.factor)}
    for name, rows in tables.items():
        for row in rows:
            if len(row) != n_features:
                raise ConfigError(
                    file.name, [f"{name}: a row has {len(row)} numbers for {n_features} features"]
                )
    if file.pairs is not None:
        return PairsModel(array, file.pairs)
    assert file.smooth is not None  # the schema requires one of the two
    return SmoothModel(array, file.smooth)
