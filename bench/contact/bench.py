"""``./run bench contact``: what each rung of the contact ladder costs and gets wrong.

Finite elements of one taxel are the reference (`config/contact/fem-*.json`, made once, readable without
felupe): each rung is played through the same loads and places. Then the paper's findings beside ours, and the
published estimators on scenes that obey physics.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.contact.findings import N_FINDINGS, findings, replayed_paper
from bench.contact.score import (
    AREA,
    AZIMUTH,
    GROOVES,
    FloatArray,
    Ripple,
    flat_errors,
    grooved_errors,
    reference_ripple,
    rung_ripple,
)
from tactiled.emulator.mechanics import compliance, lumped, periodic
from tactiled.emulator.mechanics.base import Rung, Surface
from tactiled.emulator.mechanics.stepper import play
from tactiled.emulator.prepare import rung_of
from tactiled.emulator.scene.description import load_scene, paper_scenes
from tactiled.emulator.simulate import Simulation
from tactiled.plain_table import table
from tactiled.progress import ProgressBar
from tactiled.wire.layout import load_layout
from tools.fem.reference import reference_names

LADDER: dict[str, tuple[Callable[..., Rung], float]] = {
    "lumped": (lumped.Lumped, lumped.STEP_S),
    "periodic": (periodic.Periodic, periodic.STEP_S),
    "compliance": (compliance.Compliance, compliance.STEP_S),
}
_GROOVED = ("periodic", "compliance")
_LOAD_N = 15.0 / 9
_NEEDS = {
    "absolute-force": "load curve",
    "left-right": "left, right",
    "tangential-force": "friction force at the knee",
    "gross-slip": "gross slip",
    "incipient-slip": "slipping share",
}


@dataclass(frozen=True)
class Scored:
    """A rung with what was measured on it; errors are parts of the quantity's own size."""

    name: str
    cost_ms: float
    errors: dict[str, float]
    ripples: dict[str, Ripple]


def bench_contact(progress: ProgressBar, *, quick: bool, picture: Path | None = None) -> str:
    """Error against cost for each rung; the paper's findings; its estimators on physical scenes.

    Parameters
    ----------
    progress : ProgressBar
    quick : bool
        One groove plate instead of all, one seed of the estimators instead of three.
    picture : Path, optional
        PNG to write.
    """
    plates = [name for name in GROOVES if name in reference_names("coarse")][: 1 if quick else None]
    progress.begin(len(LADDER) + N_FINDINGS + len(paper_scenes()))
    scored = []
    for name, (build, step_s) in LADDER.items():
        ripples = {plate: rung_ripple(build, plate) for plate in plates} if name in _GROOVED else {}
        scored.append(Scored(name, cost_ms(build, step_s, name in _GROOVED), flat_errors(build), ripples))
        progress.advance(name)
    reference = {
        mesh: {plate: reference_ripple(mesh, plate) for plate in plates if plate in reference_names(mesh)}
        for mesh in ("coarse", "medium")
    }
    text = [
        _rung_table(scored),
        _grooved_table(plates),
        _boards(),
        _ripple_table(scored, reference),
        _aims(scored),
    ]
    text.append(findings(progress))
    text.append(replayed_paper(progress, seeds=1 if quick else 3))
    if picture is not None:
        from bench.contact.picture import draw_contact  # matplotlib is an extra

        draw_contact(picture, {s.name: (s.cost_ms, s.errors) for s in scored}, plates)
    return "\n\n".join(text)


def cost_ms(build: Callable[..., Rung], step_s: float, is_grooved: bool) -> float:
    """Milliseconds of processor time for a simulated second: nine taxels sliding at 1 mm/s, tables made."""
    surface = Surface(0.6, 1.2, 30.0, 0.1) if is_grooved else Surface(0.6)
    steps = round(1 / step_s)
    place = np.random.default_rng(1).uniform(0, 7, (9, 2))
    way = step_s * np.arange(steps)[:, None, None] * np.array([1.0, 0.0])
    load: FloatArray = np.full((steps, 9), _LOAD_N)
    rung = build(surface, AZIMUTH, 9)
    play(rung, "force", load, place + way, step_s)  # contact is made, tables too
    began = time.process_time()
    play(rung, "force", load, place + way + way[-1], step_s)
    return 1e3 * (time.process_time() - began)


def _grooved_table(plates: list[str]) -> str:
    """The way into sliding over grooves, which only some rungs can play."""
    names = {need: name for need, name in _NEEDS.items() if need != "absolute-force"}
    rows = []
    for rung in _GROOVED:
        for plate in plates:
            errors = grooved_errors(LADDER[rung][0], [plate])
            cells = [f"{100 * errors[need]:.1f} %" for need in names]
            rows.append([rung, plate.removeprefix("groove-").replace("-", " mm, ") + " deg", *cells])
    return "The same over grooves, the way into sliding included.\n\n" + table(
        ["rung", "plate", *names.values()], rows
    )


