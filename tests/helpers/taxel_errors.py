"""Errors of contact models of the emulator against the shipped finite-element runs of one taxel.

The runs are `config/contact/fem-*.json`, made once and readable without felupe. Each model is played through
the loads and places of a run.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from taxel_runs import ReferenceRun, load_reference

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Readout, Surface, TaxelModel
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.mechanics.periodic import Periodic
from tactiled.emulator.scene.slip_instants import GROSS_SHARE

MODELS: dict[str, type[TaxelModel]] = {"periodic": Periodic, "compliance": Compliance}
# Largest errors of each model, coarse mesh. `compliance`: flat plates with friction 0.3 to 0.9, loads of 0.1
# to 3 N a taxel; grooves of 0.9 to 1.5 mm at 0 to 60 degrees. The error of incipient slip is that of the
# slipping share: rings of nodes, a fifth of the contact, slip at once; the mean error is 0.03. Ripple (of its
# amplitude) and its phase (of a turn) are worst at 60 degrees, where they are smallest: 0.24 and 0.04 up to
# 30 degrees. `periodic` errs most in the onset over grooves, which is a blend: slip is gross a tenth to a
# fifth too early.
LARGEST_ERRORS = {
    "compliance": {
        "gross-slip": 0.11, "incipient-slip": 0.22, "absolute-force": 0.02, "left-right": 0.05,
        "tangential-force": 0.08, "groove-ripple": 0.46, "groove-phase": 0.08,
    },
    "periodic": {
        "gross-slip": 0.21, "absolute-force": 0.05, "left-right": 0.11, "tangential-force": 0.17,
    },
}  # fmt: skip
LOAD_N = 15.0 / 9  # of a taxel: that of the published slides, 15 N on nine taxels
AZIMUTH = np.array([180.0, 270.0, 0.0, 90.0])  # R1, R2, R3, R4: `readout.SIDES`
AREA: Readout = "half"  # under the edge areas the right force is zero while sliding
GROOVES = ("groove-0.9-0", "groove-1.2-0", "groove-1.5-0", "groove-1.2-30", "groove-1.2-60")
_FLAT = ("flat-0.3", "flat-0.6", "flat-0.9")
# Loads of a taxel at which the load curve is compared: from the dead zone to 27 N on the array.
_SMALLEST_N, _LARGEST_N = 0.1, 3.0
_WAVES_MM = 3.0  # of sliding, which hold a wave of the longest and of the most tilted grooves
_STEP_MM = 0.02
_RUN_IN_MM = 0.6
_KNEE_MM = 0.42  # travel after which the whole contact slips


@dataclass(frozen=True, eq=False)
class Ripple:
    """Groove ripple of the left and the right read-out area of one taxel.

    Attributes
    ----------
    wave_n : (2,) complex128
        Fundamental over the last wave of sliding.
    correlation : (2,) float64
        With the finite elements, over the whole run.
    unsolved : int
        Substeps in which the solver did not converge.
    """

    wave_n: NDArray[np.complex128]
    correlation: FloatArray
    unsolved: int = 0


def replay(name: str, reference: ReferenceRun) -> dict[str, FloatArray]:
    """Play a model through the loads and places of a run; fields of `TaxelForces`, each (increments, ...)."""
    columns = reference.columns
    model = MODELS[name](reference.surface, AZIMUTH, 1, AREA)
    base = np.stack([columns["travel_x_mm"], columns["travel_y_mm"]], axis=-1)
    # The runs have no time; at 2 mm/s nothing here depends on it.
    felt = model.run(columns["normal_n"][:, None], base[:, None], 0.01)
    unsolved = {"unsolved": np.array(model.unsolved)} if isinstance(model, Compliance) else {}
    return {field: rows[:, 0] for field, rows in vars(felt).items()} | unsolved


def flat_errors(name: str) -> dict[str, float]:
    """Largest errors on flat plates by need, as parts of each quantity's own size."""
    curve = load_reference("coarse", "load")
    loaded = (curve.columns["normal_n"] > _SMALLEST_N) & (curve.columns["normal_n"] < _LARGEST_N)
    depth_mm = replay(name, curve)["indentation_mm"]
    pressed = np.interp(curve.columns["approach_mm"], depth_mm, curve.columns["normal_n"])
    load_curve = {"absolute-force": float(np.abs(pressed / curve.columns["normal_n"] - 1)[loaded].max())}
    return load_curve | sliding_errors(name, _FLAT)


