"""``python -m tactiled.client``: `tactiled listen` for hosts with tactiled-client alone."""

import argparse
import sys
from pathlib import Path

from tactiled.client.listen import listen
from tactiled.errors import TactiledError
from tactiled.events.endpoints import DEFAULT_ENDPOINT
from tactiled.events.types import EVENT_TYPES


def main() -> int:
    """Print what a daemon publishes, one line for each message; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tactiled.client",
        description="Print what a tactiled daemon publishes: words in a terminal, else JSON lines.",
        epilog="Example: python -m tactiled.client --topic slip",
    )
    parser.add_argument("endpoint", nargs="?", default=DEFAULT_ENDPOINT, help="default: %(default)s")
    parser.add_argument("-t", "--topic", action="append", default=[], choices=EVENT_TYPES, dest="topics")
    parser.add_argument("-n", "--count", type=int, help="stop after this many lines")
    parser.add_argument(
        "--timeout", type=float, dest="timeout_s", help="stop after so many seconds; 1 if nothing came"
    )
    parser.add_argument("--json", action="store_true", dest="as_json", help="print JSON in a terminal, too")
    parser.add_argument("--keys", type=Path, help="our file of `tactiled keys make`")
    asked = parser.parse_args()
    try:
        return listen(
            asked.endpoint,
            asked.topics,
            count=asked.count,
            timeout_s=asked.timeout_s,
            keys=asked.keys,
            as_json=asked.as_json or not sys.stdout.isatty(),
        )
    except TactiledError as error:
        print(error, file=sys.stderr)
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
