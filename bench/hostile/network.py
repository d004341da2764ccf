"""Networks of robots: ROS 2, zenoh, fleets."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from struct import pack

from bench.fleet.routers import free_port, router
from bench.hostile.attack import Attack, Outcome
from bench.hostile.process import tactiled

_PATIENCE_S = 60.0  # longest start of a daemon on a busy host
_TABLE_LINES = 110  # of `tactiled fleet`: 100 rows, their head, the count of the others
_LOG_BYTES = 5_000
# Of the ports of a domain below 102 (RTPS 2.5, 9.6.2), which may not be taken by connections.
_DOMAIN = 1 + os.getpid() % 101


@contextmanager
def _running(*arguments: str, err: Path) -> Iterator["subprocess.Popen[str]"]:
    with err.open("w") as stderr:
        process = subprocess.Popen(
            [sys.executable, "-m", "tactiled", *arguments], stdout=subprocess.PIPE, stderr=stderr, text=True
        )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.terminate()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def _listed(endpoint: str, *options: str) -> tuple[int, list[dict[str, object]]]:
    """Exit code and rows of ``tactiled fleet --once``."""
    done = tactiled("fleet", endpoint, "--once", "--json", *options)
    return done.code, [json.loads(line) for line in done.out.splitlines()]


def _states(rows: Sequence[dict[str, object]]) -> str:
    return ", ".join(sorted({str(row["state"]) for row in rows})) or "nothing"


def _silent_hosts(folder: Path, scale: float) -> Outcome:  # noqa: ARG001
    """Announce hosts of which none answers, and list them."""
    hosts, port = max(200, round(1000 * scale)), free_port()
    with router(port) as session:
        tokens = [session.liveliness().declare_token(f"tactile/h{number}/control") for number in range(hosts)]
        done = tactiled("fleet", f"zenoh://127.0.0.1:{port}/*", "--once")
        for token in tokens:
            token.undeclare()
    lines = done.out.count("\n")
    held = done.code == 1 and lines <= _TABLE_LINES and f"0 of {hosts} boards fresh" in done.out
    return Outcome(f"exit code {done.code}, {lines} lines for {hosts} hosts", held and done.is_tidy)


def _missed_robot(folder: Path, scale: float) -> Outcome:  # noqa: ARG001
    port = free_port()
    with router(port):
        code, rows = _listed(f"zenoh://127.0.0.1:{port}/*", "--expect", "robot7")
    held = code == 1 and [(row["host"], row["state"]) for row in rows] == [("robot7", "missing")]
    return Outcome(f"exit code {code}: {_states(rows)}", held)


def _frozen_daemon(folder: Path, scale: float) -> Outcome:  # noqa: ARG001
    """List a robot that runs, then stop its daemon with SIGSTOP and list it again."""
    port, events, config = free_port(), f"ipc://{folder}/events.ipc", folder / "tactiled.toml"
    config.write_text(f'[port]\nurl = "{folder}/board"\n[publish]\nendpoints = ["{events}"]\n')
    endpoint, err = f"zenoh://127.0.0.1:{port}/*", folder / "err"
    with ExitStack() as stack:
        stack.enter_context(router(port))
        stack.enter_context(
            _running("emulate", "--scene", "rest", "--link", f"{folder}/board", err=folder / "board.err")
        )
        daemon = stack.enter_context(_running("run", "--config", str(config), err=folder / "run.err"))
        to = ("--connect", f"tcp/127.0.0.1:{port}", "--host", "robot7")
        stack.enter_context(_running("zenoh", "--events", events, *to, err=err))
        until_s = time.monotonic() + _PATIENCE_S
        while (before := _listed(endpoint))[0] != 0 and time.monotonic() < until_s:
            time.sleep(0.5)
        daemon.send_signal(signal.SIGSTOP)
        after = _listed(endpoint)
    seen = f"{before[0]} ({_states(before[1])}), stopped {after[0]} ({_states(after[1])})"
    return Outcome(f"exit code {seen}", (before[0], after[0]) == (0, 1))


def _malformed_packets(folder: Path, scale: float) -> Outcome:
    """Send packets to the ports of ``tactiled ros2`` that begin as DDS does and go on as they like."""
    packets, err = max(200, round(20_000 * scale)), folder / "err"
    bodies = (
        pack("<BBH", 0x15, 5, 4) + b"abcd",
        pack("<BBH", 0x07, 1, 3000) + b"abcd",
        b"\x15",
        os.urandom(64),
    )
    first = 7400 + 250 * _DOMAIN + 10
    words = ("ros2", "--events", f"ipc://{folder}/events.ipc", "--domain", str(_DOMAIN))
    with (
        _running(*words, err=err) as bridge,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        assert bridge.stdout is not None
        bridge.stdout.readline()  # the node is there
        for number in range(packets):
            packet = b"RTPS\x02\x01\x01\x10" + os.urandom(12) + bodies[number % len(bodies)]
            sock.sendto(packet, ("127.0.0.1", first + number // len(bodies) % 4))
        time.sleep(1.0)  # while they are read
        is_alive = bridge.poll() is None
    logged = err.stat().st_size
    seen = f"{'alive' if is_alive else 'ended'}, {logged} bytes of log after {packets} packets"
    return Outcome(seen, is_alive and logged < _LOG_BYTES)


def _nominal_forces(folder: Path, scale: float) -> Outcome:  # noqa: ARG001
    """Convert a force of 58.9 N by nominal sensitivities, as was published where 15 N press."""
    convert = import_module("tactiled.ros2.convert")
    force = {"valid": True, "calibration": "nominal", "timestamp": 0.0, "fz_n": 58.9}
    made = convert.wrench(force, "skin")
    return Outcome("no wrench" if made is None else "a wrench", made is None)


ATTACKS: tuple[Attack, ...] = (
    Attack(
        "fleet: silent hosts",
        "1,000 hosts with a bridge and no answer",
        "exit code 1, at most 110 lines",
        _silent_hosts,
        short=0.2,
    ),
    Attack(
        "fleet: missed robot", "a robot that is expected and not there", "exit code 1, missing", _missed_robot
    ),
    Attack(
        "fleet: frozen daemon",
        "SIGSTOP to the daemon of a robot that runs",
        "exit code 0 before, 1 after",
        _frozen_daemon,
        short=None,
    ),
    Attack(
        "DDS: malformed packets",
        "20,000 packets that are no RTPS",
        "alive, less than 5 kB of log",
        _malformed_packets,
        short=0.01,
    ),
    Attack("ROS 2: nominal force", "a force from published sensitivities", "no wrench", _nominal_forces),
)
