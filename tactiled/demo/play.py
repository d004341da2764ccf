"""``tactiled demo``: emulated board, daemon, subscriber as three real processes; truth against estimate."""

import contextlib
import json
import math
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from queue import Empty, Queue
from typing import IO, Any

import click
import numpy as np

from tactiled.array import load_array
from tactiled.bench.pictures import Truth, draw_log
from tactiled.bench.report import table
from tactiled.demo.verdict import HEAD, Seen, compare
from tactiled.detect.suite import DetectParams
from tactiled.errors import ConfigError, TactiledError
from tactiled.events.types import Candidate, Event, SlipEvent, TextureEvent
from tactiled.progress import ProgressBar

SPEED_MM_S = 1.0  # of the slides in config/scenes/demo.toml, as the gripper that moves the finger would tell
START_WITHIN_S = 15.0  # Python starting three times on a small loaded machine
CONFIG = """\
[port]
url = "{link}"
[board]
array = "wang2019-3x3"
[publish]
endpoints = ["{endpoint}"]
[detect.texture]
speed_mm_s = {speed}
"""


class DemoError(TactiledError):
    """One of the three processes did not do its part."""


def run_demo(picture: Path) -> bool:
    """Play the demo scene through three processes; True when every estimate is right.

    Raises
    ------
    DemoError
        A process ended early or said nothing.
    ConfigError
        The picture cannot be written there.
    """
    if not picture.parent.is_dir() or picture.suffix not in (".png", ".pdf", ".svg"):
        raise ConfigError("--out", [f"{picture}: name a .png, .pdf or .svg in a folder that exists"])
    seen = Seen()
    unix_offset_s = time.time() - time.monotonic()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tactiled-demo-")))
        link, endpoint = folder / "board", f"tcp://127.0.0.1:{_free_port()}"
        config = folder / "tactiled.toml"
        config.write_text(CONFIG.format(link=link, endpoint=endpoint, speed=SPEED_MM_S))
        lines: Queue[tuple[str, dict[str, Any] | None]] = Queue()

        def start(name: str, *arguments: str) -> None:
            stack.enter_context(_process(name, arguments, lines, folder))

        _say("subscriber: tactiled listen", endpoint)
        start("subscriber", "listen", endpoint)
        _say("daemon: tactiled run --config", str(config))
        start("daemon", "run", "--config", str(config))
        _await(lines, "subscriber", "the daemon's first status")
        _say("board: tactiled emulate --scene demo --link", str(link))
        start("board", "emulate", "--scene", "demo", "--link", str(link))
        phases: list[tuple[float, str]] = []
        bar = stack.enter_context(ProgressBar("demo", None))
        while not seen.done:
            if seen.scene:
                bar.reach(time.monotonic() - seen.scene["t0_s"])
            for name, message in _take(lines):
                if message is None:
                    raise DemoError(f"the {name} process ended early; see above")
                if name == "board" and message.get("what") == "scene":
                    seen.scene = message
                    bar.begin(message["duration_s"])
                    phases = [(p["start_s"], _phase_words(p)) for p in message["phases"]]
                elif name == "board" and message.get("what") == "slip":
                    if message["number"] not in seen.slips and message["direction_deg"] is None:
                        lets_go_s = message["incipient_s"] - seen.scene["t0_s"]
                        _say(f"{lets_go_s:6.2f} s  true: slip on the spot: the shear that is left is let go")
                    seen.slips[message["number"]] = message
                elif name == "subscriber":
                    _receive(message, unix_offset_s, seen)
            while phases and time.monotonic() >= phases[0][0]:
                start_s, words = phases.pop(0)
                _say(f"{start_s - seen.scene['t0_s']:6.2f} s  true:", words)
    rows, good = compare(seen)
    click.echo("\n" + table(HEAD, rows))
    _draw(picture, seen)
    click.echo(f"\npicture: {picture}")
    if not good:
        click.echo("an estimate is wrong", err=True)
    return good


def _receive(message: dict[str, Any], unix_offset_s: float, seen: Seen) -> None:
    """Keep a message of the subscriber; say what a person should know."""
    topic = message["topic"]
    time_s = message["timestamp"] - unix_offset_s
    if topic == "scan":
        seen.time_s.append(time_s)
        seen.volts.append(message["volts"])
        return
    if topic == "info":
        seen.channel_offset_s = message["channel_offset_s"]
    event = _event(topic, message, unix_offset_s)
    t0_s = seen.scene.get("t0_s", time_s)
    if topic == "contact":
        _say(f"{time_s - t0_s:6.2f} s  said: contact", message["state"])
    elif isinstance(event, SlipEvent):
        seen.events.append(event)
        words = f"slip {event.state}, {event.kind}, since {event.onset_s - t0_s:.2f} s"
        _say(f"{event.detected_s - t0_s:6.2f} s  said: {words}", f"direction {event.direction_deg:.0f} deg")
    elif isinstance(event, TextureEvent):
        seen.events.append(event)
        words = (
            f"D = {event.period_mm:.4f} ± {event.period_sd_mm:.4f} mm, "
            f"angle {event.angle_deg:.2f} ± {event.angle_sd_deg:.2f} deg"
            if event.status == "ok"
            else ""
        )
        _say(f"{time_s - t0_s:6.2f} s  said: texture {event.status}", words)


