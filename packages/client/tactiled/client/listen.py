"""`tactiled listen`: events as JSON lines on stdout, other items as text on stderr."""

import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO, cast

from tactiled.client.items import Fresh, Item, Lost, Malformed, Message, Recovered, Restarted, Stale
from tactiled.client.subscriber import Subscription
from tactiled.client.typed import Topic
from tactiled.events.endpoints import DEFAULT_ENDPOINT

# After the given time, what waits is printed as well, for so long. On a busy host messages may come faster
# than they are printed, and there is always one more.
_LATER_S = 1.0


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
    """Print messages until `count` is reached, `timeout_s` has passed, or Ctrl-C.

    Parameters
    ----------
    endpoint, topics, board, keys
        As for `Client`.
    count : int, optional
        End after this number of messages.
    timeout_s : float, optional
        End after this time in all.
    out, err : text streams
        For JSON lines, and for text.

    Returns
    -------
    int
        0 when `count` was reached, or without `count` after any message or Ctrl-C; 1 when `timeout_s` passed
        before that.
    """
    out = sys.stdout if out is None else out
    err = sys.stderr if err is None else err
    until_s = None if timeout_s is None else time.monotonic() + timeout_s
    printed = 0
    try:
        # Any text is harmless: it matches no message.
        with Subscription(endpoint, cast(Sequence[Topic], topics), board, keys=keys) as subscription:
            while count is None or printed < count:
                item = subscription.next_item(until_s)
                if item is None or (until_s is not None and time.monotonic() > until_s + _LATER_S):
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
        # The reader has closed the pipe, as `| head` does; Python's flush at exit must not print an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())
    return 0


def _json_line(item: Item) -> str | None:
    """JSON of a message with its topic and mark of recovery; None for other items and invalid values."""
    mark = {"recovered": True} if isinstance(item, Recovered) else {}
    message = item.message if isinstance(item, Recovered) else item
    if not isinstance(message, Message):
        return None
    try:
        return json.dumps({"topic": message.topic, **mark, **message.data}, allow_nan=False)
    except (TypeError, ValueError):  # bytes, ext or NaN, which tactiled never sends
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
            return f"malformed: {topic} contains a value that JSON cannot represent"
