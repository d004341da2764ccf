"""When was a scan really taken? Board time fitted against host arrival times.

Bytes arrive late, never early: after the scan began by at least the sampling and the transfer time, and then
by whatever the adapter, the kernel and the scheduler add. So the truth is a line (two crystals) that no
arrival lies under, and the earliest arrivals of each second bound it from above. From below it is bounded by
the answers to pings: the board read its clock after the host began to send. Where a board answers none, it is
bounded by what had *not* arrived: a frame that an adapter handed over now was not whole at the hand-over
before, 16 ms or 1 ms ago; and where reads hold whole frames and most come about as early as the earliest,
nothing seems to bunch them, and the line is taken to run close under the earliest. That gives each second a
band, and `envelope.lines_through` gives all lines through all bands. Stalls push single arrivals up, where
they do no harm; several arrivals far under the line mean that the board's clock stepped.

An adapter whose timer divides the scan period delays every scan by the same unknown part of it. Arrivals
cannot show that: the band is as wide as the timer, and the sigma says so. Where such a timer happens to fall
between two frames it cannot even be noticed without pings: the daemon tells `handover_s` where the adapter
says it (FTDI does), and a configuration may.

A clock that is off by more than `max_drift_ppm` contradicts the bands. It is then followed up to
`STEEPEST_PPM`, and `ClockFit.warning` says so; before the contradiction is certain, the distance between the
two explanations is part of the sigma.

Words: `board_s` is board time in seconds, unwrapped, any origin; `arrival_s` is host monotonic time when the
last byte of a frame was handed to us; `time_s` is the estimated host monotonic instant of the scan.
"""

import math
from collections import deque

from pydantic import Field

from tactiled.samples.bucket import UNKNOWN_WAIT_S, Arrival, Bucket
from tactiled.samples.envelope import Band, Lines, lines_through
from tactiled.tomlfile import Params

# An asynchronous receiver loses step at 5 % between the two ends (half a bit in ten): a board whose frames
# arrive, and whose UART runs from the clock that it counts, is not further off.
STEEPEST_PPM = 50_000.0


