"""Solved tables of `periodic`: those of the shipped scenes from a file, others solved once in a process.

A period over grooves takes its parent seconds to solve, which a board in real time does not have. The file
is written by ``python -m tactiled.emulator.prepare``; a test solves some of it again.
"""

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactiled.resources import shipped

FloatArray = NDArray[np.float64]

SHIPPED = shipped("config", "contact", "periodic.npz")
_solved: dict[str, FloatArray] = {}


def table_rows(key: str, solve: Callable[[], FloatArray]) -> FloatArray:
    """Rows of a table, solved if nobody has.

    Parameters
    ----------
    key : str
        All that the table depends on.
    solve : callable
    """
    if key in shipped_tables():
        return shipped_tables()[key]
    if key not in _solved:
        _solved[key] = solve()
    return _solved[key]


def is_solved(key: str) -> bool:
    """Whether `table_rows` has this table without solving it."""
    return key in shipped_tables() or key in _solved


def solved_tables() -> Mapping[str, FloatArray]:
    """What this process had to solve."""
    return _solved


@cache
def shipped_tables() -> Mapping[str, FloatArray]:
    """What nobody needs to solve."""
    return _load(SHIPPED) if SHIPPED.exists() else {}


def write_tables(path: Path, tables: Mapping[str, FloatArray]) -> None:
    """Keys beside arrays, since a key is no file name."""
    arrays = {f"table_{k}": rows for k, rows in enumerate(tables.values())}
    np.savez_compressed(path, allow_pickle=False, keys=np.array(list(tables)), **arrays)


def _load(path: Path) -> dict[str, FloatArray]:
    with np.load(path, allow_pickle=False) as file:
        return {str(key): file[f"table_{k}"] for k, key in enumerate(file["keys"])}
