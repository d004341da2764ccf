"""The controller of a grasp: laws of one message after another."""

import itertools
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tactiled.client import GripController, grip_controller


def grip(at_s: float, shear: float = 1.0, load: float = 4.0, **rest: Any) -> dict[str, Any]:
    return {
        "timestamp": at_s, "load": load, "shear_x": shear, "shear_y": 0.0, "state": "sticking", "valid": True,
        "late": False, "friction_low": 0.5, "friction": 0.6, "p_gross_100ms": 0.0,
    } | rest  # fmt: skip


def played(controller: Any, messages: list[dict[str, Any]], present_n: float = 6.0) -> list[float]:
    return [controller.take(message, present_n) for message in messages]


def pressed(**limits: float) -> Any:
    """Controller that has pressed for a second, without a weight."""
    controller = GripController(start_n=6.0, **limits)
    played(controller, [grip(-1.0, shear=0.0)])
    return controller


def test_the_grip_is_kept_while_the_fingers_press() -> None:
    controller = GripController(start_n=6.0)
    pressing = [
        grip(k / 100, shear=4.0, state="gross") for k in range(round(100 * grip_controller.PRESS_S) - 1)
    ]
    assert set(played(controller, pressing)) == {6.0}
    assert played(controller, [grip(grip_controller.PRESS_S, shear=4.0, state="gross")]) != [6.0]


def test_the_grip_eases_to_the_target_and_no_further() -> None:
    # Shear over load is 0.25 at 6 N, half of what the bound bears: 6 N * 0.5 / TARGET is enough.
    controller = pressed()
    present_n = 6.0
    for k in range(600):
        present_n = controller.take(grip(k / 100, load=4.0 * present_n / 6.0), present_n)
    assert present_n == pytest.approx(6.0 * 0.5 / grip_controller.TARGET, rel=0.05)


def test_growing_shear_is_met_before_it_arrives() -> None:
    controller = pressed()
    played(controller, [grip(k / 100) for k in range(10)])
    growing = played(controller, [grip(0.1 + k / 100, shear=1.0 + 0.2 * k) for k in range(1, 6)])
    enough_n = 6.0 / 4.0 * 2.0 / (0.5 * grip_controller.TARGET)  # for the shear of the last message
    assert growing[-1] > enough_n


def test_gross_slip_tightens_beyond_the_present_force() -> None:
    controller = pressed()
    played(controller, [grip(k / 100) for k in range(10)])
    assert controller.take(grip(0.1, state="gross"), 6.0) >= grip_controller.GRASP_AGAIN * 6.0


def test_shear_that_drops_at_once_and_stays_is_a_slip_and_a_shear_that_goes_on_falling_is_none() -> None:
    for after, is_slip in ((1.9, True), (1.8, False)):
        controller = pressed()
        played(controller, [grip(k / 100, shear=1.5 + k / 100) for k in range(50)])
        before_n = played(controller, [grip(0.5, shear=2.0), grip(0.51, shear=1.9)])[-1]
        after_n = controller.take(grip(0.52, shear=after), before_n)
        assert (after_n >= grip_controller.GRASP_AGAIN * before_n * 0.99) == is_slip


@given(fall_per_s=st.floats(0.05, 5.0), rate_hz=st.integers(20, 1000))
@example(fall_per_s=1.1, rate_hz=100)
@example(fall_per_s=1.1, rate_hz=30)
def test_shear_that_falls_evenly_is_no_slip(fall_per_s: float, rate_hz: int) -> None:
    controller = pressed()
    falls_s = min(0.3, 0.8 / fall_per_s)
    messages = [
        grip(at_s, shear=1.0 - fall_per_s * max(at_s - 0.3, 0.0))
        for at_s in np.arange(0.0, 0.3 + falls_s, 1 / rate_hz).tolist()
    ]
    assert max(played(controller, messages)) <= 6.0


@pytest.mark.parametrize(("shear_follows", "is_slip"), [(1.0, True), (0.0, False)])
def test_shear_that_follows_an_easing_grip_is_a_slip(shear_follows: float, is_slip: bool) -> None:
    controller = pressed()
    played(controller, [grip(k / 100, shear=1.0) for k in range(60)])
    tighter = []
    for k in range(1, 13):
        force_n = 6.0 * (1 - 0.005 * k)
        shear = 1.0 * (force_n / 6.0) ** shear_follows
        before_n = controller.command_n
        tighter += [controller.take(grip(0.6 + k / 100, shear, 4.0 * force_n / 6.0), force_n) > before_n]
    assert any(tighter) == is_slip


