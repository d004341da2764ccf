"""`tactiled listen`: messages on stdout, as JSON lines or in words; other items in words on stderr."""

import json
import os
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import cast

from tactiled.client.items import Fresh, Lost, Malformed, Message, Recovered, Restarted, Stale
from tactiled.client.subscriber import Subscription
from tactiled.client.typed import Topic
from tactiled.errors import ContractError
from tactiled.events.endpoints import DEFAULT_ENDPOINT
from tactiled.events.incoming import checked_map
from tactiled.events.words import EventLines, printable

# After the given time, what waits is printed as well, for so long. On a busy host messages may come faster
# than they are printed, and there is always one more.
_LATER_S = 1.0


def listen(
    endpoint: str = DEFAULT_ENDPOINT,
    topics: Sequence[str] = (),
    *,
    count: int | None = None,
    timeout_s: float | None = None,
    keys: Path | None = None,
    as_json: bool = True,
) -> int:
    """Print messages until there were `count` lines, `timeout_s` has passed, or Ctrl-C.

    Messages go to stdout, as JSON lines or for people (`EventLines`); all else goes to stderr. Return 0 when
    `count` was reached, or without `count` after any message or Ctrl-C; 1 when `timeout_s` passed before.
    """
    line_of = _json_line if as_json else partial(_line, EventLines(clock_words, topics))
    until_s = None if timeout_s is None else time.monotonic() + timeout_s
    received = printed = 0

    def say(words: str) -> None:
        words = words if as_json else f"{clock_words(time.time())}  {words}"
        print(printable(words), file=sys.stderr, flush=True)

    try:
        # The subscription refuses unknown topics.
        with Subscription(endpoint, cast(Sequence[Topic], topics), keys=keys) as subscription:
            while count is None or printed < count:
                item = subscription.next_item(until_s)
                if item is None or (until_s is not None and time.monotonic() > until_s + _LATER_S):
                    print(f"{received} messages in {timeout_s:g} s", file=sys.stderr)
                    return 0 if received and count is None else 1
                message = item.message if isinstance(item, Recovered) else item
                if not isinstance(message, Message):
                    say(_words(message))
                    continue
                try:
                    line = line_of(message, isinstance(item, Recovered))
                except ContractError as error:
                    say(f"malformed: {error}")
                    continue
                received += 1
                if line is not None:
                    print(line, flush=True)
                    printed += 1
    except KeyboardInterrupt:
        return 0
    except BrokenPipeError:
        # The reader has closed the pipe, as `| head` does; Python's flush at exit must not print an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def clock_words(unix_s: float) -> str:
    """Return the local time of day of an instant, to the millisecond."""
    return datetime.fromtimestamp(unix_s).astimezone().strftime("%H:%M:%S.%f")[:-3]


def _json_line(message: Message, is_recovered: bool) -> str:
    """JSON of a message with its topic and mark of recovery."""
    mark = {"recovered": True} if is_recovered else {}
    try:
        return json.dumps({"topic": message.topic, **mark, **message.data}, allow_nan=False)
    except (TypeError, ValueError, RecursionError):  # bytes, ext, NaN or depth, which tactiled never sends
        raise ContractError(f"{message.topic} contains a value that JSON cannot represent") from None


def _line(lines: EventLines, message: Message, is_recovered: bool) -> str | None:
    """Line for people; None where none is due."""
    data = checked_map(message.topic, message.data)
    return lines.line(message.topic, data, " (recovered)" if is_recovered else "")


def _words(item: Stale | Fresh | Lost | Restarted | Malformed) -> str:
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
