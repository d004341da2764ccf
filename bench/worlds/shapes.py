"""Pressure under rigid objects of many shapes, at any load.

The pad is a bed of springs: a place that the object indents by some depth has a pressure that grows with a
power of that depth, so the contact area of curved objects grows with the load, and tilted or shifted ones
load a part of the taxels, or not all of them. An object that moves over the pad takes its pressures along.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.worlds.hands import log_uniform
from tactiled.array import FloatArray

SHAPES = ("flat", "flat", "sphere", "cylinder", "edge", "rib", "bumps")
_LEVELS = 40  # loads of a table, evenly spaced in their square root
_MOST = 2.5  # of the usual load, at the end of the table
_DEPTHS = 400  # trial depths of indentation, from which a depth is found by interpolation
_OFFSETS = 9  # poses of a table, evenly spaced from one end of the way to the other
_REACH = 1.0  # of half of the array: the end of the way. Objects are alike beyond, as long ones are
_EDGE_SLOPE = 1.5  # mm of gap for each mm beyond an edge: nothing there touches


@dataclass(frozen=True)
class PressureTable:
    """Loads (N) of places, at loads from 0 up, while the object moves along a line or turns."""

    usual_n: float
    reach_mm: float  # way of the object to either end of the table; of a turn, at `radius_mm`
    radius_mm: float  # mean distance of the nodes from the middle of the array, about which an object turns
    # (offsets, levels, nodes): loads of the nodes, N; the total of level k is
    # ``usual_n * 2.5 * (k / (levels - 1))^2``
    node_n: FloatArray

    def at(self, load_n: float) -> FloatArray:
        """Return the loads (nodes,) at a total load, where the object touched the pad."""
        loads = MovingLoads([self]).at(np.array([load_n / self.usual_n]), np.zeros(1))
        return np.asarray(loads[0])


class MovingLoads:
    """Loads under the objects of a batch, wherever these have moved to."""

    def __init__(self, tables: Sequence[PressureTable]) -> None:
        node_n = np.stack([table.node_n for table in tables])
        self._reach_mm = np.array([table.reach_mm for table in tables])
        self._flat = node_n.reshape(-1, node_n.shape[-1])
        self._first = np.arange(len(tables)) * _OFFSETS

    def at(self, relative_load: FloatArray, way_mm: FloatArray) -> FloatArray:
        """Return the loads (objects, nodes) at loads relative to the usual one and ways, (objects,) each."""
        row, part = rows(relative_load)
        middle = (_OFFSETS - 1) / 2
        where = middle * (1 + np.clip(way_mm / self._reach_mm, -1.0, 1.0))
        offset = np.minimum(where.astype(np.int64), _OFFSETS - 2)
        beyond = where - offset
        at = (self._first + offset) * _LEVELS + row
        found = np.zeros((len(at), self._flat.shape[1]))
        for next_offset, next_level, weight in (
            (0, 0, (1 - beyond) * (1 - part)),
            (0, 1, (1 - beyond) * part),
            (_LEVELS, 0, beyond * (1 - part)),
            (_LEVELS, 1, beyond * part),
        ):
            found += self._flat[at + next_offset + next_level] * weight[:, np.newaxis]
        return found


def rows(relative_load: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Rows of a table and the parts of the way to the next, for loads relative to the usual one."""
    where = np.sqrt(np.clip(relative_load / _MOST, 0.0, 1.0)) * (_LEVELS - 1)
    row = np.minimum(where.astype(np.int64), _LEVELS - 2)
    first = row / (_LEVELS - 1)
    last = (row + 1) / (_LEVELS - 1)
    # Loads between two rows are shared linearly, so that the total is as asked for.
    low, high = _MOST * first**2, _MOST * last**2
    return row, (np.clip(relative_load, 0.0, _MOST) - low) / (high - low)