@pytest.mark.parametrize("sway_hz", [0.7, 2.0, 5.0, 8.0])
@pytest.mark.parametrize("sway", [0.02, 0.05, 0.2])
def test_an_object_that_sways_and_sticks_is_not_gripped_ever_harder(sway_hz: float, sway: float) -> None:
    controller, present_n, grips = pressed(), 6.0, []
    for k in range(6000):
        shear = 1.0 + sway * math.sin(2 * math.pi * sway_hz * k / 100)
        present_n += 0.2 * (controller.command_n - present_n)  # the gripper follows within 50 ms
        controller.take(grip(k / 100, shear=shear, load=4.0 * present_n / 6.0), present_n)
        grips.append(present_n)
    most_n = 6.0 / 4.0 * (1.0 + sway) / (0.4 * 0.5 * grip_controller.TARGET)
    assert max(grips) < 1.3 * most_n  # friction of 0.5 is what the messages bound; jerks are met ahead


def largest_n(rate_hz: int, shear_at: Callable[[float], float]) -> float:
    """Play shear for 3.3 s to a gripper that follows at once; return the largest command after 3 s."""
    controller, present_n, commands = pressed(), 6.0, list[float]()
    for k in range(round(3.3 * rate_hz) + 1):
        at_s = k / rate_hz
        present_n = controller.take(grip(at_s, shear_at(at_s), load=4.0 * present_n / 6.0), present_n)
        commands.append(present_n)
    return max(commands[3 * rate_hz :])


MOTIONS: dict[str, Callable[[float], float]] = {  # shear of an object that sticks
    "jerk": lambda at_s: 1.0 + 10.0 * min(max(at_s - 3.0, 0.0), 0.1),
    "sway": lambda at_s: 1.0 + 0.2 * math.sin(10 * math.pi * at_s),
    "slow sway": lambda at_s: 1.0 + 0.2 * math.sin(4 * math.pi * at_s),
    "set down": lambda at_s: 1.0 - max(at_s - 3.0, 0.0) / 0.3,
}


@pytest.mark.parametrize(
    ("motion", "rate_hz"),
    [
        *itertools.product(("jerk", "set down"), (20, 50, 500, 1000)),
        *itertools.product(("sway",), (500, 1000)),  # 5 Hz have too few scans at the others
        *itertools.product(("slow sway",), (200, 500, 1000)),
    ],
)
def test_an_object_that_moves_and_sticks_is_gripped_alike_at_every_rate(motion: str, rate_hz: int) -> None:
    shear_at = MOTIONS[motion]
    assert largest_n(rate_hz, shear_at) == pytest.approx(largest_n(100, shear_at), rel=0.03)


@given(st.floats(1.0, 40.0, width=32), st.sampled_from([np.float32, np.float64, np.array, str]))
def test_a_force_counts_whatever_its_type(present_n: float, kind: Any) -> None:
    messages = [grip(k / 100) for k in range(100)]
    assert played(pressed(), messages, kind(present_n)) == played(pressed(), messages, present_n)


def test_a_gross_slip_in_the_first_message_that_counts_bounds_friction_by_what_is_known_of_it() -> None:
    commands = []
    for first in ("sticking", "gross"):
        controller, present_n = pressed(), 6.0
        for k in range(600):
            message = grip(k / 100, min(1.0, 0.05 + 0.02 * k), load=4.0 * present_n / 6.0)
            present_n = controller.take(message | {"state": first if k == 0 else "sticking"}, present_n)
        commands.append(present_n)
    assert commands[1] == pytest.approx(commands[0], rel=0.1)


@pytest.mark.parametrize("angle", [0.5, math.pi / 2, 4.0])
def test_shear_counts_alike_in_every_direction(angle: float) -> None:
    along_x = [grip(k / 100, shear=1.0 + k / 100) for k in range(200)]
    turned = [
        message
        | {"shear_x": message["shear_x"] * math.cos(angle), "shear_y": message["shear_x"] * math.sin(angle)}
        for message in along_x
    ]
    assert played(pressed(), turned) == pytest.approx(played(pressed(), along_x))


@given(st.sampled_from([{"valid": False}, {"late": True}, {"state": "none"}, {"load": 0.0}]))
def test_what_cannot_be_trusted_changes_nothing(fault: dict[str, Any]) -> None:
    controller = pressed()
    before_n = played(controller, [grip(k / 100) for k in range(50)])[-1]
    assert controller.take(grip(0.5, shear=50.0) | fault, 6.0) == before_n


