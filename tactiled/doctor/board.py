"""Check of the board: open its port, identify it, receive scans for 2 s, and restore its state.

On a busy host an answer of the board may take longer, or its scans may pause at the end of the 2 s: a board
that sends frames is waited for.
"""

import asyncio
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from tactiled import resources
from tactiled.config import Setup
from tactiled.daemon.board.diagnosis import SEARCH_ADVICE
from tactiled.daemon.board.link import STOP_S, BoardLink
from tactiled.daemon.serial.device import is_url
from tactiled.daemon.serial.port import SerialPort, open_port_in_thread
from tactiled.doctor.finding import Finding, split
from tactiled.errors import PortError
from tactiled.events.types import Event, ScanEvent, StatusEvent
from tactiled.pipeline import Health
from tactiled.samples.rate_meter import RateMeter
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Command, Corrupt, Hello
from tactiled.wire.layout import Layout, load_layout

LISTEN_S = 2.0  # a cause is named after one second; the second half of the scans gives the rate
_LATEST_S = 10.0  # for a board that sends frames and does not run yet
_STEP_S = 0.02
_TRY_S = 0.4  # at another baud rate: the board answers identify within 50 ms if it understands it
_BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600, 1_000_000, 2_000_000, 3_000_000)
_TAIL_BYTES = 4096  # several hellos or dozens of scans of any layout
_SAME_RATE = 0.03  # relative; instants are known to some milliseconds, in half a second or more
_SURE_SD_S = 2e-3  # usual after 2 s with a latency timer of 16 ms; 0.1 ms without
_NOISY_PART = 0.01
_LEAST_FRAMES = 2  # of a layout: one may be chance


@dataclass(frozen=True)
class BoardObservation:
    """Data of a board that was received for `listened_s`."""

    status: StatusEvent
    health: Health
    hello: Hello | None
    scans_s: list[float]  # instants of the scans, host monotonic seconds
    tail: bytes  # last bytes that were received
    listened_s: float


def check_board(setup: Setup) -> tuple[list[Finding], float]:
    """Check the line and the board; returns findings and scan rate (0 if unknown). The port must be free."""
    url = setup.config.port.url
    baud = setup.config.port.baud or setup.layout.file.baud
    try:
        observed = asyncio.run(_listen(setup, url, baud))
        findings = _judge(observed, setup.layout)
        if not observed.health.frames and not is_url(url):
            findings += asyncio.run(_search(setup, url, baud, observed.tail))
    except PortError as error:
        return [split("line", str(error).removeprefix(f"{url}: "), "fail")], 0.0
    return findings, observed.health.rate_hz


async def _listen(setup: Setup, url: str, baud: int) -> BoardObservation:
    """Run the board link of the daemon for `LISTEN_S`, then restore the state of the board.

    It takes longer where the rate must be measured first, and up to `_LATEST_S` more where a board sends
    frames and does not run.
    """
    layout, pipeline = setup.layout, setup.make_pipeline()
    listen_s = LISTEN_S + (RateMeter.LEAST_S if layout.measures_rate else 0.0)
    link = BoardLink(pipeline, setup.config.session, baud)
    session, encoder = link.session, Encoder(layout)
    began_s = time.monotonic()
    scans_s: list[float] = []
    found_streaming: list[bool] = []
    lost: list[str] = []
    tail = b""
    port = await open_port_in_thread(url, baud)

    def send(commands: list[Command]) -> None:
        for command in commands:
            link.sending(command, time.monotonic())
            port.write(encoder.encode(command))

    def note(event: Event) -> None:
        if isinstance(event, ScanEvent):
            scans_s.append(event.time_s)

    def received(data: bytes) -> None:
        nonlocal tail
        tail = (tail + data)[-_TAIL_BYTES:]
        send(link.received(data, time.monotonic(), note))
        if session.hello is not None and not found_streaming:
            found_streaming.append(session.hello.streaming)

    def is_over(now_s: float) -> bool:
        is_awaited = pipeline.health().frames > 0 and session.state in ("syncing", "stalled")
        return bool(lost) or now_s >= began_s + listen_s + (_LATEST_S if is_awaited else 0.0)

    try:
        port.attach(received, lost.append)
        pipeline.command("adapter", {"handover_s": port.handover_s}, time.monotonic())
        send(link.opened(time.monotonic(), _framing(port)))
        while not is_over(now_s := time.monotonic()):
            await asyncio.sleep(_STEP_S)
            send(link.watch(time.monotonic(), _framing(port)))
        listened_s = now_s - began_s
        status = link.make_status(now_s, started_s=began_s, connects=1, warning=port.warning)
        status = replace(status, reason=status.reason.removesuffix(SEARCH_ADVICE))
        if found_streaming == [False]:
            send(session.stop(time.monotonic()))
            end_s = time.monotonic() + STOP_S
            while session.is_stopping and time.monotonic() < end_s:
                await asyncio.sleep(_STEP_S)
                send(session.tick(time.monotonic()))
    finally:
        port.detach()
        await asyncio.to_thread(port.close)
    if lost:
        raise PortError(f"{url}: {lost[0]}")
    return BoardObservation(status, pipeline.health(), session.hello, scans_s, tail, listened_s)


