"""Solver behind `periodic`: surface compliance of the taxel, unilateral contact and Coulomb friction.

The body responds linearly to forces on its surface, with a matrix from finite elements
(`config/contact/compliance-*.npz`); contact, friction and their lateral coupling are solved on the surface
nodes. Large displacements enter to first order: a node meets the surface at its displaced place, with the
height and slope of the surface there, and has the effects in `skin`.

Not modelled: the skin's nonlinearity (Yeoh) beyond that, creep, adhesion, static friction above sliding
friction, the neighbours' bumps, edges of ridges sharper than the nodes' spacing (0.17 mm).
"""

import math

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Readout, Surface, TaxelForces, TaxelModel
from tactiled.emulator.mechanics.skin import (
    DisplacementEffects,
    SkinCompliance,
    on_linear_skin_n,
    shipped_skin,
    stiffening,
)
from tactiled.emulator.mechanics.solver import ContactSolver, Solution
from tactiled.errors import ConfigError

# Longest travel of a substep: the surface is linearised over it, and friction depends on the path.
_SUBSTEP_MM = 0.03
_SUBSTEP_OF_PERIOD = 1 / 30
# Friction depends on the last 0.3 mm (presliding) only: of a longer jump the last substeps are computed.
_SUBSTEPS = 32
_HALVINGS = 4  # of a substep that does not converge, before it is taken as it is
# Failed solves in one step of one taxel. A taxel that has more is jammed (unbounded friction between
# ridges), and the step ends.
_FAILURES = 6
_ROUNDS = 8  # of contact and couples in turn; two or three suffice
# Change between rounds at which they end: a thousandth of the displacement by friction.
_TURNED_MM = 3e-4


class TaxelState:
    """State of one taxel between steps; without contact at first."""

    def __init__(self, skin: SkinCompliance, friction: float) -> None:
        n = len(skin.x_mm)
        self.solver = ContactSolver(skin.compliance, friction)
        self.force_n = np.zeros((3, n))  # body components: into the skin, x, y
        self.moved_mm = np.zeros((3, n))
        self.slips = np.zeros(n, dtype=bool)
        self.turned_mm = np.zeros((3, n))  # part of `moved_mm` by the couples of displaced forces
        self.approach_mm = 0.0
        self.base_mm: FloatArray | None = None
        self.load_n: float | None = None
        self.failures = 0  # solves of this step that did not converge


