"""Commands through the whole daemon: a board on a pty, a client on a socket, and what events say of it."""

import asyncio
import json
import threading
import time
from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from boards import LAYOUT, PtyBoard, SimBoard, descriptors, until_ports_are_tried
from patience import PATIENCE_S

from tactiled.array import load_array
from tactiled.client import AsyncCommander, Client, Message, Recovered, Restarted
from tactiled.daemon.board.diagnosis import LineWatch
from tactiled.daemon.board.requirements import SessionParams
from tactiled.daemon.board.session import Session
from tactiled.daemon.runner import ServedBoard, ServiceParams
from tactiled.daemon.serial.port import PortParams
from tactiled.daemon.service import Service
from tactiled.daemon.zmq.commands import RATE_S, Commands
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.requests import Rate, Requester
from tactiled.events.types import EVENT_TYPES, Sent
from tactiled.pipeline import Pipeline

ARRAY = load_array("wang2019-3x3")
Row = dict[str, Any]


class Setup:
    """A service, what a client heard of it, and a way to command it."""

    def __init__(self, tmp_path: Path) -> None:
        self.link = tmp_path / "board"
        self.endpoint = f"ipc://{tmp_path}/events.ipc"
        self.params = ServiceParams(
            port=PortParams(url=str(self.link)), publish=PublishParams(endpoints=(self.endpoint,))
        )
        self.heard: dict[str, list[Row]] = {}
        self.restarts = 0
        self.lost = 0
        self.reload: Callable[[], None]

    async def listen(self) -> None:
        async with Client(self.endpoint) as client:
            async for item in client:
                message = item.message if isinstance(item, Recovered) else item
                if isinstance(message, Message):
                    self.heard.setdefault(message.topic, []).append(message.data)
                self.restarts += isinstance(item, Restarted)
                self.lost = client.lost

    @property
    def status(self) -> Row:
        return self.heard["status"][-1]

    async def until(self, condition: Callable[[], bool], what: str) -> None:
        try:
            async with asyncio.timeout(PATIENCE_S):
                while not condition():
                    await asyncio.sleep(0.01)
        except TimeoutError:
            raise AssertionError(f"never: {what}; last status {self.heard.get('status', [])[-1:]}") from None

    async def until_running(self) -> None:
        await self.until(lambda: "status" in self.heard and self.status["state"] == "running", "running")

    async def audited(self, id_: str) -> Row:
        def found() -> list[Row]:
            return [row for row in self.heard.get("command", []) if row["request_id"] == id_]

        await self.until(lambda: bool(found()), f"the event of {id_}")
        (row,) = found()
        return row


def play(setup: Setup, story: Callable[[AsyncCommander], Awaitable[None]]) -> None:
    """Run the service beside a story; nothing may be left over."""

    async def main() -> None:
        service = Service(
            [ServedBoard(setup.params, partial(Pipeline, LAYOUT, ARRAY), reload=lambda: setup.params)]
        )
        setup.reload = service.reload
        serving = asyncio.create_task(service.run())
        listening = asyncio.create_task(setup.listen())
        try:
            async with AsyncCommander(setup.endpoint, who="test") as daemon, asyncio.timeout(3 * PATIENCE_S):
                await story(daemon)
            assert not serving.done()
        finally:
            service.stop()
            await asyncio.gather(serving, return_exceptions=False)
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)
        assert asyncio.all_tasks() == {asyncio.current_task()}

    before, threads = descriptors(), set(threading.enumerate())
    asyncio.run(main())
    until_ports_are_tried()
    assert descriptors() == before
    assert not [t for t in set(threading.enumerate()) - threads if t.is_alive()]


def test_every_command_is_recorded_with_requester_and_result(tmp_path: Path) -> None:
    setup = Setup(tmp_path)

    async def story(daemon: AsyncCommander) -> None:
        with PtyBoard(setup.link):
            await setup.until_running()
            done = await daemon.send("mark", text="the cup is full")
            assert done.ok
            row = await setup.audited(done.data["id"])
            assert (row["command"], row["who"], row["key"], row["ok"]) == ("mark", "test", "", True)
            assert json.loads(row["arguments"]) == {"text": "the cup is full"}
            assert row["board"] == "TS0001"
            refused = await daemon.send("thresholds", values={"grip.nonsense": 1.0})
            assert not refused.ok
            row = await setup.audited(refused.data["id"])
            assert not row["ok"]
            assert "grip.nonsense: unknown key" in row["reason"] == refused.reason
            assert not (await daemon.send("record", on=True)).ok  # there is no recorder here

    play(setup, story)


