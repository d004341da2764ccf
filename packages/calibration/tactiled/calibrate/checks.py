"""Refusals: data that cannot give a calibration, with what to do about it."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.calibrate.clock import correlation_of, has_signs, quiet_bins
from tactiled.calibrate.data import BIN_HZ, BinnedLog, FitData, ReferenceTable
from tactiled.errors import DataError
from tactiled.force.calibration import AXES, has_nominal, load_calibration
from tactiled.force.model import build_model

_LEAST_S = 5.0
_FAR_S = 0.1  # between scans: presses change within fewer scans, and look like noise
_LEAST_RESPONSE = 20.0  # standard deviations of the noise: below, nothing pressed the array
_LARGEST_MPA = 2.0  # silicone skins tear or bottom out at a few MPa
_OPPOSITE, _UNRELATED, _SWAPPED = -0.5, 0.3, 0.7  # correlations of shear with the axis of the array
_LEAST_SHEAR = 0.1  # of the range of the normal force: below, the directions of shear cannot be compared
_MOST_LEFT = 0.5  # of the spread of a force that a fit leaves over; useful ones leave a tenth and less
_LEAST_BINS = 10  # without contact and with it, to compare them
_MOST_NOMINAL = 15.0  # nominal forces may be wrong by 2.7 and by electrodes; grams are wrong by 102
_GRAMS_PER_N = 101.97


def check_reference(table: ReferenceTable, array: Array) -> None:
    """Refuse a reference without forces, or with forces that no skin bears."""
    if not {0, 1, 2} & set(table.outputs):
        raise DataError("the reference has none of the columns fx_n, fy_n, fz_n with numbers in it")
    forces = table.values[:, [k for k in table.outputs if k < len(AXES)]]
    span = float(np.nanmax(np.nanmax(forces, axis=0) - np.nanmin(forces, axis=0)))
    most = _LARGEST_MPA * _area_mm2(array)
    if span > most:
        words = f"the reference reaches {span:.0f} N, but this array bears at most about {most:.0f} N"
        raise DataError(words + _are_grams(span))
    if span == 0:
        raise DataError("the reference never changes: is the force sensor connected, is it the right file?")


def check_unit(log: BinnedLog, table: ReferenceTable, array: Array) -> None:
    """Refuse a normal force that is far from the nominal one of the array, where there is one."""
    if 2 not in table.outputs or not has_nominal(array.name):
        return
    model = build_model(array, load_calibration(array.name))
    pressed = log.readings[np.argsort(log.readings.sum(axis=1))[-_LEAST_BINS:]].mean(axis=0)
    nominal = float(model.weights[2] @ model.features(pressed[np.newaxis], [log.step_s])[0])
    span = float(np.nanmax(table.values[:, 2]) - np.nanmin(table.values[:, 2]))
    if nominal > 0 and span > _MOST_NOMINAL * nominal:
        words = f"fz_n changes by {span:.0f}; by published sensitivities it is about {nominal:.2g} N"
        raise DataError(words + _are_grams(span))


def _are_grams(span: float) -> str:
    grams = f"{span:.0f} g are {span / _GRAMS_PER_N:.1f} N"
    return f": are these grams? Then divide by {_GRAMS_PER_N}; {grams}"


def _area_mm2(array: Array) -> float:
    """Area of the skin, with a margin of one taxel around; 400 mm2 a taxel where places are not known."""
    if not array.has_places:
        return 400.0 * array.n_taxels
    x, y = array.x_mm, array.y_mm
    apart = np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y))
    apart = apart[apart > 0]  # taxels of two pads may have the same place, each on its own
    pitch = float(apart.min()) if apart.size else 10.0
    return float((np.ptp(x) + pitch) * (np.ptp(y) + pitch))


def check_log(log: BinnedLog, array: Array) -> None:
    """Refuse a log that is too short, or in which nothing pressed the array."""
    seconds = float((log.end_s - log.start_s).sum())
    if seconds < _LEAST_S - 1 / BIN_HZ:
        raise DataError(f"the log has {seconds:.1f} s; press for {_LEAST_S:g} s or more, better for a minute")
    noise = max(float(np.median(log.noise)), 1e-6 * (array.high - array.low))
    response = float(np.ptp(log.readings, axis=0).max())
    if response < _LEAST_RESPONSE * noise:
        if log.step_s > _FAR_S:
            raise DataError(
                f"scans {log.step_s:.2g} s apart are too far apart to tell presses from noise: record at "
                f"{1 / _FAR_S:g} Hz or more"
            )
        raise DataError(
            f"no reading changes by more than {response:.3g} {array.unit} ({response / noise:.0f} standard "
            "deviations of the noise): nothing pressed the array. Press every taxel, and push it sideways"
        )


def check_signs(
    log: BinnedLog,
    outputs: FloatArray,
    used: list[int],
    rows: NDArray[np.bool_],
    array: Array,
    correlation: float,
) -> None:
    """Refuse a reference whose axes point the other way, or are swapped."""
    if 2 in used and (_falls(log, outputs, rows) or (correlation < 0 and has_signs(array))):
        of_zero = (
            f" If its sign is right, the log begins under load, and its first {array.zero_first_s:g} s are "
            "no zero: cut it where nothing touches the array, or give zero = [...] in the array file"
        )
        raise DataError(
            "fz_n falls when the array is pressed: force is what the object does to the skin, and fz_n > 0 "
            "presses. Multiply fz_n by -1, and check the other axes." + of_zero * bool(array.zero_first_s)
        )
    weights = array.shear_weights().sum(axis=1)
    if not weights.any() or not has_signs(array):
        return
    # A response to motion of the skin along +x is a force of the object along -x.
    felt = -log.readings[rows] @ weights.T
    outputs, size = outputs[rows], 0.0
    if 2 in used:  # a tilted reference shows a part of the normal force as shear
        normal = outputs[:, 2]
        felt, size = _without(felt, normal), float(np.ptp(normal))
        outputs = np.concatenate([_without(outputs[:, :2], normal), outputs[:, 2:]], axis=1)
    for axis, name in ((0, "fx_n"), (1, "fy_n")):
        if axis not in used or np.ptp(outputs[:, axis]) < _LEAST_SHEAR * size:
            continue
        own = correlation_of(felt[:, axis], outputs[:, axis])
        other = correlation_of(felt[:, 1 - axis], outputs[:, axis])
        if own < _OPPOSITE:
            raise DataError(
                f"{name} grows where the array says that it falls (correlation {own:.2f}): the axis is "
                f"reversed, or it is the force on the object. Multiply {name} by -1"
            )
        if abs(own) < _UNRELATED and abs(other) > _SWAPPED:
            raise DataError(
                f"{name} follows the other axis of the array (correlation {other:.2f}, with its own "
                f"{own:.2f}): exchange the columns fx_n and fy_n, or turn the sensor by 90 degrees"
            )


def _falls(log: BinnedLog, outputs: FloatArray, rows: NDArray[np.bool_]) -> bool:
    """Return True where presses lower the normal force below that of a free array."""
    quiet = quiet_bins(log) & rows
    pressed = ~quiet & rows
    if min(int(quiet.sum()), int(pressed.sum())) < _LEAST_BINS:
        return False
    return float(outputs[pressed, 2].mean()) < float(outputs[quiet, 2].mean())


def _without(columns: FloatArray, other: FloatArray) -> FloatArray:
    """Remove the part of columns (n, k) that is proportional to another (n,)."""
    centred = other - other.mean()
    slope = centred @ columns / max(float(centred @ centred), 1e-12)
    return np.asarray(columns - np.outer(centred, slope))


def check_fit(left_out: FloatArray, data: FitData) -> None:
    """Refuse a fit that explains none of the forces in the segments that were left out."""
    forces = [k for k in data.used if k < len(AXES)]
    spread = np.maximum(data.shown[:, forces].std(axis=0), 1e-12)
    part = float((np.sqrt((left_out[:, forces] ** 2).mean(axis=0)) / spread).min())
    if part > _MOST_LEFT:
        raise DataError(
            f"the readings do not explain the reference: {100 * min(part, 1.0):.0f} % of each force is left "
            "over in presses that were left out of the fit. Are both records of the same presses, and the "
            "clocks within 5 s of each other? Else record a longer log, with more presses"
        )
