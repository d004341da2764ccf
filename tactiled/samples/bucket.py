"""Arrivals of one bucket of board time, summarised in bounded memory at any scan rate.

The earliest arrival and the tightest answer to a ping are always kept. Of the other arrivals, only the first
in each of `SLOTS` equal parts of the bucket is kept: all of them up to 257 Hz, a sample above that rate.

Here a hand-over is a read of the port that returned bytes, the wait of an arrival is the time from the
hand-over before, and bunching is the delay of frames until the adapter's timer expires.
"""

import math
from statistics import fmean, median
from typing import NamedTuple

from tactiled.samples.envelope import Band

# More than the scans per second that 115200 baud carry. Prime, so that no timer of whole milliseconds is
# synchronous with the slots; otherwise the sample would contain only one phase of the timer.
SLOTS = 257
# Without bunching, the expected delay of the earliest arrival over the mean delay after it: 1/4 for 5
# exponential delays, less for more; taken larger for safety.
EARLIEST_PER_MEAN = 0.3
# Delays of bunched frames are uniform over the wait between two reads, with a median of half the wait.
UNBUNCHED_PART = 0.25
WHOLE_PART = 0.9  # least part of the reads that end with a frame where nothing is bunched
STALLED_WAITS = 3.0  # in usual waits: a longer wait is a stall
HANDOVER_JITTER_S = 1e-4  # jitter of USB polling and of the scheduler, added to the adapter's timer
LEAST_ARRIVALS = 16  # needed to decide whether frames are bunched
UNKNOWN_WAIT_S = 0.016  # default timer of FTDI: the largest delay while no wait is known
SLACK_S = 1e-6  # one tick and rounding, so that bounds that touch do not contradict each other


class FrameArrival(NamedTuple):
    """Arrival of one frame; times are in seconds since the origin of `ClockFit`."""

    board_s: float  # board time of the scan
    delay_s: float  # host time of the arrival minus board_s
    waited_s: float  # time since the hand-over before; infinity where unknown
    is_whole: bool  # the read of that hand-over ended with a frame


