"""``tactiled demo``: board emulator, daemon and subscriber as processes; estimates against truth."""

import contextlib
import dataclasses
import json
import os
import subprocess
import tempfile
import threading
import time
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from queue import Empty, Queue
from typing import IO, Any

import click
import numpy as np

from tactiled import child
from tactiled.array import load_array
from tactiled.demo.comparison import HEAD, Host, compare, finds_end_s, true_releases, true_slides
from tactiled.demo.slip_picture import draw_slips
from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.scene.phases import GroovedPlate
from tactiled.emulator.scene.truth import TruePhase, TrueSlip, Truth
from tactiled.errors import ConfigError, TactiledError
from tactiled.events.codec import evidence_key, message_key
from tactiled.events.types import Candidate, Event, GripEvent, SlipEvent, TextureEvent
from tactiled.events.words import event_words
from tactiled.plain_table import table
from tactiled.plots.log import KnownTruth, draw_log
from tactiled.progress import ProgressBar

SPEED_MM_S = 1.0  # of the slides in config/scenes/demo.toml; on a robot, the gripper knows it
SCENE = "demo"
RELEASE = "slip without motion: the remaining shear is released"
START_WITHIN_S = 60.0  # of each process; Python and its libraries take 6 s to start on a small loaded machine
GRACE_S = 5.0  # for scans that are late at the end; a longer backlog means that the host is too slow
_REST_S = 8.0  # between two plays below the page: the board is pulled out and plugged in, as the lamp shows
_CONFIG = """\
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
    """Failure of one of the three processes."""


Lines = Queue[tuple[str, dict[str, Any] | None]]


@dataclasses.dataclass
class DemoRecord:
    """Data of the subscriber and the emulator, on the host's monotonic clock."""

    t0_s: float  # instant of scene time 0
    unix_offset_s: float  # from this clock to epoch seconds
    time_s: list[float] = dataclasses.field(default_factory=list)
    volts: list[list[float]] = dataclasses.field(default_factory=list)
    events: list[Event] = dataclasses.field(default_factory=list)
    host: Host = dataclasses.field(default_factory=Host)
    next_index: int | None = None  # of the next expected scan


def run_demo(picture: Path) -> bool:
    """Play the demo scene through three processes; True when every estimate is right and the host kept up.

    `DemoError` where a process did not start, `ConfigError` where the picture cannot be written.
    """
    if not picture.parent.is_dir() or picture.suffix not in (".png", ".pdf", ".svg"):
        raise ConfigError("--out", [f"{picture}: name a .png, .pdf or .svg in a folder that exists"])
    cut_short, unix_offset_s = "", time.time() - time.monotonic()
    with ExitStack() as stack:
        folder, link, endpoint, config = stack.enter_context(_demo_folder())
        lines: Lines = Queue()

        def start(name: str, *arguments: str) -> None:
            stack.enter_context(_process(name, arguments, lines, folder))

        _say("subscriber: tactiled listen", endpoint)
        start("subscriber", "listen", endpoint)
        _say("daemon: tactiled run --config", str(config))
        start("daemon", "run", "--config", str(config))
        truth = Truth(load_scene(SCENE))
        slides = true_slides(truth)
        end_s = finds_end_s(slides, truth.scene.duration_s)
        true_events = sorted(
            [(phase.start_s, _phase_words(phase)) for phase in truth.phases]
            + [(slip.onset_s, RELEASE) for slip in truth.slips if slip.direction_deg is None]
        )
        _await_line(lines, "subscriber", "the daemon's first status")
        _say("board: tactiled emulate --scene", SCENE, "--link", str(link))
        start("board", "emulate", "--scene", SCENE, "--link", str(link))
        t0_s = _await_line(lines, "board", "the start of the scene", "scene")["t0_s"]
        seen = DemoRecord(t0_s, unix_offset_s)
        bar = stack.enter_context(ProgressBar("demo", end_s))
        while not cut_short and (not seen.time_s or seen.time_s[-1] < t0_s + end_s):
            bar.reach(time.monotonic() - t0_s)
            for name, message in _take_lines(lines):
                if message is None:
                    played_s = time.monotonic() - t0_s
                    cut_short = f"the {name} process ended after {played_s:.1f} of {end_s:.1f} s"
                elif name == "subscriber":
                    _receive(message, seen)
            while true_events and time.monotonic() >= t0_s + true_events[0][0]:
                scene_s, words = true_events.pop(0)
                _say(f"{scene_s:6.2f} s  true:", words)
            if not cut_short and time.monotonic() > t0_s + end_s + GRACE_S:
                reached_s = seen.time_s[-1] - t0_s if seen.time_s else 0.0
                cut_short = f"{GRACE_S:g} s after its end, scans had come of {reached_s:.1f} of {end_s:.1f} s"
    return _judge(picture, seen, truth, slides, cut_short)


