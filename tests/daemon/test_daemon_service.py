"""Whole daemon in this process, with a board on a real pty and a subscriber on a real socket."""

import asyncio
import itertools
import logging
import math
import os
import signal
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import pytest
from boards import PtyBoard, SimBoard
from daemons import Daemon, play
from hypothesis import given
from hypothesis import strategies as st
from patience import PATIENCE_S

from tactiled import limited_log
from tactiled.daemon import service as service_module
from tactiled.daemon.runner import STATUS_PERIOD_S, BoardRunner, next_due_s
from tactiled.daemon.service import Service, serve
from tactiled.daemon.zmq.params import PublishParams
from tactiled.received import Received
from tactiled.wire.frames import Command, Frame


def test_scans_status_and_info_of_a_board(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path)

    async def story(_: Service) -> None:
        await daemon.until_state("running")
        await daemon.until_scans(20)
        await daemon.until(lambda: bool(daemon.rows("info")), "info")
        await daemon.until(lambda: daemon.status["valid"], "a valid status")

    with PtyBoard(daemon.link) as board:
        play(daemon, story)
        assert not board.sim.streaming  # told to stop when we left
    scans = daemon.rows("scan")
    assert [b["index"] - a["index"] for a, b in itertools.pairwise(scans)] == [1] * (len(scans) - 1)
    assert scans[-1]["volts"] == [pytest.approx(1000 * 3.0 / 4096)] * 36
    assert abs(scans[-1]["timestamp"] - time.time()) < PATIENCE_S
    valid = [row for row in daemon.rows("status") if row["valid"]]
    assert {row["state"] for row in valid} == {"running"}
    assert {row["board"] for row in valid} == {"TS0001"}
    assert max(row["age_s"] for row in valid) <= 0.1
    last = daemon.status
    assert (last["state"], last["valid"], last["reason"]) == ("no-device", False, "tactiled is stopping")
    assert last["bytes_in"] == last["bytes_framed"] + last["bytes_discarded"] + last["bytes_pending"]
    assert daemon.rows("info")[0]["board_serial"] == "TS0001"
    assert len(daemon.rows("info")[0]["channel_names"]) == 36


def test_a_board_that_is_slow_to_answer_is_stopped_before_its_port_is_closed(tmp_path: Path) -> None:
    class Slow(SimBoard):
        def answer(self, command: Command) -> list[Frame]:
            time.sleep(0.4 if command.name == "stop" else 0.0)
            return super().answer(command)

    daemon = Daemon(tmp_path)

    async def story(_: Service) -> None:
        await daemon.until_state("running")

    with PtyBoard(daemon.link, Slow()) as board:
        play(daemon, story)
        assert not board.sim.streaming


def test_a_stop_that_the_board_does_not_get_is_repeated(tmp_path: Path) -> None:
    class Deaf(SimBoard):
        n_stops = 0

        def answer(self, command: Command) -> list[Frame]:
            self.n_stops += command.name == "stop"
            return [] if self.n_stops == 1 else super().answer(command)

    daemon = Daemon(tmp_path)

    async def story(_: Service) -> None:
        await daemon.until_state("running")

    with PtyBoard(daemon.link, Deaf()) as board:
        play(daemon, story)
        assert not board.sim.streaming


def test_a_missing_port_is_reported_and_retried(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path)

    async def story(_: Service) -> None:
        await daemon.until_state("no-device", "no such port")
        assert daemon.status["board"] == ""
        await daemon.until(lambda: daemon.status["age_s"] > 0.1, "an age that grows without a board")
        assert daemon.status["board"] == ""
        with PtyBoard(daemon.link):
            await daemon.until_state("running")

    play(daemon, story)


def test_a_stalling_line_is_logged_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = Daemon(tmp_path)

    async def story(_: Service) -> None:
        with PtyBoard(daemon.link) as board:
            await daemon.until_state("running")
            for _turn in range(4):
                board.silent = True
                await daemon.until_state("stalled")
                board.silent = False
                await daemon.until_state("running")

    monkeypatch.setattr(limited_log, "PERIOD_S", math.inf)  # then what repeats is counted in another line
    with caplog.at_level(logging.INFO, "tactiled"):
        play(daemon, story)
    states = [state for state, _ in itertools.groupby(row["state"] for row in daemon.rows("status"))]
    assert states.count("stalled") >= 4
    assert len([line for line in caplog.messages if "stalled" in line]) == 1
    assert len([line for line in caplog.messages if "running" in line]) == 1


