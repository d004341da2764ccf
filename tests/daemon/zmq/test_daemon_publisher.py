"""Publisher with real sockets: two frames, sequence numbers, messages for endpoints that cannot be bound."""

import asyncio
import os
import socket
import stat
from collections.abc import Awaitable, Callable
from pathlib import Path

import msgpack
import pytest
import zmq
import zmq.asyncio
from boards import descriptors
from patience import PATIENCE_S
from ports import free_pair

from tactiled import tomlfile
from tactiled.daemon.zmq.endpoints import runtime_directory
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.publisher import QUEUE_BYTES, Publisher
from tactiled.errors import ConfigError, OperatorError, UnavailableError
from tactiled.events.types import ContactEvent, Event, ScanEvent
from tactiled.tomlfile import Params


def scan(index: int) -> ScanEvent:
    return ScanEvent(
        time_s=10.0 + 0.01 * index,
        index=index,
        volts=(0.5,) * 36,
        valid=(True,) * 36,
        time_sd_s=0.0,
        age_s=0.001,
        late=False,
    )


class _File(Params):
    publish: PublishParams


CONTACT = ContactEvent(time_s=1.0, state="loading", previous="none", taxels=(1, 2), valid=True)


class Running:
    """A publisher with its endpoint, served in this event loop."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.publisher = Publisher(PublishParams(endpoints=(endpoint,)))
        self._context = zmq.asyncio.Context()

    def send(self, event: Event = CONTACT, board: str = "TS0001") -> None:
        self.publisher.send(event, board=board, unix_offset_s=1000.0)

    def subscriber(self, kind: int = zmq.SUB) -> zmq.asyncio.Socket:
        sub = self._context.socket(kind)
        sub.linger = 0
        if kind == zmq.SUB:
            sub.subscribe("")
        sub.connect(self.endpoint)
        return sub

    async def until_heard(self, *subs: zmq.asyncio.Socket) -> None:
        """Wait for the subscriptions, because what comes before them is not sent, and read all up to now."""
        while not all([await sub.poll(10) for sub in subs]):
            self.send(board="warm-up")
        self.send(board="warmed-up")
        for sub in subs:
            while (await sub.recv_multipart())[0] != b"tactile/warmed-up/contact":
                pass


def play(endpoint: str, story: Callable[[Running], Awaitable[None]]) -> None:
    """Play a story beside a running publisher; nothing may be left over."""

    async def main() -> None:
        running = Running(endpoint)
        serving = asyncio.create_task(running.publisher.server.run())
        try:
            async with asyncio.timeout(PATIENCE_S):
                await story(running)
            assert not serving.done()
        finally:
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
            running.publisher.close()
            running._context.destroy(0)  # noqa: SLF001  its own

    before = descriptors()
    asyncio.run(main())
    assert descriptors() == before


@pytest.fixture
def ipc(tmp_path: Path) -> str:
    return f"ipc://{tmp_path}/e.ipc"


def test_a_message_is_two_frames_numbered_by_board_and_topic(ipc: str) -> None:
    async def story(running: Running) -> None:
        sub = running.subscriber()
        await running.until_heard(sub)
        for board in ("TS0001", "TS0001", "TS0002"):
            running.send(scan(0), board)
            running.send(CONTACT, board)
        got = [await sub.recv_multipart() for _ in range(6)]
        assert [len(parts) for parts in got] == [2] * 6
        assert [topic.decode() for topic, _ in got[::2]] == ["tactile/TS0001/scan"] * 2 + [
            "tactile/TS0002/scan"
        ]
        assert [msgpack.unpackb(payload)["seq"] for _, payload in got] == [0, 0, 1, 1, 0, 0]
        assert msgpack.unpackb(got[0][1])["timestamp"] == 1010.0

    play(ipc, story)


def test_a_suspended_subscriber_delays_nobody_and_wakes_to_the_newest_messages(ipc: str) -> None:
    async def story(running: Running) -> None:
        sleeper, awake = running.subscriber(), running.subscriber()
        sleeper.rcvhwm = 1  # so that what it leaves unread waits with us
        sleeper.disconnect(ipc)
        sleeper.connect(ipc)
        await running.until_heard(sleeper, awake)
        numbers = []
        for index in range(10_000):  # 100 s of scans, far above what is queued for one
            running.send(scan(index))
            if index % 100 == 99:
                numbers += [msgpack.unpackb((await awake.recv_multipart())[1])["seq"] for _ in range(100)]
        assert numbers == list(range(10_000))
        slept: list[int] = []
        while not slept or slept[-1] < 9999:
            slept.append(msgpack.unpackb((await sleeper.recv_multipart())[1])["seq"])
        assert slept == sorted(set(slept))
        n_queued = QUEUE_BYTES // 500  # of scans with 36 channels, at most this many
        n_lost = 10_000 - len(slept)
        assert n_lost > 10_000 - 3 * n_queued
        assert slept[-1000:] == list(range(9000, 10_000))
        assert running.publisher.server.dropped == {"TS0001": n_lost}

    play(ipc, story)


def test_a_flushed_message_leaves_while_the_event_loop_is_busy(ipc: str) -> None:
    async def story(running: Running) -> None:
        sub = running.subscriber()
        await running.until_heard(sub)
        running.send(scan(7))
        running.publisher.server.flush()
        blocking: zmq.Socket[bytes] = zmq.Socket.shadow(sub.underlying)
        assert blocking.poll(round(1000 * PATIENCE_S))  # nothing else runs in this process
        assert msgpack.unpackb(blocking.recv_multipart()[1])["index"] == 7

    play(ipc, story)


def test_queued_events_leave_before_the_socket_closes(ipc: str) -> None:
    async def story(running: Running) -> None:
        sub = running.subscriber()
        await running.until_heard(sub)
        for index in range(500):
            running.send(scan(index))
        running.publisher.close()
        got = [msgpack.unpackb((await sub.recv_multipart())[1])["index"] for _ in range(500)]
        assert got == list(range(500))

    play(ipc, story)


def test_a_dead_subscriber_does_not_delay_shutdown(ipc: str) -> None:
    async def story(running: Running) -> None:
        await running.until_heard(sleeper := running.subscriber())
        sleeper.rcvhwm = 1
        for index in range(20_000):
            running.send(scan(index))
        running.publisher.close()  # would hang here for ever without the linger limit

    play(ipc, story)


@pytest.mark.parametrize("endpoint", ["tcp://127.0.0.1:{}", "tcp://localhost:{}"])
def test_tcp_is_served_by_address_and_by_name(endpoint: str) -> None:
    port = free_pair()
    params = PublishParams(endpoints=(endpoint.format(port),))
    publisher = Publisher(params)
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S):
        pass
    publisher.close()


@pytest.mark.parametrize(
    "endpoint",
    ["tcp://0.0.0.0:9872", "tcp://*:9872", "tcp://[::]:9872", "tcp://192.168.1.5:9872", "tcp://robot:9872",
     "tcp://eth0:9872"],
)  # fmt: skip
def test_endpoints_reachable_from_other_hosts_are_refused_by_default(endpoint: str) -> None:
    with pytest.raises(ConfigError, match=r"can be reached from other hosts.*tactiled keys make"):
        tomlfile.parse({"endpoints": [endpoint]}, PublishParams, "t.toml")
    tomlfile.parse({"endpoints": [endpoint], "keys": "/keys"}, PublishParams, "t.toml")


@pytest.mark.parametrize("endpoint", ["tcp://127.0.0.1:1", "tcp://localhost:1", "tcp://[::1]:1", "ipc:///x"])
def test_local_endpoints_are_allowed(endpoint: str) -> None:
    assert PublishParams(endpoints=(endpoint,)).endpoints == (endpoint,)


@pytest.mark.parametrize(
    ("endpoint", "says"),
    [
        ("9872", "neither tcp nor ipc"),
        ("udp://127.0.0.1:1", "neither tcp nor ipc"),
        ("inproc://x", "neither tcp nor ipc"),
        ("", "neither tcp nor ipc"),
        ("tcp://", "no host or no port"),
        ("tcp://127.0.0.1", "no host or no port"),
        ("tcp://:9872", "no host or no port"),
        ("tcp://127.0.0.1:", "no port from 1 to 65535"),
        ("tcp://127.0.0.1:0", "no port from 1 to 65535"),
        ("tcp://127.0.0.1:*", "no port from 1 to 65535"),
        ("tcp://127.0.0.1:http", "no port from 1 to 65535"),
        ("tcp://127.0.0.1:-1", "no port from 1 to 65535"),
        ("tcp://127.0.0.1:\u00b2", "no port from 1 to 65535"),  # superscript two is a digit to Python
        ("tcp://127.0.0.1:999999", "no port from 1 to 65535"),
        ("ipc://", "no path"),
        ("ipc:///", "no path"),
        ("ipc://@name", "abstract socket, which any user"),
        ("ipc://@", "abstract socket, which any user"),
        ("ipc:///run/a\0b", "cannot be printed"),
        ("ipc:///run/a\nb", "cannot be printed"),
        (f"ipc:///{'x' * 120}", "longer than the 107 bytes"),
    ],
)
def test_an_invalid_endpoint_is_refused_with_its_key(endpoint: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        tomlfile.parse({"publish": {"endpoints": [endpoint]}}, _File, "t.toml")
    (fault,) = caught.value.faults
    assert "publish.endpoints" in fault
    assert says in fault
    assert "not an endpoint" in fault


def test_the_last_port_has_no_next_port() -> None:
    with pytest.raises(ConfigError, match=r"for requests.*65536.*no port from 1 to 65535"):
        tomlfile.parse({"endpoints": ["tcp://127.0.0.1:65535"]}, PublishParams, "t.toml")


@pytest.mark.parametrize(
    "document",
    [
        {"endpoints": ["ipc:///run/a", "ipc:///run/a"]},
        {"endpoints": ["ipc:///run/events", "ipc:///run/control"]},
        {"endpoints": ["tcp://127.0.0.1:9872", "tcp://127.0.0.1:9873"]},
    ],
)
def test_an_endpoint_that_is_named_twice_is_refused(document: dict[str, list[str]]) -> None:
    with pytest.raises(ConfigError, match="is named twice"):
        tomlfile.parse(document, PublishParams, "t.toml")


def test_a_socket_is_for_its_user_and_group_only(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        publisher = Publisher(PublishParams(endpoints=(f"ipc://{tmp_path}/e.ipc",)))
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "e.ipc").stat().st_mode) == 0o660
    publisher.close()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may enter everywhere")
def test_a_path_without_permission_is_explained(tmp_path: Path) -> None:
    (tmp_path / "closed").mkdir(mode=0)
    with pytest.raises(OperatorError, match="cannot be bound: Permission denied"):
        Publisher(PublishParams(endpoints=(f"ipc://{tmp_path}/closed/e.ipc",)))


def test_two_daemons_on_one_tcp_port_get_a_clear_line() -> None:
    endpoint = f"tcp://127.0.0.1:{free_pair()}"
    first = Publisher(PublishParams(endpoints=(endpoint,)))
    with pytest.raises(UnavailableError, match=r"in use, by another tactiled perhaps .*ss -tlnp.*endpoints"):
        Publisher(PublishParams(endpoints=(endpoint,)))
    first.close()


def test_two_daemons_on_one_ipc_path_get_a_clear_line_and_a_stale_file_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "e.ipc"
    params = PublishParams(endpoints=(f"ipc://{path}",))
    first = Publisher(params)
    with pytest.raises(UnavailableError, match="in use by another tactiled"):
        Publisher(params)
    first.close()
    path.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(path))  # what a killed daemon leaves
    Publisher(params).close()


def test_an_endpoint_that_cannot_be_bound_is_explained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UnavailableError, match="cannot be bound"):
        Publisher(PublishParams(endpoints=(f"ipc://{tmp_path}/no/such/folder/e.ipc",)))
    monkeypatch.setenv("RUNTIME_DIRECTORY", f"/{'x' * 120}")
    with pytest.raises(ConfigError, match="107 bytes"):  # the placeholder is short
        Publisher(PublishParams(endpoints=("ipc://{runtime}/e.ipc",)))


def test_the_runtime_directory_is_that_of_systemd_or_the_session_or_a_private_one(tmp_path: Path) -> None:
    assert runtime_directory({"RUNTIME_DIRECTORY": "/run/tactiled/a:/run/b"}) == Path("/run/tactiled/a")
    ours = runtime_directory({"XDG_RUNTIME_DIR": str(tmp_path)})
    assert ours == tmp_path / "tactiled"
    assert stat.S_IMODE(ours.stat().st_mode) == 0o700
    assert runtime_directory({}) == Path(f"/tmp/tactiled-{os.getuid()}")


def test_a_runtime_directory_of_someone_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "tactiled").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OperatorError, match="belongs to someone else"):
        runtime_directory({"XDG_RUNTIME_DIR": str(tmp_path)})


def test_the_placeholder_stands_for_the_runtime_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    publisher = Publisher(PublishParams(endpoints=("ipc://{runtime}/events.ipc",)))
    assert (tmp_path / "events.ipc").is_socket()
    publisher.close()


def test_an_endpoint_does_not_delete_a_file(tmp_path: Path) -> None:
    precious = tmp_path / "notes.txt"
    precious.write_text("keep me")
    with pytest.raises(OperatorError, match="no socket"):
        Publisher(PublishParams(endpoints=(f"ipc://{precious}",)))
    assert precious.read_text() == "keep me"
