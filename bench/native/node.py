"""Delay of the ROS 2 node `tactiled_driver`, from a force on ZeroMQ to a subscriber of its wrench.

Three programs get a message each in turn: a bare `zmq_recv` of forces; the node, whose wrenches a subscriber
of rclcpp receives; and such a subscriber without the node, of a bare publisher. The last one is what ROS 2
takes by itself.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zmq

from bench.native.publish import BOARD, Publisher, latencies_us, publish_in_turn
from bench.report import Aim, Table, aims_table, load_words, median_aim, over_runs, table
from tactiled.array import FloatArray
from tactiled.events.types import ForceEvent

LIMIT_MS = 0.3  # aim for the median, beyond that of a bare zmq_recv
PROGRAMS = "zmq_recv", "node", "rclcpp"
_NAMES = {
    "zmq_recv": "force with zmq_recv",
    "node": "force to wrench, tactiled_driver",
    "rclcpp": "wrench, a bare publisher of rclcpp",
}
_DOMAIN = "86"  # choice: not that of a robot beside it
_WRENCHES = Path(__file__).parent / "ros"


@dataclass(frozen=True)
class NodeRun:
    """Latencies of one run, by program."""

    latency_us: dict[str, FloatArray]

    def median_ms(self, name: str) -> float:
        """Median latency of a program."""
        return float(np.median(self.latency_us[name])) / 1e3

    @property
    def beyond_zmq_ms(self) -> float:
        """Median delay of the wrench beyond a bare receipt of the force."""
        return self.median_ms("node") - self.median_ms("zmq_recv")

    @property
    def of_node_ms(self) -> float:
        """Median delay that the node adds to that of a bare publisher and subscriber of rclcpp."""
        return self.beyond_zmq_ms - self.median_ms("rclcpp")


def node_sections(folder: Path, receive: Path, repeats: int, count: int) -> list[str]:
    """Measure the node of ROS 2, where that is installed."""
    driver = find_driver()
    if driver is None:
        return ["The node of ROS 2 was not measured: no workspace with tactiled_driver is sourced."]
    wrenches, runs = build_wrenches(folder), []
    for repeat in range(repeats):
        place = folder / f"node-{repeat}"
        place.mkdir()
        runs.append(run_node(place, receive, wrenches, driver, count))
    text = (
        f"Node of ROS 2, in {repeats} runs of {count} messages at 100 Hz, each in turn with the others; "
        f"{load_words()}. Latency: from before the send to the callback of a subscriber in another process."
    )
    return [text, node_table(runs), node_words(runs), aims_table(node_aims(runs))]


def find_driver() -> Path | None:
    """Program of the node in the sourced ROS 2; None where there is none."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(":")
    programs = [Path(prefix) / "lib" / "tactiled_driver" / "driver" for prefix in prefixes if prefix]
    return next((program for program in programs if program.exists()), None)


def build_wrenches(folder: Path) -> Path:
    """Build the subscriber and the bare publisher."""
    build = folder / "wrenches"
    for arguments in (["-S", _WRENCHES, "-B", build, "-DCMAKE_BUILD_TYPE=Release"], ["--build", build]):
        subprocess.run(["cmake", *map(str, arguments)], check=True, stdout=sys.stderr)
    return build / "wrenches"


def run_node(folder: Path, receive: Path, wrenches: Path, driver: Path, count: int) -> NodeRun:
    """Send to all three until each has its messages."""
    environ = {**os.environ, "ROS_DOMAIN_ID": _DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    zmq_endpoint, node_endpoint = (f"ipc://{folder}/{name}-events" for name in ("zmq", "node"))
    ros = ["--ros-args", "-r", "__ns:=/bench", "-p", f"board:={BOARD}", "-p", f"endpoint:={node_endpoint}"]
    with ExitStack() as stack:

        def start(*command: str | Path) -> "subprocess.Popen[str]":
            pipe = subprocess.PIPE
            process = subprocess.Popen(command, env=environ, stdin=pipe, stdout=pipe, text=True)
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        context = stack.enter_context(zmq.Context())
        publishers = [Publisher(context, endpoint, _force) for endpoint in (zmq_endpoint, node_endpoint)]
        for publisher in publishers:
            stack.callback(publisher.close)
        listening = [
            start(receive, "force", zmq_endpoint, f"{count}"),
            start(wrenches, "listen", "/bench/wrench", f"{count}"),
            start(wrenches, "listen", "/bench/bare", f"{count}"),
        ]
        start(driver, *ros, "-p", "autostart:=true")
        bare = start(wrenches, "publish", "/bench/bare")
        publish_in_turn([*publishers, _BarePublisher(bare)], listening)
        rows = [process.communicate()[0].splitlines()[1:] for process in listening]  # after "ready"
        sent = [line.split() for line in bare.communicate()[0].splitlines()]
    sent_ns = [*(publisher.sent_ns for publisher in publishers), [int(at_ns) for _, at_ns in sent]]
    rows[0].pop()  # processor time
    latencies = [latencies_us(*both) for both in zip(rows, sent_ns, strict=True)]
    return NodeRun(dict(zip(PROGRAMS, latencies, strict=True)))


def _force(number: int) -> ForceEvent:
    """Return a force whose z is its number, which the wrench keeps."""
    return ForceEvent(time_s=0.0, fz_n=float(number), calibration="bench", valid=True)


class _BarePublisher:
    """Publisher of rclcpp, which publishes when it is told to."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        assert process.stdin is not None  # as asked for
        self._lines = process.stdin

    def send(self) -> None:
        self._lines.write("\n")
        self._lines.flush()

    def send_status(self) -> None:
        """It has none."""


def node_table(runs: Sequence[NodeRun]) -> Table:
    """Table of latencies."""
    rows = []
    for name, words in _NAMES.items():
        row = {"path": words}
        for heading, q in (("p50", 0.5), ("p99", 0.99)):
            values = [float(np.quantile(run.latency_us[name], q)) / 1e3 for run in runs]
            row[f"latency {heading} (ms)"] = over_runs(values, ".3f")
        rows.append(row)
    return table(rows)


def node_words(runs: Sequence[NodeRun]) -> str:
    """Say what the node adds to ROS 2."""
    added_ms = over_runs([run.of_node_ms for run in runs], ".3f")
    return f"The node adds to `zmq_recv` and to a bare publisher of rclcpp, in medians: {added_ms} ms."


def node_aims(runs: Sequence[NodeRun]) -> list[Aim]:
    """Judge the node."""
    beyond_ms = [run.beyond_zmq_ms for run in runs]
    return [median_aim("p50 of the wrench beyond zmq_recv (ms)", LIMIT_MS, beyond_ms, ".3f")]
