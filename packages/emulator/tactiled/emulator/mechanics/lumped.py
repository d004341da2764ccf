"""Contact model `lumped`: a load curve and some slip elements for each taxel, flat plates only.

Normal: ``N = a d^b``, the power law through a finite-element press of one taxel.

Friction: presliding after Jaeger (Arch. Appl. Mech. 65, 1995, 478) and Ciavarella (J. Appl. Mech. 65, 1998,
998): the part of a contact that has not slipped is a contact under less load, so

    T = mu (N(D) - N(D - travel / mu)),

where N is a function of the travel to gross slip over friction, ``D = d (reach + growth d)``. Under a ball
this is Mindlin's curve (1949), and a load that grows obliquely within the friction cone causes no slip
(Mindlin and Deresiewicz 1953). It is realised by parallel slip elements (Iwan 1966; as a friction model
"generalised Maxwell slip": Al-Bender, Lampaert, Swevers, IEEE Trans. Automatic Control 50, 2005), which give
closed loops by Masing's rule. Dahl's curve is similar, but the states of Dahl and LuGre drift: under
vibration on a held load they creep without end, which no real contact does. An element is a ring of the
contact area: the points that come into contact between two indentations, with stiffness dN' and a limit that
grows with the indentation since (Popov and Hess, Method of Dimensionality Reduction, 2015, chapter 5).
Elements that stick do not move, and the area of the rings that slip is the slipping share. A step is an
exact return mapping for travel along a line of any length.

Stribeck (1902): ``mu(v) = mu (1 + (ratio - 1) exp(-(v / v_s)^2))`` with the speed v of the base, also before
it slips, so that a slide that begins fast has no static peak.
"""

from dataclasses import dataclass

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import BUMP_MM, Readout, Surface, TaxelForces, TaxelModel
from tactiled.emulator.mechanics.sides import growth, mean_side_weights
from tactiled.emulator.mechanics.unevenness import friction_factor

# Fit to finite elements of one taxel (config/contact/fem-*-load.json, 0.03 to 0.25 mm): from 0.3 to 2.3 N
# the error is within 7 %.
_CURVE_N, _CURVE_EXPONENT = 47.3, 1.86
# Travel from rest to gross slip over friction times indentation, and its growth by indentation (the skin is
# thin: a larger contact area stiffens it more against pressure than against shear), from the friction of
# finite elements before gross slip under 0.6 N and 2.5 N (fem-coarse-flat-0.6-light.json, -heavy.json),
# within 1 %.
_REACH, _REACH_PER_MM = 1.96, 3.62
# Indentations between which the rings lie, finer at small ones: the slipping share has steps of at most 8 %
# under 1.667 N (0.165 mm) and of 13 % under 0.2 N (0.053 mm).
_RING_EDGES_MM = BUMP_MM * np.linspace(0.0, 1.0, 41) ** 2
_TOUCHING = 1e-12  # N; forces below are rounding errors
_SAME = 1e-6  # relative change of an indentation by rounding, below which tangents replace secants
_GIVES = 1 + 1e-9  # over its limit by which an element slips: at rest on the limit it does not


@dataclass(frozen=True, eq=False)
class PressedRings:
    """Rings of taxels under the loads of some steps."""

    load_n: FloatArray  # (n, t)
    depth_mm: FloatArray  # (n, t)
    # of n steps, or of one where the load is constant:
    area: FloatArray  # (n or 1, t, r): in mm of indentation, to which that of a ball is proportional
    borne_n: FloatArray  # (n or 1, t, r)
    push_n_mm: FloatArray  # (n or 1, 1, t, r): force on the skin for each mm of travel, while a ring sticks
    # whole_area, whole_n: (n or 1, t): sums over the rings, above zero
    whole_area: FloatArray
    whole_n: FloatArray

    def step(self, k: int) -> "PressedRings":
        """Return step k alone."""
        own = slice(k, k + 1)
        rings: tuple[FloatArray, ...]
        rings = self.area, self.borne_n, self.push_n_mm, self.whole_area, self.whole_n
        if len(self.area) > 1:
            rings = tuple(rows[own] for rows in rings)
        return PressedRings(self.load_n[own], self.depth_mm[own], *rings)


