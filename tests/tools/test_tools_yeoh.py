"""Fitting Yeoh constants: the paper's come back, intervals cover, files are refused by line."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import binom

from tactiled.array import FloatArray
from tactiled.errors import DataError
from tools.yeoh import YeohFit, fit_material_file, fit_yeoh, main

COMPRESSION = np.linspace(0.6, 0.99, 40)


class Yeoh(NamedTuple):
    """Rubber of table 1 of the paper: Wang, Chen, Mei, Micromachines 2019, 10(9), 579."""

    name: str
    c1_mpa: float
    c2_mpa: float
    c3_mpa: float

    def uniaxial_mpa(self, stretch: FloatArray) -> FloatArray:
        """Nominal stress 2 (l - l^-2) W'(I1) of an incompressible bar, where I1 = l^2 + 2 / l."""
        excess = stretch**2 + 2 / stretch - 3
        slope = self.c1_mpa + excess * (2 * self.c2_mpa + excess * 3 * self.c3_mpa)
        return np.asarray(2 * (stretch - stretch**-2) * slope)


RUBBER = Yeoh("conductive rubber", 0.5686, 0.0540, -0.0181)
RTV = Yeoh("RTV adhesive", 0.5551, -0.0356, 0.0027)
PDMS = Yeoh("PDMS", 0.7997, 0.2881, -0.0375)
RUBBERS = (RUBBER, RTV, PDMS)


def table(path: Path, header: str, first: FloatArray, stress: FloatArray) -> Path:
    rows = "\n".join(f"{a!r},{b!r}" for a, b in zip(first.tolist(), stress.tolist(), strict=True))
    path.write_text(f"{header}\n{rows}\n", encoding="utf-8")
    return path


def noisy(rubber: Yeoh, seed: int) -> YeohFit:
    noise = 0.005 * np.random.default_rng(seed).normal(size=COMPRESSION.size)
    return fit_yeoh(COMPRESSION, rubber.uniaxial_mpa(COMPRESSION) + noise)


@pytest.mark.parametrize("rubber", RUBBERS, ids=lambda rubber: rubber.name)
@pytest.mark.parametrize(("header", "offset"), [("strain,stress_mpa", 1.0), ("stretch,stress_mpa", 0.0)])
def test_fit_recovers_table_1_from_a_file(tmp_path: Path, rubber: Yeoh, header: str, offset: float) -> None:
    path = table(tmp_path / "curve.csv", header, COMPRESSION - offset, rubber.uniaxial_mpa(COMPRESSION))
    fit = fit_material_file(path)
    assert fit.c_mpa == pytest.approx((rubber.c1_mpa, rubber.c2_mpa, rubber.c3_mpa), abs=1e-8)


@pytest.mark.parametrize("rubber", RUBBERS, ids=lambda rubber: rubber.name)
def test_intervals_have_their_coverage(rubber: Yeoh) -> None:
    trials, truth = 600, np.array([rubber.c1_mpa, rubber.c2_mpa, rubber.c3_mpa])
    fits = [noisy(rubber, seed) for seed in range(trials)]
    low, high = np.array([f.low_mpa for f in fits]), np.array([f.high_mpa for f in fits])
    covered = np.sum((low <= truth) & (truth <= high), axis=0)
    fewest, most = (float(binom.ppf(q, trials, 0.95)) for q in (5e-5, 1 - 5e-5))
    assert np.all((fewest <= covered) & (covered <= most)), covered


def test_intervals_shrink_with_level_and_the_mean_is_unbiased() -> None:
    curve = RUBBER.uniaxial_mpa(COMPRESSION) + 0.005 * np.random.default_rng(1).normal(size=40)
    wide, narrow = fit_yeoh(COMPRESSION, curve, 0.99), fit_yeoh(COMPRESSION, curve, 0.5)
    assert np.all(np.array(wide.low_mpa) < np.array(narrow.low_mpa))
    c1 = np.array([noisy(RUBBER, seed).c_mpa[0] for seed in range(400)])
    assert abs(c1.mean() - RUBBER.c1_mpa) < 4 * c1.std() / np.sqrt(400)


