"""Unwrapping of sequence numbers and ticks, and detection of boards that restarted."""

from math import floor
from typing import Literal, NamedTuple


class CounterStep(NamedTuple):
    """Relation of a scan to the one before it."""

    # "duplicate": this scan or a newer one was counted already; "restart": the counters cannot belong to the
    # same run of the board
    kind: Literal["next", "duplicate", "restart"]
    n_scans: int  # number of scans since the one before, 1 when none is missing; 0 unless `kind` is "next"


_FOLLOWS = CounterStep("next", 1)  # nearly every scan: made once


class ScanCounter:
    """Follow the sequence number and the ticks of a board from scan to scan.

    Parameters
    ----------
    sequence_bits : int
        Width of the sequence number on the wire.
    tick_bits : int or None
        Width of the ticks; None where scans carry none.
    tick_s : float or None
        Seconds of one tick.
    """

    # An overrun shifts ticks against sequence numbers by a scan or two; a change of rate shifts them by a few
    # more before the new hello arrives. A larger difference means another run of the board.
    SLACK_SCANS = 5
    # After long silences: crystals, and a rate rounded to millihertz, are accurate to 1 %.
    SLACK_PART = 0.01
    # Longest time that bytes may wait in a queue (the kernel's 64 KiB for a tty are 7 s of a board at 115200
    # baud); for a longer difference the board was off meanwhile.
    SLACK_S = 10.0
    # A line repeats or reorders scans within this number; an older scan means a restart.
    STRAGGLERS = 16

    def __init__(self, sequence_bits: int, tick_bits: int | None, tick_s: float | None) -> None:
        self._modulus = 1 << sequence_bits
        self._tick_modulus = 1 << tick_bits if tick_bits else 0
        self.tick_s = tick_s or 0.0
        """Seconds of one tick; 0 where scans carry no ticks."""
        self.reset()

    def reset(self) -> None:
        """Forget the last scan; the next one begins a new run."""
        self._sequence: int | None = None
        self._sequence_known = False
        self._ticks: int | None = None
        self._arrival_s = 0.0
        self.age_s = 0.0
        """Age of the last scan when it was handled: what follows may be so much newer."""
        self.board_s = 0.0
        """Board time of the last scan in seconds, unwrapped, zero at the first scan of the run."""

    def forget_sequence(self) -> None:
        """Take note of a stop and start: the ticks of the board ran on, its sequence number did not."""
        self._sequence_known = False

    def runs_on(self, ticks: int, now_s: float, *, host_may_sleep: bool = False) -> bool:
        """Return True when ticks read at `now_s` can belong to the run of the last scan.

        Behind the backlog of a stall, ticks may be ahead of the host by the age of the last scan; after a
        suspend of the host (`host_may_sleep`), whose clock stood still, by any time.
        """
        if self._ticks is None:
            return True
        host_s = now_s - self._arrival_s
        ahead_s = self._elapsed(ticks, host_s + self.age_s) - host_s
        slack_s = self.SLACK_S + self.SLACK_PART * (host_s + self.age_s)
        return -slack_s <= ahead_s and (host_may_sleep or ahead_s <= self.age_s + slack_s)

    def board_s_at(self, ticks: int, now_s: float) -> float | None:
        """Return the board time of ticks that were read between scans; None where they fit no known run."""
        if self._ticks is None or not self.runs_on(ticks, now_s):
            return None
        return self.board_s + self._elapsed(ticks, now_s - self._arrival_s + self.age_s)

    def _elapsed(self, ticks: int, host_s: float) -> float:
        """Board seconds since the last scan: the value of the wrapped ticks that is nearest to host time."""
        turned = _nearest(ticks - (self._ticks or 0), host_s / self.tick_s, self._tick_modulus)
        return turned * self.tick_s

    def step(self, sequence: int, ticks: int | None, arrival_s: float, rate_hz: float) -> CounterStep:
        """Take the next scan, and return how it follows; duplicates and restarts do not change the state."""
        if self._sequence is None:
            self._keep(sequence, ticks, arrival_s, 0.0)
            return _FOLLOWS
        advance = (sequence - self._sequence) % self._modulus
        host_s = elapsed_s = arrival_s - self._arrival_s
        burst_s = 0.5  # by the host's clock alone: bytes may come in bursts
        if ticks is not None and self._ticks is not None:
            elapsed_s, burst_s = self._elapsed(ticks, host_s), 0.0
        slack = self.SLACK_SCANS + self.SLACK_PART * abs(elapsed_s * rate_hz) + burst_s * rate_hz
        if not self._sequence_known:
            if ticks is not None and not self.runs_on(ticks, arrival_s):
                return CounterStep("restart", 0)
            self._keep(sequence, ticks, arrival_s, max(elapsed_s, 0.0))
            return _FOLLOWS
        expected = elapsed_s * rate_hz
        n_scans = _nearest(advance, expected, self._modulus)
        if abs(n_scans - expected) > slack:
            if n_scans > expected:
                n_scans -= self._modulus
            # Without ticks, a scan that waited in the host comes later than its number says.
            if ticks is not None or n_scans <= 0 or host_s > self.SLACK_S:
                return CounterStep("restart", 0)
        if n_scans <= -self.STRAGGLERS:
            return CounterStep("restart", 0)  # a board counts from zero after booting; this is no late scan
        if n_scans <= 0:
            return CounterStep("duplicate", 0)
        if n_scans > self.STRAGGLERS and host_s - elapsed_s > self.SLACK_S + self.SLACK_PART * host_s:
            return CounterStep("restart", 0)  # silent for longer than its ticks say: it was switched off
        self._keep(sequence, ticks, arrival_s, elapsed_s if ticks is not None else n_scans / rate_hz)
        return _FOLLOWS if n_scans == 1 else CounterStep("next", n_scans)

    def follow(self, arrival_s: float, rate_hz: float) -> CounterStep:
        """Take the next scan of a board that does not count its scans: it is taken to follow the one before.

        A scan that was lost makes later ones seem older than they are, never fresher.
        """
        self._keep(0, None, arrival_s, 0.0 if self._sequence is None else 1 / rate_hz)
        return _FOLLOWS

    def _keep(self, sequence: int, ticks: int | None, arrival_s: float, elapsed_s: float) -> None:
        self._sequence, self._ticks, self._arrival_s = sequence, ticks, arrival_s
        self._sequence_known = True
        self.board_s += elapsed_s


def _nearest(residue: int, value: float, modulus: int) -> int:
    """Nearest integer to `value` that is congruent to `residue`."""
    return residue + modulus * int(floor((value - residue) / modulus + 0.5))  # noqa: RUF046  # a float in C
