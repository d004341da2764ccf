"""Calibration of an array: clocks, models, cross-validation, standard deviations, and the file."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.special import chdtri

from tactiled.array import Array, FloatArray
from tactiled.calibrate.checks import check_fit, check_log, check_reference, check_signs, check_unit
from tactiled.calibrate.clock import WITHIN_S, align, free_level, quiet_bins
from tactiled.calibrate.data import (
    AlignedReference,
    BinnedLog,
    FitData,
    FittedModel,
    PoseReference,
    ReferenceTable,
    bin_log,
    pose_log,
    same_poses,
)
from tactiled.calibrate.pairs import PairsFitter, has_pairs
from tactiled.calibrate.smooth import choose_smooth
from tactiled.calibrate.uncertainty import AxisUncertainty, axis_uncertainty
from tactiled.calibrate.verdict import verdict
from tactiled.force.calibration import AXES, CalibrationFile, ForceRange, Residuals, Uncertainty

N_STAGES = 6
# A smooth model must be better by this factor to be preferred: physics holds on motions that no fold has.
_PREFERENCE = 2.0
# Of the largest readings. Creep by a fifth in a hold bends readings by .06, and a lost press by its own size:
# one that is smaller than this changes little.
_MOST_BEND, _LARGEST = 0.1, 0.98  # the second: quantile of the readings
# Times that the clocks are aligned: only at about their true offset it is known what the reference does not
# see, which misleads until then.
_ALIGNED = 3
_BY_NOISE = 0.01  # probability that noise alone bends the readings of a pause
_LEAST_CONTACTS = 5  # from which the drift of the force is estimated
_PROBES = 8  # random patterns of a zero error, whose effect on the force is averaged
_PROBED = 0.002  # of the largest reading: size of these patterns
_LEAST_READING = 0.3  # of the largest reading of all channels: least for the largest one of a channel

_LEFT_OUT = "{:.1f} s were left out: the reference pauses there, and the readings change"
_NEVER_FREE = (
    "the readings never come near the array's zero, so that the force without a contact was fitted: all "
    "forces may be off by the same amount. Let go between presses; if you did, the sensor rests elsewhere: "
    'write zero = "first 0.3 s" into the array file'
)


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
    used: list[int]  # columns of the reference that have numbers

    @property
    def rms(self) -> FloatArray:
        """Rms differences (6,) in the folds."""
        return _rms(self.left_out)


def calibrate(
    array: Array,
    time_s: FloatArray,
    readings: FloatArray,
    table: ReferenceTable,
    name: str,
    reached: Callable[[str], None] = lambda _: None,
    *,
    board: str = "",
    date: str = "",
    is_same_clock: bool = False,
    are_poses: bool = False,
) -> CalibrationStudy:
    """Fit a calibration; its file has `name`, `board` and `date`.

    `readings` (n, channels) are as the sensor gave them, NaN where missing. `reached` is called with a few
    words after each of `N_STAGES` stages. With `is_same_clock`, no offset between the times of log and
    reference is searched. With `are_poses`, both have static poses in any order, and `time_s` is the number
    of the pose. `DataError` where the data cannot give a calibration; the message says what to do.
    """
    check_reference(table, array)
    between_s, starts_s = 0.0, [0.0]
    if are_poses:
        own, table = same_poses(time_s, table)
        log = pose_log(readings[own], array)
        reference: AlignedReference = PoseReference(table, log)
    else:
        log = bin_log(time_s, readings, array)
        reference = AlignedReference(table, log)
        between_s = float(time_s[0] - table.time_s[0])
        if is_same_clock or abs(between_s) <= WITHIN_S:
            starts_s = [between_s]
        elif abs(between_s) <= max(float(np.ptp(time_s)), float(np.ptp(table.time_s))):
            starts_s = [between_s, 0.0]  # else the clocks differ, and both records began together
    check_log(log, array)
    check_unit(log, table, array)
    unseen = np.zeros(len(log), dtype=np.bool_)
    for _ in range(_ALIGNED):
        clocks = align(log, reference, array, starts_s, unseen, is_same_clock=is_same_clock or are_poses)
        late_s, drift = clocks.late_s, 0.0
        rows = reference.inside(late_s, 0.0)
        unseen = _unseen(log, np.where(rows, reference.pauses(late_s), -1))
        if not unseen.any():
            break
    reached("clocks")
    used = reference.outputs
    rows &= ~unseen
    check_signs(log, reference.means(late_s, 0.0), used, rows, array, clocks.correlation)
    candidates: list[FittedModel] = []
    if has_pairs(array) and not are_poses:
        pairs, physics = PairsFitter(array, log, reference, late_s, rows).fit(reached)
        candidates.append(pairs)
        late_s, drift = late_s + physics["late_s"], physics["drift"]
    outputs = reference.means(late_s, drift)
    level = free_level(outputs, quiet_bins(log) & rows)
    if level is not None:
        outputs = outputs - level
    outputs[:, [k for k in range(6) if k not in used]] = 0.0
    data = FitData(array, log, outputs, used, rows)
    plain, smooth = choose_smooth(data)
    candidates.append(smooth.model(data))
    reached("regression")
    shown, segment = data.shown, data.segment
    best = _chosen(candidates, data)
    reached("choice of the model")
    check_fit(best.left_out, data)
    forces = best.features @ best.weights.T
    axes = _uncertainties(best, forces, reference, data)
    sd = np.zeros((len(shown), 3))
    for axis in range(3):
        if axis in used:
            sd[:, axis] = np.sqrt(axes[axis].variance(best.features, forces[:, axis], forces[:, 2]))
    baseline = _rms(plain.left_out[rows])
    ranges = [(float(column.min()), float(column.max())) for column in shown[:, :3].T]
    rms = [float(value) if k in used else None for k, value in enumerate(_rms(best.left_out)[:3])]
    size = np.abs(log.readings)
    walk_n = [0.0] * 3 if are_poses else force_walk(best.left_out, log.middle_s[rows], segment)
    file = CalibrationFile(
        name=name,
        array=array.name,
        channels=array.n_channels,
        board=board,
        date=date,
        axes=[axis for k, axis in enumerate(AXES) if k in used],
        verdict=[
            *verdict(data, best, [axis.covariance for axis in axes]),
            *([_LEFT_OUT.format(float((log.end_s - log.start_s)[unseen].sum()))] if unseen.any() else []),
            *([] if level is not None or are_poses else [_NEVER_FREE]),
        ],
        range=ForceRange(fx_n=ranges[0], fy_n=ranges[1], fz_n=ranges[2]),
        residuals=Residuals(
            fx_n=rms[0], fy_n=rms[1], fz_n=rms[2], baseline_fz_n=float(baseline[2]) if 2 in used else None
        ),
        largest_reading=np.maximum(size[rows].max(axis=0), _LEAST_READING * size.max()).tolist(),
        **{best.name: best.table},
        uncertainty=_stated(best, axes, log, walk_n),
    )
    return CalibrationStudy(
        file=file,
        late_s=late_s - between_s,
        late_sd_s=clocks.sd_s,
        drift_ppm=1e6 * drift,
        model=best.name,
        time_s=log.middle_s[rows],
        reference=shown,
        left_out=best.left_out,
        sd=sd,
        baseline=baseline,
        used=used,
    )


def _unseen(log: BinnedLog, pause: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return True (n,) for bins in pauses of the reference in which the readings follow no straight line.

    `pause` (n,) is the number of the pause of each bin, or -1. A record that is written when a force changes
    pauses, too, but while it does, only creep bends the readings.
    """
    unseen = np.zeros(len(log), dtype=np.bool_)
    most = _MOST_BEND * np.quantile(np.linalg.norm(log.readings, axis=1), _LARGEST)
    # White noise of a bin and of the line, which has at most as much: summed over channels of unequal noise,
    # a multiple of a chi-square of so many degrees of freedom (Satterthwaite 1946).
    variance = 2 * log.noise**2 / log.bin_scans
    freedom = float(variance.sum() ** 2 / max((variance**2).sum(), 1e-300))
    for one in np.unique(pause[pause >= 0]):
        bins = np.flatnonzero(pause == one)
        ends = [max(bins[0] - 1, 0), min(bins[-1] + 1, len(log) - 1)]
        part = np.interp(log.middle_s[bins], log.middle_s[ends], [0.0, 1.0])[:, np.newaxis]
        first, last = log.readings[ends]
        bend = log.readings[bins] - (1 - part) * first - part * last
        by_noise = (
            float(variance.sum() * chdtri(freedom, _BY_NOISE / len(bins)) / freedom) if freedom else 0.0
        )
        unseen[bins] = (bend**2).sum(axis=1).max() - by_noise > most**2
    return unseen


