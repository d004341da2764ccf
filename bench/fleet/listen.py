"""Subscriber in a process of its own: notes which messages came, when, and whether they were recovered.

Usage: ``python -m bench.fleet.listen ENDPOINT TOPICS LOG``; ends on SIGTERM. The log is JSON: ``messages``
has topic and board, number, time of receipt (monotonic seconds) and 1 for a recovered one; ``fresh`` the
times of `Fresh`; ``lost`` the messages that the client gave up.
"""

import json
import signal
import sys
import time
from pathlib import Path
from typing import Any

from tactiled.client import Fresh, Message, Recovered, Subscription


def listen(endpoint: str, topics: list[str], log: Path) -> None:
    """Receive until SIGTERM."""
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
    rows: list[tuple[str, int, float, int]] = []
    fresh: list[float] = []
    with Subscription(endpoint, topics) as subscription:  # type: ignore[arg-type]  # words of the command line
        while not ended:
            item = subscription.next_item(time.monotonic() + 0.2)
            is_recovered = isinstance(item, Recovered)
            message = item.message if isinstance(item, Recovered) else item
            if isinstance(message, Message):
                name = f"{message.topic}/{message.board}"
                rows.append((name, message.seq, time.monotonic(), int(is_recovered)))
            elif isinstance(item, Fresh):
                if not fresh:
                    print("ready", flush=True)
                fresh.append(time.monotonic())
        heard: dict[str, Any] = {"messages": rows, "fresh": fresh, "lost": subscription.lost}
    log.write_text(json.dumps(heard))


if __name__ == "__main__":
    listen(sys.argv[1], sys.argv[2].split(","), Path(sys.argv[3]))
