"""The cheapest physical rung: a load curve and a handful of slip elements for each taxel, flat plates only.

Normal: ``N = a d^b``, the power law through a finite-element press of one taxel.

Friction: presliding after Mindlin (1949), ``T = mu N (1 - (1 - x)^(3/2))`` with ``x = travel / (reach mu
d)``, made of parallel slip elements (Iwan 1966; as a friction model "generalised Maxwell slip": Al-Bender,
Lampaert, Swevers, IEEE Trans. Automatic Control 50, 2005), which turn it into closed loops by Masing's
rule. Dahl's curve is much the same, but Dahl's and LuGre's state ratchets: under hum on a held load it
creeps without end, a slip that no hand makes. Elements that hold do not move at all, and the share of
elements that give way is the share of the contact that slips: in Mindlin's solution the stick area shrinks
as ``1 - x``. A step is an exact return mapping for travel along a line, whatever its length.

Stribeck (1902): ``mu(v) = mu (1 + (ratio - 1) exp(-(v / v_s)^2))``.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.emulator.mechanics.base import BOTTOMED, Held, Surface, TaxelForces
from tactiled.emulator.mechanics.sides import Readout, SideWeights, growth
from tactiled.errors import ConfigError

FloatArray = NDArray[np.float64]

# Fit to finite elements of one taxel (config/contact/fem-*-load.json, 0.03 to 0.25 mm): from 0.3 to 2.3 N
# it is within 7 %. The prototype's mesh, without the skin between the taxels, gave 38.1 d^1.79.
_CURVE_N, _CURVE_EXPONENT = 47.3, 1.86
BUMP_MM = 0.4  # rim and cap, assumed geometry: pressed deeper, the plate meets the base
# Travel from rest to gross slip over friction times indentation, and its growth by indentation (the skin is
# thin: a larger patch makes it stiffer against pressing than against shear). Finite elements' friction on
# the way there asks for 2.17 under 0.6 N and 2.65 under 2.5 N (fem-coarse-flat-0.6-light.json, -heavy.json).
_REACH, _REACH_PER_MM = 1.75, 4.36
_ELEMENTS = 20  # shares of slip come in steps of 5 %
_PATCH_MM = 0.83  # contact radius of the finite elements at 1.667 N, over which the side weights are averaged
_TOUCHING = 1e-12  # N; below it division by the force means nothing
_GIVES = 1 + 1e-9  # an element at its limit that nothing moves does not slip

STEP_S = 2.5e-3  # four to a scan: what is between them is interpolated

# Largest errors against finite elements (config/contact/fem-coarse-flat-*.json: friction 0.3, 0.6, 0.9 at
# 1.667 N, light and heavy loads, a reversal; left-right on half chips; incipient slip is the share, at any
# instant), transients against `compliance` (a reversal, a turn and a fall of the load within presliding).
PROVIDES: dict[str, float] = {
    "direction": 0.045,
    "gross-slip": 0.07,
    "incipient-slip": 0.14,
    "absolute-force": 0.075,
    "left-right": 0.045,
    "tangential-force": 0.02,
    "transients": 0.07,
}


class Lumped:
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
        The surface has grooves: a load curve knows none.
    """

    def __init__(
        self, surface: Surface, azimuth_deg: FloatArray, n_taxels: int, *, readout: Readout = "edge"
    ) -> None:
        refuse_grooves("lumped", surface, "a load curve has no ridges to ride on")
        self._surface = surface
        self._n_taxels = n_taxels
        edges = 1 - np.linspace(0.0, 1.0, _ELEMENTS + 1)
        # Mindlin's curve has slope (3/2) (1 - x)^(1/2); what it loses over an element's bin is that element.
        stiffness = -np.diff(1.5 * np.sqrt(edges))
        force = -np.diff(-1.5 * (1 - edges) * np.sqrt(edges) - edges**1.5)
        self._stiffness, self._limit = stiffness, -force
        self._normal_side, self._tangential_side = _mean_weights(SideWeights(azimuth_deg, readout))
        self.reset()

    def reset(self) -> None:
        self._held_n = np.zeros((self._n_taxels, _ELEMENTS), dtype=np.complex128)
        self._base_mm: FloatArray | None = None

    def step(self, held: Held, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        run = self.run(held, value[None], base_mm[None], dt_s)
        return TaxelForces(**{name: rows[0] for name, rows in vars(run).items()})

    def run(self, held: Held, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """`step` n times at once; arguments and results have a leading axis n."""
        if held == "force":
            normal = np.maximum(value, 0.0)
            depth = indentation_mm(normal)
        else:
            depth = np.maximum(value, 0.0)
            normal = load_n(depth)
        before = base_mm[:1] if self._base_mm is None else self._base_mm[None]
        moved = np.diff(base_mm, axis=0, prepend=before) @ np.array([1.0, 1.0j])
        self._base_mm = base_mm[-1].copy()
        capacity = normal * friction_at(self._surface, np.abs(moved) / dt_s)
        secant = normal / ((_REACH + _REACH_PER_MM * depth) * np.maximum(depth, 1e-9))
        pull, slipping = self._slide(moved * secant, capacity)
        tangential = np.stack([pull.real, pull.imag], axis=-1)
        pressed, tilted = growth(normal)
        side = pressed * normal[..., None] * self._normal_side + tilted * (tangential @ self._tangential_side)
        return TaxelForces(
            normal_n=normal,
            tangential_n=tangential,
            side_n=np.maximum(side, 0.0),
            slipping=np.where(normal > _TOUCHING, slipping, 0.0),
            indentation_mm=depth,
            warnings=np.where(depth > BUMP_MM, BOTTOMED, 0),
        )

    def _slide(
        self, pull: NDArray[np.complex128], capacity: FloatArray
    ) -> tuple[NDArray[np.complex128], FloatArray]:
        """Forces on the skin and slipping shares (n, t), from pulls at the secant stiffness and limits."""
        change = -pull[..., None] * self._stiffness
        limit = capacity[..., None] * self._limit
        floor = np.maximum(limit, _TOUCHING)
        held, trial, size = np.empty_like(change), self._held_n, np.empty(limit.shape)
        for k in range(len(pull)):
            trial = trial + change[k]
            np.abs(trial, out=size[k])
            trial = np.multiply(trial, limit[k] / np.maximum(size[k], floor[k]), out=held[k])
        self._held_n = trial.copy()
        return held.sum(axis=-1), (size > limit * _GIVES).mean(axis=-1)


def load_n(depth_mm: FloatArray) -> FloatArray:
    """Load curve of one taxel on a flat plate."""
    return np.asarray(_CURVE_N * np.maximum(depth_mm, 0.0) ** _CURVE_EXPONENT)


def indentation_mm(normal_n: FloatArray) -> FloatArray:
    """Inverse of `load_n`."""
    return np.asarray((np.maximum(normal_n, 0.0) / _CURVE_N) ** (1 / _CURVE_EXPONENT))


def friction_at(surface: Surface, speed_mm_s: FloatArray) -> FloatArray:
    """Stribeck's friction coefficient at a sliding speed."""
    # Beyond 30 reference speeds the exponential is nothing, and its argument must not overflow.
    fall = np.exp(-(np.minimum(speed_mm_s / surface.stribeck_mm_s, 30.0) ** 2))
    return np.asarray(surface.friction * (1 + (surface.static_ratio - 1) * fall))


def refuse_grooves(rung: str, surface: Surface, why: str) -> None:
    """Raise `ConfigError` where the plate is not flat."""
    if surface.depth_mm > 0:
        fault = f"contact: {rung} cannot play grooves ({why}); use periodic, compliance or auto"
        raise ConfigError("scene", [fault])


def _mean_weights(weights: SideWeights) -> tuple[FloatArray, FloatArray]:
    """Side weights over a round patch under the pressure that `bristle` has there: (a,) and (2, a)."""
    radius = (np.arange(8) + 0.5) / 8
    angle = 2 * np.pi * np.arange(16) / 16
    x = _PATCH_MM * np.outer(radius, np.cos(angle)).ravel()
    y = _PATCH_MM * np.outer(radius, np.sin(angle)).ravel()
    share = np.repeat(radius * (1 - radius**2) ** 2, len(angle))
    share /= share.sum()
    normal, tangential = weights.at(x, y)
    return normal @ share, np.einsum("anv,n->va", tangential, share)
