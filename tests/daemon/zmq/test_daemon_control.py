"""Requests and replies, with and without sockets: what is asked is given, and nobody hostile breaks it."""

import asyncio
import contextlib
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import msgpack
import pytest
import zmq
import zmq.asyncio
from hypothesis import example, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from messages import anything
from networks import CONTACT, NetworkAlone
from ports import free_pair

from tactiled import resources
from tactiled.client import AsyncCommander
from tactiled.daemon.zmq import network, zmtp
from tactiled.daemon.zmq.control import REPLY_BYTES, Control
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.publisher import Publisher
from tactiled.daemon.zmq.requests import (
    LONGEST_BYTES,
    REQUESTS,
    CommandRequest,
    Request,
    Requester,
    parse,
)
from tactiled.events.types import RecordingEvent
from tactiled.limited_log import PERIOD_S

SOMEONE = Requester("1", may_command=True)
EXAMPLES: dict[str, dict[str, Any]] = {
    "state": {},
    "events": {"board": "b", "topic": "contact", "first_seq": 0},
    "tare": {"force": True},
    "speed": {"speed_mm_s": 5},
    "friction": {"value": 0.6, "sd": 0.2},
    "object-changed": {},
    "motion": {"acceleration_m_s2": [9.81, 12.0], "time_s": [7.0, 7.5], "sent_s": 7.5},
    "inhibit": {"duration_s": 0.5},
    "expect-load-change": {"duration_s": 0.5},
    "thresholds": {"values": {"grip.incipient_p": 0.5}},
    "record": {"on": True},
    "mark": {"text": "now"},
}


def request(do: str, id_: str = "r1", **arguments: Any) -> bytes:
    packed: bytes = msgpack.packb({"v": 1, "id": id_, "do": do, **arguments})
    return packed


class Desk:
    """A `Control` without sockets, and its only board with the commands that reached it."""

    serial = "b"

    def __init__(self) -> None:
        self.publisher = Publisher(PublishParams(endpoints=()))
        self.done: list[CommandRequest] = []
        self.refuse = ""
        self.control = Control(self.publisher, [self])

    def settings(self, _: float) -> dict[str, Any]:
        return {"speed_mm_s": 0.0}

    def do(self, request: CommandRequest, _requester: Requester, _now_s: float) -> str:
        self.done.append(request)
        return self.refuse

    def ask(self, payload: bytes, requester: Requester = SOMEONE, now_s: float = 0.0) -> dict[str, Any]:
        reply: dict[str, Any] = msgpack.unpackb(self.control.answer(payload, requester, now_s))
        return reply


@pytest.mark.parametrize("do", REQUESTS)
def test_every_request_is_answered_with_its_id(do: str) -> None:
    desk = Desk()
    reply = desk.ask(request(do, "my-id", **EXAMPLES[do]))
    assert (reply["v"], reply["id"], reply["do"], reply["ok"], reply["reason"]) == (1, "my-id", do, True, "")
    assert reply["run"] == desk.publisher.run
    assert len(desk.done) == (do not in ("state", "events"))


def test_state_is_the_newest_of_each_topic_as_it_was_published() -> None:
    desk = Desk()
    for _ in range(3):
        desk.publisher.send(CONTACT, board="b", unix_offset_s=0.0)
    reply = desk.ask(request("state"))
    (message,) = reply["messages"].values()
    assert list(reply["messages"]) == ["tactile/b/contact"]
    assert (message["seq"], message["run"], message["state"]) == (2, desk.publisher.run, "loading")
    assert reply["settings"] == {"speed_mm_s": 0.0}


def test_the_state_of_a_board_that_is_not_read_is_refused() -> None:
    reply = Desk().ask(request("state", board="other"))
    assert (reply["ok"], reply["reason"]) == (False, "board: other is not read here; there are: b")
    assert "settings" not in reply


def test_events_come_in_parts_of_bounded_size() -> None:
    desk = Desk()
    for _ in range(3000):
        desk.publisher.send(CONTACT, board="b", unix_offset_s=0.0)
    seqs: list[int] = []
    first_seq, parts = 5, 0
    while True:
        payload = request("events", board="b", topic="contact", first_seq=first_seq)
        packed = desk.control.answer(payload, SOMEONE, 0.0)
        assert len(packed) < REPLY_BYTES + 1000
        reply = msgpack.unpackb(packed)
        seqs += [message["seq"] for message in reply["messages"]]
        parts += 1
        if not reply["more"]:
            break
        first_seq = reply["next_seq"]
    assert seqs == list(range(5, 3000))
    assert parts > 1
    reply = desk.ask(request("events", board="b", topic="no", first_seq=0))
    assert not reply["ok"]
    assert "slip" in reply["reason"]


