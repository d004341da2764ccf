"""List of the boards of a zenoh network from one request to all hosts: rows, table, metrics page."""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tactiled.errors import UnavailableError
from tactiled.events.codec import topic_of
from tactiled.events.words import printable
from tactiled.zenoh.session import states

_TIMEOUT_S = 2.0  # for the slowest host; 300 ms after a cut were measured once
_ANSWER_S = 1.0  # beyond a status of this age, the daemon itself is silent
_UNKNOWN = "-"
# Lines of the table: what a person reads at once. With more rows than the second, words are cut at the end of
# the line instead of wrapped.
_MOST_ROWS = 100
_MOST_WRAPPED = 20
_MOST_CHARACTERS = 200  # of one text of a host
_COLUMNS = ("host", "board", "state", "age (ms)", "utilisation", "loss (ppm)", "firmware", "disk (GB)")
_NUMBERS = ("age (ms)", "utilisation", "loss (ppm)", "disk (GB)")
# On a terminal of fewer characters, a line has only these columns, and the words that say why.
_ALL_COLUMNS_WIDTH = 110
_FEW_COLUMNS = ("host", "board", "state", "age (ms)")
_PIPE_WIDTH = 200  # of lines that another program reads
_MOST_STATES = 8  # states that a daemon of ours sends
_METRICS_HOST = "127.0.0.1"  # as the pages of daemons
_UNNAMED = "-"  # stands in topics for a board that has not said its name yet


@dataclass(frozen=True)
class FleetMetric:
    """Meaning of one metric of the list, a gauge."""

    meaning: str
    labels: tuple[str, ...] = ()  # besides ``host`` and ``board``


FLEET_METRICS: Mapping[str, FleetMetric] = {
    "state": FleetMetric("1 for the present state: that in its status, silent, gone or missing.", ("state",)),
    "firmware": FleetMetric("1; the label has the version of the firmware.", ("version",)),
    "valid": FleetMetric("1 while the tactile data are fresh, else 0."),
    "scan_age_seconds": FleetMetric("Age of the newest scan when the host was asked."),
    "utilisation": FleetMetric("Part of the friction limit that is in use, during contact."),
    "missing_ratio": FleetMetric("Part of the scans since the daemon's start that are missing."),
    "disk_free_bytes": FleetMetric("Free space of the disk that holds the recording."),
}
"""Metrics of ``--serve``; the names on the page begin with ``tactiled_``."""


@dataclass(frozen=True)
class FleetRow:
    """One board of the list."""

    host: str
    board: str
    # As in its status; ``silent``: the host has a bridge but its daemon does not answer; ``gone``: it was on
    # the network before; ``missing``: it is expected and was never there
    state: str
    valid: bool = False  # fresh scans arrive
    age_s: float = -1.0  # age of the newest scan when it was asked for, seconds; -1 where unknown
    # Part of the friction limit that is in use; -1 without contact or without `grip` messages
    utilisation: float = -1.0
    loss_ppm: float = -1.0  # scans missing per million; -1 where they are not counted
    firmware: str = ""
    recording: str = ""
    free_mb: float = -1.0  # free disk space for recordings; -1 where none is made
    reason: str = ""  # why it is not valid, or the warning


class FleetList:
    """Boards of a network (``zenoh://ROUTER:7447/*``), those that have gone included.

    Hosts, or HOST/BOARD, that are `expected` get a row even where they were never on the network.
    """

    def __init__(self, endpoint: str, keys: Path | None = None, expected: Sequence[str] = ()) -> None:
        self._expected = tuple(name.partition("/")[::2] for name in expected)
        self._endpoint = endpoint
        self._keys = keys
        self._known: dict[tuple[str, str], FleetRow] = {}

    def ask(self) -> list[FleetRow]:
        """Ask all hosts, and return the boards by host and name.

        `ConfigError` or `UnavailableError` where the endpoint is invalid, or its router does not answer.
        """
        return self.update(states(self._endpoint, self._keys, _TIMEOUT_S))

    def update(self, replies: Mapping[str, tuple[Mapping[str, Any] | None, float]]) -> list[FleetRow]:
        """Take replies and times of `states`; return all boards that are, were or should be there."""
        now = {
            (row.host, row.board): row
            for host, (reply, unix_s) in replies.items()
            for row in rows_of(host, reply, unix_s)
        }
        answered = {host for host, _ in now}
        for key, row in self._known.items():
            if key not in now and (key[1] or key[0] not in answered):
                words = "no longer on the network"
                now[key] = FleetRow(row.host, row.board, "gone", firmware=row.firmware, reason=words)
        self._known = {key: row for key, row in now.items() if key[1] or key[0] in replies}
        for host, board in self._expected:
            if not any(key[0] == host and board in ("", key[1]) for key in now):
                now[host, board] = FleetRow(host, board, "missing", reason="expected, and not on the network")
        return [now[key] for key in sorted(now)]


