"""Delay and cost of the bridge to ROS 2.

Real processes: an emulated board, the daemon and ``tactiled ros2``; in this process a subscriber on each
side. The subscriber on DDS decodes with the types of Cyclone DDS itself.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import BenchOptions, BenchReport, table
from tactiled import resources
from tactiled.array import FloatArray
from tactiled.client import ForceMessage, Subscription
from tactiled.errors import OperatorError
from tactiled.progress import ProgressBar
from tactiled.ros2.convert import ros_time

_WINDOW_S, _QUICK_WINDOW_S = 60.0, 15.0
_START_S = 60.0  # for all processes; each takes 1.5 s of one core
_SETTLE_S = 5.0  # start of the bridge, and discovery of the subscribers
_DOMAIN = 211
_TICKS_HZ = os.sysconf("SC_CLK_TCK")
_LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>'
    '</General><Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers>'
    "</Discovery></Domain></CycloneDDS>"
)
_TOPIC = "rt/tactile/TS0001/wrench"
Stamp = tuple[int, int]


@dataclass(frozen=True)
class BridgeLoad:
    """Delay and cost of one run.

    Attributes
    ----------
    delay_s : (messages,) float64
        From the receipt over ZeroMQ to the receipt over DDS of the same force.
    sent : int
        Forces received over ZeroMQ.
    cpu_part : float
        Processor time of the bridge over time.
    """

    delay_s: FloatArray
    sent: int
    cpu_part: float


def bench_ros2(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Measure the bridge with and without a subscriber of `wrench`."""
    window_s = _QUICK_WINDOW_S if options.quick else _WINDOW_S
    loads: dict[str, BridgeLoad] = {}
    for done, name in enumerate(("no subscriber", "one subscriber of wrench")):
        progress.reach(done / 2)
        with tempfile.TemporaryDirectory(prefix="tactiled-ros2-") as folder:
            loads[name] = measure(Path(folder), window_s, subscribed=name != "no subscriber")
    text = (
        f"One board at 100 Hz, 36 channels, at rest; {window_s:g} s each; loopback; load average "
        f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} processors. Delay: from the receipt over ZeroMQ to "
        "that over DDS."
    )
    rows = (
        {
            "bridge with": name,
            "forces": f"{load.sent}",
            "missing on DDS": f"{load.sent - len(load.delay_s)}" if len(load.delay_s) else "-",
            "delay, median (ms)": _quantile(load, 0.5),
            "99 % (ms)": _quantile(load, 0.99),
            "processor time (%)": f"{100 * load.cpu_part:.1f}",
        }
        for name, load in loads.items()
    )
    return BenchReport([text, table(rows)])


def measure(folder: Path, window_s: float, *, subscribed: bool) -> BridgeLoad:
    """Run board, daemon and bridge once, with both subscribers in this process."""
    endpoint = f"ipc://{folder}/events.ipc"
    config = folder / "tactiled.toml"
    # The nominal calibration as if it were one of this board: of a nominal one there is no wrench.
    nominal = resources.shipped("config", "calibration", "wang2019-3x3.toml").read_text()
    calibration = folder / "calibration.toml"
    calibration.write_text(
        nominal.replace("nominal = true", "nominal = false").replace('"nominal"', '"measured"')
    )
    config.write_text(
        f'[port]\nurl = "{folder}/board"\n[publish]\nendpoints = ["{endpoint}"]\n'
        f'[board]\ncalibration = "{calibration}"\n'
    )
    with ExitStack() as stack:
        stack.enter_context(_tactiled("emulate", "--scene", "rest", "--link", f"{folder}/board"))
        stack.enter_context(_tactiled("run", "--config", str(config)))
        bridge = stack.enter_context(_tactiled("ros2", "--events", endpoint, "--domain", str(_DOMAIN)))
        received: dict[Stamp, float] = {}
        close = _subscribe(received) if subscribed else None
        try:
            sent, cpu_part = _listen(endpoint, bridge.pid, window_s)
        finally:
            time.sleep(0.5)  # for what is on the way
            if close is not None:
                close()
    delays = [received[stamp] - at_s for stamp, at_s in sent.items() if stamp in received]
    return BridgeLoad(np.array(delays), len(sent), cpu_part)


def _listen(endpoint: str, pid: int, window_s: float) -> tuple[dict[Stamp, float], float]:
    """Times of receipt of the forces of the window, and the part of time that the bridge computed."""
    sent: dict[Stamp, float] = {}
    with Subscription(endpoint, ("force",)) as subscription:
        started_s = time.monotonic() + _START_S
        while not isinstance(item := subscription.next_item(started_s), ForceMessage):
            if item is None:
                raise OperatorError(f"the daemon has published no force within {_START_S:g} s")
        settled_s = time.monotonic() + _SETTLE_S
        while time.monotonic() < settled_s:
            subscription.next_item(settled_s)
        begin_s, cpu_s = time.monotonic(), _cpu_s(pid)
        while (now_s := time.monotonic()) < begin_s + window_s:
            item = subscription.next_item(begin_s + window_s)
            if isinstance(item, ForceMessage) and item.data["valid"]:
                stamp = ros_time(item.timestamp)
                sent[stamp["sec"], stamp["nanosec"]] = item.received_s
        return sent, (_cpu_s(pid) - cpu_s) / (now_s - begin_s)


def _subscribe(received: dict[Stamp, float]) -> Any:
    """Note when each wrench arrives over DDS; returns the function that ends it."""
    idl: Any = import_module("cyclonedds.idl")
    kinds: Any = import_module("cyclonedds.idl.types")
    core: Any = import_module("cyclonedds.core")
    domain: Any = import_module("cyclonedds.domain")

    def struct(package: str, name: str, **fields: Any) -> Any:
        return idl.make_idl_struct(name, f"{package}.msg.dds_.{name}_", fields)

    stamp = struct("builtin_interfaces", "Time", sec=kinds.int32, nanosec=kinds.uint32)
    header = struct("std_msgs", "Header", stamp=stamp, frame_id=str)
    vector = struct("geometry_msgs", "Vector3", x=kinds.float64, y=kinds.float64, z=kinds.float64)
    wrench = struct("geometry_msgs", "Wrench", force=vector, torque=vector)
    stamped = struct("geometry_msgs", "WrenchStamped", header=header, wrench=wrench)

    def note(reader: Any) -> None:
        now_s = time.monotonic()
        for sample in reader.take(100):
            if (head := getattr(sample, "header", None)) is not None:
                received[head.stamp.sec, head.stamp.nanosec] = now_s

    joined = domain.Domain(_DOMAIN, _LOOPBACK)
    participant = domain.DomainParticipant(_DOMAIN)
    topic = import_module("cyclonedds.topic").Topic(participant, _TOPIC, stamped)
    listener = core.Listener(on_data_available=note)
    reader = import_module("cyclonedds.sub").DataReader(participant, topic, listener=listener)

    def close() -> None:
        for entity in (reader, participant, joined):
            entity.__del__()

    return close


@contextmanager
def _tactiled(*arguments: str) -> Iterator["subprocess.Popen[bytes]"]:
    command = [sys.executable, "-m", "tactiled", *arguments]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as child:
        try:
            yield child
        finally:
            child.kill()


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_HZ


def _quantile(load: BridgeLoad, q: float) -> str:
    return f"{1e3 * float(np.quantile(load.delay_s, q)):.1f}" if len(load.delay_s) else "-"
