"""`tactiled listen`: events as JSON lines for programs, everything else as text for people."""

import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from tactiled.client.items import Fresh, Item, Lost, Malformed, Message, Recovered, Restarted, Stale
from tactiled.client.subscriber import Subscription
from tactiled.events.endpoints import DEFAULT_ENDPOINT


def listen(
    endpoint: str = DEFAULT_ENDPOINT,
    topics: Sequence[str] = (),
    board: str | None = None,
    *,
    count: int | None = None,
    timeout_s: float | None = None,
    keys: Path | None = None,
    out: TextIO | None = None,
    err: TextIO | None = None,
) -> int:
    """Print messages until `count` of them, or `timeout_s`, or interrupted.

    Parameters
    ----------
    endpoint, topics, board, keys
        As for `Client`.
    count : int, optional
        End after so many messages.
    timeout_s : float, optional
        End after so many seconds in all.
    out, err : text streams
        Where JSON lines and words go.

    Returns
    -------
    int
        0 when `count` was reached, or without `count` when anything was printed or we were interrupted;
        1 when the time was up before that.
    """
    out = sys.stdout if out is None else out
    err = sys.stderr if err is None else err
    until_s = None if timeout_s is None else time.monotonic() + timeout_s
    printed = 0
    try:
        with Subscription(endpoint, topics, board, keys=keys) as subscription:
            while count is None or printed < count:
                item = subscription.next_item(until_s)
                if item is None:
                    print(f"{printed} messages in {timeout_s:g} s", file=err)
                    return 0 if printed and count is None else 1
                line = _json_line(item)
                if line is None:
                    print(_words(item), file=err, flush=True)
                else:
                    print(line, file=out, flush=True)
                    printed += 1
    except KeyboardInterrupt:
        return 0
    except BrokenPipeError:
        # Whoever read us has had enough, as `| head` does; Python's own flush at exit must not complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())
    return 0


def _json_line(item: Item) -> str | None:
    """The message map, its topic, and whether it is old news; None for what is no message or no JSON."""
    mark = {"recovered": True} if isinstance(item, Recovered) else {}
    message = item.message if isinstance(item, Recovered) else item
    if not isinstance(message, Message):
        return None
    try:
        return json.dumps({"topic": message.topic, **mark, **message.data}, allow_nan=False)
    except (TypeError, ValueError):  # bytes, ext or NaN: not from a tactiled of ours
        return None


def _words(item: Item) -> str:
    match item:
        case Stale(reason=reason):
            return f"stale: {reason}"
        case Fresh():
            return "fresh: the board runs"
        case Lost(topic=topic, count=count):
            return f"lost: {count} of {topic}"
        case Restarted():
            return "tactiled was restarted"
        case Malformed(reason=reason):
            return f"malformed: {reason}"
        case Message(topic=topic) | Recovered(message=Message(topic=topic)):
            return f"malformed: {topic} holds what JSON cannot say"