def rows_of(host: str, reply: Mapping[str, Any] | None, unix_s: float) -> list[FleetRow]:
    """Return the boards of one host from its reply to ``state``; never raises, whatever it contains."""
    if not (isinstance(reply, Mapping) and isinstance(messages := reply.get("messages"), Mapping)):
        return [FleetRow(host, "", "silent", reason="its bridge is there, its daemon does not answer")]
    boards: dict[str, dict[str, Mapping[str, Any]]] = {}
    for path, message in messages.items():
        parts = str(path).split("/")
        if len(parts) == 3 and isinstance(message, Mapping):
            boards.setdefault(parts[1], {})[parts[2]] = message
    if isinstance(present := reply.get("boards"), list):  # an exchanged board leaves its messages behind
        names = {topic_of(serial, "").split("/")[1] for serial in present if isinstance(serial, str)}
        boards = {board: newest for board, newest in boards.items() if board in names}
    rows = []
    if len(boards) > 1:  # the newest status from before a board said its name is no board of its own
        boards.pop(_UNNAMED, None)
    for board, newest in boards.items():
        try:
            rows.append(_row(host, board, newest, unix_s))
        except (TypeError, ValueError, KeyError, AttributeError, OverflowError, RecursionError) as error:
            rows.append(
                FleetRow(host, board, "silent", reason=f"its messages cannot be read ({error!r:.60})")
            )
    return rows


def _row(host: str, board: str, newest: Mapping[str, Mapping[str, Any]], unix_s: float) -> FleetRow:
    status, info = newest["status"], newest.get("info", {})
    recording, grip = newest.get("recording", {}), newest.get("grip", {})
    silent_s = unix_s - float(status["timestamp"])
    in_contact = grip.get("state", "none") != "none" and abs(unix_s - grip.get("timestamp", 0.0)) < _ANSWER_S
    total = status["scans"] + status["scans_missing"]
    is_silent = abs(silent_s) > _ANSWER_S  # from the future: a clock was set
    reason = _cut(status["reason"] or status["warning"])
    if is_silent and not reason:
        reason = f"its status is {silent_s:.1f} s old: no statuses arrive, or the clocks of the hosts differ"
    return FleetRow(
        host=host,
        board=board,
        state="silent" if is_silent else _cut(status["state"]),
        valid=status["valid"] is True and not is_silent,
        age_s=max(0.0, silent_s + status["age_s"]) if status["age_s"] < 1e8 else -1.0,
        utilisation=float(grip["utilisation"]) if in_contact else -1.0,
        loss_ppm=1e6 * status["scans_missing"] / total if status["loss_known"] and total else -1.0,
        firmware=_cut(info.get("firmware_version", "")),
        recording=_cut(recording.get("state", "")),
        free_mb=float(recording["free_mb"]) if recording.get("state", "off") != "off" else -1.0,
        reason=reason,
    )


