"""Calibrations of drawn rigs, by this project and by baselines, scored on other motions."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tactiled.array import Array, FloatArray, load_array
from tactiled.calibrate.data import NO_TAXEL, ReferenceTable, bin_log
from tactiled.calibrate.smooth import PLAIN, RICH, FeatureTerms, fit_smooth
from tactiled.calibrate.study import CalibrationStudy, Identity, calibrate
from tactiled.emulator.rig.motion import LARGEST_N, Loads, Motion
from tactiled.emulator.rig.sensor import RigSensor
from tactiled.emulator.rig.session import RATE_HZ, Rig, RigRun, draw_rig
from tactiled.force.calibration import CalibrationFile, load_calibration
from tactiled.force.estimator import ForceEstimator
from tactiled.samples.block import regular_block

ARRAY = "wang2019-3x3"
SHEAR_N = 0.6 * LARGEST_N
"""Range of the shear: friction times the range of the normal force."""
Z90 = 1.645
TEST_S = 30.0  # of each of two motions: holds, and presses that wander over the array
RIDGES = ("ridge, all terms", "ridge with squares")
METHODS = ("tactiled", "ridge, all terms", "ridge with squares", "linear map", "published")
_HOLD_S, _HOLD_HZ, _HOLD_N = 3600.0, 10.0, 15.0
_WARMED_K, _WARMED_S = 10.0, 1800.0


@dataclass(frozen=True)
class Case:
    """Way of calibrating."""

    motion: Motion = "press"
    seconds: float = 60.0
    creep: float = 1.0  # times the drawn creep
    moments: bool = True  # whether the reference has moments

    def __str__(self) -> str:
        words = {"press": "press", "walk": "shares change", "hold": "hold", "flat": "flat"}[self.motion]
        extra = f", {self.creep:g} x creep" if self.creep != 1 else ""
        return f"{words}, {self.seconds:g} s{extra}" + ("" if self.moments else ", no moments")


@dataclass(frozen=True)
class ForceScore:
    """One calibration on one drawn rig."""

    seed: int
    case: Case
    # normal, shear: rms error of each method over the range
    normal: dict[str, float]
    shear: dict[str, float]
    centre_mm: float  # rms error of the centre of pressure above 1 N
    # part of the scans in contact whose 90 % intervals of fx, fy, fz hold the truth
    inside: tuple[float, float, float]
    late_error_s: float
    model: str


class HoldScore(NamedTuple):
    """A hold of an hour."""

    seed: int
    inside: float  # part of the hour in which the 90 % interval of fz holds the truth
    worst: float  # largest error over standard deviation
    error_n: float  # at the end, as the next
    sd_n: float


def rig_for(seed: int, case: Case) -> tuple[Rig, RigRun, list[RigRun]]:
    """Draw a rig, its calibration run and its test runs."""
    rig, rng = draw_rig(load_array(ARRAY), seed)
    assert isinstance(rig.sensor, RigSensor)
    rig = replace(rig, sensor=replace(rig.sensor, creep=rig.sensor.creep * case.creep))
    tests = [rig.run("hold", TEST_S, rng), rig.run("walk", TEST_S, rng)]
    return rig, rig.run(case.motion, case.seconds, rng), tests


def study_of(rig: Rig, run: RigRun, case: Case) -> CalibrationStudy:
    """Calibrate as `tactiled calibrate` does."""
    values = run.reference.copy()
    if not case.moments:
        values[:, 3:] = np.nan
    table = ReferenceTable(run.reference_s, values, np.full(len(values), NO_TAXEL))
    return calibrate(rig.array, run.loads.time_s, run.readings, table, Identity("rig"))


def score(seed: int, case: Case) -> ForceScore:
    """Calibrate and score."""
    rig, run, tests = rig_for(seed, case)
    found = study_of(rig, run, case)
    # Forces are those in the axes of the reference, which the calibration cannot tell from the array's.
    truth = [rig.reference.seen(test.loads.wrench(rig.array)) for test in tests]
    normal, shear = {}, {}
    ours = [_estimated(rig.array, found.file, test.readings) for test in tests]
    normal["tactiled"], shear["tactiled"] = _rms([o[0] for o in ours], truth)
    published = load_calibration(ARRAY)
    others = [_estimated(rig.array, published, test.readings)[0] for test in tests]
    normal["published"], shear["published"] = _rms(others, truth)
    for name, terms in (
        ("ridge, all terms", RICH),
        ("ridge with squares", PLAIN),
        ("linear map", FeatureTerms(squares=False)),
    ):
        predicted, binned = _ridge(rig, run, tests, found, terms)
        averaged = [_binned(t, size) for t, size in zip(truth, binned, strict=True)]
        normal[name], shear[name] = _rms(predicted, averaged)
    force = np.concatenate([o[0] for o in ours])
    sd = np.concatenate([o[1] for o in ours])
    true = np.concatenate(truth)[:, :3]
    pressed = true[:, 2] > 0.02 * LARGEST_N
    inside = (np.abs(force - true) < Z90 * sd)[pressed].mean(axis=0)
    return ForceScore(
        seed,
        case,
        normal,
        shear,
        _centre_error(rig.array, [o[2] for o in ours], tests),
        (float(inside[0]), float(inside[1]), float(inside[2])),
        abs(found.late_s - rig.reference.late_s),
        found.model,
    )


def _estimated(
    array: Array, file: CalibrationFile, readings: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Forces (n, 3), standard deviations (n, 3) and centres (n, 2) as live."""
    events = ForceEstimator(array, file).process(regular_block(readings, RATE_HZ))
    return (
        np.array([(e.fx_n, e.fy_n, e.fz_n) for e in events]),
        np.array([(e.fx_sd_n, e.fy_sd_n, e.fz_sd_n) for e in events]),
        np.array([(e.x_mm, e.y_mm) for e in events]),
    )


