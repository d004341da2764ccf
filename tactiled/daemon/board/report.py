"""Status and info events: at once when the state changes, and periodically."""

import logging
import time
from collections.abc import Callable
from dataclasses import replace

from tactiled.array import Array
from tactiled.daemon.board.link import BoardLink
from tactiled.daemon.board.session import Session
from tactiled.daemon.operations.distributor import Distributor
from tactiled.daemon.serial.connection import Connection
from tactiled.events.types import InfoEvent
from tactiled.limited_log import RateLimitedLog
from tactiled.version import __version__
from tactiled.wire.frames import Hello
from tactiled.wire.layout import Layout

logger = logging.getLogger(__name__)

INFO_PERIOD_S = 1.0


class Report:
    """Publish status and info events, and log changes of state.

    Parameters
    ----------
    tell_state : callable
        Takes the words for a new state or reason.
    """

    def __init__(
        self,
        session: Session,
        link: BoardLink,
        connection: Connection,
        layout: Layout,
        array: Array,
        distributor: Distributor,
        tell_state: Callable[[str], None],
    ) -> None:
        self._session = session
        self._link = link
        self._connection = connection
        self._layout = layout
        self._array = array
        self._distributor = distributor
        self._tell_state = tell_state
        self.is_fresh = False
        """True where the newest status says that data are fresh."""
        self._logged = (session.state, session.reason(0.0))
        self._warned: dict[str, str] = {}
        self._log = RateLimitedLog(logger)
        self._started_s = time.monotonic()
        self._next_info_s = self._started_s
        self._described = session.hello

    def changed(self, now_s: float, *, leaving: bool) -> None:
        """Report a change of state or reason to the log and `tell_state`, and a new state to subscribers.

        With `leaving` the daemon is ending, and no state is logged as a warning.
        """
        state, reason = state_and_reason = (self._session.state, self._session.reason(now_s))
        if state_and_reason == self._logged:
            return
        new_state = state != self._logged[0]
        self._logged = state_and_reason
        text = f"{self._board} {state}: {reason or f'{self._session.rate_hz:g} Hz'}"
        expected = state in ("running", "syncing") or leaving
        self._log.add(text, now_s, logging.INFO if expected else logging.WARNING)
        if new_state:
            self._publish_status(now_s)  # a controller learns of a stall at once, not up to 0.1 s later
        self._tell_state(text)

    def regular(self, now_s: float) -> None:
        """Publish a status, and an info event each second and at once for a new board."""
        self._publish_status(now_s)
        self._log.write_counts(now_s)
        self._connection.log.write_counts(now_s)
        hello = self._session.hello
        if hello is not None and (now_s >= self._next_info_s or hello is not self._described):
            self._described = hello
            self._next_info_s = now_s + INFO_PERIOD_S
            self._distributor.publish_and_record(info_event(hello, self._layout, self._array, now_s))
        self._distributor.poll_recorder(now_s)

    def _publish_status(self, now_s: float) -> None:
        event = self._link.status(
            now_s,
            started_s=self._started_s,
            connects=self._connection.connects,
            warning=self._connection.warning,
        )
        warnings = self._link.warnings
        for cause in warnings.keys() - self._warned.keys():  # each cause once, whatever its numbers do
            self._log.add(f"{self._board}: {warnings[cause]}", now_s, kind=cause)
        self._warned = warnings
        self.is_fresh = event.valid
        self._distributor.publish_and_record(replace(event, sent=self._distributor.sent))

    @property
    def _board(self) -> str:
        return f"board {self._session.board_serial}".rstrip()


def info_event(hello: Hello, layout: Layout, array: Array, now_s: float) -> InfoEvent:
    """Make the info event from the hello of the board and the configured layout and array."""
    return InfoEvent(
        time_s=now_s,
        board_serial=hello.board_serial,
        firmware_version=hello.firmware_version,
        protocol=layout.name,
        protocol_version=hello.protocol_version,
        array_id=hello.array_id,
        channels=layout.n_channels,
        taxels=array.n_taxels,
        x_mm=tuple(array.x_mm.tolist()),
        y_mm=tuple(array.y_mm.tolist()),
        channel_names=array.channel_name,
        rate_hz=hello.rate_hz,
        volts_per_count=hello.volts_per_count,
        channel_offset_s=hello.channel_offset_s or (0.0,) * layout.n_channels,
        tactiled_version=__version__,
    )