def sliding_errors(name: str, runs: Sequence[str]) -> dict[str, float]:
    """Largest errors by need over some runs of sliding, the onset of sliding included."""
    errors: dict[str, float] = {}
    of_runs = (_slide_errors(name, load_reference("coarse", run)) for run in runs)
    for need, error in chain.from_iterable(one.items() for one in of_runs):
        errors[need] = max(errors.get(need, 0.0), error)
    return errors


def _slide_errors(name: str, reference: ReferenceRun) -> dict[str, float]:
    columns, seen = reference.columns, replay(name, reference)
    travel_mm, slipping = columns["travel_x_mm"], columns["slipping"]
    true = reference.sides(AREA)
    rest_n = true[travel_mm == 0][-1, 0]
    limit_n = reference.surface.friction * columns["normal_n"][-1]
    sliding = travel_mm > 0
    knee = sliding & (slipping < 1)
    gross_mm = [_gross_mm(travel_mm, share) for share in (seen["slipping"], slipping)]
    tangential_n = seen["tangential_n"][:, 0] - columns["tangential_x_n"]
    return {
        "left-right": float(np.abs(seen["side_n"] - true).max() / rest_n),
        "tangential-force": float(np.abs(tangential_n).max() / limit_n),
        "gross-slip": float(abs(gross_mm[0] / gross_mm[1] - 1)),
        "incipient-slip": float(np.abs(seen["slipping"] - slipping)[knee].mean()),
    }


def _gross_mm(travel_mm: FloatArray, share: FloatArray) -> float:
    """Travel at which nine tenths slip, interpolated between the steps of a run."""
    after = int(np.argmax((travel_mm > 0) & (share > GROSS_SHARE)))
    part = (GROSS_SHARE - share[after - 1]) / (share[after] - share[after - 1])
    return float(travel_mm[after - 1] + part * (travel_mm[after] - travel_mm[after - 1]))


def reference_ripple(mesh: str, plate: str) -> Ripple:
    """Ripple of the finite elements."""
    reference = load_reference(mesh, plate)
    return _ripple(reference, reference.sides(AREA))


def model_ripple(name: str, plate: str) -> Ripple:
    """Ripple of a model on the run of the coarse mesh."""
    reference = load_reference("coarse", plate)
    felt = replay(name, reference)
    return _ripple(reference, felt["side_n"], int(felt["unsolved"]))


def _ripple(reference: ReferenceRun, side_n: FloatArray, unsolved: int = 0) -> Ripple:
    travel_mm = reference.columns["travel_x_mm"]
    wave_mm = reference.surface.period_mm / np.cos(np.deg2rad(reference.surface.angle_deg))
    last = (travel_mm > _KNEE_MM) & (travel_mm > travel_mm[-1] - wave_mm)
    turn = 2 * np.pi * travel_mm[last] / wave_mm
    basis = np.stack([np.ones(len(turn)), np.cos(turn), np.sin(turn)], axis=1)
    own, true = side_n[:, [0, 2]], reference.sides(AREA)[:, [0, 2]]
    fit = np.linalg.lstsq(basis, own[last])[0]
    return Ripple(
        fit[1] - 1j * fit[2],
        np.array([np.corrcoef(own[:, k], true[:, k])[0, 1] for k in (0, 1)]),
        unsolved,
    )


def side_ripple(period_mm: float, angle_deg: int) -> FloatArray:
    """Normal force on the leading half of one unit along a slide under its load, after the run-in."""
    model = Compliance(Surface(0.6, period_mm, angle_deg, 0.1), np.array([0.0]), 1, AREA)
    x_mm = np.concatenate([np.zeros(10), np.arange(_STEP_MM, _RUN_IN_MM + _WAVES_MM, _STEP_MM)])
    load_n = LOAD_N * np.minimum(np.arange(1, len(x_mm) + 1) / 10, 1.0)
    felt = model.run(load_n[:, None], np.stack([x_mm, np.zeros(len(x_mm))], axis=-1)[:, None], 0.01)
    return felt.side_n[10 + round(_RUN_IN_MM / _STEP_MM) :, 0, 0]
