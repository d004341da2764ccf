"""The native bench: ratios and aims of made latencies, and one short run whose times nobody checks."""

import subprocess
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cpp import HEADERS, need_native

from bench.hold.play import play
from bench.native import bench, node
from bench.processes import compile_program
from tactiled.client.grip_controller import GripController
from tactiled.emulator.scene.families.holding import hold


def test_the_client_is_judged_beside_zmq_recv() -> None:
    latency_us = {"client": np.full(100, 105.0), "bare": np.full(100, 100.0)}
    run = bench.NativeRun(latency_us, {"client": 70.0, "bare": 45.0})
    assert run.ratio(0.5) == pytest.approx(1.05)
    cost = bench.NativeCost(scan_us=7.0, allocations=1.0)
    verdicts = [aim.verdict for aim in bench.aims([run], cost)]
    assert verdicts == ["met", "met", "met", "MISSED", "MISSED"]


def test_both_programs_receive_scans(tmp_path: Path) -> None:
    need_native()
    receive = bench.compile_receiver(tmp_path)
    run = bench.run_once(tmp_path, receive, n_scans=150)
    for name in bench.PROGRAMS:
        assert run.latency_us[name].size > 0
        assert np.all(run.latency_us[name] > 0)
    cost = bench.measure_cost(tmp_path, receive)
    assert cost.allocations == 0.0


def test_the_node_is_judged_beside_zmq_recv_and_rclcpp() -> None:
    latency_us = {
        name: np.full(100, us) for name, us in (("zmq_recv", 200.0), ("node", 540.0), ("rclcpp", 310.0))
    }
    run = node.NodeRun(latency_us)
    assert [aim.verdict for aim in node.node_aims([run])] == ["MISSED"]
    assert "0.030" in node.node_words([run])
    assert [row["latency p50 (ms)"][:5] for row in node.node_table([run]).rows] == ["0.200", "0.540", "0.310"]


def test_the_node_is_found_where_a_workspace_is_sourced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    assert node.find_driver() is None
    assert "not measured" in node.node_sections(tmp_path, tmp_path, 1, 1)[0]
    program = tmp_path / "lib" / "tactiled_driver" / "driver"
    program.parent.mkdir(parents=True)
    program.touch()
    assert node.find_driver() == program


@pytest.mark.skipif(node.find_driver() is None, reason="needs a sourced workspace with tactiled_driver")
def test_wrenches_come_through_the_node(tmp_path: Path) -> None:
    receive, wrenches = bench.compile_receiver(tmp_path), node.build_wrenches(tmp_path)
    driver = node.find_driver()
    assert driver is not None
    run = node.run_node(tmp_path, receive, wrenches, driver, count=150)
    assert all(run.latency_us[name].size == 50 and run.latency_us[name].min() > 0 for name in node.PROGRAMS)


class ControllerOfCpp:
    """`tactiled_grip_controller.hpp` in a process, as a `Controller`."""

    def __init__(self, program: Path, stack: ExitStack) -> None:
        pipe = subprocess.PIPE
        self.process = stack.enter_context(subprocess.Popen([program], stdin=pipe, stdout=pipe, text=True))
        stack.callback(self.process.kill)

    def take(self, message: Mapping[str, Any], present_n: float) -> float:
        names = "timestamp", "load", "shear_x", "shear_y", "friction_low", "friction"
        numbers = " ".join(repr(float(message[name])) for name in names)
        flags = f"{message['state']} {int(message['valid'])} {int(message['late'])}"
        return self._answer(f"{flags} {numbers} {present_n!r}")

    def blind(self) -> float:
        return self._answer("blind")

    def _answer(self, line: str) -> float:
        assert self.process.stdin is not None  # as asked for
        assert self.process.stdout is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()
        return float(self.process.stdout.readline())


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need_native()
    source = Path(__file__).with_name("hold.cpp")
    return compile_program(tmp_path_factory.mktemp("hold"), source, "-std=c++17", f"-I{HEADERS}")


def test_the_controller_of_cpp_holds_as_that_of_python(program: Path) -> None:
    """Also while the daemon is down, and where the next one finds the objects in the hand."""
    scenes = [hold(seed) for seed in range(500, 502)]
    with ExitStack() as stack:
        of_cpp = [ControllerOfCpp(program, stack) for _ in scenes]
        of_python = [GripController() for _ in scenes]
        episodes = play(scenes * 2, [*of_cpp, *of_python], restarts=True)
    np.testing.assert_array_equal(episodes.command_n[:, :2], episodes.command_n[:, 2:])
    assert not episodes.dropped.any()
