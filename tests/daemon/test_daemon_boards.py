"""Several boards in one daemon: what one of them meets, the others do not see."""

import asyncio
import errno
import itertools
import os
import socket
import threading
import time
import urllib.request
from collections.abc import Awaitable, Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from boards import LAYOUT, PtyBoard, SimBoard
from daemons import ARRAY, Daemon, Row, no_recorder
from patience import PATIENCE_S
from prometheus_client.parser import text_string_to_metric_families

from tactiled.client import AsyncCommander
from tactiled.daemon.board.session import SessionParams
from tactiled.daemon.operations.exporter import MetricsParams
from tactiled.daemon.operations.recorder import Recorder
from tactiled.daemon.runner import ServedBoard, ServiceParams
from tactiled.daemon.serial.port import PortParams
from tactiled.daemon.service import Service
from tactiled.pipeline import Pipeline
from tactiled.received import Output, Received
from tactiled.recording.contents import Header, load_board
from tactiled.recording.replay import replay as replay_files
from tactiled.recording.session import RecordParams

SERIALS = ("TS0001", "TS0002", "TS0003")
# A board is stalled after five scan periods: at this rate seldom by a busy machine.
RATE_HZ = 20.0
BUSY_S = 0.1  # a thread that sleeps 0.01 s and wakes later than this had to wait for the processor
HEADER = Header(load_board("board-v1", "wang2019-3x3"))


class HostLoad(threading.Thread):
    """Thread that notes whether the host gives this process no time, for which the daemon is not to blame."""

    def __init__(self) -> None:
        super().__init__()
        self.was_busy = False
        self._end = threading.Event()

    def run(self) -> None:
        before_s = time.monotonic()
        while not self._end.wait(0.01):
            now_s = time.monotonic()
            self.was_busy |= now_s - before_s > BUSY_S
            before_s = now_s

    def __enter__(self) -> "HostLoad":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self.join()


class Boards:
    """A service of three boards on ptys, and what its subscriber receives, by board."""

    def __init__(self, tmp_path: Path, **params: Any) -> None:
        self.daemon = Daemon(tmp_path)
        self.links = {serial: tmp_path / serial for serial in SERIALS}
        self.sims = {serial: SimBoard(serial, rate_hz=RATE_HZ) for serial in SERIALS}
        self.served = [
            ServedBoard(
                ServiceParams(
                    port=PortParams(url=str(self.links[serial])),
                    session=SessionParams(board_serial=serial),
                    publish=self.daemon.params.publish,
                    **params,
                ),
                Pipeline(LAYOUT, ARRAY),
                no_recorder(),
            )
            for serial in SERIALS
        ]
        self.ptys: dict[str, PtyBoard] = {}
        self.load = HostLoad()

    def rows(self, topic: str, serial: str) -> list[Row]:
        return [row for row in self.daemon.rows(topic) if row["board"] == serial]

    def states(self, serial: str) -> list[tuple[str, bool]]:
        return [(row["state"], row["valid"]) for row in self.rows("status", serial)]

    async def until_state(self, serial: str, state: str, words: str = "") -> None:
        def reached() -> bool:
            rows = self.rows("status", serial)
            return bool(rows) and rows[-1]["state"] == state and words in rows[-1]["reason"]

        await self.daemon.until(reached, f"{serial} {state} {words}")

    async def until_running(self, *serials: str) -> None:
        for serial in serials or SERIALS:
            await self.until_state(serial, "running")
            await self.until_scans(serial, 3)

    async def until_scans(self, serial: str, n: int) -> None:
        goal = len(self.rows("scan", serial)) + n
        await self.daemon.until(lambda: len(self.rows("scan", serial)) >= goal, f"{n} scans of {serial}")

    def check_undisturbed(self, *serials: str) -> None:
        """Check that boards, once they ran, were always valid, and that none of their scans is missing.

        Where the host gave the process no time, scans may have been late.
        """
        late = {("running", False), ("stalled", False)} if self.load.was_busy else set()
        for serial in serials:
            states = self.states(serial)
            begin = states.index(("running", True))
            reasons = [row["reason"] for row in self.rows("status", serial)]
            end = reasons.index("tactiled is stopping")
            assert set(states[begin:end]) - late == {("running", True)}, serial
            indices = [row["index"] for row in self.rows("scan", serial)]
            # The first scans may be sent before the subscription has reached the daemon.
            assert indices == list(range(indices[0], indices[0] + len(indices))), serial
            for topic in ("status", "scan", "info"):
                numbers = [row["seq"] for row in self.rows(topic, serial)]
                # None yet of the topic `info`, which comes once a second, where the story was short.
                assert [b - a for a, b in itertools.pairwise(numbers)] == [1] * (len(numbers) - 1), serial


