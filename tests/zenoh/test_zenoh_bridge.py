"""ZenohBridge and client through two real routers on loopback, with a line between them that is cut."""

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh
from patience import PATIENCE_S
from routers import TwoRouters, free_port, router, two_routers
from simulated_daemon import Rates, SimulatedDaemon
from zenoh_threads import zenoh_threads

from tactiled.client import Client, Commander, Fresh, Item, Lost, Message, Recovered, Stale, Subscription
from tactiled.errors import OperatorError, UnavailableError
from tactiled.zenoh.bridge import LivelyBoards, ZenohBridge, ZenohBridgeParams
from tactiled.zenoh.fleet import FleetList, FleetRow
from tactiled.zenoh.safety import bridge_config
from tactiled.zenoh.session import open_session, parse_address, spread

BOARDS = ("TS0001", "TS0002")
THINNED_HZ = 10.0

__all__ = ["zenoh_threads"]  # a fixture for every test here


@contextmanager
def bridged(params: ZenohBridgeParams, port: int) -> Iterator[ZenohBridge]:
    config = bridge_config(None, (f"tcp/127.0.0.1:{port}",), is_insecure=False)
    with zenoh.open(config) as session:
        bridge = ZenohBridge(params, session)
        thread = threading.Thread(target=bridge.run)
        thread.start()
        try:
            yield bridge
        finally:
            bridge.stop()
            thread.join()
            bridge.close()


@dataclass
class Fleet:
    routers: TwoRouters
    daemon: SimulatedDaemon

    @property
    def endpoint(self) -> str:
        return f"zenoh://127.0.0.1:{self.routers.readers_port}/robot7"


@contextmanager
def running(folder: Path) -> Iterator[Fleet]:
    with (
        two_routers() as routers,
        SimulatedDaemon(f"ipc://{folder}/events.ipc", BOARDS, Rates(20.0, 50.0)) as daemon,
        bridged(ZenohBridgeParams(daemon.endpoint, "robot7", THINNED_HZ, True), routers.robots_port),
    ):
        yield Fleet(routers, daemon)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with running(tmp_path_factory.mktemp("fleet")) as fleet:
        # Bridge and daemon open connections of their own until the first subscriber is served.
        with Subscription(fleet.endpoint, ("slip",), "TS0001") as subscription:
            until(subscription, is_fresh)
        yield fleet


def until(subscription: Subscription, is_last: Callable[[Item], bool]) -> list[Item]:
    """Items up to the first of a kind."""
    items: list[Item] = []
    end_s = time.monotonic() + PATIENCE_S
    while (item := subscription.next_item(end_s)) is not None:
        items.append(item)
        if is_last(item):
            return items
    raise AssertionError(f"not within {PATIENCE_S} s, but {[type(item).__name__ for item in items][-9:]}")


def during(subscription: Subscription, duration_s: float) -> list[Item]:
    end_s = time.monotonic() + duration_s
    return list(iter(lambda: subscription.next_item(end_s), None))


def is_fresh(item: Item) -> bool:
    return isinstance(item, Fresh)


def numbers(items: list[Item], topic: str) -> list[int]:
    """Sequence numbers of a topic, recovered ones included."""
    messages = [item.message if isinstance(item, Recovered) else item for item in items]
    return [one.seq for one in messages if isinstance(one, Message) and one.topic == topic]


def test_a_subscriber_gets_every_slip_once_and_in_order(fleet: Fleet) -> None:
    with Subscription(fleet.endpoint, ("slip",), "TS0001") as subscription:
        items = until(subscription, is_fresh)
        assert subscription.fresh
        while len(slips := numbers(items, "slip")) <= 10:
            items += during(subscription, 0.5)
    assert slips == list(range(slips[0], slips[0] + len(slips)))
    assert all(item.board == "TS0001" for item in items if isinstance(item, Message))


def test_what_the_bridge_thins_is_no_loss(fleet: Fleet) -> None:
    with Subscription(fleet.endpoint, ("scan", "contact"), "TS0002") as subscription:
        items = until(subscription, is_fresh)
        while True:
            items += during(subscription, 0.5)
            sent_s = [item.timestamp for item in items if isinstance(item, Message) and item.topic == "scan"]
            if sent_s and (span_s := sent_s[-1] - sent_s[0]) > 1.0:
                break
        assert subscription.lost == 0
    assert 3 <= len(sent_s) <= span_s * THINNED_HZ + 3
    assert not [item for item in items if isinstance(item, Lost)]
    assert not [item for item in items if isinstance(item, Recovered) and item.message.topic == "scan"]


