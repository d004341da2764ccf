"""What is kept of the arrivals of one bucket: a bounded number, however many scans it holds.

The earliest arrival and the tightest answers to pings are kept as they come. The rest serves as a sample:
the first arrival of each of `SLOTS` equal parts of the bucket is kept, so that a board of up to 257 Hz loses
nothing, and one at 20 kHz costs no more.
"""

import math
from statistics import fmean, median
from typing import NamedTuple

from tactiled.samples.envelope import Band

# More than the scans per second that 115200 baud carry. Prime, so that no timer of whole milliseconds is in
# step with the slots, where the sample would show it at one phase only.
SLOTS = 257
# Where nothing bunches frames, the earliest of a second is late by some part of how late they are on
# average: a sixth for 5 exponential delays, less for more; with room.
EARLIEST_PER_MEAN = 0.3
# Bunched frames are spread over the whole wait between two reads: their median is half of it late.
UNBUNCHED_PART = 0.25
WHOLE_PART = 0.9  # of the reads must end with a frame where nothing bunches them
STALLED_WAITS = 3.0  # a read after so many typical waits ended a stall
HANDOVER_JITTER_S = 1e-4  # of USB polling and of the host's scheduler, on top of an adapter's timer
UNBUNCHED_LEAST = 16  # arrivals from which it can be told whether anything bunches them
UNKNOWN_WAIT_S = 0.016  # FTDI's timer as delivered: before there were two reads, a frame may be so late
SLACK_S = 1e-6  # one tick, and rounding: bounds that touch must not look like a contradiction


class Arrival(NamedTuple):
    """One frame that arrived."""

    x: float  # board time since the origin
    delay: float  # arrival less board time, both since the origin
    waited: float  # seconds since the hand-over before; infinity where that bounds nothing
    whole: bool  # that read ended with a frame


