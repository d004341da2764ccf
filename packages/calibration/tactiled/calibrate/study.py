"""Calibration of an array: clocks, models, cross-validation, standard deviations, and the file."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from tactiled.array import Array, FloatArray
from tactiled.calibrate.checks import check_fit, check_log, check_reference, check_signs, check_unit
from tactiled.calibrate.clock import align, free_level, quiet_bins
from tactiled.calibrate.data import (
    AlignedReference,
    BinnedLog,
    PoseReference,
    ReferenceTable,
    bin_log,
    pose_log,
    same_poses,
)
from tactiled.calibrate.folds import correlation_bins, folds, segments
from tactiled.calibrate.pairs import PairsFit, PairsFitter
from tactiled.calibrate.smooth import PLAIN, SmoothFit, choose_smooth, fit_smooth
from tactiled.calibrate.uncertainty import AxisUncertainty, axis_uncertainty
from tactiled.calibrate.verdict import verdict
from tactiled.force.calibration import (
    AXES,
    CalibrationFile,
    ForceRange,
    Residuals,
    Uncertainty,
)

N_STAGES = 6
# A smooth model must be better by this factor to be preferred: physics holds on motions that no fold has.
_PREFERENCE = 2.0
_LEAST_CONTACTS = 5  # from which the drift of the force is estimated
_PROBES = 8  # random patterns of a zero error, whose effect on the force is averaged


@dataclass(frozen=True)
class Identity:
    """Entries of the file that the data does not contain."""

    name: str
    board: str = ""
    date: str = ""
    temperature_c: float | None = None


@dataclass(frozen=True, eq=False)
class FittedModel:
    """One fitted model with its errors in the folds."""

    model: PairsFit | SmoothFit
    weights: FloatArray
    """(3, features), of fx, fy, fz."""
    covariance: tuple[FloatArray, FloatArray, FloatArray]
    features: FloatArray
    left_out: FloatArray


@dataclass(frozen=True, eq=False)
class CalibrationStudy:
    """Results of a calibration."""

    file: CalibrationFile
    late_s: float  # clock of the reference minus that of the log
    late_sd_s: float  # its standard deviation; 0 for one clock
    drift_ppm: float  # excess of the reference's clock rate
    model: str  # "pairs" or "smooth"
    time_s: FloatArray  # (n,): middle of the bins that were used, from the log's first scan
    # reference, left_out: (n, 6): without offset; and the differences where the bin was left out of the fit
    reference: FloatArray
    left_out: FloatArray
    sd: FloatArray  # (n, 3): stated standard deviations
    baseline: FloatArray  # (6,): rms differences of ridge regression with squares in the folds
    used: list[int]
    pairs: tuple[PairsFitter, PairsFit] | None
    """Fit of the model of pairs, where the array allows it."""

    @property
    def rms(self) -> FloatArray:
        """Rms differences (6,) in the folds."""
        return np.asarray(np.sqrt((self.left_out**2).mean(axis=0)))


def calibrate(
    array: Array,
    time_s: FloatArray,
    readings: FloatArray,
    table: ReferenceTable,
    identity: Identity,
    reached: Callable[[str], None] = lambda _: None,
    *,
    models: tuple[str, ...] = ("pairs", "smooth"),
    is_same_clock: bool = False,
    are_poses: bool = False,
) -> CalibrationStudy:
    """Fit a calibration.

    Parameters
    ----------
    time_s : (n,) float64
    readings : (n, channels) float64
        As the sensor gave them, NaN where missing.
    reached : callable
        Called with a few words after each stage.
    models : tuple of str
        Models that are tried, where the array allows them.
    is_same_clock : bool
        The times of log and reference are of one clock: no offset is searched.
    are_poses : bool
        Readings and reference are static poses in any order; `time_s` is the number of the pose in both.

    Raises
    ------
    DataError
        The data cannot give a calibration; the message says what to do.
    """
    check_reference(table, array)
    if are_poses:
        own, table = same_poses(time_s, table)
        time_s, readings = time_s[own], readings[own]
    log = pose_log(readings, array) if are_poses else bin_log(time_s, readings, array)
    check_log(log, array)
    check_unit(log, table, array)
    reference = PoseReference(table, log) if are_poses else AlignedReference(table, log)
    is_same_clock = is_same_clock or are_poses
    between_s = 0.0 if are_poses else float(time_s[0] - table.time_s[0])
    if not is_same_clock and abs(between_s) > max(float(time_s[-1] - time_s[0]), float(np.ptp(table.time_s))):
        between_s = 0.0  # clocks of different origin: both records began together, within seconds
    clocks = align(log, reference, array, between_s, is_same_clock=is_same_clock)
    late_s = clocks.late_s
    reached("clocks")
    rows = reference.inside(late_s, 0.0)
    check_signs(log, reference.means(late_s, 0.0), reference.outputs, rows, array, clocks.correlation)
    used = reference.outputs
    candidates: dict[str, FittedModel] = {}
    drift = 0.0
    pairs: tuple[PairsFitter, PairsFit] | None = None
    if has_pairs(array) and "pairs" in models and not are_poses:
        fitter = PairsFitter(array, log, reference, late_s, rows)
        fit = fitter.fit(reached)
        pairs = (fitter, fit)
        late_s, drift = late_s + fit.physics["late_s"], fit.physics["drift"]
        candidates["pairs"] = _pairs_candidate(fit, reference.means(late_s, drift), log, used)
    outputs = reference.means(late_s, drift)
    level = free_level(outputs, quiet_bins(log) & rows)
    if level is not None:
        outputs = outputs - level
    outputs[:, [k for k in range(6) if k not in used]] = 0.0
    plain = fit_smooth(array, log, outputs, used, rows, PLAIN)
    reached("baseline")
    if "smooth" in models or not candidates:
        chosen = choose_smooth(array, log, outputs, used, rows)
        candidates["smooth"] = _smooth_candidate(chosen, rows, used)
    reached("choice of the model")
    name = _chosen(candidates, outputs[rows], used)
    best = candidates[name]
    check_fit(best.left_out, outputs[rows], used)
    forces = best.features @ best.weights.T
    n_segments = int(segments(outputs[rows], used, log.step_s).max()) + 1
    axes = _uncertainties(best, forces, reference, log, used, n_segments)
    shown = outputs[rows]
    sd = np.zeros((len(shown), 3))
    for axis in range(3):
        if axis in used:
            sd[:, axis] = np.sqrt(axes[axis].variance(best.features, forces[:, axis], forces[:, 2]))
    chosen_fitter = pairs[0] if pairs is not None and name == "pairs" else None
    file = _file(array, identity, log, rows, best, axes, used, shown, plain, chosen_fitter)
    words = verdict(
        array, file, best.features, best.weights, [axis.covariance for axis in axes], used, shown, name
    )
    return CalibrationStudy(
        file=file.model_copy(update={"verdict": words}),
        late_s=late_s - between_s,
        late_sd_s=clocks.sd_s,
        drift_ppm=1e6 * drift,
        model=name,
        time_s=log.middle_s[rows],
        reference=shown,
        left_out=best.left_out,
        sd=sd,
        baseline=np.sqrt((plain.left_out[rows] ** 2).mean(axis=0)),
        used=used,
        pairs=pairs,
    )


def has_pairs(array: Array) -> bool:
    """Return True for arrays whose taxels all have three side electrodes or more, and nothing else."""
    return (
        set(array.channel_kind) == {"side"}
        and int(np.bincount(array.channel_taxel, minlength=array.n_taxels).min()) >= 3
        and array.has_places
    )


def _pairs_candidate(fit: PairsFit, outputs: FloatArray, log: BinnedLog, used: list[int]) -> FittedModel:
    """Errors in the folds, and a covariance that counts correlated bins as one."""
    problem, n = fit.regression, int(fit.rows.sum())
    left = np.zeros((n, 6))
    for left_out in folds(segments(outputs[fit.rows], used, log.step_s)):
        found = problem.solve(fit.sd, ~left_out)
        left[left_out] = problem.residuals(found)[left_out]
    correlated = np.array([correlation_bins(left[:, k]) if k in used else 1.0 for k in range(6)])
    linear = problem.solve(fit.sd * np.sqrt(correlated), with_covariance=True)
    return FittedModel(fit, fit.linear.weights, linear.covariance, fit.features[fit.rows], left)


def _smooth_candidate(fit: SmoothFit, rows: NDArray[np.bool_], used: list[int]) -> FittedModel:
    left = fit.left_out[rows]
    covariance = []
    for axis in range(3):
        bins = correlation_bins(left[:, axis]) if axis in used else 1.0
        variance = float((left[:, axis] ** 2).mean()) * bins
        covariance.append(fit.covariance[axis] * variance)
    return FittedModel(
        fit, fit.weights[:3], (covariance[0], covariance[1], covariance[2]), fit.features[rows], left
    )


def _chosen(candidates: dict[str, FittedModel], outputs: FloatArray, used: list[int]) -> str:
    spread = np.maximum(outputs[:, used].std(axis=0), 1e-12)
    errors = {
        name: float(np.sqrt(((one.left_out[:, used] / spread) ** 2).mean()))
        for name, one in candidates.items()
    }
    if "pairs" in errors and errors["pairs"] <= _PREFERENCE * errors.get("smooth", np.inf):
        return "pairs"
    return min(errors, key=lambda name: errors[name])


def _uncertainties(
    best: FittedModel,
    forces: FloatArray,
    reference: AlignedReference,
    log: BinnedLog,
    used: list[int],
    n_segments: int,
) -> list[AxisUncertainty]:
    samples = max(log.step_s / reference.sample_s, 1.0)
    out = []
    for axis in range(3):
        noise = float(np.nan_to_num(reference.noise[axis])) / np.sqrt(samples)
        left = best.left_out[:, axis] if axis in used else np.zeros(len(forces))
        out.append(
            axis_uncertainty(
                AXES[axis],
                best.features,
                best.covariance[axis],
                left,
                forces[:, axis],
                forces[:, 2],
                noise,
                n_segments,
            )
        )
    return out


def _file(
    array: Array,
    identity: Identity,
    log: BinnedLog,
    rows: NDArray[np.bool_],
    best: FittedModel,
    axes: list[AxisUncertainty],
    used: list[int],
    outputs: FloatArray,
    plain: SmoothFit,
    fitter: PairsFitter | None,
) -> CalibrationFile:
    """Put the result into the form of a file."""
    rms = np.sqrt((best.left_out**2).mean(axis=0))
    baseline = np.sqrt((plain.left_out[rows] ** 2).mean(axis=0))
    factors = [axis.factor for axis in axes]
    if fitter is not None:
        factors = [fitter.file_factor(factor) for factor in factors]
    sensitivity = _sensitivity(best, log, rows, array, fitter)
    # A bin averages the noise of its scans; a live scan has all of it.
    live = sensitivity * float(np.median(log.noise)) * np.sqrt(max(1 - 1 / log.bin_scans, 0.0))
    ranges = [(float(column.min()), float(column.max())) for column in outputs[:, :3].T]
    known = [k in used for k in range(3)]
    return CalibrationFile(
        name=identity.name,
        array=array.name,
        channels=array.n_channels,
        board=identity.board,
        date=identity.date,
        temperature_c=identity.temperature_c,
        axes=[axis for axis, is_known in zip(AXES, known, strict=True) if is_known],
        range=ForceRange(fx_n=ranges[0], fy_n=ranges[1], fz_n=ranges[2]),
        residuals=Residuals(
            fx_n=float(rms[0]) if known[0] else None,
            fy_n=float(rms[1]) if known[1] else None,
            fz_n=float(rms[2]) if known[2] else None,
            baseline_fz_n=float(baseline[2]) if known[2] else None,
        ),
        largest_reading=np.maximum(np.abs(log.readings[rows]).max(axis=0), 0.3 * _largest(log)).tolist(),
        pairs=fitter.params(best.model, best.weights)
        if fitter and isinstance(best.model, PairsFit)
        else None,
        smooth=best.model.params(array, used) if isinstance(best.model, SmoothFit) else None,
        uncertainty=Uncertainty(
            factor=[factor.tolist() for factor in factors],
            floor_n=[float(np.hypot(axis.floor_n, live[k])) for k, axis in enumerate(axes)],
            own=[axis.own for axis in axes],
            of_normal=[axis.of_normal for axis in axes],
            noise=float(np.median(log.noise)),
            zero_sd=log.zero_sd,
            walk_n=force_walk(best.left_out, log.middle_s[rows], segments(outputs, used, log.step_s)),
            n_per_unit=sensitivity.tolist(),
        ),
    )


def force_walk(left_out: FloatArray, time_s: FloatArray, segment: NDArray[np.int64]) -> list[float]:
    """Random walks (3,) of the errors of fx, fy and fz, in newtons per root second.

    The mean square difference of the mean errors of two contacts is ``a + walk^2 t`` for a time t between
    them; a is what the folds know of each contact alone.

    Parameters
    ----------
    left_out : (n, 6) float64
        Errors in the folds.
    time_s : (n,) float64
    segment : (n,) int64
    """
    count = np.bincount(segment)
    if len(count) < _LEAST_CONTACTS:
        return [0.0, 0.0, 0.0]
    at_s = np.bincount(segment, time_s) / count
    one, other = np.triu_indices(len(count), 1)
    apart = np.stack([np.ones(len(one)), at_s[other] - at_s[one]], axis=1)
    walks = []
    for errors in left_out[:, :3].T:
        means = np.bincount(segment, errors) / count
        walks.append(math.sqrt(nnls(apart, (means[one] - means[other]) ** 2)[0][1]))
    return walks


def _largest(log: BinnedLog) -> float:
    return max(float(np.abs(log.readings).max()), 1e-9)


def _sensitivity(
    best: FittedModel, log: BinnedLog, rows: NDArray[np.bool_], array: Array, fitter: PairsFitter | None
) -> FloatArray:
    """Rms change (3,) of fx, fy, fz for independent errors of 1 of the zeros of all channels."""
    rng = np.random.default_rng(0)
    size = 0.002 * _largest(log)
    total = np.zeros(3)
    for _ in range(_PROBES):
        pattern = size * rng.standard_normal(log.readings.shape[1])
        if fitter is not None and isinstance(best.model, PairsFit):
            other = fitter.features(best.model.physics, pattern)[rows]
        else:
            assert isinstance(best.model, SmoothFit)  # the only other model
            moved = replace(log, readings=log.readings + pattern)
            other = best.model.at(array, moved)[rows]
        change = (other - best.features) @ best.weights.T
        total += (change**2).mean(axis=0)
    return np.asarray(np.sqrt(total / _PROBES) / size)