def _judge(observed: BoardObservation, layout: Layout) -> list[Finding]:
    health, status, hello = observed.health, observed.status, observed.hello
    findings = [_bytes(health, status, observed.listened_s)]
    identity: dict[str, Any] = {}
    if hello is not None:
        identity = {"board_serial": hello.board_serial, "array_id": hello.array_id}
    if status.state == "fault" or (status.state != "running" and health.frames):
        findings.append(replace(split("board", status.reason, "fail"), values=identity))
    elif hello is not None and health.frames:
        words = (
            f"{hello.board_serial}, firmware {hello.firmware_version or 'unknown'}, array {hello.array_id}, "
            f"protocol {layout.name} {hello.protocol_version}"
        )
        findings.append(Finding("board", "ok", words, values=identity))
    if len(observed.scans_s) > 1 and hello is not None:
        findings += [check_rate(observed.scans_s, hello.rate_hz), _clock(health)]
    if status.warning:
        findings.append(split("warnings", status.warning, "warn"))
    return findings


def _judged(check: str, words: str, remedy: str, *, is_good: bool) -> Finding:
    return Finding(check, "ok", words) if is_good else Finding(check, "warn", words, remedy)


def _bytes(health: Health, status: StatusEvent, listened_s: float) -> Finding:
    if not health.frames:
        return split("line", status.reason or "no valid frame", "fail")
    per_s, part = health.bytes_in / listened_s, health.bytes_discarded / health.bytes_in
    words = f"{per_s:.0f} bytes a second, {health.frames} good frames, {100 * part:.1f} % of bytes damaged"
    remedy = "noise: check cable, ground and connectors"
    return _judged("line", words, remedy, is_good=part < _NOISY_PART)


def check_rate(scans_s: list[float], nominal_hz: float) -> Finding:
    """Compare the rate of two or more scans with the one that the board states.

    The first half does not count: scans wait behind the hello, and their instants are not yet known.
    """
    scans_s = scans_s[(len(scans_s) - 1) // 2 :]
    measured_hz = (len(scans_s) - 1) / (scans_s[-1] - scans_s[0])
    words = f"{measured_hz:.1f} scans a second arrive, the board states {nominal_hz:g}"
    remedy = (
        "scans are lost on the line, or the firmware does not reach its rate"
        if measured_hz < nominal_hz
        else "scans that were held back arrived together: is the host busy? Or the board's timer is too fast"
    )
    return _judged("rate", words, remedy, is_good=abs(measured_hz / nominal_hz - 1) < _SAME_RATE)


def _clock(health: Health) -> Finding:
    words = f"scan times have a standard deviation of {1e3 * health.clock_sd_s:.2f} ms after {LISTEN_S:g} s"
    remedy = "bytes arrive in bunches: check the latency timer of the adapter and the load on the host"
    return _judged("clock", words, remedy, is_good=health.clock_sd_s < _SURE_SD_S)


async def _search(setup: Setup, url: str, baud: int, received: bytes) -> list[Finding]:
    """Look for frames of other layouts in the received bytes, then at other baud rates."""
    layouts = {setup.config.board.protocol: setup.layout} | other_layouts(setup.layout)
    if (name := frames_of(received, layouts)) is not None:
        values = {"protocol": name, "baud": 0}
        words = f"the board sends frames of {name}"
        return [Finding("search", "fail", words, f'set board.protocol = "{name}"', values)]
    for other in (baud, *(rate for rate in _BAUDS if rate != baud)):
        data = await _heard(setup.layout, url, other)
        if (name := frames_of(data, layouts)) is not None:
            words = f"the board sends frames of {name} at {other} baud"
            remedy = f'set port.baud = {other} and board.protocol = "{name}"'
            return [Finding("search", "fail", words, remedy, {"protocol": name, "baud": other})]
    return [Finding("search", "fail", f"no frame of {', '.join(layouts)} at any usual baud rate")]


def other_layouts(layout: Layout) -> dict[str, Layout]:
    """Load all shipped layouts except this one, by their names in board.protocol."""
    shipped = {name: load_layout(name) for name in resources.shipped_names("protocols")}
    return {name: other for name, other in shipped.items() if other.name != layout.name}


def frames_of(data: bytes, layouts: Mapping[str, Layout]) -> str | None:
    """Return the name of the first layout that decodes frames in `data`, or None."""
    for name, layout in layouts.items():
        frames = Decoder(layout).feed(data)
        if sum(not isinstance(frame, Corrupt) for frame in frames) >= _LEAST_FRAMES:
            return name
    return None


async def _heard(layout: Layout, url: str, baud: int) -> bytes:
    """Receive what the board sends at a baud rate; nothing where the driver does not support the rate."""
    data = bytearray()
    with suppress(PortError):
        port = await open_port_in_thread(url, baud)
        try:
            port.attach(data.extend, lambda _: None)
            if layout.has("identify"):
                port.write(Encoder(layout).encode(Command("identify", 1)))
            await asyncio.sleep(_TRY_S)
        finally:
            port.detach()
            await asyncio.to_thread(port.close)
    return bytes(data)


def _framing(port: SerialPort) -> int | None:
    errors = port.errors()
    return errors.framing if errors is not None else None
