"""Calibration files: what is written is read back, and what does not fit together is refused by name."""

import math
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tactiled import tomlfile
from tactiled.errors import ConfigError
from tactiled.force.calibration import (
    CalibrationFile,
    has_nominal,
    load_calibration,
    save_calibration,
    to_toml,
)

SMOOTH: dict[str, Any] = {
    "name": 'left "hand"\\ \n\t\x7f µ',
    "array": "two",
    "channels": 2,
    "board": "TB-1",
    "date": "2024-05-01",
    "nominal": False,
    "axes": ["fx", "fz"],
    "verdict": ["good", "add presses"],
    "range": {"fx_n": [-1.0, 2.0], "fy_n": [0.0, 0.0], "fz_n": [0.0, 30.0]},
    "residuals": {"fz_n": 0.25},
    "largest_reading": [0.5, 1e-9],
    "smooth": {
        "scale": [1.0, 2.0],
        "has_squares": False,
        "has_products": True,
        "creep_s": [],
        "weights": [[1.0, 2.0]] * 6,
    },
    "uncertainty": {
        "factor": [[], [[1.0, 2.0]], []],
        "floor_n": [1.0, 2.0, 3.0],
        "own": [0.0] * 3,
        "of_normal": [0.5] * 3,
    },
}
PAIRS: dict[str, Any] = {
    **{key: value for key, value in SMOOTH.items() if key != "smooth"},
    "nominal": True,
    "pairs": {
        "taxel_crosstalk": 0.125,
        "curve": {"reading": [0.0, 1.0], "load": [0.0, 1.0]},
        "creep": [{"time_s": 1.5, "gain": -0.25}, {"time_s": 30.0, "gain": 0.5}],
        "weights": [[0.5] * 9, [1.5] * 9],
    },
}


@pytest.mark.parametrize("content", [SMOOTH, PAIRS], ids=["smooth", "pairs"])
def test_a_written_file_is_read_back(content: dict[str, Any], tmp_path: Path) -> None:
    file = CalibrationFile.model_validate(content)
    save_calibration(tmp_path / "mine.toml", file)
    assert load_calibration(str(tmp_path / "mine.toml")) == file


def test_numbers_keep_seven_digits_and_their_type() -> None:
    numbers = [1.0, -2.5, 1 / 3, 1e-12, 6.02e23, 123456789.0, 1e16, math.inf]
    text = to_toml({"floats": numbers, "whole": 7, "yes": True, "no": False, "inner": {"deep": {"one": 1}}})
    found = tomllib.loads(text)
    assert found["floats"] == pytest.approx(numbers, rel=1e-6)
    assert all(isinstance(number, float) for number in found["floats"])
    assert (found["whole"], found["yes"], found["no"], found["inner"]) == (
        7,
        True,
        False,
        {"deep": {"one": 1}},
    )
    assert type(found["whole"]) is int


def edited(base: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Copy of a map with one value replaced; the keys of the path are separated by dots."""
    first, _, rest = path.partition(".")
    return {**base, first: edited(base[first], rest, value) if rest else value}


@pytest.mark.parametrize(
    ("base", "path", "value", "said"),
    [
        (PAIRS, "pairs.curve.load", [0.0, 1.0, 2.0], "2 readings, but 3 loads"),
        (PAIRS, "pairs.curve.reading", [0.0, 0.0], "reading must grow"),
        (PAIRS, "pairs.curve.load", [1.0, 0.5], "load must not fall"),
        (PAIRS, "pairs.curve", {"reading": [0.0], "load": [0.0]}, "at least 2"),
        (PAIRS, "pairs.creep", [{"time_s": 0.0, "gain": 1.0}], "greater than 0"),
        (PAIRS, "pairs.taxel_crosstalk", 1.0, "less than 1"),
        (PAIRS, "pairs.weights", [[0.5] * 9], "2 rows of 9 numbers"),
        (PAIRS, "pairs.weights", [[0.5] * 9, [0.5] * 8], "2 rows of 9 numbers"),
        (PAIRS, "pairs", None, "give one of the tables pairs and smooth"),
        (PAIRS, "smooth", SMOOTH["smooth"], "give one of the tables pairs and smooth"),
        (SMOOTH, "smooth.weights", [[1.0]] * 5, "6 rows of one length"),
        (SMOOTH, "smooth.weights", [[1.0]] * 5 + [[1.0, 2.0]], "6 rows of one length"),
        (SMOOTH, "smooth.scale", [1.0], "smooth.scale must have 2 numbers"),
        (SMOOTH, "smooth.scale", [1.0, 0.0], "greater than 0"),
        (SMOOTH, "smooth.creep_s", [0.0], "greater than 0"),
        (SMOOTH, "largest_reading", [1.0], "largest_reading has 1 numbers for 2 channels"),
        (SMOOTH, "uncertainty.factor", [[], []], "three matrices"),
        (SMOOTH, "uncertainty.floor_n", [1.0] * 4, "at most 3"),
        (SMOOTH, "uncertainty.noise", -0.1, "greater than or equal to 0"),
        (SMOOTH, "axes", [], "at least 1"),
        (SMOOTH, "name", "n" * 65, "at most 64"),
        (SMOOTH, "channels", 0, "greater than or equal to 1"),
    ],
)
def test_a_file_whose_parts_do_not_fit_together_is_refused(
    base: dict[str, Any], path: str, value: Any, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        CalibrationFile.model_validate(edited(base, path, value))


def test_a_file_without_a_needed_part_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('name = "a"\n')
    with pytest.raises(ConfigError, match="array"):
        tomlfile.load(tmp_path / "a.toml", CalibrationFile)


def test_only_published_sensitivities_are_nominal() -> None:
    assert has_nominal("wang2019-3x3")
    assert not has_nominal("normal-4x4")
    assert load_calibration("wang2019-3x3").nominal
