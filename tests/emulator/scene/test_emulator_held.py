"""A held object: Newton's law, a grip that a controller moves, and the socket over which it does."""

import json
import os
import socket
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from patience import PATIENCE_S

from tactiled.array import load_array
from tactiled.emulator.control import ControlLines, has_fallen, move_grip
from tactiled.emulator.line.links import PtyLink, make_control_link
from tactiled.emulator.realtime import Emulator
from tactiled.emulator.scene.contact import make_contact
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.emulator.scene.truth import Truth
from tactiled.emulator.simulate import Simulation
from tactiled.errors import ConfigError
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Command
from tactiled.wire.layout import load_layout

V1 = load_layout("board-v1")
PRESS = {"kind": "press", "duration_s": 0.5, "force_n": 10.0}  # friction bears 6 N


def load(tangential_n: float, duration_s: float = 0.5, **rest: Any) -> dict[str, Any]:
    return {"kind": "load", "duration_s": duration_s, "tangential_n": tangential_n, **rest}


def held(*phases: dict[str, Any], **rest: Any) -> Scene:
    document = {"name": "held", "contact": "mechanics", "held_object": {}, "phases": list(phases), **rest}
    return Scene.model_validate(document)


def contact(scene: Scene) -> PhysicalContact:
    model = make_contact(SceneMotion(scene), load_array("wang2019-3x3"))
    assert isinstance(model, PhysicalContact)
    return model


@given(st.floats(0.05, 0.9), st.floats(-180, 180), st.floats(0.02, 20.0))
@settings(max_examples=5, deadline=None)
def test_below_the_limit_friction_balances_the_load(
    part: float, direction_deg: float, mass_kg: float
) -> None:
    pulled = load(6.0 * part, 1.0, direction_deg=direction_deg)
    hold = {"kind": "hold", "duration_s": 1.0}
    truth = Truth(held(PRESS, pulled, hold, held_object={"mass_kg": mass_kg}))
    state = truth.state(np.array([2.4]))
    x, y = -state.tangential_n[0].sum(axis=0)
    assert complex(x, y) == pytest.approx(6.0 * part * np.exp(1j * np.deg2rad(direction_deg)), abs=0.1)
    assert np.linalg.norm(state.velocity_mm_s) < 0.1
    assert truth.slips == []


def test_beyond_the_limit_it_accelerates_by_newtons_law() -> None:
    scene = held(
        PRESS,
        load(9.0, 0.001),
        {"kind": "hold", "duration_s": 0.5},
        held_object={"mass_kg": 2.0, "fall_mm": 500},
    )
    state = Truth(scene).state(np.array([0.7, 0.9]))
    acceleration = np.diff(state.velocity_mm_s[:, 0])[0] / 0.2
    assert acceleration == pytest.approx((9.0 - 6.0) / 2.0 * 1e3, rel=0.01)


def test_a_look_back_changes_no_grip_and_forgets_no_fall() -> None:
    scene = held(PRESS, load(5.0), {"kind": "hold", "duration_s": 2.0})
    looked, plain = contact(scene), contact(scene)
    for one in (looked, plain):
        one.state(np.array([1.2]))
        move_grip(one, 0.0)
        one.state(np.array([2.0]))
    looked.state(np.array([0.1]))
    assert has_fallen(plain)
    assert has_fallen(looked)
    for one in (looked, plain):
        move_grip(one, 8.0)
    at_s = np.array([0.3, 1.1, 1.9, 2.2, 2.9])
    assert looked.state(at_s).load_n.tolist() == plain.state(at_s).load_n.tolist()


def test_an_early_grip_keeps_the_object_and_a_late_one_loses_it() -> None:
    document = load_scene("grasp").model_dump()
    for phase in document["phases"]:
        phase["duration_s"] /= 2
    document["disturbances"][0]["start_s"] /= 2
    scene = Scene.model_validate(document)
    simulation, lost = Simulation(scene, V1), Truth(scene)
    for _ in simulation:
        state = simulation.truth.state(np.array([simulation.now_s]))
        if state.slipping_share[0] > 0.3:
            simulation.grip(float(state.load_n[0]) * 1.2)
    kept = simulation.truth
    assert len(lost.slips) == 1
    assert lost.state(np.array([lost.t0_s + 7.0])).travel_mm[0, 1] == pytest.approx(20.0)
    assert kept.slips == []
    assert kept.state(np.array([kept.t0_s + 7.0])).travel_mm[0, 1] < 0.5


