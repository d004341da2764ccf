"""Mechanics of gradual slip against the closed forms of Mindlin and Masing."""

import numpy as np
import pytest

from tactiled.array import FloatArray
from tactiled.detect.grip.rings import N_RINGS, RingForces, mindlin_rings

MU = 0.6


def mindlin(x: FloatArray) -> FloatArray:
    """Force over limit at a travel over the travel at gross slip."""
    return np.asarray(1 - (1 - np.clip(x, 0, 1)) ** 1.5)


@pytest.mark.parametrize("n", [N_RINGS, 40])
def test_loading_curve_is_mindlins_within_the_error_of_its_chords(n: int) -> None:
    rings = mindlin_rings(n)
    x = np.linspace(0, 1, 2001)
    # A chord of length h lies below the curve by at most h^2 / 8 times the largest curvature in it; the last
    # one, whose curvature has no bound, by less than the curve's own rise within it.
    ends = 1 - (1 - np.arange(n + 1) / n) ** (4 / 3)
    length = np.diff(ends)
    bound = np.append(length[:-1] ** 2 / 8 * 0.75 / np.sqrt(1 - ends[1:-1]), length[-1] ** 1.5)
    first_slope = float((rings.limit / (ends[1:] * rings.stiffness)).mean())
    curve = np.minimum(first_slope * rings.stiffness[:, np.newaxis] * x, rings.limit[:, np.newaxis]).sum(
        axis=0
    )
    error = mindlin(x) - curve
    assert error.min() > -1e-12
    assert error.max() <= bound.max() + 1e-12
    assert rings.limit.sum() == pytest.approx(1)
    assert rings.stiffness.sum() == pytest.approx(1)


def forces_along(totals: FloatArray, load: FloatArray, x: FloatArray) -> FloatArray:
    """Shears (n, taxels) along x of taxels that bear totals one after the other."""
    rings = RingForces(np.array([MU]), x, np.zeros_like(x), mindlin_rings(40))
    out = np.zeros((len(totals), len(load)))
    for k, total in enumerate(totals):
        rings.advance(load, np.array([total, 0.0, 0.0]))
        out[k] = rings.taxel_forces()[0, 0]
    return out


def test_taxels_bear_the_total_and_the_lightly_loaded_one_slips_first() -> None:
    load = np.array([0.3, 1.0, 2.0])
    up = np.linspace(0, 0.9, 90) * MU * load.sum()
    forces = forces_along(up, load, np.array([-1.0, 0.0, 1.0]) * 0)
    np.testing.assert_allclose(forces.sum(axis=1), up, atol=2e-3 * up[-1])
    used = forces / (MU * load)
    assert np.all(np.diff(used[10:], axis=1) < 0)  # the lighter, the nearer to its limit
    # Limits go as P and stiffness as P^(1/3), so travels at gross slip go as P^(2/3) (Johnson 7.2).
    travel = 1 - (1 - used[30]) ** (2 / 3)
    np.testing.assert_allclose(travel * load ** (2 / 3), np.mean(travel * load ** (2 / 3)), rtol=0.03)


def test_unloading_follows_the_doubled_curve() -> None:
    load = np.array([1.0, 1.0])
    turn = 0.8 * MU * load.sum()
    totals = np.concatenate([np.linspace(0, turn, 200), np.linspace(turn, -0.5 * turn, 400)])
    rings = RingForces(np.array([MU]), np.array([0.0, 0.0]), np.array([0.0, 0.0]), mindlin_rings(40))
    reference = RingForces(np.array([MU]), np.array([0.0]), np.array([0.0]), mindlin_rings(40))
    for total in totals:
        rings.advance(load, np.array([total, 0.0, 0.0]))
    # Masing: the share of rings that slid back by 2 d is that which slid by d on first loading from rest.
    for total in np.linspace(0, (turn - totals[-1]) / 4, 200):
        reference.advance(load[:1], np.array([total, 0.0, 0.0]))
    assert rings.sliding_share()[0, 0] == pytest.approx(reference.sliding_share()[0, 0], abs=0.03)
    assert rings.sliding_share()[0, 0] > 0.1


def test_a_turn_moves_taxels_around_their_centre() -> None:
    x, y = np.array([1.0, 0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0, -1.0])
    rings = RingForces(np.array([MU]), x, y, mindlin_rings())
    for moment in np.linspace(0, 0.5 * 4 * MU, 30):
        rings.advance(np.ones(4), np.array([0.0, 0.0, moment]))
    along_x, along_y = rings.taxel_forces()[:, 0]
    np.testing.assert_allclose(along_x, -y * 0.5 * MU, atol=0.01)
    np.testing.assert_allclose(along_y, x * 0.5 * MU, atol=0.01)


def test_no_load_and_impossible_totals_give_finite_forces() -> None:
    rings = RingForces(np.array([0.1, 1.0]), np.zeros(3), np.zeros(3), mindlin_rings())
    for load in ([0.0, 0.0, 0.0], [1.0, 0.0, 2.0], [1e-300, 1e8, 1.0]):
        rings.advance(np.array(load), np.array([1e6, -1e6, 1e6]))
        forces = rings.taxel_forces()
        assert np.isfinite(forces).all()
        assert np.all(np.hypot(*forces) <= np.array([[0.1], [1.0]]) * np.array(load) * (1 + 1e-9) + 1e-12)


@pytest.mark.parametrize("n_steps", [25, 300])
def test_a_friction_below_the_total_slides_along_it_and_does_not_turn(n_steps: int) -> None:
    x, y = (a.ravel() for a in np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]))
    load = np.array([0.5, 1.0, 0.5, 1.0, 2.0, 1.0, 0.5, 1.0, 0.5])
    rings = RingForces(np.array([MU, 2 * MU]), x, y, mindlin_rings())
    whole = 1.3 * MU * load.sum()
    for k in range(n_steps):  # gains that differ make a moment that an even slide has not
        rings.advance(load, whole * min((k + 1) / 20, 1.0) * np.array([1.0, 0.0, 0.03]))
    along, across = rings.taxel_forces()[:, 0]
    np.testing.assert_allclose(along, MU * load, rtol=0.04)
    assert np.abs(across / (MU * load)).max() < 0.1
