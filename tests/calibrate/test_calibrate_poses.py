"""Calibrations of static poses: rows in any order, without times."""

import json
from pathlib import Path

import numpy as np
import pytest
from commands import call

from tactiled.array import Array, ArrayFile, build
from tactiled.calibrate.data import ReferenceTable
from tactiled.calibrate.study import CalibrationStudy, calibrate
from tactiled.errors import DataError
from tactiled.tomlfile import parse

CHIP = {
    "name": "chip",
    "unit": "uT",
    "range": [-500, 500],
    "zero": [10.0, -20.0, 40.0],
    "taxel_count": 1,
    "taxel_channels": [
        {"name": "X", "kind": "shear_x"},
        {"name": "Y", "kind": "shear_y"},
        {"name": "Z", "kind": "normal"},
    ],
}


def chip(**changes: object) -> Array:
    return build(parse({**CHIP, **changes}, ArrayFile, "test"))


def poses(n: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Readings (n, 3) and forces (n, 6) of poses in random order, with a response that bends."""
    rng = np.random.default_rng(0)
    force = np.column_stack([rng.uniform(-2, 2, (n, 2)), rng.uniform(0, 10, n) * (rng.random(n) < 0.8)])
    force[:, :2] *= (force[:, 2:] > 0).astype(float)
    # The object's force along x is against the skin's motion, to which a channel responds.
    response = np.column_stack([-20 * force[:, 0], -20 * force[:, 1], 30 * force[:, 2] - force[:, 2] ** 2])
    readings = np.array(CHIP["zero"]) + response + 0.2 * rng.standard_normal((n, 3))
    return readings, np.column_stack([force, np.full((n, 3), np.nan)])


def fitted(array: Array, readings: np.ndarray, values: np.ndarray) -> CalibrationStudy:
    rows = np.arange(len(values), dtype=np.float64)
    table = ReferenceTable(rows, values)
    times = np.arange(len(readings), dtype=np.float64)
    return calibrate(array, times, readings, table, "poses", are_poses=True)


def test_poses_in_any_order_give_the_same_errors_and_no_creep() -> None:
    readings, values = poses()
    found = fitted(chip(), readings, values)
    spread = np.ptp(values[:, :3], axis=0)
    assert (np.sqrt((found.left_out[:, :3] ** 2).mean(axis=0)) < 0.02 * spread).all()
    inside = (np.abs(found.left_out[:, :3]) < 1.645 * found.sd).mean(axis=0)
    assert (inside > 0.85).all()
    assert found.file.smooth is not None
    assert found.file.smooth.creep_s == []
    order = np.random.default_rng(1).permutation(len(values))
    other = fitted(chip(), readings[order], values[order])
    assert np.sqrt((other.left_out**2).mean()) == pytest.approx(np.sqrt((found.left_out**2).mean()), rel=0.1)


def test_poses_in_order_of_their_force_show_no_drift() -> None:
    readings, values = poses()
    order = np.argsort(values[:, 2])
    assert fitted(chip(), readings[order], values[order]).file.uncertainty.walk_n == [0.0, 0.0, 0.0]


def test_a_pose_that_lacks_in_one_file_moves_no_other() -> None:
    readings, values = poses()
    rows = np.arange(len(values), dtype=np.float64)
    table = ReferenceTable(np.delete(rows, 360), np.delete(values, 360, axis=0))
    log, own = np.delete(readings, 380, axis=0), np.delete(rows, 380)
    found = calibrate(chip(), own, log, table, "poses", are_poses=True)
    assert len(found.left_out) == 598
    assert (np.sqrt((found.left_out[:, :3] ** 2).mean(axis=0)) < 0.02 * np.ptp(values[:, :3], axis=0)).all()


def test_poses_that_do_not_belong_together_are_refused() -> None:
    readings, values = poses()
    rows = np.arange(len(values), dtype=np.float64)
    table = ReferenceTable(rows + 0.5, values)
    with pytest.raises(DataError, match="0 poses are in both files"):
        calibrate(chip(), rows, readings, table, "poses", are_poses=True)
    with pytest.raises(DataError, match="poses have no beginning"):
        fitted(chip(zero="first 0.3 s"), readings, values)
    readings[5, 1] = np.nan
    with pytest.raises(DataError, match="leave its row out"):
        fitted(chip(), readings, values)


@pytest.mark.parametrize("are_numbered", [False, True], ids=["without times", "numbers of the poses"])
def test_the_command_takes_tables_of_poses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], are_numbered: bool
) -> None:
    readings, values = poses()
    rows = np.arange(len(values))[:, np.newaxis]
    log, header = (np.hstack([rows, readings]), "time_s,X,Y,Z") if are_numbered else (readings, "X,Y,Z")
    np.savetxt(tmp_path / "log.csv", log, delimiter=",", header=header, comments="")
    table = np.hstack([rows, values[:, :3]])
    np.savetxt(tmp_path / "ft.csv", table, delimiter=",", header="time_s,fx_n,fy_n,fz_n", comments="")
    lines = [f"{key} = {json.dumps(value)}" for key, value in CHIP.items() if key != "taxel_channels"]
    kinds = [
        f'[[taxel_channels]]\nname = "{n}"\nkind = "{k}"'
        for n, k in zip("XYZ", ("shear_x", "shear_y", "normal"), strict=True)
    ]
    (tmp_path / "chip.toml").write_text("\n".join([*lines, *kinds]))
    command = ["calibrate", str(tmp_path / "log.csv"), "--reference", str(tmp_path / "ft.csv"), "--poses"]
    command += ["--array", str(tmp_path / "chip.toml"), "-o", str(tmp_path / "mine.toml")]
    assert call(*command) == 0, capsys.readouterr().err
    assert (tmp_path / "mine.toml").exists()
