"""Board link in the whole daemon: dead descriptors, restarts versus losses, backlog never fresh."""

import asyncio
import itertools
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from boards import LAYOUT, PtyBoard, SimBoard
from daemons import ARRAY, Daemon, play
from patience import PATIENCE_S

from tactiled.array import Array
from tactiled.daemon.board.link import SILENT_S, BoardLink
from tactiled.daemon.board.session import SessionParams
from tactiled.daemon.operations.recorder import Recorder
from tactiled.daemon.serial import device
from tactiled.daemon.serial.port import PortParams
from tactiled.daemon.service import Service
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.line.faults import FaultAt, FaultParams
from tactiled.emulator.line.links import PtyLink
from tactiled.emulator.realtime import Emulator
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.events.types import Event, ScanEvent, StatusEvent
from tactiled.pipeline import Pipeline
from tactiled.received import Output
from tactiled.recording.contents import Header, Input, Read, RecordedEvent, load_board
from tactiled.recording.reader import read_items
from tactiled.recording.replay import replay
from tactiled.recording.session import RecordParams
from tactiled.samples.block import Gap, ScanBlock
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Frame
from tactiled.wire.layout import Layout


class Stuck(PtyBoard):
    """A board whose old descriptor stays open and dead when it comes back under its name."""

    def replace(self) -> None:
        """The node is made anew; whoever reads the old one hears nothing, not even that it is gone."""
        self._masters = [*getattr(self, "_masters", []), os.dup(self._master)]
        self.unplug()
        self.plug()

    def _live(self, master: int, gone: threading.Event) -> None:
        self._master = master
        super()._live(master, gone)

    def __exit__(self, *exits: object) -> None:
        super().__exit__(*exits)
        for master in getattr(self, "_masters", []):
            os.close(master)


def record_until(daemon: Daemon, file: Path, condition: Callable[[], bool]) -> None:
    """Serve and record until a condition holds."""
    header = Header(load_board("board-v1", "wang2019-3x3"))

    async def main() -> None:
        with Recorder(RecordParams(min_free_mb=0), header, file) as recorder:
            service = Service([daemon.served(recorder)])
            serving = asyncio.create_task(service.run())
            async with asyncio.timeout(PATIENCE_S):
                while not condition():
                    await asyncio.sleep(0.01)
            service.stop()
            await serving

    asyncio.run(main())


async def until_connects(daemon: Daemon, n: int) -> None:
    await daemon.until(lambda: bool(daemon.rows("status")) and daemon.status["connects"] == n, f"port {n}")


def test_a_stuck_descriptor_is_replaced_by_the_device_of_that_name(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path)
    took_s = []

    async def story(_: Service) -> None:
        board = Stuck(daemon.link)
        with board:
            await daemon.until_state("running")
            await daemon.until_scans()
            for turn in range(2):
                await asyncio.to_thread(board.replace)
                back_s = time.monotonic()
                await until_connects(daemon, turn + 2)
                await daemon.until_state("running")
                await daemon.until_scans()
                took_s.append(time.monotonic() - back_s)

    play(daemon, story)
    reasons = {row["reason"] for row in daemon.rows("status") if row["state"] == "no-device"}
    assert any("its name leads to another device" in reason for reason in reasons)
    assert len(took_s) == 2


@contextmanager
def tcp_board(port: int, deaf: int) -> Iterator[None]:
    """A board behind TCP whose first `deaf` connections are half dead: accepted, and never answered."""
    sim, decoder, encode = SimBoard(), Decoder(LAYOUT, "host-to-board"), Encoder(LAYOUT).encode
    listener = socket.create_server(("127.0.0.1", port))
    listener.settimeout(0.05)
    ending = threading.Event()
    kept: list[socket.socket] = []

    def live() -> None:
        while len(kept) <= deaf and not ending.is_set():
            with suppress(TimeoutError):
                kept.append(listener.accept()[0])
        board, n = kept[-1], 0
        board.settimeout(0.01)  # which also paces the scans
        while not ending.is_set():
            n += 1
            replies: list[Frame] = [sim.scan(10_000 * n)]
            with suppress(TimeoutError):
                for frame in decoder.feed(board.recv(4096)):
                    replies += sim.answer(frame) if isinstance(frame, Command) else []
            with suppress(OSError):
                board.sendall(b"".join(encode(frame) for frame in replies[not sim.streaming :]))

    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()
        for item in (*kept, listener):
            item.close()