class ClockParams(Params):
    """How the board's clock is fitted to the host's."""

    bucket_s: float = Field(default=1.0, gt=0, description="the earliest arrival of each bucket is kept")
    # Crystals wander by about 1e-6 per kelvin: over two minutes that is well under 0.1 ms.
    window_buckets: int = Field(default=120, ge=3, description="buckets that the line is fitted to")
    # Board and host crystals of 100 ppm each, the worst that is sold for clocks.
    max_drift_ppm: float = Field(
        default=200.0, gt=0, description="no two crystals differ by more; beyond it, a warning"
    )
    handover_s: float | None = Field(
        default=None, ge=0, le=1, description="the adapter's timer; 0: none; left out: as reads show"
    )
    gate_s: float = Field(default=0.02, gt=0, description="arrivals this early and lasting: a stepped clock")


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
    # A drift of 0.1 % (no crystal has it, some oscillators do) needs four buckets to be told from lateness.
    UNSEEN_DRIFT = 1e-3
    BANDS_TO_SEE = 4
    FLOOR_SD_S = 50e-6  # host scheduling and tick resolution: nobody knows an instant better than this
    # A second of which everything came late is the backlog of a stall, and says nothing of the line; when all
    # has come late for so many, the board's clock has lost time.
    LATE_BUCKETS_TO_BELIEVE = 10

    def __init__(self, params: ClockParams, min_latency_s: float) -> None:
        self._params = params
        self._min_latency_s = min_latency_s
        self._limit = params.max_drift_ppm * 1e-6
        self.handover_s = params.handover_s
        """The adapter's timer; may be told at any time, and holds from the bucket being filled on."""
        self.reset()

    def reset(self) -> None:
        """Forget all arrivals."""
        self._origin: tuple[float, float] | None = None
        self._bands: deque[Band] = deque(maxlen=self._params.window_buckets)
        self._bucket = Bucket(self._params.bucket_s)
        self._running: Band | None = None  # of the bucket being filled; only until there are lines
        self._lines: Lines | None = None
        self._drop = 0.0  # how far arrivals since the last fit pushed the line down
        self._n_early = 0
        self._is_pinged = False  # answers to pings have bounded the line closer than reads could
        self._late_since: float | None = None
        self._wait_s = math.inf  # usual wait between hand-overs, as of the last bucket

    @property
    def drift_ppm(self) -> float:
        """How much longer (+) a second of the board is than one of the host."""
        return self._lines.line.slope * 1e6 if self._lines else 0.0

    @property
    def warning(self) -> str:
        """What is wrong with the board's clock and what to set; empty while it keeps to `max_drift_ppm`."""
        if self._lines is None or not self._lines.is_steep:
            return ""
        ppm = self.drift_ppm
        room_ppm = 10 ** math.ceil(math.log10(1.5 * abs(ppm)))
        return (
            f"the board's clock is {abs(ppm) / 1e4:.2g} % too {'slow' if ppm > 0 else 'fast'}, more than "
            f"max_drift_ppm = {self._params.max_drift_ppm:g} allows: scan times follow it, less certain; "
            f"if the board has no crystal, set samples.clock.max_drift_ppm = {room_ppm:g}, else look at what "
            "its ticks count (per_unit in the layout)"
        )

    def add(
        self,
        board_s: float,
        arrival_s: float,
        waited_s: float = math.inf,
        *,
        whole: bool = True,
        whole_by_s: float | None = None,
    ) -> None:
        """Take one arrival; frames of one read share their `arrival_s`.

        Parameters
        ----------
        board_s, arrival_s : float
        waited_s : float
            Time since the hand-over before the one that completed this frame; infinity where unknown.
        whole : bool
            Whether that earlier read ended with a frame, not within one.
        whole_by_s : float, optional
            When the frame was whole at the latest, by its first bytes in an earlier read; `arrival_s` where
            nothing is known.
        """
        if self._origin is None:
            self._origin = (board_s, arrival_s)
        x = board_s - self._origin[0]
        delay = (arrival_s - self._origin[1]) - x
        whole_by = delay if whole_by_s is None else min(delay, (whole_by_s - self._origin[1]) - x)
        if self._lines is not None:
            above = whole_by - self._height(x)
            if above < -self._params.gate_s:
                self._n_early += 1
                if self._n_early >= self.STEPS_TO_BELIEVE:
                    self.reset()
                    self.add(board_s, arrival_s, waited_s, whole=whole, whole_by_s=whole_by_s)
                return
            self._n_early = 0
            self._drop = min(self._drop, self._drop + above)
        number = math.floor(x / self._params.bucket_s)
        if number != self._bucket.number:
            if len(self._bucket):
                self._close_bucket()
            self._bucket.begin(number)
        self._bucket.add(Arrival(x, delay, waited_s, whole), whole_by)
        if self._lines is None:
            self._running = self._bucket.running_band(self.handover_s, self._wait_s, self._is_pinged)

    def answered(self, board_s: float, sent_s: float, arrival_s: float) -> None:
        """Take an answered ping: the board's clock read `board_s` between two instants.

        Parameters
        ----------
        board_s : float
        sent_s, arrival_s : float
            The board cannot have had the ping before, nor read its clock after. Both may be as loose as a
            backlog makes them.
        """
        if self._origin is None or not len(self._bucket):
            return
        x = board_s - self._origin[0]
        if x < self._bucket.number * self._params.bucket_s:
            return  # of a bucket that is closed
        ideal_s = self._min_latency_s - self._origin[1] - x  # makes an instant the delay of an ideal arrival
        low, high = sent_s + ideal_s, arrival_s + ideal_s
        height, gate_s = self._height(x), self._params.gate_s
        if low > height + gate_s or high < height - gate_s:
            return  # not ticks of the clock that dates the scans
        self._bucket.answer(x, low, high)
        if not self._is_pinged and self._bucket.is_answered(self.handover_s, self._wait_s):
            self._is_pinged = True
            for k, band in enumerate(self._bands):
                if band.is_assumed:
                    self._bands[k] = band._replace(low=-math.inf)

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
        if self._lines is not None:
            return self._lines.line.at(x) + self._drop
        low, high = self._bounds()
        return (low + high) / 2

    def _bounds(self) -> tuple[float, float]:
        """Bounds of all bands while there is no line through them; they meet where they contradict."""
        bands = [*self._bands, self._running] if self._running is not None else self._bands
        high = min(band.high for band in bands)
        low = max(band.low for band in bands)
        return (min(low, high) if low > -math.inf else high - UNKNOWN_WAIT_S), high

    def _sd(self, x: float) -> float:
        bands = [*self._bands, self._running] if self._running is not None else self._bands
        unseen = 0.0  # a slope that so few bands cannot show
        if len(self._bands) < self.BANDS_TO_SEE and bands:
            unseen = max(self._limit, self.UNSEEN_DRIFT) * (x - bands[0].high_x) / math.sqrt(3)
        if self._lines is not None:
            return math.hypot(self.FLOOR_SD_S, self._lines.sd_at(x), unseen)
        if not bands:
            return math.inf
        low, high = self._bounds()  # and the truth anywhere between
        # Until there are lines, arrivals that become later or earlier may as well be a clock that is off.
        late = self._bucket.doubt_s + bands[-1].high - high
        return math.hypot(self.FLOOR_SD_S, unseen, (high - low) / math.sqrt(12), late)

    def _is_backlog(self, band: Band, newest: float) -> bool:
        """Whether all of a bucket was held back; `newest`: when its last arrived, since the origin."""
        lines = self._lines
        if band.low == -math.inf:
            return False  # late or not, it bounds the line from above only
        if lines is None or band.low <= self._params.gate_s + max(
            lines.line.at(band.low_x) + self._drop, lines.free.at(band.low_x)
        ):
            self._late_since = None
            return False
        if self._late_since is None:
            self._late_since = newest
        if newest < self._late_since + self.LATE_BUCKETS_TO_BELIEVE * self._params.bucket_s:
            return True  # a stall's backlog comes at once: this counts by arrival, not by board time
        self._late_since = None
        self._bands.clear()
        self._lines = None
        return False

    def _close_bucket(self) -> None:
        bucket = self._bucket
        band = bucket.band(self.handover_s, self._wait_s, self._is_pinged)
        self._wait_s = bucket.usual_wait(self._wait_s)
        if self._is_backlog(band, bucket.newest):
            return
        self._bands.append(band)
        if len(self._bands) > 1:
            steepest = max(STEEPEST_PPM * 1e-6, self._limit)
            self._lines = lines_through(self._bands, self._limit, steepest)
            self._running = None
            self._drop = 0.0