def test_the_endpoints_are_logged_at_the_start(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    daemon, second = Daemon(tmp_path), f"ipc://{tmp_path}/second.ipc"
    publish = PublishParams(endpoints=("ipc://{runtime}/events.ipc", second))
    daemon.params = daemon.params.model_copy(update={"publish": publish})

    async def story(_: Service) -> None:
        await daemon.until_state("no-device")

    with caplog.at_level(logging.INFO, "tactiled"):
        play(daemon, story)
    assert caplog.messages.count(f"events on {daemon.endpoint} and {second}") == 1


def test_a_bug_in_the_data_path_ends_the_daemon_instead_of_starving_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = Daemon(tmp_path)

    def broken(_data: bytes, _now_s: float) -> Received:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(daemon.pipeline, "receive", broken)

    async def main() -> None:
        service = Service([daemon.served()])
        with PtyBoard(daemon.link), pytest.raises(ZeroDivisionError, match="a bug"):
            await service.run()

    asyncio.run(asyncio.wait_for(main(), PATIENCE_S))


def test_a_bug_in_the_sending_of_a_read_ends_the_daemon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = Daemon(tmp_path)

    async def main() -> None:
        service = Service([daemon.served()])
        server = service._network.publisher.server  # noqa: SLF001  it has no other way to fail
        real = server.flush

        def flush() -> None:
            real()
            if sys.exc_info()[0] is None and daemon.pipeline.health().scans and not server.is_held:
                raise ZeroDivisionError("a bug")

        monkeypatch.setattr(server, "flush", flush)
        asyncio.get_running_loop().set_exception_handler(lambda *_: None)  # the flush of a status
        with PtyBoard(daemon.link), pytest.raises(ZeroDivisionError, match="a bug"):
            await service.run()

    asyncio.run(asyncio.wait_for(main(), PATIENCE_S))


def test_a_bug_in_the_data_path_while_the_line_is_drained_is_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    daemon = Daemon(tmp_path)
    real = daemon.pipeline.receive

    async def story(service: Service) -> None:
        await daemon.until_state("running")
        (runner,) = service._runners  # noqa: SLF001  the fault must come after its stop

        def broken(data: bytes, now_s: float) -> Received:
            if runner._end.done():  # noqa: SLF001
                raise ZeroDivisionError("a bug")
            return real(data, now_s)

        monkeypatch.setattr(daemon.pipeline, "receive", broken)

    with PtyBoard(daemon.link):
        play(daemon, story)
    faults = [record for record in caplog.records if "a fault of tactiled while it ends" in record.message]
    assert faults
    assert "ZeroDivisionError: a bug" in str(faults[0].exc_text)


def test_a_stop_before_the_daemon_runs_is_kept(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path)

    async def main() -> None:
        service = Service([daemon.served()])
        service.stop()
        for runner in service._runners:  # noqa: SLF001  as a stop between two turns of the loop
            runner.stop()
        await service.run()

    asyncio.run(asyncio.wait_for(main(), PATIENCE_S))


@given(hang_s=st.floats(0.0, 5.0), phase_s=st.floats(0.0, 0.1))
def test_after_a_hang_boards_keep_phases_and_no_two_status_come_at_once(
    hang_s: float, phase_s: float
) -> None:
    due_s = next_due_s(100.0 + phase_s, 100.0 + phase_s + hang_s)
    wait_s = due_s - (100.0 + phase_s + hang_s)
    assert 0.5 * STATUS_PERIOD_S - 1e-9 <= wait_s <= 1.5 * STATUS_PERIOD_S + 1e-9
    periods = (due_s - 100.0 - phase_s) / STATUS_PERIOD_S
    assert periods == pytest.approx(round(periods))


def test_the_watchdog_is_notified_only_while_the_data_path_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = Daemon(tmp_path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "400000")

        def messages() -> list[str]:
            got = []
            while True:
                try:
                    got.append(manager.recv(4096).decode())
                except BlockingIOError:
                    return got

        hung: list[list[str]] = []
        real = daemon.pipeline.receive

        def hang(data: bytes, now_s: float) -> Received:
            if not hung:
                messages()
                time.sleep(0.5)
                hung.append(messages())
            return real(data, now_s)

        async def pings(n: int) -> list[str]:
            got = messages()
            async with asyncio.timeout(PATIENCE_S):
                while got.count("WATCHDOG=1") < n:
                    await asyncio.sleep(0.01)
                    got += messages()
            return got

        async def story(_: Service) -> None:
            assert (await pings(3))[0] == "READY=1"  # no board at all: the daemon is well nevertheless
            monkeypatch.setattr(daemon.pipeline, "receive", hang)
            with PtyBoard(daemon.link):
                await daemon.until_state("running")
                messages()
                await pings(3)

        play(daemon, story)
        assert hung == [[]]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_signals_end_the_daemon_cleanly(tmp_path: Path, number: signal.Signals) -> None:
    daemon = Daemon(tmp_path)

    async def main() -> None:
        with PtyBoard(daemon.link) as board:
            serving = asyncio.create_task(serve([daemon.served()]))
            while not board.sim.streaming:
                await asyncio.sleep(0.01)
            os.kill(os.getpid(), number)
            await asyncio.wait_for(serving, PATIENCE_S)
            assert not board.sim.streaming

    before = signal.signal(number, signal.SIG_DFL)  # one that nohup ignores stays ignored
    try:
        asyncio.run(main())
    finally:
        signal.signal(number, before)


def test_a_step_of_the_wall_clock_is_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service_module, "CLOCK_PERIOD_S", 0.1)
    daemon = Daemon(tmp_path)

    async def story(service: Service) -> None:
        await daemon.until(lambda: bool(daemon.rows("status")), "a status")
        real = time.time
        monkeypatch.setattr(service._clock, "_wall", lambda: real() + 3600.0)  # noqa: SLF001  the wall clock is stepped
        await daemon.until(lambda: daemon.status["timestamp"] > real() + 3590.0, "the new time")

    play(daemon, story)


@pytest.mark.parametrize("plugged", [False, True])
def test_the_daemon_does_not_spin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plugged: bool) -> None:
    daemon = Daemon(tmp_path)
    turns = 0
    real = BoardRunner.act

    def counted(runner: BoardRunner, commands: Sequence[Command] = ()) -> None:
        nonlocal turns
        turns += 1
        real(runner, commands)

    monkeypatch.setattr(BoardRunner, "act", counted)

    async def story(_: Service) -> None:
        await daemon.until(lambda: len(daemon.rows("status")) >= 12, "12 statuses")

    board = SimBoard()
    board.refuses = {"start": "busy"}  # a board that never comes to run keeps the session busiest
    with PtyBoard(daemon.link, board) if plugged else nullcontext():
        play(daemon, story)
    assert turns < 10 * len(daemon.rows("status"))
