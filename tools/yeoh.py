"""Yeoh constants of a rubber from a measured stress-strain curve, by the paper's method.

``python -m tools.yeoh rubber.csv`` prints them as JSON, and in words to stderr. The file is a CSV with a
header: ``strain`` or ``stretch``, and ``stress_mpa`` (nominal, uniaxial).

Nominal stress is linear in C1, C2, C3: 2 (l - l^-2) (1, 2 x, 3 x^2) with x = l^2 + 2 / l - 3. The fit is
linear least squares; intervals are Student's t with n - 3 degrees of freedom for independent errors of equal
variance (Draper and Smith, Applied Regression Analysis, 1998, chapter 5).
"""

import csv
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.errors import DataError, TactiledError
from tactiled.outside import read_text

_LEAST_STRETCH = 1e-6  # powers down to the fourth stay finite
_MOST_STRETCH, _LARGEST_MPA = 100.0, 1e5  # rubber tears at a stretch of 10 and some 30 MPa
_STRESS, _STRAIN, _STRETCH = "stress_mpa", "strain", "stretch"
_HEADER = f"'{_STRAIN},{_STRESS}' or '{_STRETCH},{_STRESS}'"
# Of the columns scaled to 1; beyond this the constants depend on the last digits of the file.
_WORST_CONDITION = 1e8


@dataclass(frozen=True)
class YeohFit:
    """Constants with intervals; `c_mpa`, `low_mpa`, `high_mpa` hold C1, C2, C3."""

    c_mpa: tuple[float, ...]
    low_mpa: tuple[float, ...]
    high_mpa: tuple[float, ...]
    level: float  # confidence of each interval from low to high
    residual_mpa: float  # standard deviation of the measured stress about the fit
    points: int
    stretch: tuple[float, float]  # shortest and longest stretch measured

    def as_map(self) -> dict[str, Any]:
        """Fit as plain data for JSON."""
        names = ("c1_mpa", "c2_mpa", "c3_mpa")
        return {
            **dict(zip(names, self.c_mpa, strict=True)),
            "interval_mpa": {
                name: [low, high] for name, low, high in zip(names, self.low_mpa, self.high_mpa, strict=True)
            },
            "confidence": self.level,
            "residual_mpa": self.residual_mpa,
            "points": self.points,
            "stretch_measured": list(self.stretch),
        }

    def in_words(self) -> str:
        """Fit in words."""
        lines = [
            f"{name} = {c:.4g} MPa ({100 * self.level:.0f} %: {low:.4g} to {high:.4g})"
            for name, c, low, high in zip(
                ("C1", "C2", "C3"), self.c_mpa, self.low_mpa, self.high_mpa, strict=True
            )
        ]
        lines.append(
            f"{self.points} points, stretch {self.stretch[0]:.3g} to {self.stretch[1]:.3g}, "
            f"stress off by {self.residual_mpa:.2g} MPa (standard deviation)"
        )
        return "\n".join(lines)


def fit_yeoh(stretch: FloatArray, stress_mpa: FloatArray, level: float = 0.95) -> YeohFit:
    """Least-squares fit of C1, C2, C3 to stretches (1 + strain) and nominal stresses (compression: below 0).

    `DataError` for fewer than 4 points, or stretches that cannot tell the three constants apart.
    """
    n = len(stretch)
    if n < 4:
        raise DataError(f"{n} points for three constants and their uncertainty: at least 4 are needed")
    excess = stretch**2 + 2 / stretch - 3
    design = (2 * (stretch - stretch**-2))[:, None] * np.stack(
        [np.ones(n), 2 * excess, 3 * excess**2], axis=1
    )
    scale = np.linalg.norm(design, axis=0)
    if not np.all(scale > 0) or np.linalg.cond(design / scale) > _WORST_CONDITION:
        raise DataError("stretches too few or too alike to tell C1, C2, C3 apart: measure over a wider range")
    left, sizes, right = np.linalg.svd(design / scale, full_matrices=False)
    constants = right.T @ ((left.T @ stress_mpa) / sizes) / scale
    variance = float(np.sum((stress_mpa - design @ constants) ** 2)) / (n - 3)
    spread = np.sqrt(variance * np.sum((right.T / sizes) ** 2, axis=1)) / scale
    reach = float(special.stdtrit(n - 3, 0.5 + level / 2)) * spread
    return YeohFit(
        c_mpa=tuple(constants.tolist()),
        low_mpa=tuple((constants - reach).tolist()),
        high_mpa=tuple((constants + reach).tolist()),
        level=level,
        residual_mpa=math.sqrt(variance),
        points=n,
        stretch=(float(stretch.min()), float(stretch.max())),
    )


def fit_material_file(path: Path, level: float = 0.95) -> YeohFit:
    """Fit a CSV whose header is ``strain,stress_mpa`` or ``stretch,stress_mpa`` (other columns are ignored).

    `DataError` names the file and, where there is one, the line.
    """
    stretch, stress = read_curve(path)
    try:
        fit = fit_yeoh(stretch, stress, level)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    if fit.c_mpa[0] <= 0:
        raise DataError(
            f"{path}: C1 = {fit.c_mpa[0]:.3g} MPa is not a material: is compression negative, stress in MPa?"
        )
    return fit


def read_curve(path: Path) -> tuple[FloatArray, FloatArray]:
    """Stretch and nominal stress (MPa) from such a file; `DataError` as above."""
    try:
        text = read_text(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error}") from None
    rows = csv.reader(text.splitlines())
    header = [name.strip() for name in next(rows, [])]
    column = next((name for name in (_STRETCH, _STRAIN) if name in header), None)
    if column is None or _STRESS not in header:
        raise DataError(f"{path}: line 1: the header must be {_HEADER}, not {','.join(header)!r}")
    places = header.index(column), header.index(_STRESS)
    offset = 1.0 if column == _STRAIN else 0.0
    curve = []
    for row in rows:
        if not any(cell.strip() for cell in row):
            continue
        try:
            along, stress = (float(row[place]) for place in places)
        except (ValueError, IndexError):
            raise DataError(f"{path}: line {rows.line_num}: {column} and {_STRESS} must be numbers") from None
        fault = ""
        if not (math.isfinite(along) and math.isfinite(stress)):
            fault = f"{column} and {_STRESS} must be finite"
        elif along + offset <= _LEAST_STRETCH:
            fault = f"{column} {along:g} squeezes the sample to nothing"
        elif along + offset > _MOST_STRETCH or abs(stress) > _LARGEST_MPA:
            hint = "strain is 0.1 for 10 %, and stress is in MPa"
            fault = f"{column} {along:g} at {stress:g} MPa is no rubber; {hint}"
        if fault:
            raise DataError(f"{path}: line {rows.line_num}: {fault}")
        curve.append((along + offset, stress))
    table = np.array(curve, dtype=np.float64).reshape(-1, 2)
    return table[:, 0], table[:, 1]


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--level", default=0.95, type=click.FloatRange(0.5, 0.999), show_default=True)
def main(file: Path, level: float) -> None:
    """Fit the three Yeoh constants to a stress-strain curve."""
    try:
        fit = fit_material_file(file, level)
    except TactiledError as error:
        sys.exit(f"yeoh: {error}")
    click.echo(json.dumps(fit.as_map(), allow_nan=False))
    click.echo(fit.in_words(), err=True)


if __name__ == "__main__":
    main()