def test_a_refusal_is_answered_with_its_reason() -> None:
    desk = Desk()
    desk.refuse = "something is in contact"
    reply = desk.ask(request("tare"))
    assert (reply["ok"], reply["reason"]) == (False, "something is in contact")


def test_a_request_that_meets_a_fault_of_tactiled_is_refused_and_logged() -> None:
    desk = Desk()
    with patch.object(desk, "do", side_effect=ZeroDivisionError("a bug")):
        reply = desk.ask(request("speed", "my-id", speed_mm_s=5.0))
    assert (reply["id"], reply["ok"]) == ("my-id", False)
    assert "a fault of tactiled" in reply["reason"]
    assert desk.control.bad.count == 1


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (b"", "not msgpack"),
        (b"\xc1", "not msgpack"),
        (b"\x91" * 10_000, "not msgpack"),
        (b"\xdf\xff\xff\xff\xff", "not msgpack"),
        (b"x" * (LONGEST_BYTES + 1), "at most"),
        (msgpack.packb([1]), "not a map"),
        (msgpack.packb({b"do": "state"}), "not a map"),
        (msgpack.packb({}), "do: None is none of state, events"),
        (msgpack.packb({"do": [1] * 5000}), "do: "),
        (request("state").replace(b"\xa1v\x01", b"\xa1v\x02"), "v: 2"),
        (request("state").replace(b"\xa1v\x01", b"\xa1v\xc3"), "v: True"),
        (request("state", ""), "id: "),
        (request("state", "x" * 65), "id: "),
        (request("state", surplus=1), "surplus: unknown key"),
        (request("speed", speed=5), "use speed_mm_s"),
        (request("speed", speed_mm_s="5"), "speed_mm_s: "),
        (request("speed", speed_mm_s=True), "speed_mm_s: "),
        (request("speed", speed_mm_s=float("nan")), "speed_mm_s: "),
        (request("speed", speed_mm_s=2**64 - 1), "speed_mm_s: "),
        (request("motion"), "acceleration_m_s2: missing"),
        (request("motion", acceleration_m_s2=1000.1), "acceleration_m_s2[0]: "),
        (request("motion", acceleration_m_s2=[9.81, float("inf")]), "acceleration_m_s2[1]: "),
        (request("motion", acceleration_m_s2=[]), "acceleration_m_s2: "),
        (request("motion", acceleration_m_s2=[9.81] * 257), "acceleration_m_s2: "),
        (request("motion", acceleration_m_s2=9.81, time_s=[-1.0], sent_s=1.0), "time_s[0]: "),
        (request("motion", acceleration_m_s2=9.81, time_s=1.0, sent_s=1e18), "sent_s: "),
        (request("motion", acceleration_m_s2=9.81, time_s="now", sent_s=1.0), "time_s[0]: "),
        (request("inhibit", duration_s=61.0), "duration_s: "),
        (request("inhibit", duration_s=-1.0), "duration_s: "),
        (request("thresholds", values={}), "values: "),
        (request("thresholds", values={str(n): 1.0 for n in range(33)}), "values: "),
        (request("thresholds", values={"a": None}), "values.a: "),
        (request("mark", text=""), "text: "),
        (request("mark", text="x" * 1001), "text: "),
        (request("events", board="b", topic="slip", first_seq=-1), "first_seq: "),
        (request("events", board="b", topic="slip", first_seq=2**63), "first_seq: "),
    ],
)
def test_an_invalid_request_is_refused_with_its_field(payload: bytes, says: str) -> None:
    desk = Desk()
    reply = desk.ask(payload)
    assert not reply["ok"]
    assert says in reply["reason"]
    assert len(reply["reason"]) <= 500
    assert desk.done == []
    assert desk.control.bad.count == 1


plain = anything(st.text() | st.integers(0, 9))
fields = st.dictionaries(
    st.sampled_from(sorted({field for example in EXAMPLES.values() for field in example}))
    | st.text(max_size=5),
    plain,
    max_size=3,
)


@given(
    payloads=st.lists(
        st.binary(max_size=80)
        | st.tuples(st.sampled_from(sorted(REQUESTS)), fields).map(
            lambda pair: request(pair[0], **{k: v for k, v in pair[1].items() if k != "do"})
        )
        | plain.map(lambda value: msgpack.packb(value)),
        max_size=10,
    )
)
@settings(deadline=None, max_examples=60)
def test_any_bytes_are_answered_once_and_never_raise(payloads: list[bytes]) -> None:
    desk = Desk()
    for payload in payloads:
        reply = desk.ask(payload)
        assert reply["ok"] == (reply["reason"] == "")
        VALIDATORS["reply"].validate(reply)


