"""When was a scan really taken? Board time fitted against host arrival times.

Bytes arrive late, never early: after the scan began by at least the sampling and the transfer time, and then
by whatever the adapter, the kernel and the scheduler add. So the truth is a line (two crystals) that no
arrival lies under, and the earliest arrivals of each second bound it from above. From below it is bounded by
what had *not* arrived: a frame that an adapter handed over now was not whole at the hand-over before, 16 ms
or 1 ms ago. Where reads hold whole frames and most come about as early as the earliest, nothing bunches
them, and the line runs close under the earliest. That gives each second a band, and `envelope.line_through`
gives all lines through all bands. Stalls push single arrivals up, where they do no harm; several arrivals
far under the line mean that the board's clock stepped.

An adapter whose timer divides the scan period delays every scan by the same unknown part of it. One end of
the line cannot see that: the band is as wide as the timer, and the sigma says so. Where such a timer
happens to fall between two frames it cannot even be noticed: the daemon tells `handover_s` where the adapter
says it (FTDI does), and a configuration may.

Words: `board_s` is board time in seconds, unwrapped, any origin; `arrival_s` is host monotonic time when the
last byte of a frame was handed to us; `time_s` is the estimated host monotonic instant of the scan.
"""

import math
from collections import deque
from statistics import fmean, median
from typing import NamedTuple

from pydantic import Field

from tactiled.samples.envelope import Band, Line, line_through
from tactiled.tomlfile import Params


class ClockParams(Params):
    """How the board's clock is fitted to the host's."""

    bucket_s: float = Field(default=1.0, gt=0, description="the earliest arrival of each bucket is kept")
    # Crystals wander by about 1e-6 per kelvin: over two minutes that is well under 0.1 ms.
    window_buckets: int = Field(default=120, ge=3, description="buckets that the line is fitted to")
    # Board and host crystals of 100 ppm each, the worst that is sold for clocks.
    max_drift_ppm: float = Field(default=200.0, gt=0, description="no two crystals differ by more")
    handover_s: float | None = Field(
        default=None, ge=0, le=1, description="the adapter's timer; 0: none; left out: as reads show"
    )
    gate_s: float = Field(default=0.02, gt=0, description="arrivals this early and lasting: a stepped clock")


class _Arrival(NamedTuple):
    x: float  # board time since the origin
    delay: float  # arrival less board time, both since the origin
    waited: float  # seconds since the hand-over before
    whole: bool  # that read ended with a frame


