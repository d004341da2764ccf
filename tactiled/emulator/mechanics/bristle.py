"""Incipient slip that spreads over the patch: independent bristles with Coulomb friction, flat plates only.

Pressure: the load curve of `lumped`, spread as under a ball on a thin incompressible layer that is bonded
below, ``p ~ (1 - r^2 / a^2)^2`` (Johnson, Contact Mechanics, 1985, section 5.8), that is ``p ~ pen^2`` for a
bristle pressed in by ``pen = d - s gap``. (The prototype's Winkler foundation, ``p = 4.2 pen^0.81`` with one
tangential stiffness for all bristles, bears the same load but slips too late at the rim: its friction is
0.1 N off before gross slip, its share of slip 0.2.)

Friction: each bristle carries ``q = k u`` up to ``mu p``, with ``k = p / (reach pen)``: it slips at the
travel ``u = reach mu pen``, so the stick area shrinks in proportion to travel, as in Mindlin's solution
(1949). Bristles are displaced alike; turning of the skin about a taxel's own axis is not seen by that
taxel.

Read-out areas add up what each bristle does to them (`sides`). Independent bristles overload the far ridge
of a grooved plate and go against finite elements there (correlation -0.8 to -0.95): refused.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.emulator.mechanics.base import BOTTOMED, Held, Surface, TaxelForces
from tactiled.emulator.mechanics.lumped import (
    BUMP_MM,
    friction_at,
    indentation_mm,
    load_n,
    refuse_grooves,
)
from tactiled.emulator.mechanics.sides import Readout, SideWeights, growth

FloatArray = NDArray[np.float64]

_BUMP_RADIUS_MM, _CAP_MM = 1.25, 0.3  # assumed geometry of the finite elements
_SPHERE_MM = (_BUMP_RADIUS_MM**2 + _CAP_MM**2) / (2 * _CAP_MM)
# Contact area of the finite elements is 0.80 of that of the undeformed sphere cut at the indentation (Hertz:
# 0.5, a thin layer: 1), within 8 % from 0.03 to 0.25 mm.
_GAP_SCALE = 1.25
# Travel from rest to gross slip over friction times indentation, and its growth by indentation (the skin is
# thin: a larger patch makes it stiffer against pressing than against shear). Finite elements' friction on
# the way there asks for 2.33 under 0.6 N and 2.82 under 2.5 N (fem-coarse-flat-0.6-light.json, -heavy.json).
_REACH, _REACH_PER_MM = 1.90, 4.45
_BRISTLES = 320  # about 140 carry 1.667 N, so a share of slip comes in steps below 1 %
_GOLDEN = np.pi * (3 - np.sqrt(5))
_GIVES = 1 + 1e-9  # a bristle at its limit that nothing moves does not slip
_TINY_N = 1e-15

STEP_S = 2.5e-3  # four to a scan: what is between them is interpolated

# Measured as those of `lumped`.
PROVIDES: dict[str, float] = {
    "direction": 0.045,
    "gross-slip": 0.07,
    "incipient-slip": 0.11,
    "absolute-force": 0.075,
    "left-right": 0.035,
    "tangential-force": 0.02,
    "transients": 0.05,
}


class Bristle:
    """See the module; a `Rung`.

    Parameters
    ----------
    surface : Surface
    azimuth_deg : (a,) float64
    n_taxels : int
    readout : {"edge", "half"}

    Raises
    ------
    ConfigError
        The surface has grooves.
    """

    def __init__(
        self, surface: Surface, azimuth_deg: FloatArray, n_taxels: int, *, readout: Readout = "edge"
    ) -> None:
        refuse_grooves("bristle", surface, "independent bristles overload the far ridge")
        self._surface = surface
        self._n_taxels = n_taxels
        place = _places_mm()
        self._gap_mm = _GAP_SCALE * (_SPHERE_MM - np.sqrt(_SPHERE_MM**2 - np.abs(place) ** 2))
        normal, tangential = SideWeights(azimuth_deg, readout).at(place.real, place.imag)
        self._normal_side = np.ascontiguousarray(normal.T)
        self._tangential_side = np.ascontiguousarray(np.moveaxis(tangential, 0, -1))
        self.reset()

    def reset(self) -> None:
        self._held_n = np.zeros((self._n_taxels, _BRISTLES), dtype=np.complex128)
        self._base_mm: FloatArray | None = None

    def step(self, held: Held, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        run = self.run(held, value[None], base_mm[None], dt_s)
        return TaxelForces(**{name: rows[0] for name, rows in vars(run).items()})

    def run(self, held: Held, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """`step` n times at once; arguments and results have a leading axis n."""
        value = np.maximum(value, 0.0)
        normal, depth = (value, indentation_mm(value)) if held == "force" else (load_n(value), value)
        before = base_mm[:1] if self._base_mm is None else self._base_mm[None]
        moved = np.diff(base_mm, axis=0, prepend=before) @ np.array([1.0, 1.0j])
        self._base_mm = base_mm[-1].copy()
        friction = friction_at(self._surface, np.abs(moved) / dt_s)

        shape = normal.shape
        pull, slipping = np.empty(shape, dtype=np.complex128), np.empty(shape)
        side = np.empty((*shape, self._normal_side.shape[1]))
        held_n = self._held_n
        for k in range(shape[0]):
            force, stiffness, touching = self._pressed(normal[k], depth[k])
            limit = friction[k][:, None] * force
            trial = held_n - stiffness * moved[k][:, None]
            size = np.abs(trial)
            held_n = trial * (limit / np.maximum(np.maximum(size, limit), _TINY_N))
            pull[k] = held_n.sum(axis=1)
            gives = (size > limit * _GIVES) & touching
            slipping[k] = gives.sum(axis=1) / np.maximum(touching.sum(axis=1), 1)
            pressed, tilted = growth(normal[k])
            side[k] = pressed * (force @ self._normal_side)
            along = held_n.real @ self._tangential_side[:, 0] + held_n.imag @ self._tangential_side[:, 1]
            side[k] += tilted * along
        self._held_n = held_n
        return TaxelForces(
            normal_n=normal,
            tangential_n=np.stack([pull.real, pull.imag], axis=-1),
            side_n=np.maximum(side, 0.0),
            slipping=slipping,
            indentation_mm=depth,
            warnings=np.where(depth > BUMP_MM, BOTTOMED, 0),
        )

    def _pressed(
        self, normal: FloatArray, depth: FloatArray
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Normal force and tangential stiffness of each bristle (t, b), and which of them touch."""
        relative = np.maximum(1 - self._gap_mm / np.maximum(depth, 1e-9)[:, None], 0.0)
        shape = relative * relative
        touching = relative > 0
        # At the lightest touch no bristle is as near as the plate: the middle one takes what there is.
        shape[:, 0] += (normal > 0) & ~touching.any(axis=1)
        total = np.maximum(shape.sum(axis=1), _TINY_N)
        force = shape * (normal / total)[:, None]
        reach = _REACH + _REACH_PER_MM * depth[:, None]
        reach_mm = reach * np.maximum(depth[:, None] * relative, 1e-9)
        return force, force / reach_mm, shape > 0


def _places_mm() -> NDArray[np.complex128]:
    """Bristles of equal area as x + iy: a sunflower spiral (Vogel 1979), made symmetric by quarter turns."""
    quarter = np.arange(_BRISTLES // 4)
    radius = _BUMP_RADIUS_MM * np.sqrt((quarter + 0.5) / len(quarter))
    places = radius * np.exp(1j * _GOLDEN * quarter)
    return np.concatenate([places, 1j * places, -places, -1j * places])