def _event(topic: str, message: dict[str, Any], unix_offset_s: float) -> Event | None:
    """The event that a message was made of, its instants back on the monotonic clock."""
    head = ("topic", "recovered", "v", "timestamp", "seq", "board", "run")
    fields = {name: value for name, value in message.items() if name not in head}
    fields["time_s"] = message["timestamp"] - unix_offset_s
    if topic == "slip":
        for name in ("onset", "detected"):
            fields[f"{name}_s"] = fields.pop(name) - unix_offset_s
        return SlipEvent(**fields)
    if topic == "texture":
        fields["candidates"] = tuple(Candidate(**c) for c in fields["candidates"])
        return TextureEvent(**fields)
    return None


def _draw(picture: Path, seen: Seen) -> None:
    truth = Truth(onsets_s=tuple(s["incipient_s"] for s in seen.slips.values()))
    for slip in seen.slides:
        surface = slip["surface"]
        if surface["kind"] == "grooves":
            turn = math.radians(surface["angle_deg"] - slip["direction_deg"])
            truth = Truth(
                onsets_s=truth.onsets_s,
                frequency_hz=SPEED_MM_S * abs(math.cos(turn)) / surface["period_mm"],
                label=f"truth: D = {surface['period_mm']:.3f} mm, angle {surface['angle_deg']:.1f}°",
            )
    draw_log(
        picture,
        load_array("wang2019-3x3"),
        np.array(seen.time_s),
        np.array(seen.volts),
        seen.events,
        DetectParams(),
        "tactiled demo",
        channel_offset_s=None if seen.channel_offset_s is None else np.array(seen.channel_offset_s),
        truth=truth,
    )


@contextlib.contextmanager
def _process(
    name: str, arguments: tuple[str, ...], lines: Queue[tuple[str, dict[str, Any] | None]], folder: Path
) -> Iterator[None]:
    """A process of ours whose JSON lines go to `lines`; its words are shown if it fails."""
    log = folder / f"{name}.log"
    with log.open("w+") as words:
        process = subprocess.Popen(
            [sys.executable, "-m", "tactiled", *arguments], stdout=subprocess.PIPE, stderr=words, text=True
        )
        assert process.stdout is not None  # asked for above
        reader = threading.Thread(target=_read, args=(name, process.stdout, lines), daemon=True)
        reader.start()
        try:
            yield
        finally:
            failed = process.poll() is not None
            process.terminate()
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            reader.join(5)
            process.stdout.close()
            if failed:
                click.echo(f"{name} said:\n{log.read_text()}", err=True)


def _read(name: str, stream: IO[str], lines: Queue[tuple[str, dict[str, Any] | None]]) -> None:
    for line in stream:
        lines.put((name, json.loads(line)))
    lines.put((name, None))


def _take(lines: Queue[tuple[str, dict[str, Any] | None]]) -> Iterator[tuple[str, dict[str, Any] | None]]:
    """What is there, waiting a moment for the first."""
    try:
        yield lines.get(timeout=0.1)
        while True:
            yield lines.get_nowait()
    except Empty:
        return


def _await(lines: Queue[tuple[str, dict[str, Any] | None]], name: str, what: str) -> None:
    until_s = time.monotonic() + START_WITHIN_S
    while time.monotonic() < until_s:
        for who, message in _take(lines):
            if message is None:
                raise DemoError(f"the {who} process ended before {what}; see above")
            if who == name:
                return
    raise DemoError(f"no sign of {what} in {START_WITHIN_S:g} s")


def _free_port() -> int:
    """A port that is free, and the next one too: the daemon takes requests there."""
    while True:
        with socket.socket() as probe, socket.socket() as beside:
            probe.bind(("127.0.0.1", 0))
            port: int = probe.getsockname()[1]
            with contextlib.suppress(OSError, OverflowError):  # in use, or beyond the last port
                beside.bind(("127.0.0.1", port + 1))
                return port


def _phase_words(phase: dict[str, Any]) -> str:
    surface = phase["surface"]
    over = (
        f" over grooves of {surface['period_mm']:g} mm at {surface['angle_deg']:g} deg"
        if surface["kind"] == "grooves"
        else " on a flat plate"
    )
    return str(phase["kind"]) + (over if phase["kind"] == "slide" else "")


def _say(*words: str) -> None:
    click.echo(" ".join(words), err=True)