def test_subscribers_are_told_which_topics_are_thinned(fleet: Fleet) -> None:
    beside: dict[tuple[str, str], set[bytes | None]] = {}

    def note(sample: zenoh.Sample) -> None:
        _, host, _, topic = str(sample.key_expr).split("/")
        names = None if sample.attachment is None else sample.attachment.to_bytes()
        beside.setdefault((host, topic), set()).add(names)

    topics = {
        "status": b"scan,grip,force",
        "scan": b"scan,grip,force",
        "grip": b"scan,grip,force",
        "slip": None,
    }
    expected = {("robot7", topic): {names} for topic, names in topics.items()}
    expected |= {("whole", topic): {None} for topic in topics}  # a bridge that thins nothing
    with (
        bridged(ZenohBridgeParams(fleet.daemon.endpoint, "whole"), fleet.routers.robots_port),
        open_session(parse_address(fleet.endpoint)) as session,
    ):
        subscriber = session.declare_subscriber("tactile/*/TS0001/*", note)
        end_s = time.monotonic() + PATIENCE_S
        while not expected.keys() <= beside.keys() and time.monotonic() < end_s:
            time.sleep(0.02)
        subscriber.undeclare()
    assert {key: beside.get(key) for key in expected} == expected


def test_a_board_is_on_the_network_while_its_status_comes(fleet: Fleet) -> None:
    with open_session(parse_address(fleet.endpoint)) as session:
        boards = LivelyBoards(session, "robot9")

        def tokens() -> set[str]:
            replies = session.liveliness().get("tactile/robot9/*")  # of the session and of its router
            return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}

        for at_s in (50.0, 50.9):
            boards.heard(b"tactile/A/status", at_s)
        boards.drop_silent(51.8)
        assert tokens() == {"tactile/robot9/A"}
        boards.drop_silent(52.0)
        assert tokens() == set()
        boards.heard(b"tactile/A/status", 60.0)
        assert tokens() == {"tactile/robot9/A"}
        boards.close()
        assert tokens() == set()


def test_the_asyncio_client_gets_the_same_items(fleet: Fleet) -> None:
    async def first_slip() -> Message:
        async with asyncio.timeout(PATIENCE_S), Client(fleet.endpoint, ("slip",), "TS0001") as client:
            async for item in client:
                if isinstance(item, Message) and client.fresh:
                    return item
        raise AssertionError

    assert asyncio.run(first_slip()).topic == "slip"


def test_a_command_reaches_the_daemon_once_with_its_origin(fleet: Fleet) -> None:
    done = len(fleet.daemon.commands)
    with Commander(fleet.endpoint, "gripper") as commander:
        assert commander.send("mark", PATIENCE_S, text="here", board="TS0001").ok
    [command] = fleet.daemon.commands[done:]
    assert command.who == "gripper zenoh"
    assert command.arguments == {"text": "here"}


def test_the_checks_of_the_daemon_hold_through_the_network(fleet: Fleet) -> None:
    with Commander(fleet.endpoint, "gripper") as commander:
        assert commander.send("inhibit", board="TS0001", duration_s=0.2).ok
        refused = commander.send("inhibit", board="TS0001", duration_s=1e9)
    assert not refused.ok
    assert "duration_s" in refused.reason


def test_a_bridge_without_permission_refuses_commands(fleet: Fleet) -> None:
    with (
        bridged(ZenohBridgeParams(fleet.daemon.endpoint, "closed"), fleet.routers.robots_port),
        Commander(fleet.endpoint.replace("robot7", "closed")) as commander,
    ):
        refused = commander.send("mark", board="TS0001", text="no")
        assert commander.send("state").ok
    assert not refused.ok
    assert "--allow-commands" in refused.reason
    assert not [command for command in fleet.daemon.commands if command.arguments.get("text") == "no"]


def test_the_list_of_boards(fleet: Fleet) -> None:
    boards = FleetList(fleet.endpoint.replace("robot7", "*"))
    end_s = time.monotonic() + PATIENCE_S
    rows: list[FleetRow] = []
    while (
        not (rows and all(row.firmware for row in rows)) and time.monotonic() < end_s
    ):  # info comes each second
        rows = [row for row in boards.ask() if row.host == "robot7"]
    assert [(row.board, row.state, row.valid) for row in rows] == [(name, "running", True) for name in BOARDS]
    assert rows[0].utilisation == pytest.approx(0.31)
    assert rows[0].firmware == "1.4.2"
    assert rows[0].free_mb == pytest.approx(45678.0)
    assert rows[0].loss_ppm == pytest.approx(1e6 * 2 / 123458)
    assert 0 <= rows[0].age_s < PATIENCE_S


