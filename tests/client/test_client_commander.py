"""Commands against a daemon that answers as told: repeated, matched by id, given up in time."""

import asyncio
import itertools
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from patience import PATIENCE_S

from tactiled.client import AsyncCommander, Commander, Stale, Subscription
from tactiled.client import __main__ as program
from tactiled.client.commander import Reply, fields_of
from tactiled.errors import ConfigError, OperatorError

Answer = Callable[[dict[str, Any], int], list[Any]]
"""Replies to a request, of which so many came before; bytes are sent as they are."""


@contextmanager
def daemon(folder: Path, answer: Answer) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Endpoint for requests that are answered in a thread, and the requests that came."""
    endpoint, asked, ended = f"ipc://{folder}/control.ipc", list[dict[str, Any]](), threading.Event()
    with zmq.Context() as context, context.socket(zmq.ROUTER) as sock:
        sock.bind(endpoint)

        def serve() -> None:
            while not ended.is_set():
                if sock.poll(20):
                    who, payload = sock.recv_multipart()
                    request = msgpack.unpackb(payload)
                    for reply in answer(request, len(asked)):
                        packed = reply if isinstance(reply, bytes) else msgpack.packb(reply)
                        sock.send_multipart([who, packed])
                    asked.append(request)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield endpoint, asked
        finally:
            ended.set()
            thread.join()


def done(request: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"v": 1, "id": request["id"], "do": request["do"], "ok": True, "run": 7, "reason": ""} | more


def send(is_async: bool, control: str, do: str = "mark", **arguments: Any) -> Reply:
    if not is_async:
        with Commander(control=control, who="gripper") as commander:
            return commander.send(do, **arguments)

    async def run() -> Reply:
        async with AsyncCommander(control=control, who="gripper") as commander:
            return await commander.send(do, **arguments)

    return asyncio.run(run())


both = pytest.mark.parametrize("is_async", [False, True], ids=["blocking", "asyncio"])


@both
def test_a_request_has_its_arguments_and_its_reply_comes_back(is_async: bool, tmp_path: Path) -> None:
    with daemon(tmp_path, lambda request, _: [done(request, extra=5)]) as (control, asked):
        reply = send(is_async, control, board="B", text="here")
    assert (reply.ok, reply.reason, reply.data["extra"]) == (True, "", 5)
    ((request),) = asked
    known = {name: request[name] for name in ("v", "do", "who", "board", "text")}
    assert known == {"v": 1, "do": "mark", "who": "gripper", "board": "B", "text": "here"}
    assert request["id"].endswith("-1")


@both
@pytest.mark.parametrize(
    ("values", "instants", "sent"),
    [
        (9.81, None, {"acceleration_m_s2": [9.81]}),
        (12, 7.0, {"acceleration_m_s2": [12.0], "time_s": [7.0]}),
        ((9.81, 12), (7.0, 7.5), {"acceleration_m_s2": [9.81, 12.0], "time_s": [7.0, 7.5]}),
    ],
)
def test_motion_is_announced_with_the_clock_of_its_instants(
    is_async: bool, values: Any, instants: Any, sent: dict[str, Any], tmp_path: Path
) -> None:
    async def announce(control: str) -> Reply:
        async with AsyncCommander(control=control) as commander:
            return await commander.announce_motion(values, instants, board="B")

    before_s = time.monotonic()
    with daemon(tmp_path, lambda request, _: [done(request)]) as (control, asked):
        if is_async:
            assert asyncio.run(announce(control)).ok
        else:
            with Commander(control=control) as commander:
                assert commander.announce_motion(values, instants, board="B").ok
    ((request),) = asked
    assert (request["do"], request["board"]) == ("motion", "B")
    assert {name: request[name] for name in sent} == sent
    assert ("sent_s" in request) == (instants is not None)
    assert before_s <= request.get("sent_s", before_s) <= time.monotonic()


@both
def test_a_refusal_has_its_reason(is_async: bool, tmp_path: Path) -> None:
    refuse: Answer = lambda request, _: [done(request, ok=False, reason="no such board")]  # noqa: E731
    with daemon(tmp_path, refuse) as (control, _):
        reply = send(is_async, control)
    assert (reply.ok, reply.reason) == (False, "no such board")


@both
def test_only_the_reply_with_the_id_of_the_request_counts(is_async: bool, tmp_path: Path) -> None:
    others: Answer = lambda request, _: [  # noqa: E731
        b"\xc1", {"v": 1}, done(request, id="other", reason="not mine"), done(request, ok=1, reason="mine"),
    ]  # fmt: skip
    with daemon(tmp_path, others) as (control, _):
        reply = send(is_async, control)
    assert reply.reason == "mine"
    assert not reply.ok  # anything but True is no consent


@both
def test_a_request_is_sent_once(is_async: bool, tmp_path: Path) -> None:
    def late(request: dict[str, Any], _before: int) -> list[Any]:
        time.sleep(1.0)
        return [done(request)]

    with daemon(tmp_path, late) as (control, asked):
        assert send(is_async, control, timeout_s=PATIENCE_S).ok
    assert len(asked) == 1


@both
@pytest.mark.parametrize("is_there", [False, True])
def test_without_a_reply_the_command_ends_with_the_endpoint(
    is_async: bool, is_there: bool, tmp_path: Path
) -> None:
    with daemon(tmp_path, lambda *_: []) as (control, _):
        endpoint = control if is_there else f"ipc://{tmp_path}/nobody.ipc"
        fault = "" if is_there else ": No such file or directory"
        words = re.escape(f"{endpoint}: no answer{fault}; is tactiled running there?")
        with pytest.raises(OperatorError, match=f"^{words}$"):
            send(is_async, endpoint, timeout_s=0.2)


@pytest.mark.parametrize(
    ("value", "said"),
    [(2**64, "beyond 64 bits"), ("\ud800", "cannot be sent"), (-(2**63) - 1, "beyond 64 bits")],
)
def test_values_that_no_message_can_have_are_refused_before_sending(
    value: Any, said: str, tmp_path: Path
) -> None:
    with (
        Commander(control=f"ipc://{tmp_path}/nobody.ipc") as commander,
        pytest.raises(OperatorError, match=f"^mark: .*{said}"),
    ):
        commander.send("mark", text=value)


def test_an_invalid_endpoint_leaves_nothing_open(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="endpoint"):
        Commander(control="nonsense")
    with pytest.raises(ConfigError, match="endpoint"):
        Commander("inproc://x")  # to which no endpoint of requests belongs
    with pytest.raises(ConfigError, match="cannot be read"):
        Commander(control=f"ipc://{tmp_path}/c.ipc", keys=tmp_path / "none.toml")


def keys_of(folder: Path, public: bytes, secret: bytes, server: bytes) -> Path:
    file = folder / "client.toml"
    names = {"public_key": public, "secret_key": secret, "daemon_key": server}
    quote = "'"
    file.write_text(
        "".join(f"{name} = {quote * 3}{key.decode()}{quote * 3}\n" for name, key in names.items())
    )
    file.chmod(0o600)
    return file


def test_tasks_that_share_a_commander_get_their_own_replies(tmp_path: Path) -> None:
    async def run(control: str) -> list[Reply]:
        async with AsyncCommander(control=control) as commander:
            return await asyncio.gather(*(commander.send("mark", text=str(n)) for n in range(4)))

    with daemon(tmp_path, lambda request, _: [done(request, text=request["text"])]) as (control, _):
        replies = asyncio.run(run(control))
    assert [reply.data["text"] for reply in replies] == ["0", "1", "2", "3"]


def test_a_commander_of_asyncio_that_is_closed_leaves_connections_made_later_alone(tmp_path: Path) -> None:
    """They have the descriptors of its sockets, which the event loop must not watch any more."""

    async def run(control: str) -> list[bytes]:
        async with AsyncCommander(control=control) as commander:
            assert (await commander.send("mark")).ok
        ends = itertools.chain(*(socket.socketpair() for _ in range(8)))
        streams = [await asyncio.open_connection(sock=end) for end in ends]
        for _, writer in streams:
            writer.write(b"hello")
        received = [await asyncio.wait_for(reader.readexactly(5), PATIENCE_S) for reader, _ in streams]
        for _, writer in streams:
            writer.close()
        return received

    with daemon(tmp_path, lambda request, _: [done(request)]) as (control, _):
        assert asyncio.run(run(control)) == 16 * [b"hello"]


def test_a_commander_of_asyncio_may_be_made_before_the_event_loop(tmp_path: Path) -> None:
    with daemon(tmp_path, lambda request, _: [done(request)]) as (control, _):
        commander = AsyncCommander(control=control)

        async def run() -> Reply:
            async with commander:
                return await commander.send("mark")

        assert asyncio.run(run()).ok


@both
def test_a_late_refusal_without_an_id_is_of_no_request(is_async: bool, tmp_path: Path) -> None:
    refusal = {"v": 1, "id": "", "do": "", "ok": False, "reason": "could not be read", "run": 1}
    with daemon(tmp_path, lambda request, _: [refusal, done(request)]) as (control, _):
        assert send(is_async, control).ok


def test_keys_open_an_encrypted_daemon_and_no_other_does(tmp_path: Path) -> None:
    server, client = zmq.curve_keypair(), zmq.curve_keypair()
    with zmq.Context() as context, context.socket(zmq.ROUTER) as sock:
        sock.setsockopt(zmq.CURVE_SERVER, 1)
        sock.setsockopt(zmq.CURVE_SECRETKEY, server[1])
        control = f"tcp://127.0.0.1:{sock.bind_to_random_port('tcp://127.0.0.1')}"
        for daemon_key, opens in [(server[0], True), (client[0], False)]:
            file = keys_of(tmp_path, *client, daemon_key)
            with Commander(control=control, keys=file) as commander:
                thread = threading.Thread(target=lambda: _answer_one(sock))
                thread.start()
                if opens:
                    assert commander.send("tare", timeout_s=PATIENCE_S).ok
                else:
                    with pytest.raises(OperatorError, match="has it the key of this client"):
                        commander.send("tare", timeout_s=0.3)
                thread.join()


def _answer_one(sock: "zmq.Socket[bytes]") -> None:
    if sock.poll(1000):
        who, payload = sock.recv_multipart()
        sock.send_multipart([who, msgpack.packb(done(msgpack.unpackb(payload)))])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("public_key = 'short'\nsecret_key = 'short'\ndaemon_key = 'short'\n", "40 characters"),
        ("".join(f"{name}_key = '{'~' * 40}'\n" for name in ("public", "secret", "daemon")), r"toml.*Z85"),
        (f"public_key = '{'k' * 40}'\n", "no file of `tactiled keys make`"),
        ("[", "no file of `tactiled keys make`"),
        ("".join(f"{name}_key = '{'µ' * 40}'\n" for name in ("public", "secret", "daemon")), "no file of"),
    ],
)
def test_a_file_that_has_no_keys_is_refused(content: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "keys.toml"
    file.write_text(content)
    file.chmod(0o600)
    with pytest.raises(ConfigError, match=said):
        Commander(control=f"ipc://{tmp_path}/c.ipc", keys=file)


@pytest.mark.parametrize(
    ("do", "words", "fields"),
    [
        ("speed", ["speed_mm_s=5"], {"speed_mm_s": 5}),
        ("mark", ["text=a=b", "board=B"], {"text": "a=b", "board": "B"}),
        ("mark", ["text="], {"text": ""}),
        ("x", ["a=true", "b=[1]", 'c="5"'], {"a": True, "b": [1], "c": "5"}),
        ("thresholds", ["slip=3"], {"values": {"slip": 3}}),
    ],
)
def test_words_become_fields(do: str, words: list[str], fields: dict[str, Any]) -> None:
    assert fields_of(do, words) == fields


@pytest.mark.parametrize("word", ["speed", "=5", ""])
def test_a_word_without_a_field_is_refused(word: str) -> None:
    with pytest.raises(OperatorError, match="give FIELD=VALUE"):
        fields_of("speed", [word])


def test_requests_go_to_the_endpoint_beside_that_of_events(tmp_path: Path) -> None:
    with daemon(tmp_path, lambda request, _: [done(request)]) as (control, requests):
        with Subscription(control.replace("control", "events"), ("slip",), stale_after_s=1e9) as subscription:
            while not requests:
                assert subscription.next_item(time.monotonic() + 0.05) is None
        assert requests[0]["do"] == "state"
        with Subscription(control.replace("control", "events"), control="") as silent:
            assert isinstance(silent.next_item(), Stale)
    assert len(requests) == 1


def test_zenoh_subscribes_to_one_host_and_finds_requests_by_itself() -> None:
    with pytest.raises(ConfigError, match="one host is needed here"):
        Subscription("zenoh://127.0.0.1:1/*", ("slip",))
    with pytest.raises(OperatorError, match="leave it out"):
        Subscription("zenoh://127.0.0.1:1/h", control="tcp://127.0.0.1:2")


def test_zenoh_endpoints_name_the_distribution_that_serves_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tactiled.zenoh.transport", None)
    for connect in (Subscription, Commander):
        with pytest.raises(OperatorError, match=r"zenoh:// endpoints: install tactiled-zenoh"):
            connect("zenoh://127.0.0.1:1/h")


def test_a_fault_of_the_listener_is_its_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["x", "nonsense"])
    assert program.main() == 2
    assert "nonsense" in capsys.readouterr().err
