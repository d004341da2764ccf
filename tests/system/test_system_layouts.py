"""Real processes: boards whose frames have neither checksum nor sequence number, at a rate to be measured."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tactiled.client import Message, Subscription

pytestmark = pytest.mark.system
PATIENCE_S = 40.0


@contextmanager
def process(*arguments: str) -> Iterator[None]:
    with subprocess.Popen([sys.executable, "-m", "tactiled", *arguments], stdout=subprocess.DEVNULL) as child:
        try:
            yield
        finally:
            child.terminate()


@pytest.mark.parametrize("protocol", ["magnetometers-5", "lines-15"])
def test_magnetometers_from_the_board_to_the_client(tmp_path: Path, protocol: str) -> None:
    board, endpoint, config = tmp_path / "board", f"ipc://{tmp_path}/events.ipc", tmp_path / "tactiled.toml"
    config.write_text(
        f'[port]\nurl = "{board}"\n[publish]\nendpoints = ["{endpoint}"]\n'
        f'[board]\nprotocol = "{protocol}"\narray = "magnetometers-5"\n'
    )
    found: dict[str, Message] = {}
    until_s = time.monotonic() + PATIENCE_S
    with (
        process("emulate", "--scene", "rest", "--protocol", protocol, "--link", str(board)),
        process("run", "--config", str(config)),
        Subscription(endpoint) as subscription,
    ):
        while "scan" not in found or "status" not in found or not found["status"].data["valid"]:
            assert time.monotonic() < until_s, f"no scan in {PATIENCE_S} s"
            item = subscription.next_item(until_s)
            if isinstance(item, Message):
                found[item.topic] = item
    status, volts = found["status"].data, found["scan"].data["volts"]
    assert status["rate_hz"] == pytest.approx(100.0, rel=0.1)  # a busy host hands over late
    assert (status["loss_known"], status["damage_known"]) == (False, False)
    assert len(volts) == 15
    assert max(abs(value) for value in volts[0::3] + volts[1::3]) < 100.0  # no shear, in uT
    assert max(volts[2::3]) < -4900.0  # no load: the lower end of the range