def _aims(scored: list[Scored]) -> str:
    """What the ladder set out to reach, and whether it did."""
    by_name = {s.name: s for s in scored}
    flat, parent, steady = by_name["lumped"], by_name["compliance"], by_name["periodic"]
    ratios = np.array([steady.ripples[p].wave_n / parent.ripples[p].wave_n for p in parent.ripples])
    correlation = np.array([parent.ripples[p].sliding_correlation for p in parent.ripples])
    whole = np.array([parent.ripples[p].correlation for p in parent.ripples])
    amplitude, phase_deg = np.abs(np.abs(ratios) - 1).max(), np.abs(np.angle(ratios, deg=True)).max()
    aims = [
        ("lumped: ms a simulated second", flat.cost_ms, 5.0, ".1f"),
        ("lumped: left, right on flat plates (%)", 100 * flat.errors["left-right"], 5.0, ".1f"),
        ("periodic: ms a simulated second", steady.cost_ms, 10.0, ".1f"),
        ("periodic: ripple against its parent (%)", 100 * amplitude, 10.0, ".1f"),
        ("periodic: phase against its parent (deg)", phase_deg, 5.0, ".1f"),
        ("compliance: ms a simulated second", parent.cost_ms, 2000.0, ".0f"),
        ("compliance: load curve (%)", 100 * parent.errors["absolute-force"], 5.0, ".1f"),
        ("compliance: steps not converged", sum(r.unsolved for r in parent.ripples.values()), 0.0, ".0f"),
    ]
    rows = [
        [name, f"at most {aim:g}", f"{got:{form}}", "met" if got <= aim else "MISSED"]
        for name, got, aim, form in aims
    ]
    for name, values in (("whole run", whole), ("one wave of sliding", correlation)):
        least = values.min()
        rows.append(
            [
                f"compliance: correlation over grooves, {name}",
                "above 0.95",
                f"{least:.3f} ({np.count_nonzero(values > 0.95)} of {values.size})",
                "met" if least > 0.95 else "MISSED",
            ]
        )
    return "Aims, worst case of all plates:\n\n" + table(["aim", "limit", "measured", ""], rows)


def _boards() -> str:
    """What the whole emulator costs: contact, sensor, converter, firmware, line."""
    parts = []
    for scene in (load_scene("demo"), load_scene("grasp")):
        simulation = Simulation(scene, load_layout("board-v1"))
        began = time.process_time()
        deque(simulation, maxlen=0)
        share = (time.process_time() - began) / scene.duration_s
        parts.append(f"{100 * share:.1f} % for `{scene.name}` ({rung_of(scene)})")
    return f"The whole emulated board at 100 Hz, of one core: {', '.join(parts)}."


def _rung_table(scored: list[Scored]) -> str:
    head = ["rung", "cost (ms/s)", *_NEEDS.values()]
    rows = [
        [s.name, f"{s.cost_ms:.1f}", *(f"{100 * s.errors[need]:.1f} %" for need in _NEEDS)] for s in scored
    ]
    return (
        "Rungs against finite elements (coarse mesh, flat plates). Cost: processor time for a simulated "
        "second of nine taxels; periodic and compliance over grooves.\n\n" + table(head, rows) + "\n\n"
        "load curve: force at an indentation, worst from 0.1 to 3 N a taxel. left, right: worst area at "
        "any instant of friction 0.3, 0.6 and 0.9, of its force at rest. friction force: worst at any "
        "instant, of its limit. gross slip: travel at which nine tenths slip, of that travel. slipping "
        "share: mean over the knee."
    )


def _ripple_table(scored: list[Scored], reference: dict[str, dict[str, Ripple]]) -> str:
    head = [
        "period, angle",
        "side",
        "fem coarse",
        "fem medium",
        *_GROOVED,
        "correlation, whole run",
        "sliding",
    ]
    by_name = {s.name: s.ripples for s in scored}
    rows = []
    for plate, coarse in reference["coarse"].items():
        medium = reference["medium"].get(plate)
        for k, side in enumerate(("left", "right")):
            cells = [by_name[name][plate].beside(coarse, k) for name in _GROOVED]
            parent = by_name["compliance"][plate]
            rows.append(
                [
                    plate.removeprefix("groove-").replace("-", " mm, ") + " deg",
                    side,
                    f"{1e3 * abs(coarse.wave_n[k]):.1f} mN",
                    medium.beside(coarse, k) if medium else "-",
                    *cells,
                    f"{parent.correlation[k]:.3f}",
                    f"{parent.sliding_correlation[k]:.3f}",
                ]
            )
    return (
        f"Groove ripple (depth 0.1 mm, friction 0.6, {_LOAD_N:.2f} N a taxel, {AREA} read-out areas): "
        "amplitude of the fundamental; then amplitude and phase against fem coarse. Correlations are those "
        "of compliance with fem coarse.\n\n" + table(head, rows)
    )
