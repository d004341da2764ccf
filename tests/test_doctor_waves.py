"""What the doctor says of an array's gratings, against a search over pairs of waves."""

import numpy as np
import pytest

from tactiled.array import Array, load_array
from tactiled.detect.texture_joint import JointParams
from tactiled.doctor.waves import check_waves, closest_rivals_rad

WANG = load_array("wang2019-3x3")
EQUAL = load_array("normal-3x3")


def apart_rad(array: Array, first: np.ndarray, second: np.ndarray) -> float:
    """By which the phases of two waves differ, a common one taken out by trying all."""
    phase = np.stack([array.x_mm, array.y_mm], axis=1) @ (first - second)
    tried = phase[:, None] - np.linspace(-np.pi, np.pi, 721)
    return float(np.sqrt((np.angle(np.exp(1j * tried)) ** 2).mean(axis=0)).min())


def test_no_pair_of_waves_is_closer_than_said() -> None:
    rng = np.random.default_rng(4)
    (said,) = closest_rivals_rad(WANG, (1.0,)).values()
    beam = 2 * np.pi / 7.3
    for _ in range(2000):
        sizes = 2 * np.pi / rng.uniform(1.0, 3.0, 2)
        turns = rng.uniform(-np.pi, np.pi, 2)
        first, second = (s * np.array([np.cos(t), np.sin(t)]) for s, t in zip(sizes, turns, strict=True))
        if np.linalg.norm(first - second) > beam:
            assert apart_rad(WANG, first, second) > said - 0.01


def test_the_vernier_tells_what_equal_gaps_cannot() -> None:
    """3.5 and 3.8 mm: dk = 2 pi / 3.65 mm leaves a residue of 0.15 / 3.65 turns at one row of three."""
    residues = 2 * np.pi * np.array([0.0, 3.5 / 3.65 - 1, 0.0])
    expected = float(np.std(residues))
    assert closest_rivals_rad(WANG, (2.0,))[2.0] == pytest.approx(expected, abs=0.01)
    assert closest_rivals_rad(EQUAL, (2.0,))[2.0] < 0.01
    (warning, _) = check_waves(EQUAL, JointParams(), 100.0, 0.0)
    assert warning.verdict == "warn"
    assert "unequal gaps" in warning.remedy
    (good, _) = check_waves(WANG, JointParams(), 100.0, 0.0)
    assert good.verdict == "ok"


def test_one_taxel_tells_no_angle_and_fast_slides_alias() -> None:
    x_mm, y_mm = WANG.x_mm.copy(), WANG.y_mm.copy()
    x_mm[:], y_mm[:] = 0.0, 0.0
    one = WANG.__class__(**{**vars(WANG), "x_mm": x_mm, "y_mm": y_mm})
    (none, fast) = check_waves(one, JointParams(), 100.0, 60.0)
    assert "no angle" in none.words
    assert fast.verdict == "warn"
    assert "1.200 mm" in fast.words
