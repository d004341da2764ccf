"""Rungs of the contact ladder scored against shipped finite-element runs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tactiled.emulator.mechanics.base import NOT_CONVERGED, Rung
from tactiled.emulator.scene.slip_instants import GROSS_SHARE
from tools.fem.reference import ReferenceRun, load_reference

FloatArray = NDArray[np.float64]

AZIMUTH = np.array([180.0, 270.0, 0.0, 90.0])  # R1, R2, R3, R4: `readout.SIDES`
AREA = "half"  # the edge's right area is at zero while sliding: nothing to compare there
FLAT = ("flat-0.3", "flat-0.6", "flat-0.9")
GROOVES = ("groove-0.9-0", "groove-1.2-0", "groove-1.5-0", "groove-1.2-30", "groove-1.2-60")
# Load of a taxel where the load curve is compared: from what a dead zone hides to 27 N on the array.
_SMALLEST_N, _LARGEST_N = 0.1, 3.0
_KNEE_MM = 0.42  # travel after which everything slips


@dataclass(frozen=True, eq=False)
class Ripple:
    """Fundamental of left and right over one wave of sliding, and likeness to the reference."""

    wave_n: NDArray[np.complex128]  # (2,)
    correlation: FloatArray  # (2,)
    sliding_correlation: FloatArray  # (2,)
    unsolved: int = 0  # steps in which the solver did not converge

    def beside(self, reference: "Ripple", side: int) -> str:
        """Amplitude in percent of the reference's and phase in degrees against it."""
        ratio = self.wave_n[side] / reference.wave_n[side]
        return f"{100 * abs(ratio):.0f} %, {np.angle(ratio, deg=True):+.1f} deg"


def replay(
    build: Callable[..., Rung], reference: ReferenceRun, *, held: str = "force"
) -> dict[str, FloatArray]:
    """A rung through the loads (or indentations) and places of a run; `TaxelForces` fields, (i, ...)."""
    columns = reference.columns
    rung = build(reference.surface, AZIMUTH, 1, readout=AREA)
    value = columns["normal_n" if held == "force" else "approach_mm"]
    base = np.stack([columns["travel_x_mm"], columns["travel_y_mm"]], axis=-1)
    # The runs know no time; at 2 mm/s nothing here depends on it.
    felt = [
        rung.step("force" if held == "force" else "displacement", value[k : k + 1], base[k : k + 1], 0.01)
        for k in range(len(value))
    ]
    return {name: np.array([vars(one)[name][0] for one in felt]) for name in vars(felt[0])}


def flat_errors(build: Callable[..., Rung]) -> dict[str, float]:
    """Worst errors on flat plates by need (`scene.Need`), as parts of each quantity's own size."""
    curve = load_reference("coarse", "load")
    loaded = (curve.columns["normal_n"] > _SMALLEST_N) & (curve.columns["normal_n"] < _LARGEST_N)
    pressed = replay(build, curve, held="displacement")["normal_n"]
    errors = {"absolute-force": float(np.abs(pressed / curve.columns["normal_n"] - 1)[loaded].max())}
    for name in FLAT:
        for need, error in _slide_errors(build, load_reference("coarse", name)).items():
            errors[need] = max(errors.get(need, 0.0), error)
    return errors


def grooved_errors(build: Callable[..., Rung], plates: Sequence[str] = GROOVES) -> dict[str, float]:
    """The same over grooves, the way into sliding included."""
    errors: dict[str, float] = {}
    for name in plates:
        for need, error in _slide_errors(build, load_reference("coarse", name)).items():
            errors[need] = max(errors.get(need, 0.0), error)
    return errors


def _slide_errors(build: Callable[..., Rung], reference: ReferenceRun) -> dict[str, float]:
    columns, seen = reference.columns, replay(build, reference)
    travel_mm, slipping = columns["travel_x_mm"], columns["slipping"]
    true = reference.sides(AREA)
    rest_n = true[travel_mm == 0][-1, 0]
    limit_n = reference.surface.friction * columns["normal_n"][-1]
    sliding = travel_mm > 0
    knee = sliding & (slipping < 1)
    gross_mm = [_gross_mm(travel_mm, share) for share in (seen["slipping"], slipping)]
    return {
        "left-right": float(np.abs(seen["side_n"] - true).max() / rest_n),
        "tangential-force": float(
            np.abs(seen["tangential_n"][:, 0] - columns["tangential_x_n"]).max() / limit_n
        ),
        "gross-slip": float(abs(gross_mm[0] / gross_mm[1] - 1)),
        "incipient-slip": float(np.abs(seen["slipping"] - slipping)[knee].mean()),
    }


def _gross_mm(travel_mm: FloatArray, share: FloatArray) -> float:
    """Travel at which nine tenths slip, between the steps of a run."""
    after = int(np.argmax((travel_mm > 0) & (share > GROSS_SHARE)))
    part = (GROSS_SHARE - share[after - 1]) / (share[after] - share[after - 1])
    return float(travel_mm[after - 1] + part * (travel_mm[after] - travel_mm[after - 1]))


def reference_ripple(mesh: str, run: str) -> Ripple:
    """Of a finite-element run."""
    reference = load_reference(mesh, run)
    return _ripple(reference, reference.sides(AREA))


def rung_ripple(build: Callable[..., Rung], run: str) -> Ripple:
    """Of a rung on the coarse mesh's run."""
    reference = load_reference("coarse", run)
    felt = replay(build, reference)
    unsolved = int(np.count_nonzero(felt["warnings"].astype(np.int64) & NOT_CONVERGED))
    return replace(_ripple(reference, felt["side_n"]), unsolved=unsolved)


def _ripple(reference: ReferenceRun, side_n: FloatArray) -> Ripple:
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
        np.array([np.corrcoef(own[last, k], true[last, k])[0, 1] for k in (0, 1)]),
    )
