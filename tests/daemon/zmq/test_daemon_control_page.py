"""Programs in protocols/control.md run as they are printed."""

import asyncio
import re
import sys
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

from patience import PATIENCE_S

from tactiled import resources
from tactiled.daemon.zmq.commands import MotionSenders
from tactiled.daemon.zmq.network import Network
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.requests import CommandRequest, Motion, Requester
from tactiled.events.types import ContactEvent

CONTACT = ContactEvent(time_s=1.0, state="loading", previous="none", taxels=(1, 2), valid=True)


def test_the_subscriber_in_the_documentation_misses_nothing(tmp_path: Path) -> None:
    page = resources.shipped("protocols", "control.md").read_text()
    code, *_ = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    endpoint = f"ipc://{tmp_path}/events.ipc"
    script = code.replace("tcp://127.0.0.1:9872", endpoint).replace(
        "tcp://127.0.0.1:9873", f"ipc://{tmp_path}/control.ipc"
    )
    heard = tmp_path / "heard"

    async def main() -> None:
        network = Network(PublishParams(endpoints=(endpoint,)), lambda *_: None, lambda *_: {})
        serving = asyncio.create_task(network.run())
        with heard.open("w") as out:
            child = await asyncio.create_subprocess_exec(sys.executable, "-c", script, stdout=out)
        try:
            async with asyncio.timeout(PATIENCE_S):
                while "now contact" not in heard.read_text():
                    network.publisher.send(CONTACT, board="b", unix_offset_s=0.0)
                    await asyncio.sleep(0.02)
                for turn in range(3):
                    with patch.object(network.publisher.server, "send"):  # messages are lost on purpose
                        for _ in range(400 * turn + 1):
                            network.publisher.send(CONTACT, board="b", unix_offset_s=0.0)
                    network.publisher.send(CONTACT, board="b", unix_offset_s=0.0)
                last = network.publisher.sent("b").contact - 1
                while f"now contact {last}\n" not in heard.read_text():
                    await asyncio.sleep(0.02)
            assert child.returncode is None
        finally:
            child.kill()
            await child.wait()
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
            network.close()
        lines = heard.read_text().splitlines()
        seqs = [int(line.rsplit(" ", 1)[1]) for line in lines]
        assert seqs == list(range(seqs[0], last + 1))
        assert sum(line.startswith("missed") for line in lines) == 1 + 401 + 801

    asyncio.run(main())


def test_the_command_in_the_documentation_is_done_exactly_once(
    tmp_path: Path,
) -> None:
    page = resources.shipped("protocols", "control.md").read_text()
    _, code, _ = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    script = code.replace("ipc:///run/tactiled/TS0001/control.ipc", f"ipc://{tmp_path}/control.ipc")
    done: list[str] = []

    def do(
        command: CommandRequest, _requester: Requester, _now_s: float, finish: Callable[[str], None]
    ) -> None:
        done.append(command.id)
        asyncio.get_running_loop().call_later(1.2, finish, "")  # it asks twice more meanwhile

    async def main() -> None:
        network = Network(PublishParams(endpoints=(f"ipc://{tmp_path}/events.ipc",)), do, lambda *_: {})
        serving = asyncio.create_task(network.run())
        try:
            for _ in range(2):
                child = await asyncio.create_subprocess_exec(
                    sys.executable, "-c", script, stdout=asyncio.subprocess.PIPE
                )
                assert (await asyncio.wait_for(child.communicate(), PATIENCE_S))[0] == b"True \n"
        finally:
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
            network.close()

    asyncio.run(main())
    assert done == ["1", "1"]


def test_the_motion_in_the_documentation_is_announced_with_its_instants(tmp_path: Path) -> None:
    page = resources.shipped("protocols", "control.md").read_text()
    *_, code = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    endpoint = f"ipc://{tmp_path}/events.ipc"
    script = code.replace('Commander(who="arm")', f'Commander("{endpoint}", who="arm")')
    done: list[CommandRequest] = []

    def do(
        command: CommandRequest, _requester: Requester, _now_s: float, finish: Callable[[str], None]
    ) -> None:
        done.append(command)
        finish("")

    async def main() -> None:
        network = Network(PublishParams(endpoints=(endpoint,)), do, lambda *_: {})
        serving = asyncio.create_task(network.run())
        try:
            child = await asyncio.create_subprocess_exec(sys.executable, "-c", script)
            assert await asyncio.wait_for(child.wait(), PATIENCE_S) == 0
        finally:
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
            network.close()

    asyncio.run(main())
    (command,) = done
    assert isinstance(command, Motion)
    reason, course = MotionSenders().course(command, ("", "session", "arm"), 200.0)
    assert reason == ""
    assert course["acceleration_m_s2"] == [9.81, 10.4, 11.2]
    # Of this host's clock at 200 s, however long the program needs between its clock and its message.
    assert 200.0 - PATIENCE_S < course["time_s"][0] < course["time_s"][2] - 0.019
    assert course["time_s"][2] < 200.0
