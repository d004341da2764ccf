"""Contact model `periodic`: sliding over grooves, from one period of phase solved on `compliance`.

In steady sliding a taxel's forces depend on its groove phase alone (and on load, direction and plate). One
period is solved for each of these, stored as a table, and interpolated for every taxel and instant. The
onset of slip is that of `lumped`: with its friction force as a part w of that in sliding, the forces are
those at rest at this phase, plus w times the difference of steady sliding from rest.

Not modelled: the effect of grooves on the onset itself (order in which ridges slip), the lag of the ripple
after a change of load or direction, the effect at rest of the phase at which the load came, curvature
between the loads of the tables, directions finer than a degree.
"""

import dataclasses
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Readout, Surface, TaxelForces, TaxelModel
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.mechanics.lumped import Lumped
from tactiled.resources import shipped

IntArray = NDArray[np.int64]

SHIPPED = shipped("config", "contact", "periodic.npz")
# Levels of load at which tables are made, with linear interpolation between them. The ratio makes a taxel's
# share of 15 N and of 20 N levels themselves.
_LEVEL_N, _LEVEL_RATIO = 15.0 / 9, 4 / 3
# Below the lowest level (a fiftieth of the reference) all forces are proportional to the load.
_LOWEST, _HIGHEST = -14, 6
_USUAL = 2  # level up to which rest is solved first: 3 N a taxel; higher levels are rare and slow to solve
_PHASES = 48  # solved in a period: the substep of `compliance` is a thirtieth
_RESTS = 8  # phases at which rest is solved
_FINE = 512  # phases of a table after interpolation: linear interpolation between them is exact to 1e-4
_RUN_IN_MM = 0.8  # travel before the period that counts: over twice the presliding distance at 4 N
_PRESSING = 6  # steps in which the load grows
_MOST_PART = 2.0  # of sliding friction: where friction is uneven, more than 1
_MOVING = 1e-6  # part of sliding friction below which no table of sliding is needed
_SIDES = 4  # columns of a table before the side forces: normal, tangential (2), indentation


