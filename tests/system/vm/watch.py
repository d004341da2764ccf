"""Report, in the guest, what a subscriber of each board sees and when the port's name comes and goes.

The report is JSON lines with CLOCK_MONOTONIC on the port to the host.
"""

import json
import sys
import time
from pathlib import Path

from tactiled.client import Message, Subscription

LOOK_S = 0.005

serials = sys.argv[1:]
there = dict.fromkeys(serials, False)
subscriptions = {
    serial: Subscription(f"ipc:///run/tactiled/{serial}/events.ipc", topics=("scan", "status", "recording"))
    for serial in serials
}
with open("/dev/virtio-ports/watch", "wb", buffering=0) as port:  # noqa: PTH123 - no file, a port

    def say(serial: str, what: str, value: object) -> None:
        line = json.dumps([time.monotonic(), serial, what, value])
        port.write(line.encode() + b"\n")

    while True:
        for serial, subscription in subscriptions.items():
            now_there = Path(f"/dev/tactiled-{serial}").exists()
            if now_there != there[serial]:
                there[serial] = now_there
                say(serial, "node", now_there)
            while (item := subscription.next_item(time.monotonic() + LOOK_S)) is not None:
                if not isinstance(item, Message):
                    say(serial, type(item).__name__, "")
                elif item.topic == "scan":
                    say(serial, "scan", [item.data["index"], item.data["late"], item.board])
                elif item.topic == "recording":
                    say(serial, "recording", item.data["state"])