def schema(name: str) -> Draft202012Validator:
    loaded = json.loads(resources.shipped("protocols", "control", f"{name}.schema.json").read_text())
    Draft202012Validator.check_schema(loaded)
    return Draft202012Validator(loaded)


VALIDATORS = {name: schema(name) for name in ("request", "reply")}


@example(do="thresholds", extra={"values": {0: 0}}, with_example=False)
@example(do="motion", extra={"time_s": {0: None}}, with_example=True)
@example(do="motion", extra={"time_s": None, "sent_s": None}, with_example=True)
@given(do=st.sampled_from(sorted(REQUESTS)), extra=fields, with_example=st.booleans())
@settings(deadline=None, max_examples=60)
def test_the_schema_and_the_daemon_agree_on_what_a_request_is(
    do: str, extra: dict[str, Any], with_example: bool
) -> None:
    document = {"v": 1, "id": "r1", "do": do, **(EXAMPLES[do] if with_example else {}), **extra}
    document["do"] = do
    taken = isinstance(parse(msgpack.packb(document)), Request)
    assert taken == VALIDATORS["request"].is_valid(plain_json(document))


def plain_json(value: Any) -> Any:
    """Convert to JSON types; a value without one becomes a value that no schema allows."""
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {key: plain_json(v) for key, v in value.items()}
    if isinstance(value, list):
        return [plain_json(v) for v in value]
    if isinstance(value, bytes | dict) or (isinstance(value, float) and value - value != 0):
        return {"no": "JSON"}  # null may be allowed
    return value


def test_refused_requests_are_counted_and_logged_at_a_bounded_rate(caplog: pytest.LogCaptureFixture) -> None:
    desk = Desk()
    for number in range(1000):
        desk.ask(b"\xc1", now_s=number * 2 * PERIOD_S / 1000)
    assert desk.control.bad.count == 1000
    assert len(caplog.records) == 2
    assert "(499 times)" in caplog.text


# ---- with sockets ----------------------------------------------------------------------------------


def endpoint(folder: Path) -> str:
    return f"ipc://{folder}/events.ipc"


def control(folder: Path) -> str:
    return f"ipc://{folder}/control.ipc"


def served(folder: Path) -> NetworkAlone:
    return NetworkAlone(endpoints=(endpoint(folder),))


def rss_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


async def until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.005)


@pytest.mark.parametrize(
    ("kind", "options"), [(zmq.REQ, ()), (zmq.REQ, (zmq.REQ_RELAXED, zmq.REQ_CORRELATE)), (zmq.DEALER, ())]
)
def test_any_zmq_client_can_ask(tmp_path: Path, kind: int, options: tuple[int, ...]) -> None:
    server = served(tmp_path)

    async def story() -> None:
        with zmq.asyncio.Context() as context, context.socket(kind) as sock:
            sock.linger = 0
            for option in options:
                sock.setsockopt(option, 1)
            sock.connect(control(tmp_path))
            await sock.send(request("state"))
            assert msgpack.unpackb(await sock.recv())["ok"]

    server.run(story)


@pytest.mark.parametrize(("n_bytes", "is_told"), [(400_000, True), (600_000, False)])
def test_a_state_of_large_messages_arrives_or_is_refused(tmp_path: Path, n_bytes: int, is_told: bool) -> None:
    server = served(tmp_path)
    large = RecordingEvent(
        time_s=1.0, state="off", reason=n_bytes * "x", file="", parts=0, bytes_written=0, free_mb=0.0,
        reads_dropped=0, reads_waiting=0,
    )  # fmt: skip
    for board in ("b", "c"):
        server.network.publisher.send(large, board=board, unix_offset_s=0.0)

    async def story() -> None:
        async with AsyncCommander(endpoint(tmp_path)) as daemon:
            reply = await daemon.send("state")
            assert reply.ok == is_told
            assert len(reply.data.get("messages", ())) == (2 if is_told else 0)
            assert is_told or "ask for the topics that you need" in reply.reason

    server.run(story)


