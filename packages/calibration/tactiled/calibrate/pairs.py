"""Fit of the model of taxels with side electrodes: few physical parameters, and weights with shared priors.

The physical parameters are crosstalk, the load curve, creep and the two clocks. Given these, forces are
linear in the weights, which are eliminated at every step (variable projection: Golub and Pereyra, SIAM J.
Numerical Analysis 10, 1973, 413), so that the search has a dozen dimensions. Priors make taxels share what
the reference does not separate: the weights of each electrode position have a common part and a smaller part
of each taxel's own.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tactiled.array import Array, FloatArray
from tactiled.calibrate.clock import free_level, quiet_bins
from tactiled.calibrate.data import AlignedReference, BinnedLog, FittedModel
from tactiled.calibrate.folds import correlation_bins, folds, segments
from tactiled.calibrate.linear import Prior, Regression
from tactiled.force.calibration import CreepState, LoadCurve, PairsModelParams
from tactiled.force.model import N_KINDS, low_passed, taxel_means, uncoupling

# Prior of the physical parameters: mean and standard deviation. Loads are in units of the load at the 95 %
# quantile of the readings, so that numbers are those of a pressed electrode.
PHYSICS: dict[str, tuple[float, float]] = {
    "saturation": (0.35, 0.25),  # reading over the divider's supply; the ADC ends at 0.9 of it
    "exponent": (1.0, 0.25),  # of conductance in force; percolation in rubber gives 0.8 to 1.3
    "dead": (0.03, 0.05),  # load below which rubber does not conduct
    "taxel_crosstalk": (0.0, 0.03),  # of multiplexer and wiring
    "neighbour_crosstalk": (0.0, 0.02),
    "fast_creep": (0.0, 0.03),  # relative change of sensitivity: elastomers creep by some percent in a minute
    "slow_creep": (0.0, 0.03),
    "log_fast_s": (0.4, 0.8),  # time constants around 1.5 s ...
    "log_slow_s": (3.0, 0.8),  # ... and 20 s: what a calibration of a minute can tell apart
    "unloading": (0.0, 0.02),
    "late_s": (0.0, 0.3),  # after the correlation of the two records
    "drift": (0.0, 2e-4),  # quartz is within 100 ppm; two of them differ by 200
    "turn": (0.0, 0.05),  # rotation of the reference about the normal: 3 degrees
    "origin_x_mm": (0.0, 0.5),
    "origin_y_mm": (0.0, 0.5),
}
_NAMES = tuple(PHYSICS)
_OF_MOMENTS = ("turn", "origin_x_mm", "origin_y_mm")
_MEAN = np.array([mean for mean, _ in PHYSICS.values()])
_SD = np.array([sd for _, sd in PHYSICS.values()])
# Limits where formulas lose their meaning.
_LIMITS = {"saturation": (0.0, 0.85), "exponent": (0.4, 2.5), "dead": (0.0, 0.4), "unloading": (-0.2, 0.2)}
# Weights: standard deviations of the common and of each taxel's own part, over the common weight of a load.
_SHARED, _OWN = (0.5, 0.3, 0.3), (0.3, 0.15, 0.1)
# Shear over the difference of the loads of opposite electrodes, by the published sensitivities: 0.471 V/N of
# shear and 0.201 V/N of normal force on the mean of four resistors.
_SHEAR_RATIO = 1.7
_STEP_NOISES = 4.0  # readings beyond so much noise are above the dead zone
_SHIFT = 100.0  # of the search variables, away from 0, so that relative steps of derivatives are even
_KNOTS = 200  # of the tabulated curve: its error is below 1e-4 of the load


def has_pairs(array: Array) -> bool:
    """Return True for arrays whose taxels all have three side electrodes or more, and nothing else."""
    return (
        set(array.channel_kind) == {"side"}
        and int(np.bincount(array.channel_taxel, minlength=array.n_taxels).min()) >= 3
        and array.has_places
    )


class PairsFitter:
    """Fit of physics and weights to some `rows` (n,) of the bins; `late_s` is from the correlation."""

    def __init__(
        self,
        array: Array,
        log: BinnedLog,
        reference: AlignedReference,
        late_s: float,
        rows: NDArray[np.bool_],
    ) -> None:
        self._array, self._log, self._reference = array, log, reference
        self._late_s, self._rows = late_s, rows
        self._mean = taxel_means(array)
        self._quiet = quiet_bins(log) & rows
        self._used = reference.outputs
        # Most of a log may be a rest: at least the median of the bins in which something touches.
        part = min(0.05, 0.5 * float((~quiet_bins(log)).mean()))
        self._unit = float(np.quantile(log.readings.max(axis=1), 1 - part))
        self._step = max(_STEP_NOISES * float(np.median(log.noise)), 0.003 * self._unit)

    def _features(self, physics: dict[str, float], readings: FloatArray) -> FloatArray:
        """Features (n, 3 channels) of all bins: load, reading over unit, load times mean load."""
        if physics["taxel_crosstalk"] or physics["neighbour_crosstalk"]:
            matrix = uncoupling(self._array, physics["taxel_crosstalk"], physics["neighbour_crosstalk"])
            readings = readings @ matrix.T
        load = self._curve(readings, physics)
        own = load @ self._mean.T
        if physics["unloading"]:
            peak = _peaks(own)
            load = load / (1 + physics["unloading"] * (1 - own / np.maximum(peak, 1e-9)))
            own = load @ self._mean.T
        gains = [physics["fast_creep"], physics["slow_creep"]]
        times_s = np.exp([physics["log_fast_s"], physics["log_slow_s"]])
        if any(gains):
            bare, steps_s = load, self._log.steps_s
            for _ in range(2):  # the delayed load is that after correction; the second pass is exact to 1e-4
                factor = np.ones_like(own)
                for gain, time_s in zip(gains, times_s, strict=True):
                    factor += gain * _delayed(own, steps_s, float(time_s))
                load = bare / factor
                own = load @ self._mean.T
        return np.concatenate([load, readings / self._unit, load * own], axis=1)

    def _curve(self, readings: FloatArray, physics: dict[str, float]) -> FloatArray:
        """Load of electrodes, 1 at the reading `unit`, from divider, rubber and dead zone."""
        part = np.maximum(readings, 0.0) / self._unit
        s, q = physics["saturation"], physics["exponent"]
        part = np.minimum(part, 0.95 / max(s, 0.1))
        ratio = part * (1 - s) / (1 - s * part)
        return np.asarray(ratio**q + physics["dead"] * np.tanh(np.maximum(readings, 0.0) / self._step))

    def _regression(self, physics: dict[str, float]) -> Regression:
        """Make the linear problem of the used bins."""
        features = self._features(physics, self._log.readings)
        outputs = self._reference.means(self._late_s + physics["late_s"], physics["drift"])
        taxel = np.tile(self._array.channel_taxel, N_KINDS)
        x = self._array.x_mm[taxel] - physics["origin_x_mm"]
        y = self._array.y_mm[taxel] - physics["origin_y_mm"]
        turn = physics["turn"]
        return Regression(
            features[self._rows],
            outputs[self._rows],
            self._used,
            x + turn * y,
            y - turn * x,
            self._priors(features, outputs),
            free_level(outputs, self._quiet),
        )

    def _priors(self, features: FloatArray, outputs: FloatArray) -> list[Prior]:
        """Priors of the weights of fx, fy and fz."""
        array, n = self._array, self._array.n_channels
        total = features[self._rows, :n].sum(axis=1)
        scale = self._scale(total, outputs)
        azimuth = np.deg2rad(array.azimuth_deg)
        means = (
            _SHEAR_RATIO * scale * np.cos(azimuth) * array.sign,
            _SHEAR_RATIO * scale * np.sin(azimuth) * array.sign,
            np.full(n, scale),
        )
        position = _positions(array)
        priors = []
        for mean in means:
            precision = np.zeros((N_KINDS * n, N_KINDS * n))
            for kind in range(N_KINDS):
                for place in set(position.tolist()):
                    members = np.flatnonzero(position == place)
                    covariance = (_SHARED[kind] * scale) ** 2 * np.ones((len(members), len(members)))
                    covariance += (_OWN[kind] * scale) ** 2 * np.eye(len(members))
                    at = kind * n + members
                    precision[np.ix_(at, at)] = np.linalg.inv(covariance)
            priors.append(Prior(np.concatenate([mean, np.zeros(2 * n)]), precision))
        return priors

    def _scale(self, total: FloatArray, outputs: FloatArray) -> float:
        """Newtons for a load of 1 on one electrode, from the normal force if it is known."""
        if 2 not in self._used:
            shear = np.hypot(outputs[self._rows, 0], outputs[self._rows, 1])
            return max(float(np.quantile(shear, 0.95)) / max(float(np.quantile(total, 0.95)), 1e-9), 1e-9)
        fz = outputs[self._rows, 2]
        centred = total - total.mean()
        slope = float(centred @ (fz - fz.mean())) / max(float(centred @ centred), 1e-12)
        return max(abs(slope), 1e-9)

    def fit(self, reached: Callable[[str], None]) -> tuple[FittedModel, dict[str, float]]:
        """Fit everything; return the model with its errors in the folds, and its physical parameters.

        The standard deviations of the outputs follow the residuals.
        """
        theta, sd = _MEAN.copy(), self._floor()
        names = [name for name in _NAMES if name not in _OF_MOMENTS or {3, 4} & set(self._used)]
        free = np.array([_NAMES.index(name) for name in names])
        low, high = (
            np.array([_LIMITS.get(name, (-np.inf, np.inf))[end] for name in names]) / _SD[free]
            for end in (0, 1)
        )
        for stage in range(3):
            sd = self._spread(theta, sd)
            found = least_squares(
                partial(self._loss, theta=theta, free=free, sd=sd),
                _SHIFT + np.clip(theta[free] / _SD[free], low + 1e-6, high - 1e-6),
                bounds=(_SHIFT + low, _SHIFT + high),
                diff_step=[1e-3 / _SHIFT] * len(free),
                max_nfev=8,
                xtol=1e-3,
                ftol=1e-4,
            )
            theta[free] = (found.x - _SHIFT) * _SD[free]
            reached(f"fit {stage + 1} of 3")
        return self._model(theta, self._spread(theta, sd)), _named(theta)

    def _loss(self, z: FloatArray, theta: FloatArray, free: NDArray[np.int64], sd: FloatArray) -> FloatArray:
        """Whitened residuals and differences from the priors, at free parameters over the sd of theirs."""
        full = theta.copy()
        full[free] = (z - _SHIFT) * _SD[free]
        problem = self._regression(_named(full))
        linear = problem.solve(sd)
        residuals = problem.residuals(linear)[:, self._used] / sd[self._used]
        prior = z - _SHIFT - _MEAN[free] / _SD[free]
        return np.concatenate([residuals.ravel(), linear.prior_loss, prior])

    def _spread(self, theta: FloatArray, sd: FloatArray) -> FloatArray:
        """Standard deviations (6,) of the residuals of a fit with those before, at least the floor."""
        problem = self._regression(_named(theta))
        n = max(int(self._rows.sum()) - 1, 1)
        squares = (problem.residuals(problem.solve(sd)) ** 2).sum(axis=0)
        return np.asarray(np.maximum(np.sqrt(squares / n), self._floor()))

    def _floor(self) -> FloatArray:
        """Smallest standard deviations (6,) of the outputs: the noise of the reference in a bin."""
        samples = max(self._log.step_s / self._reference.sample_s, 1.0)
        noise = self._reference.noise / np.sqrt(samples)
        spread = self._reference.means(self._late_s, 0.0)[self._rows].std(axis=0)
        return np.asarray(np.maximum(np.nan_to_num(noise, nan=1.0), 1e-4 * spread + 1e-9))

    def _model(self, theta: FloatArray, sd: FloatArray) -> FittedModel:
        """Errors in the folds, and a covariance that counts correlated bins as one."""
        physics, rows, used = _named(theta), self._rows, self._used
        problem = self._regression(physics)
        outputs = self._reference.means(self._late_s + physics["late_s"], physics["drift"])[rows]
        left = np.zeros_like(outputs)
        for left_out in folds(segments(outputs, used, self._log.step_s)):
            left[left_out] = problem.residuals(problem.solve(sd, ~left_out))[left_out]
        correlated = np.array([correlation_bins(left[:, k]) if k in used else 1.0 for k in range(6)])
        weights = problem.solve(sd).weights
        units = np.repeat([1.0, self._unit, 1.0], self._array.n_channels)  # a file has readings as they are
        return FittedModel(
            name="pairs",
            weights=weights,
            covariance=problem.solve(sd * np.sqrt(correlated)).covariance,
            features=self._features(physics, self._log.readings)[rows],
            left_out=left,
            moved=lambda change: self._features(physics, self._log.readings + change)[rows],
            table=self._params(physics, weights / units),
            feature_units=units,
        )

    def _params(self, physics: dict[str, float], weights: FloatArray) -> PairsModelParams:
        """Model as it goes into a file; `weights` (3, features) of fx, fy and fz in the unit of the array."""
        most = min(0.95 / max(physics["saturation"], 0.1) * self._unit, 3.0 * self._unit)
        reading = np.unique(
            np.concatenate([np.linspace(0, 3 * self._step, _KNOTS // 4), np.linspace(0, most, _KNOTS)])
        )
        load = np.maximum.accumulate(self._curve(reading, physics))
        n = self._array.n_channels
        return PairsModelParams(
            taxel_crosstalk=physics["taxel_crosstalk"],
            neighbour_crosstalk=physics["neighbour_crosstalk"],
            curve=LoadCurve(reading=reading.tolist(), load=load.tolist()),
            creep=[
                CreepState(time_s=float(np.exp(physics[f"log_{name}_s"])), gain=physics[f"{name}_creep"])
                for name in ("fast", "slow")
            ],
            unloading=physics["unloading"],
            weights=weights.reshape(3, N_KINDS, n).transpose(2, 1, 0).reshape(n, 3 * N_KINDS).tolist(),
        )


def _named(theta: FloatArray) -> dict[str, float]:
    return dict(zip(_NAMES, theta.tolist(), strict=True))


def _positions(array: Array) -> NDArray[np.int64]:
    """Number of each channel's position within its taxel (channels,): electrodes of one azimuth share it."""
    rounded = np.round(array.azimuth_deg).astype(np.int64) % 360
    return np.unique(rounded, return_inverse=True)[1].astype(np.int64)


def _delayed(values: FloatArray, steps_s: FloatArray, time_s: float) -> FloatArray:
    """Low-passed values (n, channels) of all bins before each one."""
    return np.concatenate([np.zeros_like(values[:1]), low_passed(values, steps_s, time_s)[:-1]])


def _peaks(load: FloatArray) -> FloatArray:
    """Largest load (n, channels) since the taxel was last free, as the running model keeps it."""
    out = np.empty_like(load)
    peak = np.zeros(load.shape[1])
    for k, row in enumerate(load):
        peak = np.maximum(peak, row)
        peak[row < 0.02 * peak] = 0.0
        out[k] = np.where(peak > 0.0, peak, row)
    return out