def test_the_same_commands_at_the_same_instants_give_the_same_bits() -> None:
    def play() -> list[tuple[float, bytes]]:
        simulation = Simulation(load_scene("grasp"), V1, duration_s=3.0)
        out = []
        for k, arrival in enumerate(simulation):
            if k % 50 == 20:
                simulation.grip(10.0 + 0.1 * k)
            out.append(arrival)
        return out

    assert play() == play()


def test_a_controllers_grips_are_repeated_when_the_past_is_computed_again() -> None:
    model = contact(held(PRESS, load(3.0), {"kind": "hold", "duration_s": 7.0}))
    for time_s in np.arange(0, 2, 0.01):
        if 0.99 < time_s < 1.01:
            move_grip(model, 18.0)
        model.state(np.array([time_s]))
    instants = np.arange(0.9, 1.5, 0.01)
    first = model.state(instants)
    model.state(np.array([7.0]))  # the newest 4 s are kept
    again = model.state(instants)
    np.testing.assert_array_equal(first.load_n, again.load_n)
    np.testing.assert_array_equal(first.travel_mm, again.travel_mm)
    assert first.load_n[0] == 10.0
    assert first.load_n[-1] == pytest.approx(18.0)


def test_grip_follows_at_its_rate() -> None:
    model = contact(
        held(PRESS, load(1.0), {"kind": "hold", "duration_s": 2.0}, held_object={"grip_rate_n_s": 20.0})
    )
    model.play_until(1.0)
    move_grip(model, 20.0)
    grip_n = model.state(np.arange(1.1, 1.9, 0.01)).load_n
    assert np.diff(grip_n).max() <= 0.2 + 1e-9
    assert grip_n[-1] == pytest.approx(20.0)


def test_a_dragged_object_sticks_and_slips() -> None:
    truth = Truth(load_scene("stick-slip"))
    assert len(truth.slips) >= 5
    assert all(slip.direction_deg == 0.0 for slip in truth.slips)
    # The spring follows 20 mm; friction takes up to 7.5 N / 2 N/mm of it.
    assert 16.0 < truth.state(np.array([21.0])).travel_mm[0, 0] < 20.0


def test_a_released_object_falls() -> None:
    scene = held(PRESS, load(3.0), {"kind": "lift", "duration_s": 0.5}, {"kind": "rest", "duration_s": 1.0})
    model = contact(scene)
    model.play_until(2.4)
    assert has_fallen(model)
    assert np.hypot(*model.state(np.array([2.4])).travel_mm[0]) == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("phases", "rest", "finding"),
    [
        ([PRESS, load(1.0)], {"held_object": None}, "add .held_object"),
        ([load(1.0)], {}, "needs contact"),
        ([PRESS, {"kind": "slide", "duration_s": 1, "speed_mm_s": 1}], {}, "spring_n_mm"),
        ([PRESS, {"kind": "rotate", "duration_s": 1, "angle_deg": 1}], {}, "does not turn"),
        ([PRESS | {"surface": {"kind": "flat", "friction": 0.3}}], {}, "one surface"),
    ],
)
def test_impossible_held_objects_are_refused(phases: list[Any], rest: dict[str, Any], finding: str) -> None:
    with pytest.raises(ValueError, match=finding):
        held(*phases, **rest)


def test_impossible_grips_are_refused() -> None:
    model = contact(held(PRESS))
    for force_n in (-1.0, float("nan"), float("inf"), 1e9):
        with pytest.raises(ConfigError, match="not a force from 0 to 2000 N"):
            move_grip(model, force_n)
    plain = Simulation(load_scene("prescribed"), V1)
    with pytest.raises(ConfigError, match="nothing to grip"):
        plain.grip(1.0)


LINES = [
    b'{"grip_n": 12.5}',
    b"",
    b"{}",
    b"nonsense",
    b'{"grip": 1}',
    b"[]",
    b'{"grip_n": "much"}',
    b'{"grip_n": -4}',
    b'{"grip_n": true}',
]