def test_hostile_clients_do_not_affect_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Floods, junk, many frames, oversize, clients that never read: others are served, memory stays."""
    monkeypatch.setattr(network, "BOUNDS", replace(network.BOUNDS, steps_per_s=5000.0))
    server = served(tmp_path)
    server.send(3000)

    async def story() -> None:
        context = zmq.asyncio.Context()
        try:
            evil = [context.socket(zmq.DEALER) for _ in range(4)]
            for sock in evil:
                sock.setsockopt(zmq.LINGER, 0)
                sock.setsockopt(zmq.SNDHWM, 10)
                sock.setsockopt(zmq.RCVHWM, 10)  # or what is measured is their memory, in this process
                sock.connect(control(tmp_path))
            await asyncio.sleep(0.1)
            before = rss_bytes()
            greedy = request("events", board="b", topic="contact", first_seq=0)
            for turn in range(300):
                floods = (
                    [request("mark", f"id-{turn}", text="x" * 900)],  # an id each
                    [b"\x93" * 3000],
                    [b"f"] * 2000,  # many frames
                    [greedy],  # and never reads
                )
                for sock, frames in zip(evil, floods, strict=True):
                    with contextlib.suppress(zmq.Again):
                        await sock.send_multipart(frames, zmq.NOBLOCK)
                await asyncio.sleep(0.001)
            async with AsyncCommander(endpoint(tmp_path)) as daemon:
                assert (await daemon.send("mark", text="still there")).ok
            assert rss_bytes() - before < 40e6
            assert server.network.control.bad.count > 0
            big = context.socket(zmq.DEALER)
            big.setsockopt(zmq.LINGER, 0)
            big.connect(control(tmp_path))
            await big.send(b"x" * (LONGEST_BYTES + 1))  # libzmq drops who sends more
            assert not await big.poll(200)
            async with AsyncCommander(endpoint(tmp_path)) as daemon:
                assert (await daemon.send("state")).ok
        finally:
            context.destroy(linger=0)

    server.run(story)


def test_a_request_without_a_last_part_is_not_kept(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    server = served(tmp_path)

    async def story() -> None:
        reader, writer = await asyncio.open_unix_connection(str(tmp_path / "control.ipc"))
        writer.write(zmtp.GREETING + zmtp.ready("DEALER"))
        for _ in range(2000):
            writer.write(b"\1\x0a" + bytes(10))
        writer.write(b"\0\0" + zmtp.message(request("state")))
        await reader.readexactly(len(zmtp.GREETING + zmtp.ready("ROUTER")))
        head = await reader.readexactly(9)  # of the only reply, to the second request
        size = int.from_bytes(head[1:]) if head[0] & 2 else head[1]
        reply = head[9 if head[0] & 2 else 2 :]
        assert msgpack.unpackb(reply + await reader.readexactly(size - len(reply)))["ok"]
        assert "several frames: send one" in caplog.text
        writer.close()
        await writer.wait_closed()

    server.run(story)


def test_an_internal_error_fails_only_its_request(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def broken() -> str:
        raise ZeroDivisionError("a bug")

    server = NetworkAlone(broken, endpoints=(endpoint(tmp_path),))

    async def story() -> None:
        async with AsyncCommander(endpoint(tmp_path)) as daemon:
            reply = await daemon.send("mark", text="x")
            assert not reply.ok
            assert "a fault of tactiled, please report it: ZeroDivisionError" in reply.reason
            assert (await daemon.send("state")).ok
        assert "report it" in caplog.text

    server.run(story)


def test_a_command_over_ipc_carries_the_user(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    server = served(tmp_path)

    async def story() -> None:
        async with AsyncCommander(endpoint(tmp_path), who="test") as daemon:
            assert (await daemon.send("inhibit", duration_s=1.0)).ok
        assert [command.who for command in server.done] == ["test"]
        (requester,) = server.requesters
        assert (requester.uid, requester.key) == (os.getuid(), "")
        assert f"command: inhibit by uid {os.getuid()}: done" in caplog.text

    server.run(story)


@pytest.mark.parametrize("allowed", [False, True])
def test_commands_over_tcp_are_refused_unless_allowed_but_queries_are_answered(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, allowed: bool
) -> None:
    """One ROUTER serves both ways: it knows from whom each request came."""
    port = free_pair()
    events = f"tcp://127.0.0.1:{port}"
    server = NetworkAlone(
        endpoints=(events, endpoint(tmp_path)),
        allow_commands_over_tcp=allowed,
    )

    async def story() -> None:
        async with AsyncCommander(events) as tcp, AsyncCommander(control=control(tmp_path)) as ipc:
            assert (await tcp.send("state")).ok
            reply = await tcp.send("record", on=False)
            assert reply.ok == allowed
            if not allowed:
                assert "allow_commands_over_tcp" in reply.reason
                assert "record by an unknown user over TCP from 127.0.0.1" in caplog.text
            assert (await ipc.send("record", on=False)).ok
        assert [requester.uid for requester in server.requesters] == [-1] * allowed + [os.getuid()]

    server.run(story)