def draw_table(
    rng: np.random.Generator, shape: str, x: FloatArray, y: FloatArray, towards: float | None
) -> PressureTable:
    """Draw an object's place, tilt and curvature, and the pressures (x, y in mm) that it causes.

    It moves in the direction `towards` (radians), or turns about the middle of the array.
    """
    usual_n = float(np.clip(rng.lognormal(np.log(3.0), 0.6), 0.6, 12.0))
    half, radius = float(np.abs(x).max()), float(np.hypot(x, y).mean())
    angle = rng.uniform(0.0, np.pi)
    centre_x, centre_y = rng.normal(0, 0.2) * half, rng.normal(0, 0.2) * half
    depth = log_uniform(rng, 0.15, 1.0)  # mm, of a flat object at the usual load
    tilt_mm = depth * rng.normal(0, 0.2, 2)
    skin = depth * rng.uniform(0.0, 0.08) * rng.normal(size=len(x))  # neither is quite even
    power, gap_of = rng.uniform(1.0, 1.5), _gap(rng, shape, half)
    reach_mm = _REACH * half
    found = []
    for way_mm in np.linspace(-reach_mm, reach_mm, _OFFSETS):
        own_x, own_y = x, y  # places in the object's own frame
        if towards is None:
            cos, sin = np.cos(way_mm / radius), np.sin(way_mm / radius)
            own_x, own_y = cos * x + sin * y, cos * y - sin * x
        else:
            own_x, own_y = x - way_mm * np.cos(towards), y - way_mm * np.sin(towards)
        own_x, own_y = own_x - centre_x, own_y - centre_y
        along, across = (
            own_x * np.cos(angle) + own_y * np.sin(angle),
            own_y * np.cos(angle) - own_x * np.sin(angle),
        )
        # A hand keeps the object's tilt towards the pad, whichever part of it touches.
        gap = gap_of(along, across) + (tilt_mm[0] * x + tilt_mm[1] * y) / half + skin
        found.append(_levels(usual_n, gap - gap.min(), depth, power))
    return PressureTable(usual_n, reach_mm, radius, np.stack(found))


def _gap(rng: np.random.Generator, shape: str, half: float) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Draw a shape: gap in mm between the undeformed skin and the object, by place along and across it."""
    radius = log_uniform(rng, 15.0, 120.0)
    if shape == "sphere":
        return lambda along, across: (along**2 + across**2) / (2 * radius)
    if shape == "cylinder":
        twice = 2 * rng.uniform(8.0, 80.0)
        return lambda _along, across: across**2 / twice
    if shape == "edge":
        edge = rng.uniform(-0.3, 0.6) * half
        return lambda _along, across: _EDGE_SLOPE * np.maximum(across - edge, 0.0)
    if shape == "rib":
        edge, slope = rng.uniform(0.2, 0.6) * half, rng.uniform(0.2, _EDGE_SLOPE)
        return lambda _along, across: slope * np.maximum(np.abs(across) - edge, 0.0)
    if shape == "bumps":
        turn, height = 2 * np.pi / rng.uniform(2.0, 6.0), rng.uniform(0.05, 0.4)
        phase = rng.uniform(0.0, 2 * np.pi, 2)
        return lambda along, across: (
            height * (1 - np.cos(turn * along + phase[0]) * np.cos(turn * across + phase[1])) / 2
        )
    return lambda along, _across: np.zeros_like(along)


def _levels(usual_n: float, gap: FloatArray, depth: float, power: float) -> FloatArray:
    """Return the loads (levels, nodes) of one pose."""
    depths = np.linspace(0.0, 1.0, _DEPTHS) ** 2 * (float(gap.max()) + 6 * depth)
    stiffness = usual_n / (len(gap) * depth**power)
    totals = stiffness * (np.maximum(depths[:, np.newaxis] - gap, 0.0) ** power).sum(axis=1)
    wanted = usual_n * _MOST * (np.arange(_LEVELS) / (_LEVELS - 1)) ** 2
    found = np.interp(wanted, totals, depths)
    loads = np.maximum(found[:, np.newaxis] - gap, 0.0) ** power
    loads *= (wanted / np.maximum(loads.sum(axis=1), 1e-12))[:, np.newaxis]
    return np.asarray(loads)