def _rms(forces: list[FloatArray], truth: list[FloatArray]) -> tuple[float, float]:
    error = np.concatenate([f[:, :3] - t[:, :3] for f, t in zip(forces, truth, strict=True)])
    fx, fy, fz = np.sqrt((error**2).mean(axis=0))
    return float(fz / LARGEST_N), float(np.hypot(fx, fy) / np.sqrt(2) / SHEAR_N)


def _centre_error(array: Array, centres: list[FloatArray], tests: list[RigRun]) -> float:
    errors = []
    for centre, test in zip(centres, tests, strict=True):
        wrench = test.loads.wrench(array)
        pressed = wrench[:, 2] > 1.0
        true = np.stack([-wrench[pressed, 4], wrench[pressed, 3]], axis=1) / wrench[pressed, 2:3]
        errors.append(((centre[pressed] - true) ** 2).sum(axis=1))
    return float(np.sqrt(np.concatenate(errors).mean()))


def _ridge(
    rig: Rig, run: RigRun, tests: list[RigRun], found: CalibrationStudy, terms: FeatureTerms
) -> tuple[list[FloatArray], list[int]]:
    """Forces of the test runs in bins, by ridge regression with the clocks that the study found."""
    log = bin_log(run.loads.time_s, run.readings, rig.array)
    rows = np.isin(np.round(log.middle_s, 6), np.round(found.time_s, 6))
    outputs = np.zeros((len(log), 6))
    outputs[rows] = found.reference
    fit = fit_smooth(rig.array, log, outputs, found.used, rows, terms)
    forces, sizes = [], []
    for test in tests:
        binned = bin_log(test.loads.time_s, test.readings, rig.array)
        forces.append(fit.at(rig.array, binned) @ fit.weights.T)
        sizes.append(binned.bin_scans)
    return forces, sizes


def _binned(rows: FloatArray, size: int) -> FloatArray:
    n = len(rows) // size
    return np.asarray(rows[: n * size].reshape(n, size, -1).mean(axis=1))


def hold_for_an_hour(seed: int, case: Case) -> HoldScore:
    """Hold 15 N for an hour while the object warms the skin by 10 K, with a calibration of a minute."""
    rig, run, _ = rig_for(seed, case)
    found = study_of(rig, run, case)
    n = round(_HOLD_S * _HOLD_HZ)
    time_s = np.arange(n) / _HOLD_HZ
    share = rig.sensor.stiffness / rig.sensor.stiffness.sum()
    loads = np.zeros((n, rig.array.n_taxels, 3))
    press = np.clip((time_s - 5.0) / 0.5, 0, 1) * _HOLD_N
    loads[:, :, 2] = press[:, np.newaxis] * share
    warmth = _WARMED_K * np.clip((time_s - 60.0) / _WARMED_S, 0, 1)
    readings = rig.sensor.readings(loads, _HOLD_HZ, np.random.default_rng([16, seed]), warmth)
    events = ForceEstimator(rig.array, found.file).process(regular_block(readings, _HOLD_HZ))
    true = rig.reference.seen(Loads(time_s, loads).wrench(rig.array))[:, 2]
    held = slice(round(6.0 * _HOLD_HZ), None)
    error = np.array([e.fz_n for e in events])[held] - true[held]
    sd = np.array([e.fz_sd_n for e in events])[held]
    inside, worst = (np.abs(error) < Z90 * sd).mean(), (np.abs(error) / sd).max()
    return HoldScore(seed, float(inside), float(worst), float(error[-1]), float(sd[-1]))
