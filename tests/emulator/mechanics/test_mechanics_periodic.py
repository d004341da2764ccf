"""Contact model periodic: its parent's ripple at a fraction of the cost, at any load, place and direction."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Surface
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.mechanics.periodic import Periodic

AZIMUTH = np.array([180.0, 0.0])
LOAD_N = 15.0 / 9
PRESS, SLIDE, STEP_MM = 10, 150, 0.02


def protocol(load_n: float, direction_deg: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Press, then slide 3 mm; two taxels."""
    load = np.concatenate([np.linspace(0, load_n, PRESS), np.full(SLIDE, load_n)])
    way = np.concatenate([np.zeros(PRESS), STEP_MM * np.arange(1, SLIDE + 1)])
    course = np.array([np.cos(np.deg2rad(direction_deg)), np.sin(np.deg2rad(direction_deg))])
    base = way[:, None, None] * course + np.array([[0.0, 0.0], [0.37, 1.1]])
    return np.repeat(load[:, None], 2, axis=1), base


def ripple(values: FloatArray, base: FloatArray, surface: Surface) -> NDArray[np.complex128]:
    """Fundamental of each taxel's values by its own groove phase, over the sliding part."""
    angle = np.deg2rad(surface.angle_deg)
    turn = (base @ np.array([np.cos(angle), np.sin(angle)]))[PRESS + 40 :] * 2 * np.pi / surface.period_mm
    found = []
    for k in range(values.shape[1]):
        basis = np.stack([np.ones(len(turn)), np.cos(turn[:, k]), np.sin(turn[:, k])], axis=1)
        _, cosine, sine = np.linalg.lstsq(basis, values[PRESS + 40 :, k])[0]
        found.append(cosine - 1j * sine)
    return np.array(found)


@pytest.mark.parametrize(
    ("surface", "load_n", "direction_deg"),
    [
        (Surface(0.6, 1.2, 30.0, 0.1), 1.9, 0.0),  # a load between the tables'
        (Surface(0.6, 1.5, 0.0, 0.1), 1.9, 180.0),
    ],
)
def test_ripple_is_that_of_compliance(surface: Surface, load_n: float, direction_deg: float) -> None:
    load, base = protocol(load_n, direction_deg)
    own = Periodic(surface, AZIMUTH, 2, "half").run(load, base, 0.01)
    parent = Compliance(surface, AZIMUTH, 2, "half").run(load, base, 0.01)
    for side in (0, 1):
        ratio = ripple(own.side_n[..., side], base, surface) / ripple(parent.side_n[..., side], base, surface)
        assert np.abs(np.abs(ratio) - 1).max() < 0.1
        assert np.abs(np.angle(ratio, deg=True)).max() < 5
    np.testing.assert_allclose(own.normal_n, parent.normal_n, atol=1e-4)
    hold_n = parent.side_n[PRESS - 1].mean()
    # The way from rest into sliding is a blend: measured 11 % of the hold at most.
    assert np.abs(own.side_n - parent.side_n).max() < 0.11 * hold_n


def test_chunking_changes_nothing_and_reset_is_new() -> None:
    load, base = protocol(LOAD_N)
    model = Periodic(Surface(0.6, 1.2, 0.0, 0.1), np.array([0.0, 90.0, 180.0, 270.0]), 2)  # a shipped table
    whole = model.run(load, base, 0.01)
    model.reset()
    parts = [model.step(load[k], base[k], 0.01) for k in range(len(load))]
    for name, values in vars(whole).items():
        np.testing.assert_array_equal(np.array([vars(part)[name] for part in parts]), values)


@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_forces_are_finite_at_any_load_and_direction(friction: float) -> None:
    load = np.array([0.0, 1e-9, 1e-3, 0.05, 1.0, 1.0, 1.0, 1.0, 0.0, 20.0, 1.0, 1.0])[:, None]
    x = np.array([0, 0, 0, 0, 0, 0.5, 0.5, 0.2, 0.2, 0.2, 0.2, 50.2])
    y = np.array([0, 0, 0, 0, 0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5])
    model = Periodic(Surface(friction, 1.2, 0.0, 0.1), AZIMUTH, 1)
    felt = model.run(load, np.stack([x, y], axis=-1)[:, None], 0.01)
    assert all(np.isfinite(values).all() for values in vars(felt).values())
    assert not felt.side_n[[0, 8]].any()
    assert (felt.side_n >= 0).all()
    np.testing.assert_array_equal(felt.normal_n, load)


def test_a_flat_plate_and_a_slide_along_the_grooves_have_no_ripple() -> None:
    load, base = protocol(LOAD_N, 90.0)
    for surface in (Surface(0.6), Surface(0.6, 1.2, 0.0, 0.1)):
        felt = Periodic(surface, AZIMUTH, 2).run(load, base, 0.01)
        assert np.ptp(felt.side_n[-50:], axis=0).max() < 1e-9
