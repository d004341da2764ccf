"""The finite-element runs that ship as reference data, and the function that makes them."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from tactiled.emulator.mechanics.base import HeldQuantity, Surface
from tactiled.errors import ConfigError
from tools.fem.contact import TOLERANCE, Equilibrium, ImposedState, TaxelPress, penalties
from tools.fem.mesh import MATERIALS, MESHES, taxel_mesh
from tools.fem.reference import reference_path, write_reference

LOAD_N = 15.0 / 9  # the paper's simulations: 15 N on nine taxels
_KNEE_MM = 0.42  # travel after which every point slips, friction 0.9 included
_TO_LOAD_MM = 0.14  # approach at which pressing changes from displacement to force


@dataclass(frozen=True)
class PlannedRun:
    """A plate, and the states that are imposed on the taxel."""

    surface: Surface
    instants: list[ImposedState]


def _pressed(load_n: float, depth_mm: float = 0.0) -> list[ImposedState]:
    # Without contact a force has no equilibrium, so pressing begins by displacement.
    start = min(_TO_LOAD_MM, 0.1 * load_n) + depth_mm / 2
    steps = [ImposedState("displacement", float(d)) for d in np.linspace(0.0, start, 6)[1:]]
    return [*steps, ImposedState("force", load_n)]


def _slide(
    load_n: float,
    way_mm: Sequence[float],
    azimuth_deg: float = 0.0,
    depth_mm: float = 0.0,
    held: HeldQuantity = "force",
) -> list[ImposedState]:
    way = np.deg2rad(azimuth_deg)
    steps = [ImposedState(held, load_n, (float(s * np.cos(way)), float(s * np.sin(way)))) for s in way_mm]
    return [*_pressed(load_n, depth_mm), *steps]


def _grooves(period_mm: float, angle_deg: float) -> PlannedRun:
    """One wave after the knee and a quarter more, so that periodicity can be seen."""
    depth_mm, wave_mm = 0.1, period_mm / float(np.cos(np.deg2rad(angle_deg)))
    step = period_mm / 24
    way = np.arange(step, _KNEE_MM + 1.25 * wave_mm, step)
    return PlannedRun(
        Surface(0.6, period_mm, angle_deg, depth_mm), _slide(LOAD_N, list(way), depth_mm=depth_mm)
    )


_KNEE = [float(s) for s in np.arange(0.02, _KNEE_MM + 0.01, 0.02)]
_THERE_AND_BACK = [*np.arange(0.03, 0.31, 0.03), *np.arange(0.27, -0.31, -0.03)]

RUNS: dict[str, Callable[[], PlannedRun]] = {
    "load": lambda: PlannedRun(
        Surface(0.6), [ImposedState("displacement", float(d)) for d in np.arange(0.01, 0.2501, 0.01)]
    ),
    "flat-0.6": lambda: PlannedRun(Surface(0.6), _slide(LOAD_N, _KNEE)),
    "flat-0.3": lambda: PlannedRun(Surface(0.3), _slide(LOAD_N, _KNEE)),
    "flat-0.9": lambda: PlannedRun(Surface(0.9), _slide(LOAD_N, _KNEE)),
    "groove-1.2-0": lambda: _grooves(1.2, 0.0),
    "groove-0.9-0": lambda: _grooves(0.9, 0.0),
    "groove-1.5-0": lambda: _grooves(1.5, 0.0),
    "groove-1.2-30": lambda: _grooves(1.2, 30.0),
    "groove-1.2-60": lambda: _grooves(1.2, 60.0),
    "flat-0.6-light": lambda: PlannedRun(Surface(0.6), _slide(0.6, _KNEE)),
    "flat-0.6-heavy": lambda: PlannedRun(Surface(0.6), _slide(2.5, _KNEE)),
    "flat-0.6-diagonal": lambda: PlannedRun(Surface(0.6), _slide(LOAD_N, _KNEE, azimuth_deg=45.0)),
    "flat-0.6-back": lambda: PlannedRun(Surface(0.6), _slide(LOAD_N, _THERE_AND_BACK)),
}


def produce(mesh: str, names: Sequence[str], report: Callable[[str], None]) -> list[Path]:
    """Run and write into `config/contact/`; half a minute to half an hour a run (needs ``tactiled[fem]``).

    Parameters
    ----------
    mesh : str
        Of `mesh.MESHES`.
    names : sequence of str
        Of `RUNS`; none asks for all.
    report : callable
        Called with one line for each run.

    Raises
    ------
    ConfigError
        An unknown mesh or run.
    DataError
        felupe is missing, or an increment has no equilibrium.
    """
    faults = [f"no run {name!r}; there are: {', '.join(RUNS)}" for name in names if name not in RUNS]
    if mesh not in MESHES:
        faults.append(f"no mesh {mesh!r}; there are: {', '.join(MESHES)}")
    if faults:
        raise ConfigError("finite elements", faults)
    return [_produce(mesh, name, report) for name in names or RUNS]


def _produce(mesh: str, name: str, report: Callable[[str], None]) -> Path:
    planned, taxel = RUNS[name](), taxel_mesh(MESHES[mesh])
    began = time.perf_counter()
    solutions = list(TaxelPress(taxel, planned.surface).follow(planned.instants))
    seconds = time.perf_counter() - began
    stiff, stick = penalties(planned.surface)
    steps, cuts = sum(s.newton_steps for s in solutions), sum(s.halvings > 0 for s in solutions)
    path = reference_path(mesh, name)
    provenance = {
        "command": f"python -m tools.fem {mesh} {name}",
        "surface": asdict(planned.surface),
        "held": "displacement" if name == "load" else f"force {planned.instants[-1].value:.6g} N",
        "mesh": {"name": mesh, "cells": len(taxel.cells), "unknowns": taxel.points_mm.size},
        "materials": [asdict(material) for material in MATERIALS],
        "versions": {library: version(library) for library in ("felupe", "numpy", "scipy")},
        "solver": {"penalty": stiff, "penalty_slip": stick, "tolerance": TOLERANCE},
        "convergence": {"increments": len(solutions), "newton_steps": steps, "increments_halved": cuts},
        "seconds": round(seconds, 1),
    }
    rows = [_row(instant, s) for instant, s in zip(planned.instants, solutions, strict=True)]
    write_reference(path, provenance, rows)
    report(f"{path.name}: {len(solutions)} increments, {steps} Newton steps, {cuts} halved, {seconds:.0f} s")
    return path


def _row(instant: ImposedState, solution: Equilibrium) -> list[float]:
    return [
        *instant.base_mm,
        solution.normal_n,
        *solution.tangential_n,
        *solution.half_n,
        *solution.edge_n,
        solution.centre_n,
        solution.approach_mm,
        solution.contact_mm2,
        solution.slipping,
        *solution.continued,
    ]