class Lumped(TaxelModel):
    """Load curve and slip elements.

    `run` is `press`, `slide` and `felt` in turn. Where the motion follows from the forces (`scene.held`), the
    loads of some steps are pressed at once, and slid one by one.
    """

    step_s = 2.5e-3  # four steps a scan, interpolated between them

    def __init__(
        self, surface: Surface, azimuth_deg: FloatArray, n_taxels: int, readout: Readout = "edge"
    ) -> None:
        self._surface = surface
        self._is_uneven, self._falls = np.any(surface.unevenness), np.any(surface.static_ratio != 1.0)
        # Of all taxels, or of each (t,): friction over that of the surface; may be changed between steps.
        self.friction_part: float | FloatArray = 1.0
        self._n_taxels = n_taxels
        self._edges = np.stack(
            [_RING_EDGES_MM, load_n(_RING_EDGES_MM), _way_mm(_RING_EDGES_MM), _stiffness_n_mm(_RING_EDGES_MM)]
        )
        self._normal_side, self._tangential_side = mean_side_weights(azimuth_deg, readout)
        self.reset()

    def reset(self) -> None:
        shape = (self._n_taxels, len(_RING_EDGES_MM))
        self._held_n = np.zeros((2, *shape))
        self._borne_n = np.zeros(shape)
        self._way_mm = np.zeros(self._n_taxels)
        self._base_mm: FloatArray | None = None
        self._pressed = np.zeros(0)

    def run(self, load_n: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        pressed = self.press(load_n)
        return self.felt(pressed, *self.slide(pressed, base_mm, dt_s))

    def press(self, load_n: FloatArray) -> PressedRings:
        """Advance by n steps to loads (n, t) at their ends, of which each step is then slid once."""
        normal = np.maximum(load_n, 0.0)
        depth = indentation_mm(normal)
        way = _way_mm(depth)
        # A ring that comes into contact, or leaves it, within a step takes part in a part of its travel only.
        grown = _changes(way, self._way_mm)
        rings = _rings_within(float(depth.max()))  # the others bear no load in these steps
        deep = depth if grown.any() else depth[-1:]
        if not np.array_equal(deep, self._pressed):  # a constant grip is computed once
            self._pressed, self._rings_pressed = deep, self._rings(deep, rings)
        area, borne, stiffness = self._rings_pressed
        self._held_n, self._borne_n = _first(self._held_n, rings), _first(self._borne_n, rings)
        changes = np.abs(grown) > _SAME * way
        if changes.any():
            more = _changes(borne, self._borne_n)
            secant = more / np.where(changes, grown, 1.0)[..., None]
            stiffness = np.where(changes[..., None], secant, stiffness)
        self._borne_n, self._way_mm = borne[-1], way[-1].copy()
        wholes = [np.maximum(rows.sum(axis=-1), _TOUCHING) for rows in (area, borne)]
        return PressedRings(normal, depth, area, borne, -stiffness[:, None], *wholes)

    def slide(self, pressed: PressedRings, base_mm: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
        """Advance by the steps of `pressed` to places (n, t, 2) over the surface at their ends.

        Return friction on the skin (n, t, 2) and slipping shares (n, t).
        """
        moved = _changes(base_mm, base_mm[0] if self._base_mm is None else self._base_mm)
        self._base_mm = base_mm[-1].copy()
        friction: float | FloatArray = self._surface.friction
        if self._falls:
            friction = friction_at(self._surface, np.hypot(moved[..., 0], moved[..., 1]) / dt_s)
        capacity = pressed.load_n * friction * self.friction_part
        if self._is_uneven:
            capacity *= friction_factor(self._surface.unevenness, base_mm)
        # The force that each step would add to the rings, replaced step by step by the force after it.
        held = pressed.push_n_mm * moved.swapaxes(-1, 1)[..., None]
        limit = pressed.borne_n * (capacity / pressed.whole_n)[..., None]
        floor, size = np.maximum(limit, _TOUCHING), np.empty(limit.shape)
        before, square, part = self._held_n, np.empty(held.shape[1:]), np.empty(limit.shape[1:])
        x, y = square
        for trial, bound, least, force in zip(held, limit, floor, size, strict=True):
            trial += before
            np.square(trial, out=square)
            np.add(x, y, out=force)
            np.sqrt(force, out=force)
            np.maximum(force, least, out=part)
            np.divide(bound, part, out=part)
            trial *= part
            before = trial
        self._held_n = before
        limit *= _GIVES
        slipping = np.add.reduce(pressed.area * (size > limit), axis=-1)
        slipping /= pressed.whole_area
        return np.add.reduce(held, axis=-1).swapaxes(1, -1), slipping

    def felt(self, pressed: PressedRings, tangential_n: FloatArray, slipping: FloatArray) -> TaxelForces:
        """Return the forces of steps that were pressed and slid."""
        normal = pressed.load_n
        straight, tilted = growth(normal)
        side = straight * normal[..., None] * self._normal_side
        side += tilted * (tangential_n @ self._tangential_side)
        return TaxelForces(
            normal_n=normal,
            tangential_n=tangential_n,
            side_n=np.maximum(side, 0.0),
            slipping=slipping,
            indentation_mm=pressed.depth_mm,
        )

    def _rings(self, depth_mm: FloatArray, rings: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Area, load (N) and stiffness (N/mm) of the first rings (..., r) of contacts (...)."""
        deep = depth_mm[..., None]
        load, way, stiffness = load_n(deep), _way_mm(deep), _stiffness_n_mm(deep)
        edge, edge_load, edge_way, edge_stiffness = self._edges[:, :rings]
        below = np.minimum(edge_stiffness, stiffness)
        # The integral of (D - s) dN'(s) over a ring, by parts.
        borne = np.minimum(edge_load, load) + below * np.maximum(way - edge_way, 0.0)
        return (
            _widths(np.minimum(edge, deep), depth_mm) * (load > _TOUCHING),
            np.maximum(_widths(borne, load[..., 0]), 0.0),
            _widths(below, stiffness[..., 0]),
        )


def _changes(rows: FloatArray, before: FloatArray) -> FloatArray:
    """Differences of rows (n, ...); the first from `before` (...)."""
    changes = np.subtract(rows, before)
    if len(rows) > 1:
        np.subtract(rows[1:], rows[:-1], out=changes[1:])
    return changes


def _first(rows: FloatArray, rings: int) -> FloatArray:
    """First rings of rows (..., r); those beyond r bear no load."""
    if rows.shape[-1] < rings:
        return np.concatenate([rows, np.zeros((*rows.shape[:-1], rings - rows.shape[-1]))], axis=-1)
    return rows[..., :rings]


def _widths(starts: FloatArray, end: FloatArray) -> FloatArray:
    """Distances from each start (..., r) to the next; the last to `end` (...)."""
    widths = np.empty(starts.shape)
    np.subtract(starts[..., 1:], starts[..., :-1], out=widths[..., :-1])
    np.subtract(end, starts[..., -1], out=widths[..., -1])
    return widths


def _rings_within(depth_mm: float) -> int:
    """Number of rings in a contact, a multiple of eight: sums then round as those over all rings."""
    touched = int(np.searchsorted(_RING_EDGES_MM, depth_mm))
    return min(max(-(-touched // 8), 1) * 8, len(_RING_EDGES_MM))


def _way_mm(depth_mm: FloatArray) -> FloatArray:
    """Travel to gross slip over friction; beyond the height of the bump proportional to the indentation."""
    return np.asarray(depth_mm * (_REACH + _REACH_PER_MM * np.minimum(depth_mm, BUMP_MM)))


def _stiffness_n_mm(depth_mm: FloatArray) -> FloatArray:
    """Tangential stiffness dN/dD of a contact at rest."""
    growth = np.where(depth_mm > BUMP_MM, 1.0, 2.0) * np.minimum(depth_mm, BUMP_MM)
    slope = _CURVE_N * _CURVE_EXPONENT * depth_mm ** (_CURVE_EXPONENT - 1)
    return np.asarray(slope / (_REACH + _REACH_PER_MM * growth))


def load_n(depth_mm: FloatArray) -> FloatArray:
    """Load curve of one taxel on a flat plate."""
    return np.asarray(_CURVE_N * np.maximum(depth_mm, 0.0) ** _CURVE_EXPONENT)


def indentation_mm(normal_n: FloatArray) -> FloatArray:
    """Indentation (mm) under a load, the inverse of `load_n`."""
    return np.asarray((np.maximum(normal_n, 0.0) / _CURVE_N) ** (1 / _CURVE_EXPONENT))


def friction_at(surface: Surface, speed_mm_s: FloatArray) -> FloatArray:
    """Stribeck's friction coefficient at a sliding speed."""
    # Beyond 30 reference speeds the exponential is 0, and its argument must not overflow.
    part = np.minimum(speed_mm_s / surface.stribeck_mm_s, 30.0)
    fall = np.exp(-part * part)
    return np.asarray(surface.friction * (1 + (surface.static_ratio - 1) * fall))
