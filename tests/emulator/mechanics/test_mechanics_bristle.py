"""What bristle alone has: slip that spreads from the rim of the patch."""

import numpy as np

from tactiled.emulator.mechanics.base import Surface
from tactiled.emulator.mechanics.bristle import Bristle
from tactiled.emulator.mechanics.lumped import Lumped
from tactiled.emulator.mechanics.stepper import play

SIDES = np.array([180.0, 270.0, 0.0, 90.0])


def test_slip_spreads_smoothly_over_the_patch() -> None:
    base = np.zeros((300, 1, 2))
    base[:, 0, 0] = np.linspace(0, 0.35, 300)
    share = play(Bristle(Surface(0.6), SIDES, 1), "force", np.full((300, 1), 1.667), base, 1e-3).slipping[
        :, 0
    ]
    assert np.all(np.diff(share) >= 0)
    assert np.diff(share).max() < 0.035  # four bristles of some 140, by symmetry
    assert 0.4 < share[110] < 0.6
    assert share[-1] == 1.0


def test_a_firmer_grip_stops_incipient_slip() -> None:
    base = np.zeros((30, 1, 2))
    base[:, 0, 0] = np.concatenate([np.linspace(0, 0.1, 20), 0.1 + np.linspace(5e-5, 5e-4, 10)])
    load = np.array([1.5] * 20 + [3.0] * 10)[:, None]
    felt = play(Bristle(Surface(0.6), SIDES, 1), "force", load, base, 1e-3)
    assert felt.slipping[19, 0] > 0.3
    assert felt.slipping[20:, 0].max() < 0.1


def test_both_rungs_bear_the_same_load_and_slide_alike() -> None:
    base = np.zeros((200, 4, 2))
    base[:, :, 1] = np.linspace(0, 1.5, 200)[:, None]
    depth = np.broadcast_to(np.array([0.02, 0.08, 0.17, 0.3]), (200, 4))
    felt = [play(r(Surface(0.4), SIDES, 4), "displacement", depth, base, 1e-3) for r in (Lumped, Bristle)]
    np.testing.assert_allclose(felt[0].normal_n, felt[1].normal_n)
    np.testing.assert_allclose(felt[0].tangential_n[-1], felt[1].tangential_n[-1], rtol=1e-9, atol=1e-12)
