"""Tables of contact model `periodic`: one period of groove phase, solved on `compliance` and interpolated."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import NOT_CONVERGED, HeldQuantity, Readout, Surface, TaxelForces
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.resources import shipped

_STEP_S = 0.01  # without effect: `compliance` depends on the path and not on time

# Levels of load and of indentation at which tables are made, with linear interpolation between them. The
# ratio makes a taxel's share of 15 N and of 20 N levels themselves.
LEVEL_RATIO = 4 / 3
LEVEL = {"force": 15.0 / 9, "displacement": 0.175}
# Below the lowest level (a fiftieth of the reference) all forces are proportional to the load.
LOWEST, HIGHEST = -14, 6
_PHASES = 48  # solved in a period: the substep of `compliance` is a thirtieth
_RESTS = 8  # phases at which rest is solved
FINE = 512  # phases of a table after interpolation: linear interpolation between them is exact to 1e-4
_RUN_IN_MM = 0.8  # travel before the period that counts: over twice the presliding distance at 4 N
_PRESSING = 6  # steps in which the load grows
_USUAL = 2  # level up to which rest is solved first: 3 N a taxel; higher levels are rare and slow to solve


SHIPPED = shipped("config", "contact", "periodic.npz")
_solved: dict[str, FloatArray] = {}


@dataclass(frozen=True)
class PeriodConditions:
    """Conditions of one period: surface, read-out, imposed quantity and mesh."""

    surface: Surface
    azimuth_deg: tuple[float, ...]
    held: HeldQuantity
    readout: Readout
    mesh: str


def table_key(case: PeriodConditions, level: int, direction_deg: int | None) -> str:
    """Key of the table of a level, sliding in a direction or resting (None)."""
    # The shipped file has keys with the word "Case".
    fields = ", ".join(f"{name}={value!r}" for name, value in vars(case).items())
    if direction_deg is None:
        return f"Case({fields}) resting {_USUAL if level <= _USUAL else HIGHEST}"
    return f"Case({fields}) sliding {level} {direction_deg}"


@lru_cache(maxsize=512)
def sliding(case: PeriodConditions, level: int, direction_deg: int) -> FloatArray:
    """Rows (FINE + 1, width) over a period of phase while sliding; columns as in `_row`."""
    return _refine(
        table_rows(table_key(case, level, direction_deg), lambda: solve_sliding(case, level, direction_deg))
    )


@lru_cache(maxsize=512)
def resting(case: PeriodConditions, level: int) -> FloatArray:
    """Rows (FINE + 1, width) over a period of phase for a taxel that is pressed and not moved."""
    highest = _USUAL if level <= _USUAL else HIGHEST
    rows = table_rows(table_key(case, level, None), lambda: _solve_resting(case, highest))
    return _refine(rows[:, level - LOWEST])


def solve_sliding(case: PeriodConditions, level: int, direction_deg: int) -> FloatArray:
    """Rows (phases, width) of steady sliding; see `sliding`."""
    surface = case.surface
    heading = np.deg2rad(direction_deg)
    course = np.array([np.cos(heading), np.sin(heading)]).round(15)
    across = float(course @ groove_normal(surface))
    value = np.array([level_value(case.held, level)])
    model = _compliance(case)
    if surface.depth_mm == 0 or abs(across) * _PHASES < 1:
        # The phase does not change while sliding: each phase is solved by a separate slide.
        return np.array([_slide(model, case, value, place, course, 0.1, 8)[-1] for place in _places(surface)])
    step_mm = surface.period_mm / _PHASES / abs(across)
    run_in = int(np.ceil(_RUN_IN_MM / step_mm))
    rows = _slide(model, case, value, -run_in * step_mm * course, course, step_mm, run_in + _PHASES)
    period = np.array(rows[run_in:-1])
    # Phase grows along the rows in either direction of travel.
    return period if across > 0 else np.concatenate([period[:1], period[:0:-1]])


def _solve_resting(case: PeriodConditions, highest: int) -> FloatArray:
    """Rows (phases, levels, width): at each place all levels in one press."""
    model = _compliance(case)
    pressed = []
    for place in _places(case.surface):
        model.reset()
        values = [level_value(case.held, level) for level in range(LOWEST, highest + 1)]
        pressed.append([_row(model.step(case.held, np.array([v]), place[None], _STEP_S)) for v in values])
    return np.array(pressed)


def _compliance(case: PeriodConditions) -> Compliance:
    return Compliance(case.surface, np.array(case.azimuth_deg), 1, readout=case.readout, mesh=case.mesh)


def level_value(held: HeldQuantity, level: int) -> float:
    """Load (N) or indentation (mm) of a level."""
    return float(LEVEL[held] * LEVEL_RATIO**level)


def groove_normal(surface: Surface) -> FloatArray:
    """Unit vector (2,) across the grooves."""
    angle = np.deg2rad(surface.angle_deg)
    return np.array([np.cos(angle), np.sin(angle)])


def _places(surface: Surface) -> list[FloatArray]:
    """Places of equally spaced phases; one of them where the plate is flat."""
    count = _RESTS if surface.depth_mm > 0 else 1
    return [k / count * surface.period_mm * groove_normal(surface) for k in range(count)]


def _slide(
    model: Compliance,
    case: PeriodConditions,
    value: FloatArray,
    start_mm: FloatArray,
    course: FloatArray,
    step_mm: float,
    steps: int,
) -> list[FloatArray]:
    """Press at a place, then slide; rows after the press and after each step."""
    model.reset()
    for k in range(1, _PRESSING + 1):
        felt = model.step(case.held, value * k / _PRESSING, start_mm[None], _STEP_S)
    rows = [_row(felt)]
    for k in range(1, steps + 1):
        rows.append(_row(model.step(case.held, value, (start_mm + k * step_mm * course)[None], _STEP_S)))
    return rows


def _row(felt: TaxelForces) -> FloatArray:
    flag = felt.warnings[0] & NOT_CONVERGED
    return np.concatenate(
        [felt.normal_n, felt.tangential_n[0], felt.indentation_mm, [float(flag > 0)], felt.side_n[0]]
    )


def _refine(rows: FloatArray) -> FloatArray:
    """Interpolate a period to `FINE` phases by a periodic cubic spline; the first is repeated at the end."""
    from scipy.interpolate import CubicSpline  # half a second, not needed over a flat surface

    table = rows.copy()
    flag = table[:, 4].max()
    if len(table) > 1:
        spline = CubicSpline(np.arange(len(table) + 1) / len(table), [*table, table[0]], bc_type="periodic")
        table = spline(np.arange(FINE + 1) / FINE)
    table[:, 4] = flag
    return np.asarray(table)


def table_rows(key: str, solve: Callable[[], FloatArray]) -> FloatArray:
    """Rows of a table: shipped, solved before, or solved now by `solve`."""
    if key in shipped_tables():
        return shipped_tables()[key]
    if key not in _solved:
        _solved[key] = solve()
    return _solved[key]


def is_solved(key: str) -> bool:
    """Return whether `table_rows` has this table without solving it."""
    return key in shipped_tables() or key in _solved


def solved_tables() -> Mapping[str, FloatArray]:
    """Tables that this process has solved."""
    return _solved


@cache
def shipped_tables() -> Mapping[str, FloatArray]:
    """Tables in the shipped file."""
    if not SHIPPED.exists():
        return {}
    with np.load(SHIPPED, allow_pickle=False) as file:
        return {str(key): file[f"table_{k}"] for k, key in enumerate(file["keys"])}


def ship_tables() -> None:
    """Write the tables that this process has solved, with an array of keys: a key is no valid file name."""
    arrays = {f"table_{k}": rows for k, rows in enumerate(_solved.values())}
    np.savez_compressed(SHIPPED, allow_pickle=False, keys=np.array(list(_solved)), **arrays)