def test_settings_survive_a_replug_and_are_in_state(tmp_path: Path) -> None:
    setup = Setup(tmp_path)

    async def story(daemon: AsyncCommander) -> None:
        with PtyBoard(setup.link) as board:
            await setup.until_running()
            assert (await daemon.send("rate", rate_hz=200.0)).ok
            assert board.sim.rate_hz == 200.0
            assert (await daemon.send("speed", speed_mm_s=5.0)).ok
            assert (await daemon.send("friction", value=0.8)).ok
            assert (await daemon.send("thresholds", values={"grip.incipient_p": 0.5})).ok
            assert (await daemon.send("inhibit", duration_s=60.0)).ok
            await asyncio.to_thread(board.unplug)
            await setup.until(lambda: setup.status["state"] == "no-device", "no-device")
            board.sim.reboot()
            await asyncio.to_thread(board.plug)
            await setup.until_running()
            assert (board.sim.rate_hz, board.sim.streaming) == (200.0, True)
            reply = (await daemon.send("state")).data
            assert reply["settings"]["speed_mm_s"] == 5.0
            assert reply["settings"]["friction"] == [0.8, 0.1]
            assert reply["settings"]["rate_hz"] == 200.0
            assert reply["settings"]["inhibited_s"] > 30.0
            assert reply["settings"]["detect"]["grip"]["incipient_p"] == 0.5
            assert setup.status["inhibited_s"] > 30.0
            assert "tactile/TS0001/info" in reply["messages"]

    play(setup, story)


def test_a_stream_of_motion_is_one_command_event_and_its_refusal_another(tmp_path: Path) -> None:
    setup = Setup(tmp_path)

    async def story(daemon: AsyncCommander) -> None:
        with PtyBoard(setup.link):
            await setup.until_running()
            assert (await daemon.send("state")).data["settings"]["acceleration_m_s2"] == []
            for _ in range(5):
                now_s = time.monotonic()
                plan_s = [now_s + 0.05 * k for k in range(20)]
                assert (await daemon.announce_motion([12.5] * 20, plan_s)).ok
            assert (await daemon.send("state")).data["settings"]["acceleration_m_s2"] == [12.5]
            refused = [await daemon.announce_motion([9.81, 9.81]) for _ in range(2)]
            assert [reply.reason.split(":")[0] for reply in refused] == ["time_s", "time_s"]
            last = await daemon.send("mark", text="end")
            await setup.audited(last.data["id"])
            heard = [(row["command"], row["ok"]) for row in setup.heard["command"]]
            assert heard == [("motion", True), ("motion", False), ("mark", True)]

    play(setup, story)


def test_a_tare_applies_only_to_its_board(tmp_path: Path) -> None:
    setup = Setup(tmp_path)

    async def tared(daemon: AsyncCommander) -> bool:
        return bool((await daemon.send("state")).data["settings"]["tared"])

    async def story(daemon: AsyncCommander) -> None:
        with PtyBoard(setup.link) as board:
            await setup.until_running()
            assert not (await daemon.send("tare")).ok
            # A busy machine may make gaps, after which both need half a second of scans.
            while "lift the finger" not in (await daemon.send("tare")).reason:  # 1000 counts are 0.7 V
                await asyncio.sleep(0.05)
            assert not await tared(daemon)
            while not (reply := await daemon.send("tare", force=True)).ok:
                assert "ask again" in reply.reason
                await asyncio.sleep(0.05)
            await setup.until(lambda: setup.status["contact"] == "none", "no contact")
            await asyncio.to_thread(board.unplug)
            await asyncio.to_thread(board.plug)
            await setup.until_running()
            assert await tared(daemon)
            assert setup.heard["scan"][-1]["volts"] == [pytest.approx(1000 * 3.0 / 4096)] * 36
        with PtyBoard(setup.link, SimBoard(serial="TS0002")):
            await setup.until(lambda: setup.status["board"] == "TS0002", "the other board")
            assert not await tared(daemon)

    play(setup, story)


def test_a_rate_that_the_board_refuses_leaves_the_old_one(tmp_path: Path) -> None:
    setup = Setup(tmp_path)

    async def story(daemon: AsyncCommander) -> None:
        sim = SimBoard()
        with PtyBoard(setup.link, sim):
            await setup.until_running()
            sim.refuses = {"set_rate": "bad_argument"}
            reply = await daemon.send("rate", rate_hz=9000.0)
            assert not reply.ok
            assert reply.reason.endswith("; the board keeps the rate that it has")
            sim.refuses = {}
            await setup.until_running()
            assert sim.rate_hz == 100.0
            assert (await daemon.send("rate", rate_hz=50.0)).ok
            sim.refuses = {"set_rate": "bad_argument"}
            reply = await daemon.send("rate", rate_hz=9000.0)
            assert reply.reason.endswith("; 50 Hz is set instead")

    play(setup, story)


