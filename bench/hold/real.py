"""Grasps through real processes: board emulator, daemon, and ``examples/hold.py``, in real time."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

import numpy as np

from bench.hold.play import least_n
from bench.hold.result import GraspResult
from tactiled.emulator.scene.families.holding import HOLD_S, LIFTED_S, hold

EXAMPLE = Path(__file__).parents[2] / "examples" / "hold.py"


def play_in_processes(seed: int) -> GraspResult:
    """Play one grasp; it takes its 7 s and the start of three processes."""
    scene = hold(seed)
    with TemporaryDirectory() as folder, ExitStack() as running:
        endpoint, control = f"ipc://{folder}/events.ipc", f"unix://{folder}/control"
        config = Path(folder) / "hold.toml"
        config.write_text(f'port.url = "{folder}/board"\npublish.endpoints = ["{endpoint}"]\n')
        emulate = ["-m", "tactiled", "emulate", "--scene", scene.name, "--link", f"{folder}/board"]
        emulator = running.enter_context(_process(*emulate, "--control", control, "--scans"))
        assert emulator.stdout is not None
        reports = _reports(emulator.stdout)
        next(report for report in reports if report["what"] == "ready")
        running.enter_context(_process(str(EXAMPLE), control, endpoint))
        running.enter_context(_process("-m", "tactiled", "run", "--config", str(config)))
        t0_s = next(report["t0_s"] for report in reports if report["what"] == "scene")
        scans = [next(reports)]
        while scans[-1]["what"] != "scan" or scans[-1]["began_s"] < t0_s + HOLD_S:
            scans.append(next(reports))
    scans = [scan for scan in scans if scan["what"] == "scan" and scan["began_s"] > t0_s + LIFTED_S]
    grip_n = np.array([scan["grip_n"] for scan in scans])
    least = least_n(scene, np.array([scan["began_s"] - t0_s for scan in scans]))
    fallen = bool(scans[-1]["fallen"])
    return GraspResult(
        event=scene.description,
        dropped=fallen,
        over_least=float("nan") if fallen else float(grip_n.mean() / least.mean()),
        slid_mm=float(np.hypot(*scans[-1]["travel_mm"])),
        reaction_s=float("nan"),
    )


@contextmanager
def _process(*arguments: str) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, *arguments]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as child:
        try:
            yield child
        finally:
            child.kill()


def _reports(lines: IO[str]) -> Iterator[dict[str, Any]]:
    for line in lines:
        yield json.loads(line)
