"""Calibration file: parameters that turn the readings of one array into newtons, with their uncertainty.

`tactiled calibrate` writes such files; ``config/calibration/`` has one nominal file for each array whose
sensitivities were published. Features are the numbers that a model computes from the readings of a scan; a
force is a weighted sum of features (`tactiled.force.model`).
"""

import itertools
import json
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from tactiled import resources, tomlfile, tomltext
from tactiled.array import Array
from tactiled.errors import ConfigError
from tactiled.tomlfile import Params

FOLDER = "config/calibration"
Axis = Literal["fx", "fy", "fz"]
Curve = Literal["linear", "log", "inverse"]
AXES: tuple[Axis, Axis, Axis] = ("fx", "fy", "fz")
OUTPUTS = (*AXES, "tx", "ty", "tz")
Matrix = list[list[float]]
Positive = Annotated[float, Field(gt=0)]


class LoadCurve(Params):
    """Monotone curve from the reading of an electrode to its load, as a table."""

    reading: list[float] = Field(min_length=2, description="relative to zero, in the unit of the array")
    load: list[float] = Field(min_length=2, description="in units of the weights")

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        if len(self.reading) != len(self.load):
            raise ValueError(f"{len(self.reading)} readings, but {len(self.load)} loads")
        if any(b <= a for a, b in itertools.pairwise(self.reading)):
            raise ValueError("reading must grow from entry to entry")
        if any(b < a for a, b in itertools.pairwise(self.load)):
            raise ValueError("load must not fall")
        return self


class CreepState(Params):
    """Part of the sensitivity that follows the load with a delay."""

    time_s: float = Field(gt=0, description="time constant")
    gain: float = Field(description="relative change of sensitivity for a load of 1, after a long time")


class PairsModelParams(Params):
    """Physics of taxels with side electrodes: crosstalk, load curve, creep, and a map to forces."""

    taxel_crosstalk: float = Field(default=0.0, gt=-1, lt=1, description="part of the taxel's mean reading")
    neighbour_crosstalk: float = Field(default=0.0, gt=-1, lt=1, description="part of the neighbours' mean")
    curve: LoadCurve
    creep: list[CreepState] = []
    unloading: float = Field(default=0.0, ge=-0.5, le=2, description="gain at no load after a large one")
    weights: Matrix = Field(
        description="for each channel: fx, fy, fz by load, fx, fy, fz by reading, fx, fy, fz by load times "
        "the mean load of the taxel"
    )


class SmoothFeatures(Params):
    """Features of the smooth model: readings, their squares and products, and low-passed copies.

    Attributes
    ----------
    curve : str
        What is taken for the reading v of a channel that reads v0 without a load: v - v0 (``"linear"``),
        log(v / v0) or 1 / v - 1 / v0 (``"inverse"``). A resistor whose conductance grows with the load
        follows one of the latter two, by what it is divided with.
    """

    scale: list[Positive] = Field(min_length=1, description="size of each channel's reading that counts as 1")
    curve: Curve = "linear"
    zero: list[float] = Field(default=[], description="reading of each channel without a load, for a curve")
    has_squares: bool = True
    has_products: bool = False
    creep_s: list[Positive] = Field(default=[], description="time constants of the low-passed copies")

    @model_validator(mode="after")
    def _has_zero(self) -> Self:
        if self.curve != "linear" and (len(self.zero) != len(self.scale) or min(self.zero) <= 0):
            raise ValueError(
                f"zero must have {len(self.scale)} positive numbers where the curve is {self.curve}"
            )
        return self


class SmoothModelParams(SmoothFeatures):
    """Ridge regression on smooth features."""

    weights: Matrix = Field(description="rows fx, fy, fz, tx, ty, tz; columns are features")


class Uncertainty(Params):
    """Standard deviation of a force: parameters, model, zero and drift of sensitivity."""

    factor: list[Matrix] = Field(
        default=[], description="for fx, fy, fz: rows whose products with the features are independent errors"
    )
    floor_n: list[float] = Field(min_length=3, max_length=3, description="of fx, fy, fz, at any load")
    own: list[float] = Field(min_length=3, max_length=3, description="part of the component itself")
    of_normal: list[float] = Field(min_length=3, max_length=3, description="part of the normal force")
    noise: float = Field(default=0.0, ge=0, description="of a reading of one scan, in the unit of the array")
    zero_sd: float = Field(default=0.0, ge=0, description="of the zero of a channel after a tare, in unit")
    walk_n: list[float] = Field(
        default=[0.0, 0.0, 0.0],
        min_length=3,
        max_length=3,
        description="of fx, fy, fz in a second of contact",
    )
    n_per_unit: list[float] = Field(
        default=[0.0, 0.0, 0.0], min_length=3, max_length=3, description="change of fx, fy, fz by the zero"
    )


