"""Pressure under rigid objects of many shapes, at any load.

The pad is a bed of springs: a place that the object indents by some depth has a pressure that grows with a
power of that depth, so the contact area of curved objects grows with the load, and tilted or shifted ones
load a part of the taxels, or not all of them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.worlds.hands import log_uniform
from tactiled.array import FloatArray

SHAPES = ("flat", "flat", "sphere", "cylinder", "edge", "rib", "bumps")
_LEVELS = 40  # loads of a table, evenly spaced in their square root
_MOST = 2.5  # of the usual load, at the end of the table
_DEPTHS = 400  # trial depths of indentation, from which a depth is found by interpolation
_EDGE_SLOPE = 1.5  # mm of gap for each mm beyond an edge: nothing there touches


@dataclass(frozen=True)
class PressureTable:
    """Loads (N) of places, at loads from 0 up."""

    usual_n: float
    # (levels, nodes): loads of the nodes, N; the total of row k is ``usual_n * 2.5 * (k / (levels - 1))^2``
    node_n: FloatArray

    def at(self, load_n: float) -> FloatArray:
        """Return the loads (nodes,) at a total load."""
        row, part = rows(np.array([load_n / self.usual_n]))
        return np.asarray(self.node_n[row[0]] * (1 - part[0]) + self.node_n[row[0] + 1] * part[0])


def rows(relative_load: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Rows of a table and the parts of the way to the next, for loads relative to the usual one."""
    where = np.sqrt(np.clip(relative_load / _MOST, 0.0, 1.0)) * (_LEVELS - 1)
    row = np.minimum(where.astype(np.int64), _LEVELS - 2)
    first = row / (_LEVELS - 1)
    last = (row + 1) / (_LEVELS - 1)
    # Loads between two rows are shared linearly, so that the total is as asked for.
    low, high = _MOST * first**2, _MOST * last**2
    return row, (np.clip(relative_load, 0.0, _MOST) - low) / (high - low)


def draw_table(rng: np.random.Generator, shape: str, x: FloatArray, y: FloatArray) -> PressureTable:
    """Draw an object's place, tilt and curvature, and the pressures (x, y in mm) that it causes."""
    usual_n = float(np.clip(rng.lognormal(np.log(3.0), 0.6), 0.6, 12.0))
    half = float(np.abs(x).max())
    angle = rng.uniform(0.0, np.pi)
    x, y = x - rng.normal(0, 0.2) * half, y - rng.normal(0, 0.2) * half
    along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    depth = log_uniform(rng, 0.15, 1.0)  # mm, of a flat object at the usual load
    gap = _gap(rng, shape, along, across, half)
    tilt_mm = depth * rng.normal(0, 0.2, 2)
    gap = gap + (tilt_mm[0] * x + tilt_mm[1] * y) / half
    gap = gap + depth * rng.uniform(0.0, 0.08) * rng.normal(size=len(x))  # neither is quite even
    gap -= gap.min()
    return _table(usual_n, gap, depth, rng.uniform(1.0, 1.5))


def _gap(
    rng: np.random.Generator, shape: str, along: FloatArray, across: FloatArray, half: float
) -> FloatArray:
    """Gap (nodes,) in mm between the undeformed skin and the object."""
    radius = log_uniform(rng, 15.0, 120.0)
    if shape == "sphere":
        return np.asarray((along**2 + across**2) / (2 * radius))
    if shape == "cylinder":
        return np.asarray(across**2 / (2 * rng.uniform(8.0, 80.0)))
    if shape == "edge":
        beyond = np.maximum(across - rng.uniform(-0.3, 0.6) * half, 0.0)
        return np.asarray(_EDGE_SLOPE * beyond)
    if shape == "rib":
        beyond = np.maximum(np.abs(across) - rng.uniform(0.2, 0.6) * half, 0.0)
        return np.asarray(rng.uniform(0.2, _EDGE_SLOPE) * beyond)
    if shape == "bumps":
        spacing, height = rng.uniform(2.0, 6.0), rng.uniform(0.05, 0.4)
        phase = rng.uniform(0.0, 2 * np.pi, 2)
        wave = np.cos(2 * np.pi * along / spacing + phase[0]) * np.cos(
            2 * np.pi * across / spacing + phase[1]
        )
        return np.asarray(height * (1 - wave) / 2)
    return np.zeros_like(along)


def _table(usual_n: float, gap: FloatArray, depth: float, power: float) -> PressureTable:
    depths = np.linspace(0.0, 1.0, _DEPTHS) ** 2 * (float(gap.max()) + 6 * depth)
    stiffness = usual_n / (len(gap) * depth**power)
    totals = stiffness * (np.maximum(depths[:, np.newaxis] - gap, 0.0) ** power).sum(axis=1)
    wanted = usual_n * _MOST * (np.arange(_LEVELS) / (_LEVELS - 1)) ** 2
    found = np.interp(wanted, totals, depths)
    loads = np.maximum(found[:, np.newaxis] - gap, 0.0) ** power
    loads *= (wanted / np.maximum(loads.sum(axis=1), 1e-12))[:, np.newaxis]
    return PressureTable(usual_n, loads)