def test_all_hosts_become_an_endpoint_each(fleet: Fleet) -> None:
    others = ("tcp://127.0.0.1:9872", fleet.endpoint)
    everyone = fleet.endpoint.replace("robot7", "*")
    assert spread((*others, everyone), None, 2.0) == (*others, fleet.endpoint)


def test_a_name_that_another_bridge_has_is_refused(fleet: Fleet) -> None:
    config = bridge_config(None, (f"tcp/127.0.0.1:{fleet.routers.readers_port}",), is_insecure=False)
    with zenoh.open(config) as session, pytest.raises(UnavailableError, match="robot7"):
        ZenohBridge(ZenohBridgeParams(fleet.daemon.endpoint, "robot7"), session)


def test_a_board_whose_daemon_ended_has_no_token(tmp_path: Path, fleet: Fleet) -> None:
    endpoint = f"ipc://{tmp_path}/events.ipc"
    with (
        open_session(parse_address(fleet.endpoint)) as session,
        bridged(ZenohBridgeParams(endpoint, "robot8"), fleet.routers.robots_port),
    ):

        def tokens() -> list[str]:
            found = session.liveliness().get("tactile/robot8/*")
            return sorted(str(reply.ok.key_expr) for reply in found if reply.ok is not None)

        def wait_for(expected: list[str]) -> None:
            end_s = time.monotonic() + PATIENCE_S
            while tokens() != expected and time.monotonic() < end_s:
                time.sleep(0.05)
            assert tokens() == expected

        with SimulatedDaemon(endpoint, ("TS0008",), Rates()):
            wait_for(["tactile/robot8/TS0008", "tactile/robot8/control"])
        wait_for(["tactile/robot8/control"])
        rows = FleetList(fleet.endpoint.replace("robot7", "robot8")).ask()
        assert [(row.host, row.board, row.state) for row in rows] == [("robot8", "", "silent")]
        with pytest.raises(UnavailableError, match="robot8"):
            ZenohBridge(ZenohBridgeParams(endpoint, "robot8"), session)


@pytest.mark.parametrize("how", ["close", "silence"])
def test_nothing_is_lost_while_the_line_between_routers_is_cut(tmp_path: Path, how: str) -> None:
    with running(tmp_path) as fleet, Subscription(fleet.endpoint, ("slip",), "TS0001") as subscription:
        items = until(subscription, is_fresh)
        getattr(fleet.routers.line, how)()
        items += until(subscription, lambda item: isinstance(item, Stale))
        assert not subscription.fresh
        items += during(subscription, 1.0)
        fleet.routers.line.mend()
        items += until(subscription, is_fresh) + during(subscription, 1.0)
        fleet.daemon.stop_slips()
        while numbers(items, "slip")[-1:] != [fleet.daemon.slips["TS0001"] - 1]:
            items += during(subscription, 0.1)
        assert subscription.lost == 0
    slips = numbers(items, "slip")
    assert slips == list(range(slips[0], slips[0] + len(slips)))


def test_a_subscriber_waits_for_its_router_and_outlives_it(tmp_path: Path) -> None:
    port = free_port()
    with (
        Subscription(f"zenoh://127.0.0.1:{port}/robot7", ("slip",)) as subscription,
        SimulatedDaemon(f"ipc://{tmp_path}/events.ipc", ("TS0001",), Rates(20.0)) as daemon,
    ):
        items = until(subscription, lambda item: isinstance(item, Stale))
        first = router(port)
        with bridged(ZenohBridgeParams(daemon.endpoint, "robot7"), port):
            items = until(subscription, is_fresh)
            first.close()
            items += until(subscription, lambda item: isinstance(item, Stale))
            with closing(router(port)):
                items += until(subscription, is_fresh) + during(subscription, 1.0)
        assert subscription.lost == 0
    slips = numbers(items, "slip")
    assert slips == list(range(slips[0], slips[0] + len(slips)))


def test_a_command_to_a_bridge_that_ends_without_a_reply_is_sent_once() -> None:
    port, taken = free_port(), list[bytes]()

    def take(query: zenoh.Query) -> None:
        taken.append(b"" if query.payload is None else query.payload.to_bytes())
        query.drop()

    with router(port) as session:
        queryable = session.declare_queryable("tactile/h/command", take)
        with Commander(f"zenoh://127.0.0.1:{port}/h") as commander, pytest.raises(OperatorError):
            commander.send("mark", timeout_s=1.0, text="x")
        queryable.undeclare()
    assert len(taken) == 1