@pytest.mark.parametrize(
    ("asked_hz", "says"), [(None, "the board keeps the rate that it has"), (500.0, "500 Hz is set instead")]
)
def test_a_rate_that_fails_undoes_no_configuration_that_was_read_meanwhile(
    asked_hz: float | None, says: str
) -> None:
    session = Session(SessionParams(board_serial="A"), LAYOUT, lambda _: None, LineWatch(LAYOUT.name, 115200))
    commands = Commands(Pipeline(LAYOUT, ARRAY), session, lambda *_: None)
    reasons: list[str] = []
    session.opened(0.0)
    rate = Rate(v=1, id="1", who="test", do="rate", rate_hz=200.0)
    commands.do(rate, Requester("1", may_command=True), 0.0, reasons.append)
    assert session.params.rate_hz == 200.0
    read_again = SessionParams(board_serial="B", rate_hz=asked_hz)
    commands.configure(read_again)
    commands.poll(RATE_S)
    assert [reason.rpartition("; ")[2] for reason in reasons] == [says]
    assert session.params == read_again


def test_a_commanded_rate_holds_where_a_configuration_that_is_read_again_names_none(tmp_path: Path) -> None:
    setup = Setup(tmp_path)

    async def story(daemon: AsyncCommander) -> None:
        with PtyBoard(setup.link) as board:
            await setup.until_running()
            assert (await daemon.send("rate", rate_hz=50.0)).ok
            setup.reload()
            board.sim.reboot()
            await setup.until(lambda: board.sim.rate_hz == 50.0, "the commanded rate after a reboot")
            setup.params = setup.params.model_copy(update={"session": SessionParams(rate_hz=200.0)})
            setup.reload()
            await setup.until(lambda: board.sim.rate_hz == 200.0, "the rate that the configuration names")

    play(setup, story)


def test_a_refused_rate_is_not_the_answer_to_the_next_one(tmp_path: Path) -> None:
    setup = Setup(tmp_path)

    async def story(daemon: AsyncCommander) -> None:
        await setup.until(lambda: "status" in setup.heard, "a status")
        assert (await daemon.send("rate", rate_hz=5000.0)).ok  # nobody there to know better
        sim = SimBoard()
        sim.refuses = {"set_rate": "bad_argument"}
        with PtyBoard(setup.link, sim):
            await setup.until(lambda: "refused set_rate to 5000" in str(setup.status["reason"]), "a refusal")
            sim.refuses = {}
            assert (await daemon.send("rate", rate_hz=50.0)).ok
            await setup.until_running()
            assert sim.rate_hz == 50.0
            sim.refuses = {"set_rate": "bad_argument"}
            assert not (await daemon.send("rate", rate_hz=9000.0)).ok
            sim.refuses = {}
            assert (await daemon.send("rate", rate_hz=100.0)).ok
            assert sim.rate_hz == 100.0

    play(setup, story)


def test_a_rate_without_a_board_is_kept_for_when_one_comes(tmp_path: Path) -> None:
    setup = Setup(tmp_path)

    async def story(daemon: AsyncCommander) -> None:
        assert (await daemon.send("rate", rate_hz=50.0)).ok
        with PtyBoard(setup.link) as board:
            await setup.until_running()
            assert board.sim.rate_hz == 50.0

    play(setup, story)


def test_a_restart_is_reported_and_no_message_of_either_run_is_lost(tmp_path: Path) -> None:
    setup = Setup(tmp_path)

    async def main() -> None:
        listening = asyncio.create_task(setup.listen())
        with PtyBoard(setup.link):
            for run in range(2):
                service = Service([ServedBoard(setup.params, partial(Pipeline, LAYOUT, ARRAY))])
                serving = asyncio.create_task(service.run())
                goal = len(setup.heard.get("scan", [])) + 30
                await setup.until(lambda goal=goal: len(setup.heard.get("scan", [])) > goal, "scans")  # type: ignore[misc]
                service.stop()
                await serving
                assert setup.restarts >= run
        listening.cancel()
        await asyncio.gather(listening, return_exceptions=True)

    asyncio.run(asyncio.wait_for(main(), 3 * PATIENCE_S))
    scans = setup.heard["scan"]
    runs = list(dict.fromkeys(row["run"] for row in scans))
    assert len(runs) == 2
    second = [row["seq"] for row in scans if row["run"] == runs[1]]
    assert second == list(range(len(second)))
    assert setup.lost == 0


def test_status_counts_every_topic_but_itself() -> None:
    assert set(Sent.__dataclass_fields__) == set(EVENT_TYPES) - {"status"}