def test_a_connection_that_delivers_nothing_is_reopened(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path)

    async def story(_: Service) -> None:
        with tcp_board(port, deaf=1):
            await daemon.until(lambda: bool(daemon.rows("info")), "a board that answers")
            await until_connects(daemon, 2)

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    daemon.params = daemon.params.model_copy(update={"port": PortParams(url=f"socket://127.0.0.1:{port}")})
    play(daemon, story)
    assert any("no byte for 3 s: opened anew" in row["reason"] for row in daemon.rows("status"))


def bare_link(array: Array = ARRAY) -> BoardLink:
    return BoardLink(Pipeline(LAYOUT, array), SessionParams(), LAYOUT.file.baud)


def test_a_silent_port_is_reopened_at_growing_intervals() -> None:
    link, now_s, openings = bare_link(), 100.0, []
    link.opened(now_s)
    while now_s < 800.0:
        now_s += 0.1
        if reason := link.expire_silence(now_s):
            openings.append(now_s)
            link.lost(reason)
            link.opened(now_s)
    waits = [b - a for a, b in itertools.pairwise([100.0, *openings])]
    assert waits[0] == pytest.approx(SILENT_S, abs=0.2)
    assert all(b >= a - 0.2 for a, b in itertools.pairwise(waits))
    assert waits[-1] == pytest.approx(60.0, abs=0.2)


def test_received_bytes_reset_the_interval() -> None:
    link = bare_link()
    link.opened(100.0)
    assert link.expire_silence(100.0 + SILENT_S)
    link.opened(104.0)
    assert not link.expire_silence(104.0 + SILENT_S)
    link.received(b"\0", 105.0, lambda _: None)
    assert not link.expire_silence(105.0 + 0.9 * SILENT_S)
    assert link.expire_silence(105.0 + SILENT_S)


def test_a_hello_after_a_silence_is_no_fault_of_the_line() -> None:
    sim, link = SimBoard(), bare_link()
    link.opened(100.0)
    for tenth in range(30):
        link.watch(100.0 + tenth / 10)
    assert "no bytes arrive" in link.session.reason(102.9)
    link.received(Encoder(LAYOUT).encode(sim.hello()), 102.95, lambda _: None)
    assert link.session.reason(102.95) == "waiting for scans"


def stream(sim: SimBoard, n: int, tick: int) -> bytes:
    encode = Encoder(LAYOUT).encode
    return b"".join(encode(sim.scan(tick + 10_000 * k)) for k in range(n))


@pytest.mark.parametrize("hello_is_lost", [False, True])
def test_a_reboot_is_a_restart_and_no_loss(hello_is_lost: bool) -> None:
    sim, link, events = SimBoard(), bare_link(), list[Event]()
    encode = Encoder(LAYOUT).encode
    link.opened(100.0)
    link.received(encode(sim.hello()) + stream(sim, 50, 0), 100.5, events.append)
    sim.reboot()
    if not hello_is_lost:
        link.received(encode(sim.hello()), 101.0, events.append)
    link.received(stream(sim, 50, 0), 101.5, events.append)
    link.received(encode(sim.hello()), 101.6, events.append)
    status = link.make_status(101.6, started_s=100.0, connects=1)
    assert (status.restarts, status.scans, status.scans_missing) == (1, 100, 0)


