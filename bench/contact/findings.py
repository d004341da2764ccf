"""The findings of Wang 2019 beside those of the contact ladder, and its estimators on physical scenes."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from bench.paper.bench import compare
from tactiled.emulator.mechanics.base import HeldQuantity, Surface, TaxelForces
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.scene.description import paper_scenes
from tactiled.plain_table import table
from tactiled.progress import ProgressBar
from tools.fem.reference import load_reference

FloatArray = NDArray[np.float64]
Ripples = Mapping[tuple[float, int], FloatArray]

_LOAD_N = 15.0 / 9
_SLIDE_MM = 9.0  # 7.5 waves of 1.2 mm: the paper's curves have 7 to 8 peaks
_STEP_MM = 0.02
_RUN_IN_MM = 0.6
_PLATES = ((0.9, 0), (1.2, 0), (1.5, 0), (1.2, 30), (1.2, 60))

N_FINDINGS = 2  # steps of progress


def findings(progress: ProgressBar) -> str:
    """Opposite change, ripple by period and angle, number of peaks."""
    unit = {plate: normal_ripple(*plate) for plate in _PLATES}
    progress.advance("ripple at held indentation")
    side = {plate: side_ripple(*plate) for plate in _PLATES}
    progress.advance("ripple at held load")
    edge, half = (_opposite_change(area) for area in ("edge", "half"))

    def by_period(ripple: Ripples) -> str:
        return ", ".join(f"{1e3 * np.ptp(ripple[p, 0]):.0f} mN ({p:g} mm)" for p in (0.9, 1.2, 1.5))

    def by_angle(ripple: Ripples) -> str:
        return ", ".join(f"{1e3 * np.ptp(ripple[1.2, a]):.0f} mN ({a} deg)" for a in (0, 30, 60))

    peaks = ", ".join(f"{_peaks(unit[1.2, a])} ({a} deg)" for a in (0, 30, 60))
    larger, halves = "larger periods, larger ripple", "80 mN (0 deg) to 40 mN (60 deg)"
    rows = [
        ["change of left, right in slip", "almost 100 %, opposite", f"edge areas {edge}; half {half}"],
        ["ripple by period: half area, held load", larger, by_period(side)],
        ["ripple by period: unit, held indentation", larger, by_period(unit)],
        ["ripple by angle: half area, held load", halves, by_angle(side)],
        ["ripple by angle: unit, held indentation", halves, by_angle(unit)],
        [f"peaks in {_SLIDE_MM:g} mm, 1.2 mm", "7-8 (0 deg) to 3-4 (60 deg)", peaks],
    ]
    return (
        "The paper's findings, on rung compliance (groove depth 0.1 mm and bump shape are assumed; ripple is "
        "peak to trough; the paper does not say what holds a single unit).\n\n"
        + table(["finding", "paper", "ours"], rows)
    )


def replayed_paper(progress: ProgressBar, *, seeds: int) -> str:
    """The published procedure on the protocols again, with physics instead of prescribed signals."""
    scenes = {
        name: scene.with_changes(contact="lumped" if name.startswith("flat") else "periodic")
        for name, scene in paper_scenes().items()
    }
    return "With physics (lumped on the flat plate, periodic on grooves):\n\n" + compare(
        progress, scenes, seeds=seeds
    )


def normal_ripple(period_mm: float, angle_deg: int) -> FloatArray:
    """Normal force of one unit along a slide at the indentation that gives the load on average."""
    surface = Surface(0.6, period_mm, angle_deg, 0.1)
    wave_mm = period_mm / np.cos(np.deg2rad(angle_deg))
    depth_mm = np.mean([felt.indentation_mm[0] for felt in _slide(surface, "force", _LOAD_N, wave_mm)])
    felt = _slide(surface, "displacement", float(depth_mm), _SLIDE_MM)
    return np.array([one.normal_n[0] for one in felt])


def side_ripple(period_mm: float, angle_deg: int) -> FloatArray:
    """Normal force on the leading half of one unit along a slide under its load."""
    felt = _slide(Surface(0.6, period_mm, angle_deg, 0.1), "force", _LOAD_N, _SLIDE_MM)
    return np.array([one.side_n[0, 0] for one in felt])


def _slide(surface: Surface, held: HeldQuantity, value: float, length_mm: float) -> list[TaxelForces]:
    """What is felt along a slide, after the run-in."""
    rung = Compliance(surface, np.array([0.0]), 1, readout="half")
    for part in np.linspace(0.1, 1.0, 10):
        rung.step(held, np.array([value * part]), np.zeros((1, 2)), 0.01)
    felt = [
        rung.step(held, np.array([value]), np.array([[x_mm, 0.0]]), 0.01)
        for x_mm in np.arange(_STEP_MM, _RUN_IN_MM + length_mm, _STEP_MM)
    ]
    return felt[round(_RUN_IN_MM / _STEP_MM) :]


def _peaks(normal_n: FloatArray) -> int:
    """Peaks that stand out by a third of the ripple: what one counts by eye."""
    return len(find_peaks(normal_n, prominence=float(np.ptp(normal_n)) / 3)[0])


def _opposite_change(area: str) -> str:
    """Of finite elements and of compliance at friction 0.6; a contact sensor shows nothing below zero."""
    reference = load_reference("coarse", "flat-0.6")
    columns, sides = reference.columns, np.maximum(reference.sides(area)[:, [0, 2]], 0.0)
    rung = Compliance(
        reference.surface, np.array([180.0, 0.0]), 1, readout="edge" if area == "edge" else "half"
    )
    own = []
    for load_n, x_mm in zip(columns["normal_n"], columns["travel_x_mm"], strict=True):
        own.append(rung.step("force", np.array([load_n]), np.array([[x_mm, 0.0]]), 0.01).side_n[0])
    rest = int(np.flatnonzero(columns["travel_x_mm"] == 0)[-1])

    def change(values: FloatArray) -> str:
        return " / ".join(f"{100 * part:+.0f} %" for part in values[-1] / values[rest] - 1)

    return f"{change(np.array(own))} (fem {change(sides)})"
