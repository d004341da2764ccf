"""Emulated grasps that the controllers of C++ and Python hold, each from the messages of its own grasps."""

import subprocess
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from bench.hold.bench import over_least
from bench.hold.play import Controller, GraspResult, play
from bench.report import table
from tactiled.array import load_array
from tactiled.client.grip_controller import GripController
from tactiled.emulator.scene.families.holding import hold

GRASPS, QUICK_GRASPS = 240, 40
BATCH = 40  # that are simulated at once
_NUMBERS = "timestamp", "load", "shear_x", "shear_y", "friction_low", "friction"


class ControllerOfCpp:
    """`tactiled_grip_controller.hpp` in a process, as a `Controller`."""

    def __init__(self, program: Path, stack: ExitStack) -> None:
        pipe = subprocess.PIPE
        self._process = stack.enter_context(subprocess.Popen([program], stdin=pipe, stdout=pipe, text=True))
        stack.callback(self._process.kill)

    def take(self, message: Mapping[str, Any], present_n: float) -> float:
        """Return the force to command (N)."""
        assert self._process.stdin is not None  # as asked for
        assert self._process.stdout is not None
        numbers = " ".join(repr(float(message[name])) for name in _NUMBERS)
        flags = f"{message['state']} {int(message['valid'])} {int(message['late'])}"
        self._process.stdin.write(f"{flags} {numbers} {present_n!r}\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())


def grasps(program: Path, seeds: range) -> dict[str, Sequence[GraspResult]]:
    """Play grasps with either controller."""
    scenes = [hold(seed) for seed in seeds]
    array = load_array("wang2019-3x3")
    with ExitStack() as stack:
        of_cpp: list[Controller] = [ControllerOfCpp(program, stack) for _ in scenes]
        of_python: list[Controller] = [GripController() for _ in scenes]
        played = {"C++": of_cpp, "Python": of_python}
        return {name: play(scenes, array, each, "grip").results() for name, each in played.items()}


def grasps_table(found: Mapping[str, Sequence[GraspResult]]) -> str:
    """Make the table of both controllers."""
    return table(
        {
            "controller": name,
            "grasps": f"{len(some)}",
            "dropped": f"{sum(one.dropped for one in some)}",
            "grip over the least": f"{over_least(some):.2f}",
            "slid 1 mm or more": f"{sum(one.slid_mm >= 1.0 for one in some)}",
        }
        for name, some in found.items()
    )
