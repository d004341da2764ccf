"""Contact model `periodic`: sliding over grooves, from one period of phase solved on `compliance`.

In steady sliding a taxel's forces depend on its groove phase alone (and on load, direction and plate). One
period is solved for each of these, stored (`period`), and interpolated for every taxel and instant. The
onset of slip is that of `lumped`: with its friction force as a part w of that in sliding, the forces are
those at rest at this phase, plus w times the difference of steady sliding from rest.

Not modelled: the effect of grooves on the onset itself (order in which ridges slip), the lag of the ripple
after a change of load or direction, the effect at rest of the phase at which the load came, curvature
between the loads of the tables, directions finer than a degree.
"""

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import (
    BOTTOMED,
    NOT_CONVERGED,
    HeldQuantity,
    Readout,
    Surface,
    TaxelForces,
)
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.mechanics.lumped import Lumped
from tactiled.emulator.mechanics.period import (
    FINE,
    HIGHEST,
    LEVEL,
    LEVEL_RATIO,
    LOWEST,
    PeriodConditions,
    groove_normal,
    level_value,
    resting,
    sliding,
    table_key,
)
from tactiled.emulator.mechanics.taxel_shape import CAP_MM

IntArray = NDArray[np.int64]

STEP_S = 0.01  # a scan: 12 samples of the shortest period of the paper at 10 mm/s

_MOST_PART = 2.0  # of sliding friction: where friction is uneven, more than 1
_MOVING = 1e-6  # part of sliding friction below which no table of sliding is needed

# As for `compliance`; onset of slip and slipping share are those of `lumped` on a flat plate. Errors are
# largest in the onset over grooves, which is a blend: slip is gross a tenth to a fifth too early.
PROVIDES: dict[str, float] = {
    "direction": 0.035,
    "gross-slip": 0.21,
    "absolute-force": 0.05,
    "left-right": 0.11,
    "tangential-force": 0.17,
    "groove-ripple": 0.46,
    "groove-phase": 0.08,
}