def test_scans_are_published_once_and_before_the_detectors_see_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sim, link, order = SimBoard(), bare_link(), list[str]()
    encode, detect = Encoder(LAYOUT).encode, link.pipeline.tuning.process

    def process(item: ScanBlock | Gap) -> list[Event]:
        order.append("detectors")
        return detect(item)

    monkeypatch.setattr(link.pipeline.tuning, "process", process)

    def receive(data: bytes, now_s: float) -> list[str]:
        order.clear()
        outputs: list[list[str]] = []
        link.received(
            data,
            now_s,
            lambda event: order.append(event.topic),
            lambda _data, found, _now_s: outputs.append([e.topic for e in found if isinstance(e, Event)]),
            lambda: order.append("offer"),
        )
        # The recorder has each scan beside the grip message of its instant.
        published = [topic for topic in order if topic not in ("detectors", "offer")]
        assert [sorted(topics) for topics in outputs] == [sorted(published)]
        return list(order)

    link.opened(100.0)
    assert receive(encode(sim.hello()) + stream(sim, 1, 0), 100.5)[:3] == ["scan", "offer", "detectors"]
    assert receive(stream(sim, 1, 10_000), 100.51)[:3] == ["scan", "offer", "detectors"]
    assert receive(stream(sim, 2, 20_000), 100.53)[:4] == ["scan", "scan", "offer", "detectors"]
    behind_hello = receive(stream(sim, 2, 40_000) + encode(sim.hello()) + stream(sim, 1, 60_000), 100.56)
    assert behind_hello[:5] == ["scan", "scan", "scan", "offer", "detectors"]
    another = replace(sim.hello(), board_serial="TS0002")
    assert receive(encode(another) + stream(sim, 1, 70_000), 100.57)[:3] == ["scan", "offer", "detectors"]


def test_a_read_with_scans_of_two_boards_is_recorded_and_not_published() -> None:
    sim, link, recorded = SimBoard(), bare_link(), list[Output]()
    published: list[str] = []

    def receive(data: bytes, now_s: float) -> int:
        published.clear()
        link.received(
            data,
            now_s,
            lambda event: published.append(event.topic),
            lambda _data, outputs, _now_s: recorded.extend(outputs),
        )
        return published.count("scan")

    link.opened(100.0)
    assert receive(Encoder(LAYOUT).encode(sim.hello()) + stream(sim, 2, 0), 100.5) == 2
    other = Encoder(LAYOUT).encode(replace(sim.hello(), board_serial="TS0009"))
    assert receive(stream(sim, 2, 20_000) + other + stream(sim, 1, 0), 100.53) == 0
    assert not published
    assert receive(stream(sim, 1, 10_000), 100.54) == 1
    assert sum(isinstance(output, ScanEvent) for output in recorded) == 6


def test_a_hello_that_waited_in_the_backlog_of_a_stall_is_no_restart() -> None:
    """A silence of 4 s, then a hello that the board had sent after 1.3 s."""
    sim, link, events = SimBoard(), bare_link(), list[Event]()
    encode = Encoder(LAYOUT).encode
    link.opened(100.0)
    link.received(encode(replace(sim.hello(), ticks=0)) + stream(sim, 50, 0), 100.5, events.append)
    link.received(encode(replace(sim.hello(), ticks=1_760_000)), 104.4, events.append)
    stream(sim, 350, 500_000)
    link.received(stream(sim, 50, 4_000_000), 104.5, events.append)
    status = link.make_status(104.5, started_s=100.0, connects=1)
    assert (status.restarts, status.scans, status.scans_missing) == (0, 100, 350)


@pytest.mark.parametrize("away_s", [0.483, 100.0])
def test_a_stalled_host_is_no_restart_of_a_board_whose_counters_go_on(away_s: float) -> None:
    """The queue of the port holds the first 0.4 s; then come a hello, an answer to a ping, and new scans."""
    sim, link, events = SimBoard(), bare_link(), list[Event]()
    encode, away_ticks = Encoder(LAYOUT).encode, round(away_s * 1e6)
    link.opened(100.0)
    link.received(encode(replace(sim.hello(), ticks=0)), 100.0, events.append)
    for k in range(500):
        link.received(stream(sim, 1, 10_000 * k), 100.015 + 0.01 * k, events.append)
    link.watch(105.0)
    link.watch(105.0 + away_s)
    assert not link.expire_silence(105.0 + away_s)  # this process slept, not the port
    link.received(stream(sim, 40, 5_000_000), 105.0 + away_s, events.append)
    link.sending(Command("ping", 1), 105.001 + away_s)
    behind = encode(replace(sim.hello(), ticks=5_002_000 + away_ticks))
    answer = encode(Acknowledge(1, "ping", "ok", ticks=5_004_000 + away_ticks))
    link.received(behind + answer, 105.005 + away_s, events.append)
    n_lost = round(100 * away_s) - 40 + 1
    stream(sim, n_lost, 0)
    link.received(stream(sim, 1, 5_010_000 + away_ticks), 105.025 + away_s, events.append)
    status = link.make_status(105.03 + away_s, started_s=100.0, connects=1)
    assert (status.restarts, status.scans, status.scans_missing) == (0, 541, n_lost)