def _rms(left_out: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((left_out**2).mean(axis=0)))


def _chosen(candidates: list[FittedModel], data: FitData) -> FittedModel:
    """Model of pairs, if there is one and no other has much smaller errors in the folds."""
    spread = np.maximum(data.shown[:, data.used].std(axis=0), 1e-12)
    first, *others = candidates
    errors = [float(np.sqrt(((one.left_out[:, data.used] / spread) ** 2).mean())) for one in candidates]
    return others[0] if others and errors[0] > _PREFERENCE * errors[1] else first


def _uncertainties(
    best: FittedModel, forces: FloatArray, reference: AlignedReference, data: FitData
) -> list[AxisUncertainty]:
    """Uncertainties of fx, fy and fz."""
    samples = max(data.log.step_s / reference.sample_s, 1.0)
    return [
        axis_uncertainty(
            AXES[axis],
            best.features,
            best.covariance[axis],
            best.left_out[:, axis] if axis in data.used else np.zeros(len(forces)),
            forces[:, axis],
            forces[:, 2],
            float(np.nan_to_num(reference.noise[axis])) / np.sqrt(samples),
            int(data.segment.max()) + 1,
        )
        for axis in range(3)
    ]


def _stated(
    best: FittedModel, axes: list[AxisUncertainty], log: BinnedLog, walk_n: list[float]
) -> Uncertainty:
    """Uncertainty as it goes into a file."""
    noise = float(np.median(log.noise))
    n_per_unit = _sensitivity(best, log)
    # A bin averages the noise of its scans; a live scan has all of it.
    live_n = n_per_unit * noise * np.sqrt(max(1 - 1 / log.bin_scans, 0.0))
    return Uncertainty(
        factor=[(axis.factor / best.feature_units).tolist() for axis in axes],
        floor_n=[float(np.hypot(axis.floor_n, live_n[k])) for k, axis in enumerate(axes)],
        own=[axis.own for axis in axes],
        of_normal=[axis.of_normal for axis in axes],
        noise=noise,
        zero_sd=log.zero_sd,
        walk_n=walk_n,
        n_per_unit=n_per_unit.tolist(),
    )


def force_walk(left_out: FloatArray, time_s: FloatArray, segment: NDArray[np.int64]) -> list[float]:
    """Random walks (3,) of the errors of fx, fy and fz, in newtons per root second.

    The mean square difference of the mean errors of two contacts is ``a + walk^2 t`` for a time t between
    them; a is what the folds know of each contact alone. `left_out` (n, 6) are the errors in the folds.
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


def _sensitivity(best: FittedModel, log: BinnedLog) -> FloatArray:
    """Rms change (3,) of fx, fy, fz for independent errors of 1 of the zeros of all channels."""
    rng = np.random.default_rng(0)
    size = _PROBED * max(float(np.abs(log.readings).max()), 1e-9)
    total = np.zeros(3)
    for _ in range(_PROBES):
        moved = best.moved(np.asarray(size * rng.standard_normal(log.readings.shape[1])))
        total += (((moved - best.features) @ best.weights.T) ** 2).mean(axis=0)
    return np.asarray(np.sqrt(total / _PROBES) / size)