def test_fit_is_the_least_squares_one() -> None:
    rng = np.random.default_rng(3)
    stretch = rng.uniform(0.5, 1.8, 60)
    stress = rng.normal(size=60)
    fit = fit_yeoh(stretch, stress)

    def squares(c: FloatArray) -> float:
        x = stretch**2 + 2 / stretch - 3
        model = 2 * (stretch - stretch**-2) * (c[0] + 2 * c[1] * x + 3 * c[2] * x**2)
        return float(np.sum((stress - model) ** 2))

    best = squares(np.array(fit.c_mpa))
    assert fit.residual_mpa == pytest.approx(np.sqrt(best / 57))
    for nudge in np.vstack([np.eye(3), -np.eye(3)]) * 1e-3:
        assert squares(np.array(fit.c_mpa) + nudge) > best


@pytest.mark.parametrize("rubber", RUBBERS, ids=lambda rubber: rubber.name)
def test_the_map_is_json(rubber: Yeoh) -> None:
    document = json.loads(json.dumps(noisy(rubber, 0).as_map(), allow_nan=False))
    low, high = document["interval_mpa"]["c1_mpa"]
    assert low < document["c1_mpa"] < high


def test_other_columns_blank_lines_spaces_and_a_byte_order_mark_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    stress = PDMS.uniaxial_mpa(COMPRESSION)
    rows = "\n\n".join(f"x, {s!r} ,{a!r}" for a, s in zip(COMPRESSION.tolist(), stress.tolist(), strict=True))
    path.write_text(f"\ufeffspecimen, stress_mpa ,stretch\r\n{rows}\n", encoding="utf-8")
    assert fit_material_file(path).c_mpa[0] == pytest.approx(PDMS.c1_mpa)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "line 1: the header"),
        ("strain,stress\n0.1,2\n", "line 1: the header"),
        ("strain,stress_mpa\n-0.1,-0.2\n-0.2,soft\n", "line 3: .* must be numbers"),
        ("strain,stress_mpa\n\n-0.1\n", "line 3: .* must be numbers"),
        ("strain,stress_mpa\n-0.1,nan\n", "line 2: .* must be finite"),
        ("strain,stress_mpa\n-1,-5\n", "line 2: strain -1 squeezes"),
        ("stretch,stress_mpa\n0,-5\n", "line 2: stretch 0 squeezes"),
        ("stretch,stress_mpa\n1e200,5\n", "line 2: .* is no rubber"),
        ("stretch,stress_mpa\n0.9,-1e308\n", "line 2: .* is no rubber"),
        ("strain,stress_mpa\n-0.1,-0.3\n-0.2,-0.6\n-0.3,-1\n", "3 points"),
        ("strain,stress_mpa\n" + "-0.1,-0.3\n" * 9, "wider range"),
        ("strain,stress_mpa\n" + "0,0\n" * 9, "wider range"),
        ("strain,stress_mpa\n-0.1,0.3\n-0.2,0.7\n-0.3,1.2\n-0.4,2\n-0.5,4\n", "is compression negative"),
    ],
)
def test_faults_of_a_file_are_named(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "curve.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=complaint) as caught:
        fit_material_file(path)
    assert str(caught.value).startswith(str(path))


def test_the_program_prints_the_fit_and_names_a_missing_file(tmp_path: Path) -> None:
    path = table(tmp_path / "curve.csv", "stretch,stress_mpa", COMPRESSION, PDMS.uniaxial_mpa(COMPRESSION))
    printed = CliRunner().invoke(main, [str(path)])
    assert json.loads(printed.stdout)["c1_mpa"] == pytest.approx(PDMS.c1_mpa)
    assert "C1 = 0.7997 MPa" in printed.stderr
    refused = CliRunner().invoke(main, [str(tmp_path / "nowhere.csv")])
    assert refused.exit_code == 1
    assert "nowhere.csv: cannot be read" in str(refused.output)
