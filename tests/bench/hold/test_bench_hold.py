"""The hold bench against the emulator, and its numbers against what is known of them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from bench.hold.batch import ARRAY, RATE_HZ, STEP_S, HeldBatch
from bench.hold.bench import aims
from bench.hold.play import DOWN_S, RESTART_S, Episodes, GraspResult, least_n, play, reaction_s
from tactiled.client.subscriber import STALE_AFTER_S
from tactiled.emulator.control import move_grip
from tactiled.emulator.scene.contact import make_contact
from tactiled.emulator.scene.families.holding import EVENTS, LIFTED_S, hold
from tactiled.emulator.scene.motion import SceneMotion


def test_the_batch_moves_as_the_emulator_does() -> None:
    scenes = [hold(seed) for seed in (510, 511)]
    batch = HeldBatch(scenes)
    contacts = [make_contact(SceneMotion(scene), ARRAY) for scene in scenes]
    for scan in range(300):
        batch.scan()
        at_s = np.array([(scan + 1) / RATE_HZ - STEP_S])
        states = [contact.state(at_s) for contact in contacts]
        if scan == 200:
            batch.command(np.full(2, 9.0))
            for contact in contacts:
                move_grip(contact, 9.0)
    np.testing.assert_allclose(batch.grip_n, [state.load_n[0] for state in states], atol=1e-9)
    np.testing.assert_allclose(batch.place_mm, [state.travel_mm[0] for state in states], atol=2e-4)


def test_twice_the_least_holds_a_lift_and_less_than_the_least_does_not() -> None:
    scenes = [scene for scene in map(hold, range(40)) if scene.description == "none"][:4]
    at_rest_s = np.array([LIFTED_S + 0.4])
    batch = HeldBatch(scenes)
    batch.command(np.array([2.0, 2.0, 0.9, 0.9]) * [least_n(scene, at_rest_s)[0] for scene in scenes])
    for _ in range(batch.n_scans):
        batch.scan()
    assert batch.has_fallen.tolist() == [False, False, True, True]


def test_a_seed_has_each_event_and_the_same_length() -> None:
    scenes = [hold(seed) for seed in range(40)]
    assert {scene.description for scene in scenes} == set(EVENTS)
    assert {round(scene.duration_s, 9) for scene in scenes} == {7.0}


def test_reaction_counts_from_the_slip_and_may_be_ahead_of_it() -> None:
    slides, command_n = np.zeros(100, dtype=np.bool_), np.full(100, 6.0)
    slides[50:60] = True
    after, ahead = command_n.copy(), command_n.copy()
    after[54:] = ahead[45:] = 9.0
    assert reaction_s(slides, after) == pytest.approx(0.04)
    assert reaction_s(slides, ahead) == pytest.approx(-0.05)
    assert np.isinf(reaction_s(slides, command_n))
    assert np.isnan(reaction_s(np.zeros_like(slides), after))


def test_grip_over_the_least_is_of_grasps_that_hold() -> None:
    grip_n, blank = np.full((700, 2), 8.0), np.zeros((700, 2))
    dropped = np.array([False, True])
    episodes = Episodes([hold(0), hold(1)], grip_n, grip_n / 2, grip_n, blank > 0, blank, dropped)
    assert [one.dropped for one in episodes.results()] == [False, True]
    np.testing.assert_equal([one.over_least for one in episodes.results()], [2.0, np.nan])


class Listener:
    """Controller that grips firmly; it notes what it gets, and how often it is blind."""

    def __init__(self) -> None:
        self.heard: list[tuple[float, str]] = []
        self.n_blind = 0

    def take(self, message: Mapping[str, Any], _present_n: float) -> float:
        self.heard.append((message["timestamp"], message["state"]))
        return 20.0

    def blind(self) -> float:
        self.n_blind += 1
        return 21.0


def test_a_daemon_that_restarts_is_silent_and_then_does_not_know_the_contact() -> None:
    listener = Listener()
    episodes = play([hold(500)], [listener], restarts=True)
    times_s = [at_s for at_s, _ in listener.heard]
    silent = int(np.argmax(np.diff(times_s)))
    assert times_s[silent] < RESTART_S <= times_s[silent] + 1 / RATE_HZ
    assert times_s[silent + 1] - times_s[silent] == pytest.approx(DOWN_S + 1 / RATE_HZ)
    assert listener.n_blind == round((DOWN_S - STALE_AFTER_S) * RATE_HZ)
    assert listener.heard[silent][1] != "unknown"
    assert listener.heard[silent + 1][1] == "unknown"
    scan = round((RESTART_S + DOWN_S) * RATE_HZ) - 1
    assert episodes.command_n[scan, 0] == 21.0


def test_aims_are_judged_on_drops_and_on_what_held() -> None:
    held = [GraspResult("none", False, 1.3, 0.0, float("nan"))] * 199
    lost = [GraspResult("none", True, float("nan"), 20.0, 0.05)]
    assert [aim.verdict for aim in aims(held * 5 + lost)] == ["met", "met"]  # 1 of 996: below 0.48 %
    assert [aim.verdict for aim in aims(held * 4 + lost)] == ["open", "met"]
    assert [aim.verdict for aim in aims(held)] == ["open", "met"]
    assert [aim.verdict for aim in aims(held[:98] + lost)] == ["MISSED", "met"]