class ClockFit:
    """Streaming fit of ``time_s = offset + rate * board_s`` under the earliest arrivals.

    Parameters
    ----------
    params : ClockParams
    min_latency_s : float
        Time from the start of a scan to the arrival of its last byte on an ideal line: sampling of
        all channels plus transfer. What the line adds to each frame alike cannot be seen from one end.
    """

    STEPS_TO_BELIEVE = 5  # early arrivals in a row before we believe that the board's clock stepped
    FLOOR_SD_S = 50e-6  # host scheduling and tick resolution: nobody knows an instant better than this
    # Where nothing bunches frames, the earliest of a second is late by some part of how late they are on
    # average: a sixth for 5 exponential delays, less for more; with room.
    EARLIEST_PER_MEAN = 0.3
    # Bunched frames are spread over the whole wait between two reads: their median is half of it late.
    UNBUNCHED_PART = 0.25
    # A second of which everything came late is the backlog of a stall, and says nothing of the line; when all
    # has come late for so many, the board's clock has lost time.
    LATE_BUCKETS_TO_BELIEVE = 10
    STALLED_WAITS = 3.0  # a read after so many typical waits ended a stall
    HANDOVER_JITTER_S = 1e-4  # of USB polling and of the host's scheduler, on top of an adapter's timer

    def __init__(self, params: ClockParams, min_latency_s: float) -> None:
        self._params = params
        self._min_latency_s = min_latency_s
        self.handover_s = params.handover_s
        """The adapter's timer; may be told at any time, and holds from the bucket being filled on."""
        self.reset()

    def reset(self) -> None:
        """Forget all arrivals."""
        self._origin: tuple[float, float] | None = None
        self._bands: deque[Band] = deque(maxlen=self._params.window_buckets)
        self._bucket = 0
        self._arrivals: list[_Arrival] = []  # of the bucket being filled
        self._line: Line | None = None
        self._drop = 0.0  # how far arrivals since the last fit pushed the line down
        self._n_early = 0
        self._late_since: float | None = None
        self._wait_s = math.inf  # usual wait between hand-overs, as of the last bucket

    @property
    def drift_ppm(self) -> float:
        """How much longer (+) a second of the board is than one of the host."""
        return self._line.slope * 1e6 if self._line else 0.0

    def add(
        self, board_s: float, arrival_s: float, waited_s: float = math.inf, *, whole: bool = True
    ) -> None:
        """Take one arrival; frames of one read share their `arrival_s`.

        Parameters
        ----------
        board_s, arrival_s : float
        waited_s : float
            Time since the hand-over before the one that completed this frame; infinity where unknown.
        whole : bool
            Whether that earlier read ended with a frame, not within one.
        """
        if self._origin is None:
            self._origin = (board_s, arrival_s)
        x = board_s - self._origin[0]
        delay = (arrival_s - self._origin[1]) - x
        if self._line is not None:
            above = delay - self._height(x)
            if above < -self._params.gate_s:
                self._n_early += 1
                if self._n_early >= self.STEPS_TO_BELIEVE:
                    self.reset()
                    self.add(board_s, arrival_s, waited_s, whole=whole)
                return
            self._n_early = 0
            self._drop = min(self._drop, self._drop + above)
        bucket = math.floor(x / self._params.bucket_s)
        if bucket != self._bucket and self._arrivals:
            self._close_bucket()
        self._bucket = bucket
        self._arrivals.append(_Arrival(x, delay, waited_s, whole))

    def time_of(self, board_s: float) -> tuple[float, float]:
        """Host instant of a board instant, and its standard deviation.

        Returns
        -------
        time_s, time_sd_s : float
        """
        if self._origin is None:
            return board_s, math.inf
        x = board_s - self._origin[0]
        time_s = self._origin[1] + x + self._height(x) - self._min_latency_s
        return time_s, self._sd(x)

    def _height(self, x: float) -> float:
        """Delay of an ideal arrival at `x`."""
        if self._line is not None:
            return self._line.at(x) + self._drop
        bands = [*self._bands, self._band()]
        return min((band.low + band.high) / 2 for band in bands)

    def _sd(self, x: float) -> float:
        if self._line is not None:
            return math.hypot(self.FLOOR_SD_S, math.sqrt(self._line.variance_at(x)))
        band = self._band()
        drift = self._params.max_drift_ppm * 1e-6 * (x - band.high_x)
        width = band.high - band.low  # and the truth anywhere in it
        return math.hypot(self.FLOOR_SD_S, drift, width / math.sqrt(12))

    def _band(self) -> Band:
        """Bounds that the bucket being filled puts on the line."""
        earliest = min(self._arrivals, key=lambda arrival: arrival.delay)
        x, least = earliest.x, earliest.delay
        timer = self.handover_s
        latest = []
        if timer != 0 and not (timer is None and self._is_unbunched(least)):
            for arrival in self._arrivals:
                if arrival.waited > self.STALLED_WAITS * self._usual_wait():
                    continue  # held back by more than the adapter
                waited = (arrival.waited if timer is None else timer) + self.HANDOVER_JITTER_S
                if arrival.delay - least <= waited < math.inf:  # else it queued up behind others
                    latest.append((arrival.delay - waited, arrival.x))
        if not latest:
            mean_late = fmean(arrival.delay for arrival in self._arrivals) - least
            latest = [(least - self.EARLIEST_PER_MEAN * mean_late, x)]
        low, low_x = max(latest)
        return Band(low_x, low, x, least)

    def _usual_wait(self) -> float:
        """Time between two hand-overs when nothing stalls; a stall may fill most of a bucket."""
        waits = sorted(arrival.waited for arrival in self._arrivals)
        return min(waits[len(waits) // 4], 2 * self._wait_s)

    def _is_unbunched(self, least: float) -> bool:
        """Whether reads hold whole frames, most of them about as early as the earliest."""
        if sum(arrival.whole for arrival in self._arrivals) < 0.9 * len(self._arrivals):
            return False
        late = median(arrival.delay for arrival in self._arrivals) - least
        return late <= self.UNBUNCHED_PART * median(arrival.waited for arrival in self._arrivals)

    def _is_backlog(self, band: Band, newest: float) -> bool:
        """Whether all of a bucket was held back; `newest`: when its last arrived, since the origin."""
        if self._line is None or band.low <= self._line.at(band.low_x) + self._drop + self._params.gate_s:
            self._late_since = None
            return False
        if self._late_since is None:
            self._late_since = newest
        if newest < self._late_since + self.LATE_BUCKETS_TO_BELIEVE * self._params.bucket_s:
            return True  # a stall's backlog comes at once: this counts by arrival, not by board time
        self._late_since = None
        self._bands.clear()
        self._line = None
        return False

    def _close_bucket(self) -> None:
        band = self._band()
        self._wait_s = self._usual_wait()
        newest = self._arrivals[-1].x + self._arrivals[-1].delay
        self._arrivals.clear()
        if self._is_backlog(band, newest):
            return
        self._bands.append(band)
        if len(self._bands) > 1:
            self._line = line_through(self._bands, self._params.max_drift_ppm * 1e-6)
            self._drop = 0.0