def play(
    boards: Boards, story: Callable[[Service], Awaitable[None]], plugged: tuple[str, ...] = SERIALS
) -> None:
    """Run the service with the boards beside a story."""

    async def main() -> None:
        listening = asyncio.create_task(boards.daemon.listen())
        service = Service(boards.served)
        serving = asyncio.create_task(service.run())
        try:
            telling = asyncio.ensure_future(story(service))
            await asyncio.wait([telling, serving], return_when=asyncio.FIRST_COMPLETED)
            if serving.done():
                telling.cancel()
                await serving
            await telling
        finally:
            service.stop()
            await serving
            await boards.daemon.until_ended(len(SERIALS))
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)
        assert asyncio.all_tasks() == {asyncio.current_task()}

    with boards.load, ExitStack() as stack:
        for serial in plugged:
            boards.ptys[serial] = stack.enter_context(PtyBoard(boards.links[serial], boards.sims[serial]))
        asyncio.run(main())


def test_an_unplugged_board_is_not_noticed_by_the_others(tmp_path: Path) -> None:
    boards = Boards(tmp_path)

    async def story(_: Service) -> None:
        await boards.until_running()
        await asyncio.to_thread(boards.ptys["TS0001"].unplug)
        await boards.until_state("TS0001", "no-device")
        await boards.until_scans("TS0002", 20)
        await asyncio.to_thread(boards.ptys["TS0001"].plug)
        await boards.until_running("TS0001")
        for serial in SERIALS:
            await boards.daemon.until(lambda serial=serial: bool(boards.rows("info", serial)), "info")  # type: ignore[misc]

    play(boards, story)
    boards.check_undisturbed("TS0002", "TS0003")
    assert {row["board_serial"] for row in boards.daemon.rows("info")} == set(SERIALS)
    assert len({row["run"] for row in boards.daemon.rows("status")}) == 1
    assert not any(sim.streaming for sim in boards.sims.values())  # all are told to stop


def test_noise_on_one_line_is_not_noticed_by_the_others(tmp_path: Path) -> None:
    boards = Boards(tmp_path)

    async def story(_: Service) -> None:
        await boards.until_running()

        def send_noise(master: int, _: object) -> None:
            with suppress(BlockingIOError):  # nobody reads it yet
                os.write(master, os.urandom(64))

        boards.ptys["TS0002"]._send = send_noise  # type: ignore[method-assign, assignment]  # noqa: SLF001
        await boards.until_state("TS0002", "stalled", "bytes arrive but no frame passes")
        await boards.until_scans("TS0001", 20)

    play(boards, story)
    boards.check_undisturbed("TS0001", "TS0003")
    assert boards.rows("status", "TS0002")[-1]["frames_corrupt"] > 0
    assert any("bytes arrive but no frame passes" in row["reason"] for row in boards.rows("status", "TS0002"))
    assert boards.rows("status", "TS0001")[-1]["frames_corrupt"] == 0


@pytest.mark.parametrize("stranger", [SimBoard("TS0009"), SimBoard("TS0003", array_id="another")])
def test_a_wrong_board_is_a_fault_of_its_port_alone(tmp_path: Path, stranger: SimBoard) -> None:
    boards = Boards(tmp_path)
    stranger.streaming = True
    boards.sims["TS0003"] = stranger

    async def story(_: Service) -> None:
        await boards.until_running("TS0001", "TS0002")
        await boards.until_state("TS0003", "fault")
        await boards.until_scans("TS0001", 20)

    play(boards, story)
    boards.check_undisturbed("TS0001", "TS0002")
    assert boards.rows("scan", "TS0003") == boards.rows("scan", stranger.serial) == []
    assert {command.name for command in stranger.commands} == {"identify"}


def test_a_full_disk_of_one_board_stops_only_its_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    boards = Boards(tmp_path)
    bad, good = tmp_path / "bad", tmp_path / "good"
    good.mkdir()
    real = os.open

    def refuse(path: Any, *args: Any, **kwargs: Any) -> int:
        if str(path).startswith(str(bad)):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(path, *args, **kwargs)

    monkeypatch.setattr(os, "open", refuse)

    async def story(_: Service) -> None:
        await boards.until_running()
        for serial in SERIALS:
            await boards.until_scans(serial, 20)

    with (
        Recorder(RecordParams(directory=str(bad), min_free_mb=0), HEADER) as failing,
        Recorder(RecordParams(directory=str(good), min_free_mb=0), HEADER) as working,
    ):
        boards.served[0] = replace(boards.served[0], recorder=failing)
        boards.served[1] = replace(boards.served[1], recorder=working)
        play(boards, story)
    boards.check_undisturbed(*SERIALS)
    assert boards.rows("recording", "TS0001")[-1]["state"] == "failed"
    assert boards.rows("recording", "TS0002")[-1]["state"] == "recording"
    verdict = replay_files(sorted(good.glob("*.mcap")), lambda _: None)
    assert verdict.is_good
    assert verdict.compared >= 20