class ForceRange(Params):
    """Smallest and largest value in the data of the calibration."""

    fx_n: tuple[float, float]
    fy_n: tuple[float, float]
    fz_n: tuple[float, float]


class Residuals(Params):
    """Rms differences from the reference in segments that were left out of the fit."""

    fx_n: float | None = None
    fy_n: float | None = None
    fz_n: float | None = None
    baseline_fz_n: float | None = Field(default=None, description="of ridge regression with squares")


class CalibrationFile(Params):
    """Schema of a calibration file."""

    version: Literal[1] = 1
    name: str = Field(min_length=1, max_length=64, description="as in the field `calibration` of messages")
    array: str = Field(min_length=1, description="array that was calibrated")
    channels: int = Field(ge=1, description="number of its channels")
    board: str = Field(default="", description="serial number of the board; empty where it is not known")
    date: str = Field(default="", description="day of the calibration")
    nominal: bool = Field(default=False, description="from published numbers, not from this sensor")
    axes: list[Axis] = Field(min_length=1, description="components that are known")
    verdict: list[str] = Field(default=[], description="what is known well, what is not, and what to add")
    range: ForceRange
    residuals: Residuals = Residuals()
    largest_reading: list[float] = Field(description="of each channel in the calibration, relative to zero")
    pairs: PairsModelParams | None = None
    smooth: SmoothModelParams | None = None
    uncertainty: Uncertainty

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.pairs is None) == (self.smooth is None):
            raise ValueError("give one of the tables pairs and smooth")
        if len(self.largest_reading) != self.channels:
            raise ValueError(
                f"largest_reading has {len(self.largest_reading)} numbers for {self.channels} channels"
            )
        if self.pairs is not None and (
            len(self.pairs.weights) != self.channels or any(len(row) != 9 for row in self.pairs.weights)
        ):
            raise ValueError(f"pairs.weights must have {self.channels} rows of 9 numbers")
        if self.smooth is not None:
            widths = {len(row) for row in self.smooth.weights}
            if len(self.smooth.weights) != len(OUTPUTS) or len(widths) != 1:
                raise ValueError(f"smooth.weights must have {len(OUTPUTS)} rows of one length")
            if len(self.smooth.scale) != self.channels:
                raise ValueError(f"smooth.scale must have {self.channels} numbers")
        if self.uncertainty.factor and len(self.uncertainty.factor) != len(AXES):
            raise ValueError("uncertainty.factor must have three matrices")
        return self

    def check_array(self, array: Array) -> None:
        """Raise `ConfigError` where the file is of another array."""
        if self.array != array.name or self.channels != array.n_channels:
            fault = (
                f"this calibration is of array {self.array} with {self.channels} channels, but the array "
                f"is {array.name} with {array.n_channels}: calibrate this array, or name another file"
            )
            raise ConfigError(self.name, [fault])


def load_calibration(name_or_path: str) -> CalibrationFile:
    """Load a calibration by shipped name or by path; `ConfigError` lists every fault of the file."""
    return tomlfile.load(tomltext.locate(name_or_path, FOLDER), CalibrationFile)


def has_nominal(array: str) -> bool:
    """Return True where a nominal calibration of the array is shipped."""
    return array in resources.shipped_names(FOLDER)


def save_calibration(path: Path, file: CalibrationFile) -> None:
    """Write a calibration file."""
    path.write_text(to_toml(file.model_dump(exclude_none=True)), encoding="utf-8")


def to_toml(document: dict[str, object]) -> str:
    """Format plain maps, lists, numbers and strings as TOML."""
    lines: list[str] = []
    _table(document, "", lines)
    return "\n".join(lines) + "\n"


def _table(table: dict[str, object], prefix: str, lines: list[str]) -> None:
    inner = {key: value for key, value in table.items() if isinstance(value, dict)}
    for key, value in table.items():
        if key not in inner:
            lines.append(f"{key} = {_value(value)}")
    for key, value in inner.items():
        name = f"{prefix}.{key}" if prefix else key
        lines.extend(("", f"[{name}]"))
        _table(value, name, lines)


def _value(value: object) -> str:
    if isinstance(value, float):  # 24 bits: far below any uncertainty, and half the size of the file
        return repr(float(f"{value:.7g}"))
    if isinstance(value, str | int):  # as JSON has them, bool among them
        return tomltext.quoted(value) if isinstance(value, str) else json.dumps(value)
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_value(inner)}" for key, inner in value.items()) + " }"
    assert isinstance(value, list | tuple)
    cells = [_value(entry) for entry in value]
    if value and isinstance(value[0], list | dict):
        return "[\n" + "".join(f"  {cell},\n" for cell in cells) + "]"
    return "[" + ", ".join(cells) + "]"
