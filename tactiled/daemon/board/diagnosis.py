"""Diagnosis of the serial line: the likely cause when no frame arrives, or when some are damaged.

The decoder gives a reason for each rejection (`Corrupt.reason`). Each cause has its own mixture of reasons,
measured by sampling a board's bits at a wrong rate and by feeding other protocols and noise
(tests/helpers/uart.py):

=================  =======================================================================================
wrong baud         no structure: "stuffing", "overlong", "length"; where the UART counts, framing errors
text               bytes of a console or a bootloader: printable, whatever the reasons
another protocol   "type": intact frames, checksum and all, that the layout does not know; or no structure
                   while the UART sees no framing error
heavy noise        "checksum", or "value" in a protocol without one: the structure stands, the content is
                   damaged
noise              most frames are good, a few are not
overloaded board   frames are intact, sequence numbers are missing and the flag ``overrun`` says why
full buffer        frames are intact, sequence numbers are missing and no flag says why
=================  =======================================================================================
"""

import math
from collections import Counter, deque

from tactiled.pipeline import Health

SEARCH_ADVICE = "; stop tactiled, then run tactiled doctor: it looks for both"
"""End of a fault where baud rate or protocol may be wrong; the doctor, which reads the port, omits it."""

HICCUP_S = 1.0  # shortest silence or noise for which a cause is named
_WINDOW_S = 10.0  # length of the sliding window over which damaged bytes and missed scans are counted
_MARK_S = 1.0  # period at which counts are stored for that window
_TAIL_BYTES = 1024  # some ten frames of any layout; so many random bytes are never 90 % printable
_LEAST_TEXT = 32  # fewer printable bytes than this may be chance
_TEXT_PART = 0.9  # least share of printable bytes in text
_MAIN_PART = 0.5  # least share of the rejections that the main reason has
_NOISY_PART = 0.01  # share of damaged bytes: a good cable has none; 1 % is a frame a second
_LEAST_MISSED = 5  # least number of scans: fewer may be a single incident
_MISSING_PART = 0.01  # share of the scan instants: a healthy board on a healthy line misses none
_FRAMING_PART = 0.02  # a line at the right rate has none; at a wrong one every other byte lacks its stop bit