@given(
    st.sampled_from(["timestamp", "shear_x", "shear_y", "load", "friction", "friction_low", "state"]),
    st.sampled_from([math.nan, math.inf, -math.inf, 1.7e308, "1", None, [1.0]]),
)
def test_values_that_are_no_numbers_change_nothing_then_or_later(name: str, number: Any) -> None:
    controller, undisturbed = pressed(), pressed()
    before, after = [grip(k / 100) for k in range(50)], [grip(0.5 + k / 100) for k in range(300)]
    kept_n = played(controller, before)[-1]
    assert controller.take(grip(0.495) | {name: number}, 6.0) == kept_n
    assert controller.take({key: value for key, value in grip(0.495).items() if key != name}, 6.0) == kept_n
    played(undisturbed, before)
    assert played(controller, after) == played(undisturbed, after)


@given(st.floats(0.001, 1e6))
def test_a_clock_that_is_set_back_moves_the_grip_by_little(by_s: float) -> None:
    controller = pressed()
    held_n = played(controller, [grip(k / 100) for k in range(600)])[-1]
    after = played(controller, [grip(6.0 - by_s + k / 100) for k in range(600)])
    assert after == pytest.approx([held_n] * 600, rel=0.01)
    slipping = controller.take(grip(12.0 - by_s, state="gross"), 6.0)
    assert slipping >= 1.3 * held_n  # and a slip is answered at once


def test_after_a_clock_that_is_set_back_shear_that_follows_an_easing_grip_is_a_slip() -> None:
    controller = pressed()
    played(controller, [grip(1000.0 + k / 100, shear=1.5 + k / 100) for k in range(50)])
    before_n = controller.command_n
    dropped = [grip(1000.5 + k / 100, shear=shear) for k, shear in enumerate((2.0, 1.9, 1.9))]
    assert played(controller, dropped)[-1] > before_n
    held_n = played(controller, [grip(900.0 + k / 100) for k in range(300)])[-1]
    easing = [
        controller.take(grip(903.0 + k / 100, 1 - 0.005 * k, 4.0 - 0.02 * k), 6.0 - 0.03 * k)
        for k in range(1, 13)
    ]
    assert max(easing) > 1.2 * held_n


GAP = {"state": "none", "valid": False, "load": 0.0, "friction": 0.0, "friction_low": 0.0}  # as a gap is sent


def test_a_gap_of_80_ms_forgets_neither_the_object_nor_its_friction() -> None:
    controller, gapless = pressed(), pressed()
    before = [grip(k / 100, friction_low=2.0, friction=2.4) for k in range(300)]
    after = [grip(3.08 + k / 100, friction_low=0.1, friction=2.4) for k in range(100)]  # which knows less
    played(gapless, before)
    kept_n = played(controller, before)[-1]
    assert controller.take(grip(2.99) | GAP, 6.0) == kept_n
    assert played(controller, after) == played(gapless, after)


def test_slip_right_after_a_gap_is_answered_at_once() -> None:
    controller = pressed()
    played(controller, [grip(k / 100) for k in range(100)])
    controller.take(grip(0.99) | GAP, 6.0)
    assert controller.take(grip(1.08, state="gross"), 6.0) >= grip_controller.GRASP_AGAIN * 6.0


def test_a_pause_of_any_length_and_a_clock_set_forward_are_no_other_object() -> None:
    for is_stale in (False, True):
        controller = pressed()
        played(controller, [grip(k / 100) for k in range(100)])
        if is_stale:
            controller.take(grip(0.99, state="none"), 6.0)  # and then nobody sees whether it came back
            controller.blind()
        assert controller.take(grip(3600.0, state="gross"), 6.0) >= grip_controller.GRASP_AGAIN * 6.0


def test_a_contact_that_flickers_is_the_same_object() -> None:
    controller = pressed()
    played(controller, [grip(k / 100) for k in range(100)])
    controller.take(grip(1.0, state="none"), 6.0)
    assert controller.take(grip(1.1, state="gross"), 6.0) >= grip_controller.GRASP_AGAIN * 6.0


@pytest.mark.parametrize("reading", [0.0, -12.0, math.nan, math.inf, 5e-324, None, "6"])
def test_a_gripper_without_a_reading_keeps_its_hold_and_answers_a_slip(reading: Any) -> None:
    controller = pressed()
    held_n = played(controller, [grip(k / 100) for k in range(600)])[-1]
    after = played(controller, [grip(6.0 + k / 100) for k in range(300)], reading)
    assert after == pytest.approx([held_n] * 300, rel=0.01)
    assert controller.take(grip(9.0, state="gross"), reading) >= grip_controller.GRASP_AGAIN * held_n


def test_the_limit_of_an_unseen_contact_ends_with_its_state() -> None:
    """A gross slip is then answered up to what it would be answered with after a beginning that was seen."""
    commands = []
    for state in ("unknown", "sticking"):
        controller = GripController(start_n=3.0)
        played(controller, [grip(k / 100, state=state) for k in range(150)], 3.0)
        for k in range(150, 600):
            is_gross = k > 300
            message = grip(k / 100, 6.0 if is_gross else 1.0, state="gross" if is_gross else "sticking")
            controller.take(message, controller.command_n)
        commands.append(controller.command_n)
    assert commands[0] == pytest.approx(commands[1], rel=0.01)


