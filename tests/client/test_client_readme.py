"""The program in README runs as it is printed."""

import asyncio
import re
import sys
import time
from dataclasses import replace
from pathlib import Path

from messages import SLIP, STATUS
from patience import PATIENCE_S

from tactiled.daemon.zmq.network import Network
from tactiled.daemon.zmq.params import PublishParams

README = Path(__file__).parents[2] / "README.md"


def test_the_program_in_readme_prints_slips_and_a_silent_daemon(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    endpoint = f"ipc://{tmp_path}/events.ipc"
    printed = tmp_path / "printed"

    async def until_printed(words: str, network: Network | None) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while words not in printed.read_text():
                if network is not None:
                    now_s = time.time()
                    slip = replace(SLIP, time_s=now_s, onset_s=now_s, detected_s=now_s)
                    for event in (
                        replace(STATUS, time_s=now_s),
                        replace(slip, valid=False, kind="incipient"),
                        slip,
                    ):
                        network.publisher.send(event, board="b", unix_offset_s=0.0)
                await asyncio.sleep(0.02)

    async def main() -> None:
        network = Network(PublishParams(endpoints=(endpoint,)), [])
        serving = asyncio.create_task(network.run())
        program = code.replace("tcp://127.0.0.1:9872", endpoint)
        with printed.open("w") as out:
            child = await asyncio.create_subprocess_exec(sys.executable, "-c", program, stdout=out)
        try:
            await until_printed("gross slip: onset\n", network)
            await until_printed("hold without touch: ", None)
            assert child.returncode is None
        finally:
            child.kill()
            await child.wait()
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
            network.close()

    asyncio.run(main())
    assert "incipient" not in printed.read_text()  # not valid