def test_control_lines_answer_each_line_in_any_chunking() -> None:
    text = b"\n".join(LINES) + b"\n"
    lines = ControlLines(contact(held(PRESS, load(1.0))), 2.0)
    whole = lines.receive(text, 0.3)
    again = ControlLines(contact(held(PRESS, load(1.0))), 2.0)
    assert b"".join(again.receive(text[k : k + 1], 0.3) for k in range(len(text))) == whole
    answers = [json.loads(line) for line in whole.splitlines()]
    assert [answer["ok"] for answer in answers] == [True, True, False, False, False, False, False, False]
    assert (answers[1]["scene_s"], answers[1]["duration_s"]) == (0.3, 2.0)
    assert {"grip_n", "slipping", "travel_mm", "normal_n", "fallen"} < answers[1].keys()
    assert json.loads(lines.receive(b"x" * 5000, 0.3))["ok"] is False


@given(st.binary(max_size=60))
@settings(max_examples=50, deadline=None)
def test_any_bytes_get_lines_of_json(data: bytes) -> None:
    lines = ControlLines(CONTACT, 1.0)
    for line in lines.receive(data + b"\n", 0.0).splitlines():
        assert isinstance(json.loads(line)["ok"], bool)


CONTACT = contact(held(PRESS))


def test_a_controller_moves_the_grip_of_a_running_emulator(tmp_path: Path) -> None:
    reports: list[dict[str, Any]] = []
    ready = threading.Event()

    def report(what: dict[str, Any]) -> None:
        reports.append(what)
        ready.set()

    address = f"unix://{tmp_path}/control"
    scene = held(PRESS, load(2.0), {"kind": "hold", "duration_s": 60.0})
    emulator = Emulator(
        scene, V1, PtyLink(tmp_path / "board"), report=report, control=make_control_link(address)
    )
    thread = threading.Thread(target=emulator.run)
    thread.start()
    try:
        assert ready.wait(PATIENCE_S)
        assert reports[0]["control"] == address
        peer = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        peer.connect(str(tmp_path / "control"))
        peer.settimeout(PATIENCE_S)
        board = os.open(reports[0]["device"], os.O_RDWR | os.O_NOCTTY)
        with peer, peer.makefile("rwb") as lines:
            grip_n, end_s = 0.0, time.monotonic() + PATIENCE_S
            while grip_n != 21.0 and time.monotonic() < end_s:  # 0.1 s after the scene has begun
                os.write(board, Encoder(V1).encode(Command("start", 1)))  # unheard while the board boots
                lines.write(b'{"grip_n": 21.0}\n')
                lines.flush()
                answer = json.loads(lines.readline())
                assert answer["ok"]
                grip_n = answer["grip_n"]
                time.sleep(0.01)
        assert grip_n == 21.0
        os.close(board)
    finally:
        emulator.stop()
        thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert not (tmp_path / "control").exists()


def test_a_gripper_has_a_delay_and_a_resolution() -> None:
    gripper = {"grip_rate_n_s": 1000.0, "grip_delay_s": 0.05, "grip_step_n": 0.5}
    model = contact(held(PRESS, load(1.0), {"kind": "hold", "duration_s": 1.0}, held_object=gripper))
    model.play_until(1.0)
    move_grip(model, 12.3)
    grip_n = model.state(np.arange(1.0, 1.2, 0.01)).load_n
    assert np.all(grip_n[:4] == 10.0)
    assert np.all(grip_n[10:] == 12.5)


def test_friction_that_falls_lets_go_where_friction_no_longer_bears_the_load() -> None:
    eases = {"on": "friction", "shape": "ramp", "amplitude": -0.8, "start_s": 1.0, "duration_s": 0.8}
    model = contact(
        held(PRESS, load(3.0), {"kind": "hold", "duration_s": 1.0}, disturbances=[eases])
    )  # bears 6 N at 1.0 s, 3 N at 1.5 s
    model.play_until(2.0)
    moved_mm = np.hypot(*model.state(np.array([1.4, 1.7])).travel_mm.T)
    assert moved_mm[0] < 0.2
    assert moved_mm[1] > 1.0
    with pytest.raises(ValueError, match="a held object has a flat one"):
        held(PRESS, surface={"kind": "grooves", "period_mm": 1.2})


def test_a_press_alone_does_not_hold_what_is_lifted_and_filled() -> None:
    model = contact(load_scene("hold"))
    model.play_until(4.0)
    assert not has_fallen(model)
    model.play_until(7.0)
    assert has_fallen(model)
