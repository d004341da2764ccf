"""Subscriber in protocols/events.md: runs as it is printed, and detects a dead daemon."""

import re
import subprocess
import sys
import time
from pathlib import Path

import zmq
from messages import SLIP, STATUS
from patience import PATIENCE_S

from tactiled import resources
from tactiled.events import codec


def test_the_subscriber_in_the_documentation_works(tmp_path: Path) -> None:
    page = resources.shipped("protocols", "events.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    endpoint = f"ipc://{tmp_path}/events.ipc"
    heard = tmp_path / "heard"
    with zmq.Context() as context, context.socket(zmq.PUB) as publisher, heard.open("w") as out:
        publisher.setsockopt(zmq.LINGER, 0)
        publisher.bind(endpoint)
        script = code.replace("tcp://127.0.0.1:9872", endpoint)
        subscriber = subprocess.Popen([sys.executable, "-c", script], stdout=out)
        try:
            seq, deadline_s = 0, time.monotonic() + PATIENCE_S
            while "onset gross 30.0 lost 1" not in heard.read_text() and time.monotonic() < deadline_s:
                for event in (STATUS, SLIP):
                    frames = codec.encode(event, seq=seq, board="hand", unix_offset_s=time.time())
                    publisher.send_multipart(frames)
                seq += 2  # as if every other message had been lost
                time.sleep(0.05)
            assert "onset gross 30.0 lost 1" in heard.read_text()
            alive = heard.read_text().count("no live board")
            while heard.read_text().count("no live board") == alive and time.monotonic() < deadline_s:
                time.sleep(0.05)
            assert heard.read_text().count("no live board") > alive
            assert subscriber.poll() is None
        finally:
            subscriber.kill()
            subscriber.wait()
