"""The subscriber in protocols/events.md runs as it is printed, and tells living from dead."""

import re
import subprocess
import sys
import time
from pathlib import Path

import zmq

from tactiled import resources
from tactiled.events import codec
from tactiled.events.types import SlipEvent, StatusEvent

STATUS = StatusEvent(
    time_s=0.0, state="running", valid=True, reason="", warning="", age_s=0.01, clock_sd_s=0.0,
    clock_rate_ppm=0.0, rate_hz=100.0, scans=1, frames_corrupt=0, scans_missing=0, scans_duplicate=0,
    restarts=0, bytes_in=0, bytes_framed=0, bytes_discarded=0, bytes_pending=0, connects=1,
    contact="sliding", slipping=True, uptime_s=1.0,
)  # fmt: skip
SLIP = SlipEvent(
    time_s=0.0, state="onset", kind="gross", onset_s=0.0, onset_sd_s=0.01, direction_deg=30.0,
    direction_sd_deg=2.0, confidence=1.0, taxels=(4,), detector="test", statistic=1.0, threshold=0.5,
    valid=True, detected_s=0.0,
)  # fmt: skip


def test_the_printed_subscriber_works(tmp_path: Path) -> None:
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
            seq, deadline_s = 0, time.monotonic() + 30
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