class Periodic:
    """Interpolation of tables, a `TaxelModel` and a `stepper.BlockTaxelModel`.

    Parameters
    ----------
    azimuth_deg : (a,) float64
    readout : {"edge", "half"}

    Raises
    ------
    ConfigError
        Model `compliance` cannot play the surface.
    """

    def __init__(
        self,
        surface: Surface,
        azimuth_deg: FloatArray,
        n_taxels: int,
        *,
        readout: Readout = "edge",
        mesh: str = "coarse",
    ) -> None:
        # Forces grow with friction, and tables are those of even plates.
        self._onset = Lumped(Surface(surface.friction, unevenness=surface.unevenness), azimuth_deg, n_taxels)
        surface = dataclasses.replace(surface, unevenness=0.0)
        Compliance(surface, azimuth_deg, 1, readout=readout, mesh=mesh)  # raises ConfigError
        self._surface, self._readout, self._mesh = surface, readout, mesh
        self._azimuth_deg = tuple(float(a) for a in azimuth_deg)

    def reset(self) -> None:
        """Return to no contact and no history."""
        self._onset.reset()

    def step(self, held: HeldQuantity, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """See `base.TaxelModel.step`."""
        run = self.run(held, value[None], base_mm[None], dt_s)
        return TaxelForces(**{name: rows[0] for name, rows in vars(run).items()})

    def run(self, held: HeldQuantity, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """Do n steps at once; arguments and results have a leading axis n."""
        case = self._case(held)
        onset = self._onset.run(held, value, base_mm, dt_s)
        part, keys = self._table_places(held, value, onset)
        turn = base_mm @ groove_normal(self._surface) / self._surface.period_mm
        rows = np.zeros((*value.shape, 5 + len(self._azimuth_deg)))
        touching = value > 0
        for key in np.unique(keys[touching], axis=0):
            chosen = touching & (keys == key).all(axis=-1)
            k, heading = int(key[0]), int(key[1])
            below, above = level_value(held, k), level_value(held, k + 1)
            inside = np.clip(value[chosen], level_value(held, LOWEST), above)
            share = np.clip((inside - below) / (above - below), 0.0, 1.0)[:, None]
            ends = []
            for at in (k, k + 1):
                felt = _look_up(resting(case, at), turn[chosen])
                if key[2]:
                    slid = _look_up(sliding(case, at, heading), turn[chosen])
                    felt += part[chosen][:, None] * (slid - felt)
                ends.append(felt)
            mixed = ends[0] + share * (ends[1] - ends[0])
            rows[chosen] = mixed * (value[chosen] / inside)[:, None]
        return TaxelForces(
            normal_n=np.maximum(value, 0.0) if held == "force" else np.maximum(rows[..., 0], 0.0),
            tangential_n=rows[..., 1:3],
            side_n=np.maximum(rows[..., 5:], 0.0),
            slipping=np.where(touching, onset.slipping, 0.0),
            indentation_mm=rows[..., 3] if held == "force" else value,
            warnings=_warnings(rows),
        )

    def _case(self, held: HeldQuantity) -> PeriodConditions:
        return PeriodConditions(self._surface, self._azimuth_deg, held, self._readout, self._mesh)

    def _table_places(
        self, held: HeldQuantity, value: FloatArray, onset: TaxelForces
    ) -> tuple[FloatArray, IntArray]:
        """Look up the place in the tables.

        Returns the utilisation that the onset has reached (n, t), and level, direction and whether it moves
        (n, t, 3).
        """
        pull = -onset.tangential_n
        capacity = self._surface.friction * onset.normal_n
        part = np.minimum(np.hypot(pull[..., 0], pull[..., 1]) / np.maximum(capacity, 1e-12), _MOST_PART)
        direction_deg = np.rint(np.rad2deg(np.arctan2(pull[..., 1], pull[..., 0]))).astype(np.int64)
        level = np.log(np.maximum(value / LEVEL[held], 1e-12)) / np.log(LEVEL_RATIO)
        low = np.clip(np.floor(level), LOWEST, HIGHEST - 1).astype(np.int64)
        moving = part > _MOVING
        return part, np.stack([low, np.where(moving, direction_deg, 0), moving], axis=-1)


class TableCollector(Periodic):
    """Collect the tables that a `Periodic` would need, without solving them.

    Its forces are those of the onset.

    Attributes
    ----------
    needed : dict
        Table key to the function that solves it, in the order of need.
    """

    def __init__(
        self, surface: Surface, azimuth_deg: FloatArray, n_taxels: int, *, readout: Readout = "edge"
    ) -> None:
        super().__init__(surface, azimuth_deg, n_taxels, readout=readout)
        self.needed: dict[str, Callable[[], FloatArray]] = {}

    def run(self, held: HeldQuantity, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """See `Periodic.run`."""
        case = self._case(held)
        onset = self._onset.run(held, value, base_mm, dt_s)
        _, keys = self._table_places(held, value, onset)
        for low, direction_deg, moves in np.unique(keys[value > 0], axis=0).tolist():
            for level in (low, low + 1):
                self.needed[table_key(case, level, None)] = partial(resting, case, level)
                if moves:
                    key = table_key(case, level, direction_deg)
                    self.needed[key] = partial(sliding, case, level, direction_deg)
        return onset


def _warnings(rows: FloatArray) -> IntArray:
    failed = np.where(rows[..., 4] > 0, NOT_CONVERGED, 0)
    return np.asarray(failed | np.where(rows[..., 3] > CAP_MM, BOTTOMED, 0), dtype=np.int64)


def _look_up(table: FloatArray, turn: FloatArray) -> FloatArray:
    if len(table) == 1:
        return np.repeat(table, len(turn), axis=0)
    place = (turn - np.floor(turn)) * FINE
    below = np.minimum(place.astype(np.int64), FINE - 1)
    return np.asarray(table[below] + (place - below)[:, None] * (table[below + 1] - table[below]))