def _judge(picture: Path, seen: DemoRecord, truth: Truth, slides: Sequence[TrueSlip], cut_short: str) -> bool:
    """Print the results; estimates are judged only if the host kept up with the board."""
    verdict = compare(slides, seen.events, seen.t0_s, true_releases(truth))
    _say("host:", str(seen.host))
    if too_slow := seen.host.too_slow(is_wrong=verdict.is_groove_wrong):
        load, _, _ = os.getloadavg()
        _say(
            f"this host is too slow or too busy for the demo: {too_slow} (load {load:.1f} on "
            f"{os.cpu_count()} processors). The line is not at fault, and the estimates are not judged."
        )
    else:
        click.echo("\n" + table(HEAD, verdict.rows))
    if cut_short:
        _say(f"the demo was cut short: {cut_short}")
    if seen.time_s:
        whole = picture.with_stem(f"{picture.stem}-log")
        title = _draw(picture, whole, seen, truth, slides)
        click.echo(f"\n{title}.\npictures: {picture} (the slips), {whole} (all that was read and found)")
    for words in verdict.wrong:
        _say("not judged:" if too_slow else "wrong:", words)
    return not (too_slow or cut_short or verdict.wrong)


def _receive(message: dict[str, Any], seen: DemoRecord) -> None:
    """Store a message of the subscriber and print events."""
    topic = message["topic"]
    if topic == "scan":
        seen.time_s.append(message["timestamp"] - seen.unix_offset_s)
        seen.volts.append(message["volts"])
        host = seen.host
        host.scans += 1
        host.late += message["late"]
        host.oldest_s = max(host.oldest_s, message["age_s"])
        host.lost += 0 if seen.next_index is None else max(message["index"] - seen.next_index, 0)
        seen.next_index = message["index"] + 1
        return
    if topic == "status":
        seen.host.fits_late = message["fits_late"]
    event = _event(topic, message, seen.unix_offset_s)
    if event is not None:
        seen.events.append(event)
    if topic in ("contact", "slip", "texture"):
        found_s = message[evidence_key(topic)] - seen.unix_offset_s - seen.t0_s
        _say(f"{found_s:6.2f} s  found:", event_words(topic, message))


def _event(topic: str, message: dict[str, Any], unix_offset_s: float) -> Event | None:
    """Convert a message back to its event on the monotonic clock."""
    kinds: dict[str, type[Event]] = {"grip": GripEvent, "slip": SlipEvent, "texture": TextureEvent}
    kind = kinds.get(topic)
    if kind is None:
        return None
    fields = {}
    for field in dataclasses.fields(kind):
        value = message[key := message_key(field.name)]
        fields[field.name] = value if key == field.name else value - unix_offset_s
    if kind is TextureEvent:
        fields["candidates"] = tuple(Candidate(**c) for c in fields["candidates"])
    return kind(**fields)


def _draw(picture: Path, whole: Path, seen: DemoRecord, truth: Truth, slides: Sequence[TrueSlip]) -> str:
    t0_s = seen.t0_s
    shear_s = [phase.start_s for phase in truth.phases if phase.kind == "slide"]
    instant_s = np.array(seen.time_s) - t0_s
    played = (instant_s >= 0) & (instant_s <= truth.scene.duration_s)
    shown = KnownTruth(
        onsets_s=tuple(t0_s + slide.onset_s for slide in slides),
        spans_s=tuple(
            (t0_s + max(s for s in shear_s if s <= slide.onset_s), t0_s + (slide.gross_s or slide.end_s))
            for slide in slides
        ),
        time_s=t0_s + instant_s[played],
        utilisation=truth.utilisation(instant_s[played]),
    )
    title = draw_slips(picture, seen.events, shown)
    array = load_array("wang2019-3x3")
    time_s, volts = np.array(seen.time_s), np.array(seen.volts)
    draw_log(whole, array, time_s, volts, seen.events, "tactiled demo", truth=shown)
    return title