def test_another_board_on_the_port_is_not_a_restart_of_the_first() -> None:
    """The second has the boot count and the rate of the first, and another ADC: its volts are its own."""
    link, events = bare_link(), list[Event]()
    encode = Encoder(LAYOUT).encode
    for serial in ("TS0001", "TS0002"):
        sim = SimBoard(serial=serial)
        link.opened(100.0)
        link.received(encode(sim.hello()) + stream(sim, 5, 0), 100.5, events.append)
        link.lost("unplugged")
    status = link.make_status(101.0, started_s=100.0, connects=2)
    assert (status.restarts, status.scans_missing, status.scans) == (0, 0, 10)


def test_a_status_that_is_not_valid_for_late_scans_says_so() -> None:
    """Scans that wait for 4 s: the board runs, and what arrives of it is old."""
    sim, link, events = SimBoard(), bare_link(), list[Event]()
    link.opened(100.0)
    link.received(Encoder(LAYOUT).encode(sim.hello()) + stream(sim, 50, 0), 100.5, events.append)
    fresh = link.make_status(100.5, started_s=100.0, connects=1)
    assert (fresh.state, fresh.valid, fresh.reason) == ("running", True, "")
    link.received(stream(sim, 50, 500_000), 104.5, events.append)
    late = link.make_status(104.5, started_s=100.0, connects=1)
    assert (late.state, late.valid) == ("running", False)
    assert late.reason.startswith("scans come late: the newest was taken 3")


def test_a_channel_that_comes_up_after_the_zero_is_named_until_a_tare() -> None:
    sim, link = SimBoard(), bare_link(replace(ARRAY, zero_first_s=0.3))
    encode, events = Encoder(LAYOUT).encode, list[Event]()
    late = []
    for k in range(30):
        scan = sim.scan(10_000 * k)
        scan.counts[5] = 4095
        late.append(encode(scan))
    link.opened(100.0)
    assert link.info(sim.hello(), 100.0).zero == ()
    link.received(encode(sim.hello()) + b"".join(late), 100.3, events.append)
    link.received(stream(sim, 60, 300_000), 100.9, events.append)
    link.make_status(100.9, started_s=100.0, connects=1)
    assert link.warnings["zero"].startswith("channels [5] had no valid reading in the first 0.3 s")
    zero = link.info(sim.hello(), 100.9).zero
    assert (len(zero), zero[5]) == (36, 0.0)
    assert zero[4] == pytest.approx(1000 * 3.0 / 4096)
    assert link.pipeline.command("tare", {"force": False}, 100.9) == ("", [])
    assert not link.make_status(100.9, started_s=100.0, connects=1).warning


def test_the_latency_timer_of_the_adapter_is_used_by_the_clock_recorded_and_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(device, "shorten_latency", lambda _: 16)
    daemon, file = Daemon(tmp_path), tmp_path / "a.mcap"
    with PtyBoard(daemon.link):
        record_until(daemon, file, lambda: daemon.pipeline.health().scans >= 30)
    first, *_ = [item for item in read_items(file) if not isinstance(item, RecordedEvent)]
    assert isinstance(first, Input)
    assert (first.name, first.values()) == ("adapter", {"handover_s": 0.016})
    verdict = replay([file], lambda _: None)
    assert (verdict.is_good, verdict.compared >= 30) == (True, True)
    events = [item.event for item in read_items(file) if isinstance(item, RecordedEvent)]
    warnings = [event.warning for event in events if isinstance(event, StatusEvent)]
    assert any("every 16 ms only" in warning for warning in warnings)
    assert caplog.text.count("every 16 ms only") == 1


def is_answered_ping(frame: object) -> bool:
    return isinstance(frame, Acknowledge) and frame.command == "ping"


