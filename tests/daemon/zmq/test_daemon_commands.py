"""Commands through the whole daemon: a board on a pty, a client on a socket, and what events say of it."""

import asyncio
import json
import os
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from boards import PtyBoard, SimBoard
from daemons import Daemon, Row, play

from tactiled.client import AsyncCommander
from tactiled.daemon import runner
from tactiled.daemon.service import Service
from tactiled.events.types import EVENT_TYPES, Sent


async def audited(daemon: Daemon, id_: str) -> Row:
    """Return the command event of a request."""

    def found() -> list[Row]:
        return [row for row in daemon.rows("command") if row["request_id"] == id_]

    await daemon.until(lambda: bool(found()), f"the event of {id_}")
    (row,) = found()
    return row


def play_commands(daemon: Daemon, story: Callable[[AsyncCommander], Awaitable[None]]) -> None:
    async def with_commander(_: Service) -> None:
        async with AsyncCommander(daemon.endpoint, who="test") as commander:
            await story(commander)

    play(daemon, with_commander)


def test_every_command_is_recorded_with_requester_and_result(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path)

    async def story(commander: AsyncCommander) -> None:
        with PtyBoard(daemon.link):
            await daemon.until_state("running")
            done = await commander.send("mark", text="the cup is full")
            assert done.ok
            row = await audited(daemon, done.data["id"])
            assert (row["command"], row["who"], row["key"], row["ok"]) == ("mark", "test", "", True)
            assert row["uid"] == os.getuid()
            assert json.loads(row["arguments"]) == {"text": "the cup is full"}
            assert row["board"] == "TS0001"
            refused = await commander.send("thresholds", values={"grip.nonsense": 1.0})
            assert not refused.ok
            row = await audited(daemon, refused.data["id"])
            assert not row["ok"]
            assert "grip.nonsense: unknown key" in row["reason"] == refused.reason
            assert "set record.directory" in (await commander.send("record", on=True)).reason

    play_commands(daemon, story)


def test_settings_survive_a_replug_and_are_in_state(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path)

    async def story(commander: AsyncCommander) -> None:
        with PtyBoard(daemon.link) as board:
            await daemon.until_state("running")
            assert (await commander.send("speed", speed_mm_s=5.0)).ok
            assert (await commander.send("friction", value=0.8)).ok
            assert (await commander.send("thresholds", values={"grip.incipient_p": 0.5})).ok
            assert (await commander.send("inhibit", duration_s=60.0)).ok
            await asyncio.to_thread(board.unplug)
            await daemon.until(lambda: daemon.status["state"] == "no-device", "no-device")
            board.sim.reboot()
            await asyncio.to_thread(board.plug)
            await daemon.until_state("running")
            assert board.sim.streaming
            reply = (await commander.send("state")).data
            assert reply["settings"]["speed_mm_s"] == 5.0
            assert reply["settings"]["friction"] == [0.8, 0.1]
            assert reply["settings"]["inhibited_s"] > 30.0
            assert reply["settings"]["detect"]["grip"]["incipient_p"] == 0.5
            assert daemon.status["inhibited_s"] > 30.0
            assert "tactile/TS0001/info" in reply["messages"]

    play_commands(daemon, story)


def test_a_stream_of_motion_is_one_command_event_and_its_refusal_another(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path)

    async def story(commander: AsyncCommander) -> None:
        with PtyBoard(daemon.link):
            await daemon.until_state("running")
            assert (await commander.send("state")).data["settings"]["acceleration_m_s2"] == []
            for _ in range(5):
                now_s = time.monotonic()
                plan_s = [now_s + 0.05 * k for k in range(20)]
                assert (await commander.announce_motion([12.5] * 20, plan_s)).ok
            assert (await commander.send("state")).data["settings"]["acceleration_m_s2"] == [12.5]
            refused = [await commander.announce_motion([9.81, 9.81]) for _ in range(2)]
            assert [reply.reason.split(":")[0] for reply in refused] == ["time_s", "time_s"]
            last = await commander.send("mark", text="end")
            await audited(daemon, last.data["id"])
            heard = [(row["command"], row["ok"]) for row in daemon.heard["command"]]
            assert heard == [("motion", True), ("motion", False), ("mark", True)]

    play_commands(daemon, story)


def test_a_tare_applies_only_to_its_board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "INFO_PERIOD_S", 1e9)  # a new zero and a new board are told at once
    daemon = Daemon(tmp_path)

    async def tared(commander: AsyncCommander) -> bool:
        return bool((await commander.send("state")).data["settings"]["tared"])

    async def story(commander: AsyncCommander) -> None:
        with PtyBoard(daemon.link) as board:
            await daemon.until_state("running")
            assert not (await commander.send("tare")).ok
            # A busy machine may make gaps, after which both need half a second of scans.
            while "lift the finger" not in (await commander.send("tare")).reason:  # 1000 counts are 0.7 V
                await asyncio.sleep(0.05)
            assert not await tared(commander)
            while not (reply := await commander.send("tare", force=True)).ok:
                assert "ask again" in reply.reason
                await asyncio.sleep(0.05)
            await daemon.until(lambda: daemon.status["contact"] == "none", "no contact")
            tared_to = [pytest.approx(1000 * 3.0 / 4096, abs=1e-3)] * 36
            await daemon.until(lambda: daemon.heard["info"][-1]["zero"] == tared_to, "the zero of the tare")
            at_s, told_s = (daemon.heard[topic][-1]["timestamp"] for topic in ("command", "info"))
            between = [row for row in daemon.heard["status"] if at_s < row["timestamp"] < told_s]
            assert len(between) < 50  # the board says hello each 100 statuses, and info follows a hello
            await asyncio.to_thread(board.unplug)
            await asyncio.to_thread(board.plug)
            await daemon.until_state("running")
            assert await tared(commander)
            assert daemon.heard["scan"][-1]["volts"] == [pytest.approx(1000 * 3.0 / 4096)] * 36
        with PtyBoard(daemon.link, SimBoard(serial="TS0002")):
            await daemon.until(lambda: daemon.status["board"] == "TS0002", "the other board")
            assert not await tared(commander)
            await daemon.until(lambda: daemon.heard["info"][-1]["zero"] == [0.0] * 36, "that of the array")

    play_commands(daemon, story)


def test_status_counts_every_topic_but_itself() -> None:
    assert set(Sent.__dataclass_fields__) == set(EVENT_TYPES) - {"status"}