def run_page_demo(port: int, *, opens: bool) -> None:
    """Play the demo scene again and again below the live page, until Ctrl-C.

    With `opens`, the browser of this desktop shows the page. `DemoError` where a process does not start or
    ends.
    """
    play_s = load_scene(SCENE).duration_s + _REST_S
    lines: Lines = Queue()
    with ExitStack() as stack:
        folder, link, endpoint, config = stack.enter_context(_demo_folder())
        stack.enter_context(_process("daemon", ("run", "--config", str(config)), lines, folder))
        page = ("web", "--events", endpoint, "--port", str(port), "--allow-commands")
        stack.enter_context(_process("page", page, lines, folder))
        url = _await_line(lines, "page", "the address of the page")["url"]
        click.echo(f"The page: {url}\nCtrl-C ends the demo.", err=True)
        if opens:
            webbrowser.open(url)
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                with _process("board", ("emulate", "--scene", SCENE, "--link", str(link)), lines, folder):
                    until_s = time.monotonic() + play_s
                    while time.monotonic() < until_s:
                        for name, message in _take_lines(lines):
                            if message is None and name != "board":  # a board ends after each play
                                raise DemoError(f"the {name} process ended; see above")


@contextlib.contextmanager
def _demo_folder() -> Iterator[tuple[Path, Path, str, Path]]:
    """Make a folder for the block; yield it, the board's port, the daemon's endpoint and configuration."""
    # The name of a socket has at most 107 bytes, and TMPDIR may be longer.
    place = "/tmp" if len(tempfile.gettempdir()) > 60 else None  # the name is random
    with tempfile.TemporaryDirectory(prefix="tactiled-demo-", dir=place) as name:
        link, endpoint, config = Path(name, "board"), f"ipc://{name}/events.ipc", Path(name, "tactiled.toml")
        config.write_text(_CONFIG.format(link=link, endpoint=endpoint, speed=SPEED_MM_S))
        yield Path(name), link, endpoint, config


@contextlib.contextmanager
def _process(name: str, arguments: tuple[str, ...], lines: Lines, folder: Path) -> Iterator[None]:
    """Run a tactiled command; its JSON lines go to `lines`, and its stderr is printed if it fails."""
    log = folder / f"{name}.log"
    with log.open("w+") as words:
        started = child.start(*arguments, stdout=subprocess.PIPE, stderr=words, text=True)
        assert started.stdout is not None  # asked for above
        reader = threading.Thread(target=_read, args=(name, started.stdout, lines), daemon=True)
        reader.start()
        try:
            yield
        finally:
            failed = started.poll() not in (None, 0)
            child.end(started)
            reader.join(5)
            started.stdout.close()
            if failed:
                click.echo(f"stderr of {name}:\n{log.read_text()}", err=True)


def _read(name: str, stream: IO[str], lines: Lines) -> None:
    for line in stream:
        lines.put((name, json.loads(line)))
    lines.put((name, None))


def _take_lines(lines: Lines) -> Iterator[tuple[str, dict[str, Any] | None]]:
    """Yield queued lines, waiting up to 0.1 s for the first."""
    try:
        yield lines.get(timeout=0.1)
        while True:
            yield lines.get_nowait()
    except Empty:
        return


def _await_line(lines: Lines, name: str, what: str, kind: str | None = None) -> dict[str, Any]:
    """Wait for the first line of a process, or the first of a given `kind`."""
    until_s = time.monotonic() + START_WITHIN_S
    while time.monotonic() < until_s:
        for who, message in _take_lines(lines):
            if message is None:
                raise DemoError(f"the {who} process ended before {what}; see above")
            if who == name and kind in (None, message.get("what")):
                return message
    load, _, _ = os.getloadavg()
    raise DemoError(
        f"{what} did not come within {START_WITHIN_S:g} s: this host is too slow or too busy for the demo "
        f"(load {load:.1f} on {os.cpu_count()} processors)"
    )


def _phase_words(phase: TruePhase) -> str:
    over = " on a flat plate"
    if isinstance(grooves := phase.surface, GroovedPlate):
        over = f" over grooves of {grooves.period_mm:g} mm at {grooves.angle_deg:g} deg"
    return phase.kind + (over if phase.kind == "slide" else "")


def _say(*words: str) -> None:
    click.echo(" ".join(words), err=True)