def test_a_fault_in_one_board_names_it_and_ends_the_recordings_of_all_others_whole(tmp_path: Path) -> None:
    boards = Boards(tmp_path)

    def fail(_received: Sequence[Received]) -> list[list[Output]]:
        raise ZeroDivisionError("a bug in a detector")

    async def main() -> ZeroDivisionError:
        listening = asyncio.create_task(boards.daemon.listen())
        serving = asyncio.create_task(Service(boards.served).run())
        try:
            await boards.until_running()
            boards.served[1].pipeline.detect = fail  # type: ignore[method-assign, assignment]
            with pytest.raises(ZeroDivisionError) as fault:
                await serving
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)
        return fault.value

    folder = tmp_path / "recordings"
    folder.mkdir()
    with (
        Recorder(RecordParams(directory=str(folder), min_free_mb=0), HEADER) as recorder,
        ExitStack() as stack,
    ):
        boards.served[0] = replace(boards.served[0], recorder=recorder)
        for serial in SERIALS:
            stack.enter_context(PtyBoard(boards.links[serial], boards.sims[serial]))
        assert asyncio.run(main()).__notes__ == ["board TS0002"]
    verdict = replay_files(sorted(folder.glob("*.mcap")), lambda _: None)
    assert verdict.is_good
    assert verdict.compared >= 3


def test_commands_go_to_the_board_that_they_name(tmp_path: Path) -> None:
    boards = Boards(tmp_path)

    async def story(_: Service) -> None:
        await boards.until_running()
        async with AsyncCommander(boards.daemon.endpoint) as commander:
            reply = await commander.send("speed", speed_mm_s=3.0)
            assert reply.reason == ("board: say which one is meant; there are: TS0001, TS0002, TS0003")
            reply = await commander.send("speed", board="TS0009", speed_mm_s=3.0)
            assert reply.reason.startswith("board: TS0009 is not read here")
            assert (await commander.send("state", board="TS0009")).reason == reply.reason
            assert (await commander.send("speed", board="TS0002", speed_mm_s=3.0)).ok
            assert (await commander.send("mark", board="TS0003", text="here")).ok
            speeds = {}
            for serial in SERIALS:
                state = (await commander.send("state", board=serial)).data
                speeds[serial] = state["settings"]["speed_mm_s"]
            assert speeds == {"TS0001": 0.0, "TS0002": 3.0, "TS0003": 0.0}
            state = (await commander.send("state")).data
            assert (state["settings"], state["boards"]) == ({}, list(SERIALS))
            assert {f"tactile/{serial}/scan" for serial in SERIALS} <= state["messages"].keys()
        await boards.daemon.until(lambda: len(boards.daemon.rows("command")) >= 2, "commands")

    play(boards, story)
    commands = [(row["board"], row["command"]) for row in boards.daemon.rows("command")]
    assert commands == [("TS0002", "speed"), ("TS0003", "mark")]


def test_one_metrics_page_has_all_boards(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    boards = Boards(tmp_path, metrics=MetricsParams(port=port))
    bodies: list[str] = []

    async def story(_: Service) -> None:
        await boards.until_running("TS0001", "TS0003")
        page = await asyncio.to_thread(urllib.request.urlopen, f"http://127.0.0.1:{port}/metrics")
        with page:
            bodies.append(page.read().decode())

    play(boards, story, ("TS0001", "TS0003"))
    families = {family.name: family for family in text_string_to_metric_families(bodies[0])}
    valid = {sample.labels["board"]: sample.value for sample in families["tactiled_valid"].samples}
    assert valid == {"TS0001": 1, "TS0002": 0, "TS0003": 1}
    assert len(families["tactiled_info"].samples) == 1
    assert bodies[0].count("# TYPE tactiled_valid ") == 1


def test_the_line_of_status_counts_fresh_boards_and_the_watchdog_is_fed_without_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    boards = Boards(tmp_path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "400000")
        got: list[str] = []

        async def until_told(wanted: str, n: int = 1) -> None:
            got.clear()
            async with asyncio.timeout(PATIENCE_S):
                while sum(wanted in message for message in got) < n:
                    try:
                        got.append(manager.recv(4096).decode())
                    except BlockingIOError:
                        await asyncio.sleep(0.01)

        async def story(_: Service) -> None:
            await until_told("STATUS=0 of 3 boards fresh; board TS0001 no-device")
            await until_told("WATCHDOG=1", 3)
            with PtyBoard(boards.links["TS0001"], boards.sims["TS0001"]):
                await until_told("STATUS=1 of 3 boards fresh; board TS0002 no-device")
                with PtyBoard(boards.links["TS0002"], boards.sims["TS0002"]):
                    with PtyBoard(boards.links["TS0003"], boards.sims["TS0003"]):
                        await until_told("STATUS=3 of 3 boards fresh")
                    await until_told("STATUS=2 of 3 boards fresh; board TS0003 no-device")

        play(boards, story, ())
