"""Programs in protocols/control.md, and the example that it names, run as they are printed."""

import asyncio
import re
import sys
from pathlib import Path
from unittest.mock import patch

from networks import NetworkAlone
from patience import PATIENCE_S

from tactiled import resources
from tactiled.daemon.zmq.commands import MotionSenders
from tactiled.daemon.zmq.requests import Motion

SUBSCRIBER = (Path(__file__).parents[3] / "examples" / "fetch_missed.py").read_text()
COMMAND, MOTION = re.findall(
    r"```python\n(.*?)```", resources.shipped("protocols", "control.md").read_text(), re.DOTALL
)


def test_the_subscriber_of_the_example_misses_nothing(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/events.ipc"
    script = SUBSCRIBER.replace("tcp://127.0.0.1:9872", endpoint).replace(
        "tcp://127.0.0.1:9873", f"ipc://{tmp_path}/control.ipc"
    )
    heard = tmp_path / "heard"
    server = NetworkAlone(endpoints=(endpoint,))
    publisher = server.network.publisher

    async def story() -> None:
        with heard.open("w") as out:
            child = await asyncio.create_subprocess_exec(sys.executable, "-c", script, stdout=out)
        try:
            while "now contact" not in heard.read_text():
                server.send()
                await asyncio.sleep(0.02)
            for turn in range(3):
                with patch.object(publisher.server, "send"):  # messages are lost on purpose
                    server.send(400 * turn + 1)
                server.send()
            while f"now contact {publisher.sent('b').contact - 1}\n" not in heard.read_text():
                await asyncio.sleep(0.02)
            assert child.returncode is None
        finally:
            child.kill()
            await child.wait()

    server.run(story)
    lines = heard.read_text().splitlines()
    seqs = [int(line.rsplit(" ", 1)[1]) for line in lines]
    assert seqs == list(range(seqs[0], publisher.sent("b").contact))
    assert sum(line.startswith("missed") for line in lines) == 1 + 401 + 801


def test_the_command_in_the_documentation_is_done(tmp_path: Path) -> None:
    script = COMMAND.replace("ipc:///run/tactiled/TS0001/control.ipc", f"ipc://{tmp_path}/control.ipc")
    server = NetworkAlone(endpoints=(f"ipc://{tmp_path}/events.ipc",))

    async def story() -> None:
        for _ in range(2):
            child = await asyncio.create_subprocess_exec(
                sys.executable, "-c", script, stdout=asyncio.subprocess.PIPE
            )
            assert (await child.communicate())[0] == b"True \n"

    server.run(story)
    assert [command.id for command in server.done] == ["1", "1"]


def test_the_motion_in_the_documentation_is_announced_with_its_instants(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/events.ipc"
    script = MOTION.replace('Commander(who="arm")', f'Commander("{endpoint}", who="arm")')
    server = NetworkAlone(endpoints=(endpoint,))

    async def story() -> None:
        child = await asyncio.create_subprocess_exec(sys.executable, "-c", script)
        assert await child.wait() == 0

    server.run(story)
    (command,) = server.done
    assert isinstance(command, Motion)
    reason, course = MotionSenders().course(command, ("", "1", "arm"), 200.0)
    assert reason == ""
    assert course["acceleration_m_s2"] == [9.81, 10.4, 11.2]
    # Of this host's clock at 200 s, however long the program needs between its clock and its message.
    assert 200.0 - PATIENCE_S < course["time_s"][0] < course["time_s"][2] - 0.019
    assert course["time_s"][2] < 200.0