def draw_table(rows: list[FleetRow], *, clear: bool) -> None:
    """Print the list on stdout; of a long one, the first rows and the number of others by state.

    What is not fresh comes first then. A narrow terminal shows fewer columns.
    """
    shown = rows if len(rows) <= _MOST_ROWS else sorted(rows, key=lambda row: row.valid)[:_MOST_ROWS]
    is_long = len(shown) > _MOST_WRAPPED
    console = Console(width=None if sys.stdout.isatty() else _PIPE_WIDTH)
    columns = _COLUMNS if console.width >= _ALL_COLUMNS_WIDTH else _FEW_COLUMNS
    table = Table(box=None, pad_edge=False)
    for name in columns:
        table.add_column(name, no_wrap=True, justify="right" if name in _NUMBERS else "left")
    table.add_column("words")
    for row in shown:
        style = "" if row.valid else "dim" if row.state == "gone" else "bold"
        # As `Text`, in which rich looks for no markup: a board could carry some.
        *cells, last = (Text(printable(cell)) for cell in _cells(row))
        # Of a column that does not wrap, rich would cut the others, too.
        last.overflow, last.no_wrap = "ellipsis" if is_long else "fold", is_long
        table.add_row(*cells[: len(columns)], last, style=style)
    if clear:
        console.clear()
    console.print(table)
    if len(shown) < len(rows):
        others = Counter(row.state for row in rows) - Counter(row.state for row in shown)
        words = ", ".join(f"{count} {printable(state)}" for state, count in others.most_common(_MOST_STATES))
        console.print(f"and {len(rows) - len(shown)} more: {words}", markup=False)
    fresh = sum(row.valid for row in rows)
    console.print(f"{fresh} of {len(rows)} boards fresh")


def _cut(value: object) -> str:
    """Return a text of a host, at a length that no text of ours has."""
    return str(value)[:_MOST_CHARACTERS]


def _cells(row: FleetRow) -> list[str]:
    return [
        row.host,
        row.board,
        row.state,
        _UNKNOWN if row.age_s < 0 else f"{1e3 * row.age_s:.0f}",
        _UNKNOWN if row.utilisation < 0 else f"{row.utilisation:.2f}",
        _UNKNOWN if row.loss_ppm < 0 else f"{row.loss_ppm:.1f}",
        row.firmware or _UNKNOWN,
        _UNKNOWN
        if row.free_mb < 0
        else f"{row.free_mb / 1e3:.1f}" + ("" if row.recording == "recording" else " !"),
        row.reason,
    ]


class FleetMetrics(Collector):
    """Metrics of the newest list, for Prometheus on the host of the list.

    Metrics pages of daemons listen on loopback. What they say of freshness comes here over zenoh, with its
    certificates. Metrics that the daemons' pages have, too, have the same names.
    """

    def __init__(self) -> None:
        self.rows: Sequence[FleetRow] = ()

    def lose(self) -> None:
        """Tell that the network cannot be asked: no board is known to be fresh."""
        self.rows = [FleetRow(row.host, row.board, "silent") for row in self.rows]

    @contextmanager
    def serving(self, port: int) -> Iterator[int]:
        """Serve ``http://127.0.0.1:PORT/metrics`` in a thread until the end of the block; yield the port.

        `UnavailableError` where the port is in use.
        """
        registry = CollectorRegistry()
        registry.register(self)
        try:
            server, thread = start_http_server(port, _METRICS_HOST, registry)
        except OSError as error:
            raise UnavailableError(
                f"--serve: {_METRICS_HOST}:{port} cannot be had: {error.strerror}"
            ) from None
        try:
            yield int(server.server_address[1])
        finally:
            server.shutdown()
            server.server_close()
            thread.join()

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield the metrics; a number that is not known is left out."""
        families = {
            name: GaugeMetricFamily(
                f"tactiled_{name}", metric.meaning, labels=("host", "board", *metric.labels)
            )
            for name, metric in FLEET_METRICS.items()
        }
        for row in self.rows:
            board = (row.host, row.board)
            families["state"].add_metric((*board, row.state), 1.0)
            families["valid"].add_metric(board, float(row.valid))
            if row.firmware:
                families["firmware"].add_metric((*board, row.firmware), 1.0)
            for name, value, scale in (
                ("scan_age_seconds", row.age_s, 1.0),
                ("utilisation", row.utilisation, 1.0),
                ("missing_ratio", row.loss_ppm, 1e-6),
                ("disk_free_bytes", row.free_mb, 1e6),
            ):
                if value >= 0:
                    families[name].add_metric(board, scale * value)
        yield from families.values()