class LineWatch:
    """Watch bytes, frames and counters of a line, and name what is wrong with it.

    `protocol` and `baud` are named in messages.
    """

    def __init__(self, protocol: str, baud: int) -> None:
        self._protocol = protocol
        self._baud = baud
        self.reset(0.0)

    def reset(self, now_s: float, *, is_pty: bool = False) -> None:
        """Begin with a port that was just opened; behind a pty is a program, not a cable with a board."""
        self._is_pty = is_pty
        self._overrun_s = -math.inf
        self._first: Health | None = None
        self.byte_s = now_s
        """Time of the last byte, or of opening the port."""
        self._frame_s = now_s
        self._tail = b""
        self._newest: Health | None = None
        self._framing_errors: int | None = None
        # Counters at the newest frame
        self._at_frame: Health | None = None
        self._framing_errors_at_frame = 0
        self._marks: deque[tuple[float, Health]] = deque()
        self._cause = ("", "")
        self._look_s = now_s + HICCUP_S

    def received(self, data: bytes, now_s: float) -> None:
        """Take the bytes of one read."""
        self.byte_s = now_s
        self._tail = (self._tail + data)[-_TAIL_BYTES:]

    def framed(self, now_s: float) -> None:
        """Take note of a good frame."""
        self._frame_s = now_s

    def count(self, health: Health, framing_errors: int | None, now_s: float) -> None:
        """Take the counters as they are now; `framing_errors` is None where the UART's driver keeps none."""
        self._first = self._first or health
        newest = self._newest
        if self._first.bytes_framed == (newest or self._first).bytes_framed < health.bytes_framed:
            self._marks.clear()  # before the first frame came the rest of one that had begun: no damage
        if newest is not None and health.scans_overrun > newest.scans_overrun:
            self._overrun_s = now_s
        if newest is None or health.bytes_framed > newest.bytes_framed:
            self._at_frame, self._framing_errors_at_frame = health, framing_errors or 0
            if newest is not None:
                self._frame_s = now_s
            self._cause, self._look_s = ("", ""), now_s + HICCUP_S
        self._newest, self._framing_errors = health, framing_errors
        if now_s >= self._look_s:
            self._look_s = now_s + HICCUP_S
            kind, words = self._likely_cause(health)
            # The words are logged when they change, so numbers in them stay as they were.
            if kind != self._cause[0]:
                self._cause = kind, words
        if not self._marks or now_s >= self._marks[-1][0] + _MARK_S:
            self._marks.append((now_s, health))
            if self._marks[0][0] < now_s - _WINDOW_S:
                self._marks.popleft()

    def fault(self, now_s: float) -> str:
        """Return the likely cause when no frame has arrived for `HICCUP_S`, else an empty string."""
        if now_s - self.byte_s >= HICCUP_S:
            return self._silence()
        if now_s - self._frame_s >= HICCUP_S:
            return f"bytes arrive but no frame passes: {self._cause[1] or 'the cause is not known yet'}"
        return ""

    @property
    def is_overloaded(self) -> bool:
        """True when the board flagged missed scan instants within `_WINDOW_S` before its last byte."""
        return self._overrun_s >= self.byte_s - _WINDOW_S

    @property
    def overload(self) -> str:
        """Advice for a board that misses scan instants."""
        if self._is_pty:
            return (
                "it flags overruns, and it is a program on a pseudo-terminal (tactiled emulate?): its host "
                "is too slow or too busy"
            )
        return "it flags overruns, so its processor is too slow for its rate: lower session.rate_hz"

    def warning(self) -> str:
        """Return the faults of a line on which frames do arrive; empty for none."""
        if self._newest is None or not self._marks:
            return ""
        _, before = self._marks[0]
        came = self._newest.bytes_in - before.bytes_in
        lost = self._newest.bytes_discarded - before.bytes_discarded
        if came <= 0 or self._newest.bytes_framed == before.bytes_framed:
            return ""
        words = []
        if lost >= _NOISY_PART * came:
            words.append(
                f"{100 * lost / came:.0f} % of the bytes are damaged: noise on the line; look at cable, "
                "ground and connectors"
            )
        due = self._newest.scans + self._newest.scans_missing - before.scans - before.scans_missing
        overrun = self._newest.scans_overrun - before.scans_overrun
        dropped = self._newest.scans_dropped - before.scans_dropped
        least = max(_LEAST_MISSED, _MISSING_PART * due)
        if overrun >= least:
            words.append(
                f"the board missed {overrun} of its last {due} scan instants, and what came is intact: "
                f"{self.overload}"
            )
        if not lost and dropped >= least:
            words.append(
                f"{dropped} of the last {due} scans are missing although no byte is damaged: whole frames "
                "were left out, by a full buffer in the board, the adapter or this host"
            )
        return "; ".join(words)

    def _silence(self) -> str:
        """Likely cause of a silent line, from what was received before."""
        if self.is_overloaded:
            return f"no bytes arrive any more from a board that missed scan instants before: {self.overload}"
        if self._is_pty:
            return (
                "no bytes arrive: this port is a pseudo-terminal, so a program plays the board (tactiled "
                "emulate?): is it running, and is this host fast enough for it?"
            )
        framed = self._newest.bytes_framed if self._newest is not None else 0
        if self._first is not None and framed > self._first.bytes_framed:
            return "no bytes arrive any more, and frames did: is the board powered, is it plugged in?"
        return "no bytes arrive: is the board powered, is this its port, are its two lines swapped?"

    def _likely_cause(self, now: Health) -> tuple[str, str]:
        """Kind of the cause, and its description."""
        since = self._at_frame or now
        reasons = Counter(now.corrupt_by_reason)
        reasons.subtract(since.corrupt_by_reason)
        total = reasons.total()
        is_misframed = None
        if self._framing_errors is not None:
            n_errors = self._framing_errors - self._framing_errors_at_frame
            is_misframed = n_errors > _FRAMING_PART * (now.bytes_in - since.bytes_in)
        if _printable(self._tail) >= _TEXT_PART:
            shown = self._tail[-40:].decode("ascii", "replace").strip()
            return "text", f"this is text ({shown!r}): a console or a bootloader speaks, not the firmware"
        if is_misframed:
            return "baud", f"wrong baud rate ({self._baud} configured): the UART counts framing errors"
        if reasons["type"] >= _MAIN_PART * max(total, 1):
            return "type", (
                f"wrong protocol ({self._protocol} configured): intact frames of another one or version; "
                "name its layout in board.protocol, or update the firmware"
            )
        if reasons["checksum"] + reasons["value"] >= _MAIN_PART * max(total, 1):
            return "noise", (
                "every frame is damaged: heavy noise; look at cable, ground and connectors "
                f"(a baud rate slightly off {self._baud} does it too)"
            )
        if is_misframed is not None:
            return "protocol", f"wrong protocol ({self._protocol} configured); {self._baud} baud is right"
        return "structure", (
            f"no frame structure in it: wrong baud rate ({self._baud} configured) most likely, "
            f"else wrong protocol ({self._protocol} configured){SEARCH_ADVICE}"
        )


def _printable(data: bytes) -> float:
    """Share of printable ASCII bytes; 0 for fewer than `_LEAST_TEXT` bytes."""
    if len(data) < _LEAST_TEXT:
        return 0.0
    return sum(32 <= byte < 127 or byte in b"\t\r\n" for byte in data) / len(data)