class Compliance(TaxelModel):
    """Compliance of the whole surface with contact and friction on its nodes.

    Indentation counts from the plane of the ridges. Friction depends on the path and not on time. It takes a
    second of processor for a second of nine sliding taxels and more: scenes play tables of it (`periodic`).
    """

    step_s = 0.01  # a scan: shorter steps only cost more

    def __init__(
        self, surface: Surface, azimuth_deg: FloatArray, n_taxels: int, readout: Readout = "edge"
    ) -> None:
        if surface.static_ratio != 1.0:
            raise ConfigError(
                "scene", ["surface.static_ratio: must be 1 on each plate of a scene with grooves"]
            )
        self._surface = surface
        self._skin = shipped_skin(readout)
        self._n_taxels = n_taxels
        self._displaced = DisplacementEffects(self._skin, azimuth_deg)
        grooved_mm = surface.period_mm * _SUBSTEP_OF_PERIOD if surface.depth_mm > 0 else math.inf
        self._substep_mm = min(_SUBSTEP_MM, grooved_mm)
        self._flat = self._skin.compliance.reshape(3 * len(self._skin.x_mm), -1)
        self.reset()

    def reset(self) -> None:
        # Substeps that did not converge: their forces are the last ones, scaled to the load.
        self.unsolved = 0
        self._taxels = [TaxelState(self._skin, self._surface.friction) for _ in range(self._n_taxels)]

    def run(self, load_n: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        del dt_s
        steps = []
        for goals, places in zip(on_linear_skin_n(load_n), base_mm, strict=True):
            for taxel, goal, place in zip(self._taxels, goals.tolist(), places, strict=True):
                self._advance(taxel, goal, place)
            steps.append(self._felt())
        return TaxelForces(
            **{name: np.stack([vars(step)[name] for step in steps]) for name in vars(steps[0])}
        )

    def _advance(self, taxel: TaxelState, load_n: float, base_mm: FloatArray) -> None:
        """Go to a load and a place, in substeps."""
        if taxel.base_mm is None:
            taxel.base_mm = base_mm.copy()
        if taxel.load_n == load_n and np.array_equal(taxel.base_mm, base_mm):
            return
        taxel.failures = 0
        start, way = taxel.base_mm, base_mm - taxel.base_mm
        first = taxel.load_n or 0.0
        wanted = math.ceil(float(np.hypot(*way)) / self._substep_mm)
        count = max(1, min(wanted, _SUBSTEPS))
        length = self._substep_mm / max(float(np.hypot(*way)), self._substep_mm) if wanted > 1 else 1.0
        for left in range(count - 1, -1, -1):
            share = 1.0 - left * (length if wanted > _SUBSTEPS else 1.0 / count)
            if taxel.failures < _FAILURES or not left:
                self._substep(taxel, first + share * (load_n - first), start + share * way, _HALVINGS)
        taxel.base_mm, taxel.load_n = base_mm.copy(), load_n

    def _substep(self, taxel: TaxelState, load_n: float, base_mm: FloatArray, halvings: int) -> None:
        """Solve one substep, or halve it where Newton's method fails."""
        before_n, here_mm = float(taxel.force_n[0].sum()), taxel.base_mm
        assert here_mm is not None  # `_advance` has set it
        solution, frame = self._solve(taxel, load_n, base_mm, base_mm - here_mm)
        taxel.failures += not solution.converged
        if not solution.converged and halvings and taxel.failures < _FAILURES:
            self._substep(taxel, (before_n + load_n) / 2, (here_mm + base_mm) / 2, halvings - 1)
            self._substep(taxel, load_n, base_mm, halvings - 1)
            return
        if solution.converged:
            taxel.force_n = np.einsum("ijk,ik->jk", frame, solution.force_n)
            taxel.approach_mm += solution.approach_mm
        else:  # the last state, scaled to this load, is the best approximation
            self.unsolved += 1
            taxel.force_n *= load_n / max(before_n, 1e-9)
        taxel.moved_mm = (self._flat @ taxel.force_n.ravel()).reshape(3, -1) + taxel.turned_mm
        taxel.slips = solution.slips
        taxel.base_mm = base_mm

    def _solve(
        self, taxel: TaxelState, load_n: float, base_mm: FloatArray, travel_mm: FloatArray
    ) -> tuple[Solution, FloatArray]:
        """Solve contact at a place; return the solution and the contact frames."""
        moved = taxel.moved_mm
        along, across = self._skin.x_mm + base_mm[0] + moved[1], self._skin.y_mm + base_mm[1] + moved[2]
        height, frame = plate_under(self._surface, along, across)
        lowest = float((self._skin.gap_mm - height).min())  # approach at which the unloaded skin touches
        if load_n <= 0:
            taxel.approach_mm = lowest
            taxel.turned_mm = nothing = np.zeros_like(taxel.force_n)
            return Solution(nothing, 0.0, np.zeros(nothing.shape[1], dtype=bool), True), frame
        if not taxel.force_n[0].any():
            taxel.approach_mm = lowest
        gap = self._skin.gap_mm - height - taxel.approach_mm
        # Gap, and slip of this step: travel, minus what the nodes had moved.
        free = np.empty_like(taxel.force_n)
        free[0] = frame[0, 0] * gap - frame[0, 1] * moved[1] - frame[0, 2] * moved[2]
        for axis in (1, 2):
            a = frame[axis]
            free[axis] = a[1] * (travel_mm[0] - moved[1]) + a[2] * (travel_mm[1] - moved[2]) - a[0] * moved[0]
        guess = np.einsum("ijk,jk->ik", frame, taxel.force_n)
        np.maximum(guess[0], 0.0, out=guess[0])
        return self._solve_turning(taxel, frame, free, guess, load_n), frame

    def _solve_turning(
        self, taxel: TaxelState, frame: FloatArray, free: FloatArray, guess: FloatArray, load_n: float
    ) -> Solution:
        """Solve contact until the couples belong to its forces; each round leaves a tenth of the change."""
        before = taxel.turned_mm
        for _ in range(_ROUNDS):
            turned = np.einsum("ijk,jk->ik", frame, taxel.turned_mm)
            solution = taxel.solver.solve(frame, free + turned, guess, load_n)
            if not solution.converged:
                taxel.turned_mm = before
                return solution
            guess = solution.force_n
            force = np.einsum("ijk,ik->jk", frame, guess)
            moved = (self._flat @ force.ravel()).reshape(3, -1) + taxel.turned_mm
            last, taxel.turned_mm = taxel.turned_mm, self._displaced.turned_mm(force, moved)
            if np.abs(taxel.turned_mm - last).max() < _TURNED_MM:
                break
        return solution

    def _felt(self) -> TaxelForces:
        force = np.array([t.force_n for t in self._taxels])  # (t, 3, n)
        moved = np.array([t.moved_mm for t in self._taxels])
        total = force.sum(axis=2)
        gain = stiffening(total[:, 0])
        touching = (force[:, 0] > 0) * self._skin.area_mm2
        slips = np.array([t.slips for t in self._taxels])
        return TaxelForces(
            normal_n=gain * total[:, 0],
            tangential_n=gain[:, None] * total[:, 1:],
            side_n=gain[:, None] * self._displaced.side_n(force, moved),
            slipping=(slips * touching).sum(axis=1) / np.maximum(touching.sum(axis=1), 1e-12),
            indentation_mm=np.array([t.approach_mm for t in self._taxels]),
        )


def plate_under(surface: Surface, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Height (n,) over the plane of the ridges, 0 or less, and contact frames (3, 3, n) at places.

    ``frame[i, :, k]`` is contact direction i (normal into the skin, two tangents) of place k as (into the
    skin, x, y).
    """
    depth, period = surface.depth_mm, surface.period_mm
    angle = np.deg2rad(surface.angle_deg) if depth > 0 else 0.0
    c, s = np.cos(angle), np.sin(angle)
    phase = 2 * np.pi * (x_mm * c + y_mm * s) / period
    height = depth * (np.cos(phase) - 1) / 2
    slope = -depth * np.pi / period * np.sin(phase)
    tilt = 1 / np.sqrt(1 + slope**2)
    frame = np.zeros((3, 3, len(phase)))
    frame[0] = tilt, -slope * tilt * c, -slope * tilt * s
    frame[1] = slope * tilt, tilt * c, tilt * s
    frame[2, 1], frame[2, 2] = -s, c
    return height, frame