class Periodic(TaxelModel):
    """Interpolation of tables."""

    step_s = 0.01  # a scan: 12 samples of the shortest period of the paper at 10 mm/s

    def __init__(
        self, surface: Surface, azimuth_deg: FloatArray, n_taxels: int, readout: Readout = "edge"
    ) -> None:
        # Forces grow with friction, and tables are those of even plates.
        self._onset = Lumped(Surface(surface.friction, unevenness=surface.unevenness), azimuth_deg, n_taxels)
        self._case = TableCase(
            dataclasses.replace(surface, unevenness=0.0), tuple(azimuth_deg.tolist()), readout
        )
        self._case.model()  # raises ConfigError

    def reset(self) -> None:
        self._onset.reset()

    def run(self, load_n: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        case, surface = self._case, self._case.surface
        onset = self._onset.run(load_n, base_mm, dt_s)
        part, keys = self._table_places(load_n, onset)
        turn = base_mm @ groove_normal(surface) / surface.period_mm
        rows = np.zeros((*load_n.shape, _SIDES + len(case.azimuth_deg)))
        touching = load_n > 0
        for level, heading, moves in np.unique(keys[touching], axis=0).tolist():
            chosen = touching & (keys == (level, heading, moves)).all(axis=-1)
            below, above = _level_n(level), _level_n(level + 1)
            inside = np.clip(load_n[chosen], _level_n(_LOWEST), above)
            share = np.clip((inside - below) / (above - below), 0.0, 1.0)[:, None]
            ends = []
            for at in (level, level + 1):
                felt = _look_up(table(case, at, None), turn[chosen])
                if moves:
                    slid = _look_up(table(case, at, heading), turn[chosen])
                    felt += part[chosen][:, None] * (slid - felt)
                ends.append(felt)
            mixed = ends[0] + share * (ends[1] - ends[0])
            rows[chosen] = mixed * (load_n[chosen] / inside)[:, None]
        return TaxelForces(
            normal_n=np.maximum(load_n, 0.0),
            tangential_n=rows[..., 1:3],
            side_n=np.maximum(rows[..., _SIDES:], 0.0),
            slipping=np.where(touching, onset.slipping, 0.0),
            indentation_mm=rows[..., 3],
        )

    def _table_places(self, load_n: FloatArray, onset: TaxelForces) -> tuple[FloatArray, IntArray]:
        """Utilisation that the onset has reached (n, t); level, direction and whether it moves (n, t, 3)."""
        pull = -onset.tangential_n
        capacity = self._case.surface.friction * onset.normal_n
        part = np.minimum(np.hypot(pull[..., 0], pull[..., 1]) / np.maximum(capacity, 1e-12), _MOST_PART)
        direction_deg = np.rint(np.rad2deg(np.arctan2(pull[..., 1], pull[..., 0]))).astype(np.int64)
        level = np.log(np.maximum(load_n / _LEVEL_N, 1e-12)) / np.log(_LEVEL_RATIO)
        low = np.clip(np.floor(level), _LOWEST, _HIGHEST - 1).astype(np.int64)
        moving = part > _MOVING
        return part, np.stack([low, np.where(moving, direction_deg, 0), moving], axis=-1)


@dataclass(frozen=True)
class TableCase:
    """Plate and read-out areas of a table."""

    surface: Surface
    azimuth_deg: tuple[float, ...]
    readout: Readout

    def key(self, level: int, direction_deg: int | None) -> str:
        """Key of the table of a level, sliding in a direction or resting (None)."""
        of = f"resting {_rest_top(level)}" if direction_deg is None else f"sliding {level} {direction_deg}"
        return f"{self.surface} {self.azimuth_deg} {self.readout} {of}"

    def model(self) -> Compliance:
        """Model of one taxel that solves the tables."""
        return Compliance(self.surface, np.array(self.azimuth_deg), 1, self.readout)


@cache
def tables() -> dict[str, FloatArray]:
    """Rows of the tables that are shipped or that this process has solved, by key."""
    if not SHIPPED.exists():
        return {}
    with np.load(SHIPPED, allow_pickle=False) as file:
        return {str(key): file[f"table_{k}"] for k, key in enumerate(file["keys"])}


@lru_cache(maxsize=1024)
def table(case: TableCase, level: int, direction_deg: int | None) -> FloatArray:
    """Rows over a period of phase at a level, sliding in a direction or, pressed and not moved, at rest.

    They are (`_FINE` + 1, width), or (1, width) where the phase has no effect. A table that is not there is
    solved, which can take a minute.
    """
    key = case.key(level, direction_deg)
    if key not in tables():
        tables()[key] = (
            _solve_resting(case, _rest_top(level))
            if direction_deg is None
            else solve_sliding(case, level, direction_deg)
        )
    rows = tables()[key]
    return _refine(rows[:, level - _LOWEST] if direction_deg is None else rows)


def solve_sliding(case: TableCase, level: int, direction_deg: int) -> FloatArray:
    """Rows (phases, width) of steady sliding."""
    surface = case.surface
    heading = np.deg2rad(direction_deg)
    course = np.array([np.cos(heading), np.sin(heading)]).round(15)
    across = float(course @ groove_normal(surface))
    load_n, model = np.array([_level_n(level)]), case.model()
    if surface.depth_mm == 0 or abs(across) * _PHASES < 1:
        # The phase does not change while sliding: each phase is solved by a separate slide.
        return np.array([_slide(model, load_n, place, course, 0.1, 8)[-1] for place in _places(surface)])
    step_mm = surface.period_mm / _PHASES / abs(across)
    run_in = int(np.ceil(_RUN_IN_MM / step_mm))
    rows = _slide(model, load_n, -run_in * step_mm * course, course, step_mm, run_in + _PHASES)
    period = np.array(rows[run_in:-1])
    # Phase grows along the rows in either direction of travel.
    return period if across > 0 else np.concatenate([period[:1], period[:0:-1]])


def _solve_resting(case: TableCase, highest: int) -> FloatArray:
    """Rows (phases, levels, width): at each place all levels in one press."""
    model = case.model()
    pressed = []
    for place in _places(case.surface):
        model.reset()
        loads_n = [_level_n(level) for level in range(_LOWEST, highest + 1)]
        pressed.append([_row(model, np.array([load_n]), place) for load_n in loads_n])
    return np.array(pressed)


def _slide(
    model: Compliance,
    load_n: FloatArray,
    start_mm: FloatArray,
    course: FloatArray,
    step_mm: float,
    steps: int,
) -> list[FloatArray]:
    """Press at a place, then slide; rows after the press and after each step."""
    model.reset()
    for k in range(1, _PRESSING + 1):
        pressed = _row(model, load_n * k / _PRESSING, start_mm)
    return [pressed, *(_row(model, load_n, start_mm + k * step_mm * course) for k in range(1, steps + 1))]


def _row(model: Compliance, load_n: FloatArray, place_mm: FloatArray) -> FloatArray:
    """Step a model of one taxel, and return its row of a table."""
    felt = model.step(load_n, place_mm[None], Periodic.step_s)
    return np.concatenate([felt.normal_n, felt.tangential_n[0], felt.indentation_mm, felt.side_n[0]])


def _refine(rows: FloatArray) -> FloatArray:
    """Interpolate a period to `_FINE` phases by a periodic cubic spline; the first is repeated at the end."""
    from scipy.interpolate import CubicSpline  # half a second, not needed over a flat surface

    if len(rows) == 1:
        return rows
    spline = CubicSpline(np.arange(len(rows) + 1) / len(rows), [*rows, rows[0]], bc_type="periodic")
    return np.asarray(spline(np.arange(_FINE + 1) / _FINE))


def _look_up(rows: FloatArray, turn: FloatArray) -> FloatArray:
    if len(rows) == 1:
        return np.repeat(rows, len(turn), axis=0)
    place = (turn - np.floor(turn)) * _FINE
    below = np.minimum(place.astype(np.int64), _FINE - 1)
    return np.asarray(rows[below] + (place - below)[:, None] * (rows[below + 1] - rows[below]))


def _level_n(level: int) -> float:
    return float(_LEVEL_N * _LEVEL_RATIO**level)


def _rest_top(level: int) -> int:
    """Highest level of the table at rest that has this level."""
    return _USUAL if level <= _USUAL else _HIGHEST


def groove_normal(surface: Surface) -> FloatArray:
    """Unit vector (2,) across the grooves."""
    angle = np.deg2rad(surface.angle_deg)
    return np.array([np.cos(angle), np.sin(angle)])


def _places(surface: Surface) -> list[FloatArray]:
    """Places of equally spaced phases; one of them where the plate is flat."""
    count = _RESTS if surface.depth_mm > 0 else 1
    return [k / count * surface.period_mm * groove_normal(surface) for k in range(count)]
