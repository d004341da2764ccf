"""Permission to command by transport, and identity of the requester in the log; with real sockets."""

import asyncio
import os
import stat
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE_S
from ports import free_pair

from tactiled.client import AsyncCommander
from tactiled.daemon.zmq.network import Network
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.requests import CommandRequest, Requester


class Server:
    """A network in this process, and who commanded it."""

    def __init__(self, **params: Any) -> None:
        self.requesters: list[Requester] = []
        self.network = Network(PublishParams(**params), self.do, lambda *_: {})

    def do(
        self, _command: CommandRequest, requester: Requester, _now_s: float, done: Callable[[str], None]
    ) -> None:
        self.requesters.append(requester)
        done("")

    def run(self, story: Callable[[], Awaitable[None]]) -> None:
        """Play a story beside it."""

        async def main() -> None:
            serving = asyncio.create_task(self.network.run())
            try:
                async with asyncio.timeout(PATIENCE_S):
                    await story()
                assert not serving.done()
            finally:
                serving.cancel()
                await asyncio.gather(serving, return_exceptions=True)
                self.network.close()

        asyncio.run(main())


def test_a_command_over_ipc_carries_the_user(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    endpoint = f"ipc://{tmp_path}/events.ipc"
    server = Server(endpoints=(endpoint,))

    async def story() -> None:
        async with AsyncCommander(endpoint) as daemon:
            assert (await daemon.send("inhibit", duration_s=1.0)).ok
        (requester,) = server.requesters
        assert (requester.uid, requester.key) == (os.getuid(), "")
        assert f"command: inhibit by uid {os.getuid()}: done" in caplog.text

    server.run(story)


def test_both_sockets_of_ipc_are_for_user_and_group_only(tmp_path: Path) -> None:
    server = Server(endpoints=(f"ipc://{tmp_path}/events.ipc",))

    async def story() -> None:
        for name in ("events.ipc", "control.ipc"):
            assert stat.S_IMODE((tmp_path / name).stat().st_mode) == 0o660

    server.run(story)


@pytest.mark.parametrize("allowed", [False, True])
def test_commands_over_tcp_are_refused_unless_allowed_but_queries_are_answered(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, allowed: bool
) -> None:
    """One ROUTER serves both ways: it knows from whom each request came."""
    port = free_pair()
    endpoint = f"tcp://127.0.0.1:{port}"
    control = f"ipc://{tmp_path}/control.ipc"
    server = Server(
        endpoints=(endpoint,),
        control_endpoints=(f"tcp://127.0.0.1:{port + 1}", control),
        allow_commands_over_tcp=allowed,
    )

    async def story() -> None:
        async with AsyncCommander(endpoint) as tcp, AsyncCommander(control=control) as ipc:
            assert (await tcp.send("state")).ok
            reply = await tcp.send("record", on=False)
            assert reply.ok == allowed
            if not allowed:
                assert "allow_commands_over_tcp" in reply.reason
                assert "record by an unknown user over TCP from 127.0.0.1" in caplog.text
            assert (await ipc.send("record", on=False)).ok
        assert [requester.uid for requester in server.requesters] == [-1] * allowed + [os.getuid()]

    server.run(story)


def test_an_endpoint_on_a_private_network_accepts_commands() -> None:
    port = free_pair()
    endpoint = f"tcp://0.0.0.0:{port}"
    server = Server(endpoints=(endpoint,), allow_plaintext_on_network=True)

    async def story() -> None:
        async with AsyncCommander(f"tcp://127.0.0.1:{port}") as daemon:
            assert (await daemon.send("record", on=False)).ok
        assert server.requesters[0].address == "127.0.0.1"

    server.run(story)