class Bucket:
    """Bounds that the arrivals of one bucket put on the line.

    Parameters
    ----------
    width_s : float
        Board time that a bucket spans.
    """

    def __init__(self, width_s: float) -> None:
        self._width_s = width_s
        self.begin(0)

    def begin(self, number: int) -> None:
        """Forget all arrivals; bucket `number` starts at `number * width_s`."""
        self.number = number
        self._kept: list[Arrival] = []
        self._slot = -1
        self._n = 0
        self._n_at_band = 0
        self._newest = 0.0
        self._earliest = (math.inf, 0.0)  # delay, x
        self._answer: tuple[float, float] | None = None  # delay of the latest sending, x
        self._band: Band | None = None
        self.doubt_s = 0.0
        """As of `running_band`: how far the line may be from the band, for all that is known so far."""

    def __len__(self) -> int:
        """Arrivals that were taken."""
        return self._n

    @property
    def n_kept(self) -> int:
        """Number of arrivals kept, at most `SLOTS`."""
        return len(self._kept)

    def is_answered(self, timer_s: float | None, usual_before: float) -> bool:
        """Whether an answer to a ping says more than the reads do."""
        return self._answer is not None and self._answer > max(
            self._handovers(timer_s, usual_before), default=(-math.inf, 0.0)
        )

    @property
    def newest(self) -> float:
        """When the newest arrived, since the origin."""
        return self._newest

    def add(self, arrival: Arrival, whole_by: float) -> None:
        """Take one arrival; `whole_by` is the delay that it had at most, which may be less than it shows."""
        self._n += 1
        self._newest = arrival.x + arrival.delay
        if whole_by < self._earliest[0]:
            self._earliest = (whole_by, arrival.x)
        slot = int((arrival.x / self._width_s - self.number) * SLOTS)
        if slot != self._slot or not self._kept:
            self._slot = slot
            if len(self._kept) < SLOTS:  # board time that goes back and forth fills no memory
                self._kept.append(arrival)

    def answer(self, x: float, low: float, high: float) -> None:
        """Take the bounds that an answered ping puts on the line at `x`."""
        if self._answer is None or low > self._answer[0]:
            self._answer = (low, x)
        if high < self._earliest[0]:
            self._earliest = (high, x)
        self._band = None

    def usual_wait(self, before: float) -> float:
        """Time between two hand-overs when nothing stalls; a stall may fill most of a bucket.

        Parameters
        ----------
        before : float
            That of the bucket before.
        """
        waits = sorted(arrival.waited for arrival in self._kept)
        return min(waits[len(waits) // 4], 2 * before)

    def running_band(self, timer_s: float | None, usual_before: float, is_pinged: bool) -> Band:
        """The band so far, brought up to date when the arrivals have grown by an eighth or an earlier came.

        The cost over a bucket is then that of a number of bands that grows with the logarithm of the rate.
        """
        due = self._n >= self._n_at_band + max(1, self._n_at_band // 8)
        if self._band is None or due:
            self._band = self.band(timer_s, usual_before, is_pinged)
            self._n_at_band = self._n
            self.doubt_s = self._trend_s()
            if timer_s is None and len(self._kept) < UNBUNCHED_LEAST:
                self.doubt_s += min(self.usual_wait(usual_before), UNKNOWN_WAIT_S)
        elif self._earliest[0] < self._band.high:
            high, high_x = self._earliest
            self._band = self._band._replace(low=min(self._band.low, high), high_x=high_x, high=high)
        return self._band

    def band(self, timer_s: float | None, usual_before: float, is_pinged: bool) -> Band:
        """Bounds of the line.

        Parameters
        ----------
        timer_s : float or None
            The adapter's timer; None: as reads show; 0: none.
        usual_before : float
            Usual wait in the bucket before.
        is_pinged : bool
            Answers to pings have shown what reads cannot: nothing is assumed of them any more.
        """
        least, x = self._earliest
        lows = [] if timer_s == 0 else self._handovers(timer_s, usual_before)
        tightest = max(lows) if lows else (-math.inf, x)
        answer = self._answer
        if answer is not None and tightest < answer and timer_s != 0:
            tightest = answer
        elif timer_s == 0 or (not is_pinged and (not lows or (timer_s is None and self._is_unbunched()))):
            mean_late_s = fmean(arrival.delay for arrival in self._kept) - least
            return Band(x, least - EARLIEST_PER_MEAN * mean_late_s - SLACK_S, x, least, timer_s != 0)
        return Band(tightest[1], tightest[0] - SLACK_S, x, least)

    def _handovers(self, timer_s: float | None, usual_before: float) -> list[tuple[float, float]]:
        """What had not arrived at the hand-over before: bounds from below, and where."""
        least = self._earliest[0]
        longest = STALLED_WAITS * self.usual_wait(usual_before)
        lows = []
        for arrival in self._kept:
            if arrival.waited > longest:
                continue  # held back by more than the adapter
            waited = (arrival.waited if timer_s is None else timer_s) + HANDOVER_JITTER_S
            if arrival.delay - least <= waited < math.inf:  # else it queued up behind others
                lows.append((arrival.delay - waited, arrival.x))
        return lows

    def _is_unbunched(self) -> bool:
        """Whether reads hold whole frames, most of them about as early as the earliest."""
        if sum(arrival.whole for arrival in self._kept) < WHOLE_PART * len(self._kept):
            return False
        late = median(arrival.delay for arrival in self._kept) - self._earliest[0]
        return late <= UNBUNCHED_PART * median(arrival.waited for arrival in self._kept)

    def _trend_s(self) -> float:
        """How far the line moves over the arrivals so far, if it moves at a steady rate.

        The earliest of the first quarter and of the last differ by three quarters of that.
        """
        part = max(UNBUNCHED_LEAST // 2, len(self._kept) // 4)
        first = min(arrival.delay for arrival in self._kept[:part])
        last = min(arrival.delay for arrival in self._kept[-part:])
        return abs(last - first) / 0.75
