"""Findings of Wang 2019 beside those of the contact model `compliance`."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from scipy.signal import find_peaks

from bench.contact.score import LOAD_N
from bench.report import table
from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import HeldQuantity, Surface, TaxelForces
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.progress import ProgressBar
from tools.fem.reference import load_reference

_SLIDE_MM = 9.0  # 7.5 waves of 1.2 mm: the paper's curves have 7 to 8 peaks
_STEP_MM = 0.02
_RUN_IN_MM = 0.6
N_STEPS = 2  # of progress
_PERIODS_MM = (0.9, 1.2, 1.5)
_ANGLES_DEG = (0, 30, 60)
_PLATES = ((0.9, 0), (1.2, 0), (1.5, 0), (1.2, 30), (1.2, 60))


def findings_table(progress: ProgressBar) -> str:
    """Opposite change of left and right, ripple by period and angle, number of peaks."""
    unit = {plate: normal_ripple(*plate) for plate in _PLATES}
    progress.advance("ripple at held indentation")
    side = {plate: side_ripple(*plate) for plate in _PLATES}
    progress.advance("ripple at held load")

    def by_period(ripple: Mapping[tuple[float, int], FloatArray]) -> str:
        return ", ".join(f"{1e3 * np.ptp(ripple[p, 0]):.0f} mN ({p:g} mm)" for p in _PERIODS_MM)

    def by_angle(ripple: Mapping[tuple[float, int], FloatArray]) -> str:
        return ", ".join(f"{1e3 * np.ptp(ripple[1.2, a]):.0f} mN ({a} deg)" for a in _ANGLES_DEG)

    change = f"edge areas {_opposite_change('edge')}; half {_opposite_change('half')}"
    peaks = ", ".join(f"{_peaks(unit[1.2, a])} ({a} deg)" for a in _ANGLES_DEG)
    larger, halves = "larger periods, larger ripple", "80 mN (0 deg) to 40 mN (60 deg)"
    rows = (
        ("change of left, right in slip", "almost 100 %, opposite", change),
        ("ripple by period: half area, held load", larger, by_period(side)),
        ("ripple by period: unit, held indentation", larger, by_period(unit)),
        ("ripple by angle: half area, held load", halves, by_angle(side)),
        ("ripple by angle: unit, held indentation", halves, by_angle(unit)),
        (f"peaks in {_SLIDE_MM:g} mm, 1.2 mm", "7-8 (0 deg) to 3-4 (60 deg)", peaks),
    )
    return (
        "The paper's findings, on contact model compliance (groove depth 0.1 mm and bump shape are assumed; "
        "ripple is peak to trough; the paper does not say what holds a single unit).\n\n"
        + table({"finding": finding, "paper": paper, "ours": ours} for finding, paper, ours in rows)
    )


def normal_ripple(period_mm: float, angle_deg: int) -> FloatArray:
    """Normal force of one unit along a slide at the indentation that gives the load on average."""
    surface = Surface(0.6, period_mm, angle_deg, 0.1)
    wave_mm = period_mm / np.cos(np.deg2rad(angle_deg))
    depth_mm = np.mean([felt.indentation_mm[0] for felt in _slide(surface, "force", LOAD_N, wave_mm)])
    felt = _slide(surface, "displacement", float(depth_mm), _SLIDE_MM)
    return np.array([one.normal_n[0] for one in felt])


def side_ripple(period_mm: float, angle_deg: int) -> FloatArray:
    """Normal force on the leading half of one unit along a slide under its load."""
    felt = _slide(Surface(0.6, period_mm, angle_deg, 0.1), "force", LOAD_N, _SLIDE_MM)
    return np.array([one.side_n[0, 0] for one in felt])


def _slide(surface: Surface, held: HeldQuantity, value: float, length_mm: float) -> list[TaxelForces]:
    """Forces along a slide, after the run-in."""
    model = Compliance(surface, np.array([0.0]), 1, readout="half")
    for part in np.linspace(0.1, 1.0, 10):
        model.step(held, np.array([value * part]), np.zeros((1, 2)), 0.01)
    felt = [
        model.step(held, np.array([value]), np.array([[x_mm, 0.0]]), 0.01)
        for x_mm in np.arange(_STEP_MM, _RUN_IN_MM + length_mm, _STEP_MM)
    ]
    return felt[round(_RUN_IN_MM / _STEP_MM) :]


def _peaks(normal_n: FloatArray) -> int:
    """Count peaks that stand out by a third of the ripple, as one counts by eye."""
    return len(find_peaks(normal_n, prominence=float(np.ptp(normal_n)) / 3)[0])


def _opposite_change(area: Literal["edge", "half"]) -> str:
    """Change of left and right at friction 0.6; a contact sensor shows nothing below zero."""
    reference = load_reference("coarse", "flat-0.6")
    columns, sides = reference.columns, np.maximum(reference.sides(area)[:, [0, 2]], 0.0)
    model = Compliance(reference.surface, np.array([180.0, 0.0]), 1, readout=area)
    own = np.array(
        [
            model.step("force", np.array([load_n]), np.array([[x_mm, 0.0]]), 0.01).side_n[0]
            for load_n, x_mm in zip(columns["normal_n"], columns["travel_x_mm"], strict=True)
        ]
    )
    rest = int(np.flatnonzero(columns["travel_x_mm"] == 0)[-1])

    def change(values: FloatArray) -> str:
        return " / ".join(f"{100 * part:+.0f} %" for part in values[-1] / values[rest] - 1)

    return f"{change(own)} (finite elements {change(sides)})"