def test_pings_are_answered_recorded_and_replayed_bit_for_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon, file = Daemon(tmp_path), tmp_path / "a.mcap"
    receive, live, n_answers = daemon.pipeline.receive, Decoder(LAYOUT), 0

    def counted(data: bytes, now_s: float) -> Any:
        nonlocal n_answers
        n_answers += sum(map(is_answered_ping, live.feed(data)))
        return receive(data, now_s)

    monkeypatch.setattr(daemon.pipeline, "receive", counted)
    with emulated(daemon.link, load_scene("rest"), FaultParams()):
        record_until(daemon, file, lambda: n_answers >= 3)
    pings, answers = list[Input](), list[tuple[float, Acknowledge]]()
    decoder = Decoder(LAYOUT)
    for item in read_items(file):
        if isinstance(item, Input) and item.name == "ping":
            pings.append(item)
        elif isinstance(item, Read):
            frames = decoder.feed(item.data)
            acknowledged = [frame for frame in frames if isinstance(frame, Acknowledge)]
            answers += [(item.arrival_s, frame) for frame in acknowledged if frame.command == "ping"]
    assert len(pings) >= 3
    assert len(answers) >= len(pings) - 1
    sent_s = {ping.values()["token"]: ping.time_s for ping in pings}
    for arrival_s, answer in answers:
        assert answer.result == "ok"
        assert arrival_s - sent_s[answer.token] > 0
    verdict = replay([file], lambda _: None)
    assert (verdict.is_good, verdict.compared >= 100) == (True, True)


def test_a_clock_beyond_the_limit_is_named_in_status_and_once_in_the_log(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    daemon = Daemon(tmp_path)

    async def story(_: Service) -> None:
        await daemon.until_state("running")
        await daemon.until(lambda: "max_drift_ppm = 200" in daemon.status["warning"], "the warning")
        await daemon.until(lambda: "too slow" in daemon.status["warning"], "the direction")
        await daemon.until_scans(100)  # with a warning in each status, and one line in the log
        assert daemon.status["clock_sd_s"] > 0

    with emulated(
        daemon.link, load_scene("rest"), FaultParams(), board=EmulatedBoardParams(drift_ppm=-10_000.0)
    ):
        play(daemon, story)
    assert caplog.text.count("set samples.clock.max_drift_ppm") == 1


@contextmanager
def emulated(
    link: Path,
    scene: Scene,
    faults: FaultParams,
    layout: Layout = LAYOUT,
    board: EmulatedBoardParams | None = None,
) -> Iterator[None]:
    """Emulator in a thread beside the daemon."""
    emulator = Emulator(scene, layout, PtyLink(link), board=board, faults=faults, report=lambda _: None)
    thread = threading.Thread(target=emulator.run)
    thread.start()
    try:
        yield
    finally:
        emulator.stop()
        thread.join()


def test_a_backlog_is_delivered_marked_late_and_raises_no_valid_slip(tmp_path: Path) -> None:
    """The skin begins to slide while nothing arrives; half a second later all of it does."""
    demo = load_scene("prescribed")
    rest, press, hold, slide = demo.phases[:4]
    phases = [
        rest.model_copy(update={"duration_s": 0.3}),
        press.model_copy(update={"duration_s": 0.6}),
        hold.model_copy(update={"duration_s": 1.1}),
        slide,
    ]
    scene = demo.model_copy(update={"phases": phases})
    daemon = Daemon(tmp_path)

    async def story(_: Service) -> None:
        await daemon.until(lambda: any(row["late"] for row in daemon.rows("scan")), "late scans")
        await daemon.until(lambda: bool(daemon.rows("slip")), "the slip")
        await daemon.until_state("running")
        await daemon.until(lambda: daemon.status["valid"], "fresh again")

    stall = FaultParams(at=[FaultAt(kind="stall", at_s=2.05)], stall_s=1.0)
    with emulated(daemon.link, scene, stall):
        play(daemon, story)
    onset = next(row for row in daemon.rows("slip") if row["state"] == "onset")
    assert not onset["valid"]
    scans = daemon.rows("scan")
    late = [row for row in scans if row["late"]]
    assert len(late) >= 50
    assert all(row["age_s"] > 0.1 for row in late)
    assert [row["index"] for row in scans] == list(range(scans[0]["index"], scans[-1]["index"] + 1))
    stalled = [row for row in daemon.rows("status") if row["state"] == "stalled"]
    assert stalled
    assert not any(row["valid"] for row in stalled)