class Bucket:
    """Bounds of the delay of an ideal arrival, from the arrivals of one bucket.

    Parameters
    ----------
    number : int
        The bucket starts at `number * width_s` of board time.
    """

    def __init__(self, width_s: float, number: int = 0) -> None:
        self._width_s = width_s
        self.number = number
        self._kept: list[FrameArrival] = []
        self._slot = -1
        self._n = 0
        self._n_at_band = 0
        self.newest_s = 0.0
        """Host time of the newest arrival, seconds since the origin."""
        self._earliest_s = math.inf  # least delay
        self._earliest_at_s = 0.0  # board time of it
        self._answer: tuple[float, float] | None = None  # largest lower bound from a ping, board_s
        self._band: Band | None = None
        self.doubt_s = 0.0
        """Possible distance of the line from the band of `running_band` (s): trend, and unknown bunching."""

    def __len__(self) -> int:
        """Number of arrivals added."""
        return self._n

    def is_answered(self, wait_before_s: float) -> bool:
        """Return True where an answer to a ping bounds the delay as closely as the wait between two reads."""
        if self._answer is None:
            return False
        return self._earliest_s - self._answer[0] <= self.usual_wait_s(min(wait_before_s, UNKNOWN_WAIT_S))

    @property
    def has_answer(self) -> bool:
        """True where a ping was answered in this bucket."""
        return self._answer is not None

    def add(
        self, board_s: float, delay_s: float, waited_s: float, is_whole: bool, latest_delay_s: float
    ) -> None:
        """Add an arrival, as in `FrameArrival`; `latest_delay_s` is an upper bound of its delay."""
        self._n += 1
        self.newest_s = board_s + delay_s
        if latest_delay_s < self._earliest_s:
            self._earliest_s, self._earliest_at_s = latest_delay_s, board_s
        slot = int((board_s / self._width_s - self.number) * SLOTS)
        if slot != self._slot or not self._kept:
            self._slot = slot
            if len(self._kept) < SLOTS:  # also where board time goes back and forth
                self._kept.append(FrameArrival(board_s, delay_s, waited_s, is_whole))

    def answer(self, board_s: float, low_s: float, high_s: float) -> None:
        """Add the bounds of the delay at `board_s` that an answered ping gives."""
        if self._answer is None or low_s > self._answer[0]:
            self._answer = (low_s, board_s)
        if high_s < self._earliest_s:
            self._earliest_s, self._earliest_at_s = high_s, board_s
        self._band = None

    def usual_wait_s(self, before_s: float) -> float:
        """Time between two hand-overs without a stall: a quartile, since a stall may fill most of a bucket.

        Parameters
        ----------
        before_s : float
            Usual wait of the bucket before; the result is at most twice as long.
        """
        waits = sorted(arrival.waited_s for arrival in self._kept)
        return min(waits[len(waits) // 4], 2 * before_s)

    def running_band(self, handover_s: float | None, wait_before_s: float, is_pinged: bool) -> Band:
        """Band so far, recomputed when arrivals have grown by an eighth, or at an earlier arrival.

        The number of recomputations in a bucket then grows with the logarithm of the scan rate.
        """
        due = self._n >= self._n_at_band + max(1, self._n_at_band // 8)
        if self._band is None or due:
            self._band = self.band(handover_s, wait_before_s, is_pinged)
            self._n_at_band = self._n
            self.doubt_s = self._trend_s()
            if handover_s is None and len(self._kept) < LEAST_ARRIVALS:
                self.doubt_s += min(self.usual_wait_s(wait_before_s), UNKNOWN_WAIT_S)
        elif self._earliest_s < self._band.high:
            high, high_x = self._earliest_s, self._earliest_at_s
            self._band = self._band._replace(low=min(self._band.low, high), high_x=high_x, high=high)
        return self._band

    def band(self, handover_s: float | None, wait_before_s: float, is_pinged: bool) -> Band:
        """Compute the bounds of the delay of an ideal arrival.

        Parameters
        ----------
        handover_s : float or None
            Timer of the adapter; None: estimate it from the reads; 0: there is none.
        wait_before_s : float
            Usual wait in the bucket before.
        is_pinged : bool
            The board answers pings fast: they alone bound the delay from below. A read that a busy host does
            late makes its hand-over look later than it was, and the bound too high.
        """
        least_s, board_s = self._earliest_s, self._earliest_at_s
        if handover_s == 0:
            return self._unbunched_band()
        lows = [] if is_pinged else self._handovers(handover_s, wait_before_s)
        tightest = max(lows) if lows else (-math.inf, board_s)
        answer = self._answer
        if answer is not None and tightest < answer:
            return Band(answer[1], answer[0] - SLACK_S, board_s, least_s, is_answered=True)
        if not is_pinged and (not lows or (handover_s is None and self._is_unbunched())):
            return self._unbunched_band()
        return Band(tightest[1], tightest[0] - SLACK_S, board_s, least_s, is_answered=tightest == answer)

    def _unbunched_band(self) -> Band:
        """Band close below the earliest arrival, by the mean delay."""
        least_s, board_s = self._earliest_s, self._earliest_at_s
        mean_late_s = fmean(arrival.delay_s for arrival in self._kept) - least_s
        return Band(board_s, least_s - EARLIEST_PER_MEAN * mean_late_s - SLACK_S, board_s, least_s)

    def _handovers(self, handover_s: float | None, wait_before_s: float) -> list[tuple[float, float]]:
        """Lower bounds of the delay, with board times: a frame was incomplete at the hand-over before."""
        least_s = self._earliest_s
        longest_s = STALLED_WAITS * self.usual_wait_s(wait_before_s)
        lows = []
        for arrival in self._kept:
            if arrival.waited_s > longest_s:
                continue  # a stall
            waited_s = (arrival.waited_s if handover_s is None else handover_s) + HANDOVER_JITTER_S
            # A frame with a longer delay was queued behind other frames.
            if arrival.delay_s - least_s <= waited_s < math.inf:
                lows.append((arrival.delay_s - waited_s, arrival.board_s))
        return lows

    def _is_unbunched(self) -> bool:
        """Return True where reads end with frames and most delays are close to the smallest."""
        if sum(arrival.is_whole for arrival in self._kept) < WHOLE_PART * len(self._kept):
            return False
        late = median(arrival.delay_s for arrival in self._kept) - self._earliest_s
        return late <= UNBUNCHED_PART * median(arrival.waited_s for arrival in self._kept)

    def _trend_s(self) -> float:
        """Estimate the change of the smallest delay over the arrivals so far (s), at a constant rate.

        The smallest delays of the first and of the last quarter differ by three quarters of that.
        """
        part = max(LEAST_ARRIVALS // 2, len(self._kept) // 4)
        first = min(arrival.delay_s for arrival in self._kept[:part])
        last = min(arrival.delay_s for arrival in self._kept[max(len(self._kept) - part, 0) :])
        return abs(last - first) / 0.75