def test_messages_of_another_board_change_nothing() -> None:
    controller, alone = pressed(), pressed()
    for k in range(200):
        message = grip(k / 100, state="gross" if k > 100 else "sticking", board="left")
        alone.take(message, 6.0)
        controller.take(message, 6.0)
        for other in ({"state": "none"}, {"friction_low": 3.0, "friction": 4.0}):
            assert controller.take(grip(k / 100, board="right") | other, 6.0) == alone.command_n


def test_a_load_next_to_zero_is_no_load() -> None:
    controller = pressed()
    loads = [grip(k / 100, load=5e-324, shear=0.0) for k in range(200)]
    assert set(played(controller, loads)) == {6.0}


def test_another_object_is_met_without_what_was_learnt() -> None:
    controller = GripController(start_n=6.0)
    played(controller, [grip(k / 100, friction_low=2.0, friction=2.2) for k in range(300)])
    command_n = controller.take(grip(3.0, state="none"), 6.0)
    again = [grip(4.0 + k / 100) for k in range(300)]
    assert played(controller, again) == played(GripController(start_n=command_n), again)


def test_a_contact_whose_beginning_was_not_seen_is_held_by_its_shear_and_by_what_was_learnt_before() -> None:
    """A daemon that is started anew knows less of friction, and nothing of the beginning."""
    controller, undisturbed = pressed(), pressed()
    for each in (controller, undisturbed):
        played(each, [grip(k / 100, shear=1.5) for k in range(300)])
        each.blind()
    after = [grip(4.0 + k / 100, shear=1.5) for k in range(500)]
    unseen = [message | {"state": "unknown", "friction_low": 0.2} for message in after]
    assert played(controller, unseen) == pytest.approx(played(undisturbed, after), rel=0.1)


@pytest.mark.parametrize("again_s", [6.5, 5.0])  # also by a clock that was set back meanwhile
def test_stale_data_tighten_once_and_ease_nothing_for_a_second(again_s: float) -> None:
    controller = pressed()
    before_n = played(controller, [grip(k / 100) for k in range(600)])[-1]
    tight_n = controller.blind()
    assert tight_n == controller.blind() == pytest.approx(grip_controller.BLIND * before_n, rel=0.02)
    assert played(controller, [grip(again_s + k / 100) for k in range(90)])[-1] == tight_n
    assert played(controller, [grip(again_s + 1 + k / 100) for k in range(300)])[-1] < 0.9 * tight_n


@given(
    st.lists(
        st.tuples(
            st.floats(0, 50), st.floats(0.01, 50), st.floats(0.01, 5), st.sampled_from(["sticking", "gross"])
        ),
        max_size=30,
    )
)
def test_commands_stay_within_the_limits(rows: list[tuple[float, float, float, str]]) -> None:
    controller = pressed(least_n=1.0, most_n=20.0)
    for k, (shear, load, friction, state) in enumerate(rows):
        message = grip(k / 100, shear, load, friction_low=friction, friction=1.2 * friction, state=state)
        assert 1.0 <= controller.take(message, 6.0) <= 20.0


def test_the_example_is_short_and_imports_the_client_alone() -> None:
    lines = (Path(__file__).parents[2] / "examples" / "hold.py").read_text().splitlines()
    imported = {line.split()[1] for line in lines if line.startswith(("import ", "from "))}
    assert imported - set(sys.stdlib_module_names) == {"tactiled.client"}
    assert len(lines) <= 60


def test_the_example_without_an_argument_says_how_it_is_used() -> None:
    example = Path(__file__).parents[2] / "examples" / "hold.py"
    done = subprocess.run([sys.executable, example], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.split()[0], done.stderr.count("\n")) == (1, "usage:", 1)


@pytest.mark.parametrize("states", [("unknown",), ("unknown", "partial")])
def test_shear_that_grows_with_the_grip_does_not_tighten_it_without_end(states: tuple[str, ...]) -> None:
    """A contact that nobody saw begin, in which pressing makes shear of a quarter of the load."""
    controller, present_n = GripController(start_n=6.0), 6.0
    for k in range(1000):
        state = states[k // 40 % len(states)]
        message = grip(k / 100, load=present_n, shear=0.25 * present_n, friction_low=0.2, state=state)
        present_n += 0.5 * (controller.take(message, present_n) - present_n)
    assert 6.0 < present_n < 1.75 * 6.0
