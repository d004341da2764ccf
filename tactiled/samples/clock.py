"""Fit of board time to host time from the arrival times of frames: estimates the instant of each scan.

Names: `board_s` is unwrapped board time in seconds with any origin; `arrival_s` is host monotonic time when
the last byte of a frame was read; `time_s` is the estimated host monotonic instant of the scan.

A frame arrives after the sampling and transfer time plus the delays of adapter, kernel and scheduler, and
never before. Two crystals make the true relation a straight line, and no arrival lies below it. For each
second, the line is bounded to a band:

- From above by the earliest arrival.
- From below by the answers to pings, because the board read its clock after the host began to send. Nothing
  else is a lower bound on a busy host.
- From below, for boards that answer no pings or slowly, by the hand-over before: a frame that an adapter
  delivers now was not complete then, 16 ms or 1 ms ago. Where reads end with frames and most delays are close
  to the smallest, frames are not bunched, and the line is assumed close below the earliest arrival.

`envelope.lines_through` computes the set of lines through all bands. A stall delays single arrivals, which
does not change the bound; several arrivals far below the line mean that the board's clock stepped.

An adapter whose timer divides the scan period delays every scan by the same unknown part of the timer's
period. Arrival times do not reveal that delay, so the band is as wide as the timer, and the standard
deviation follows it. If such a timer expires between two frames, only pings reveal it: the daemon sets
`handover_s` where the adapter reports its timer (FTDI), and the configuration can set it.

A clock that deviates by more than `max_drift_ppm` contradicts the bands. It is then followed up to
`STEEPEST_PPM`, with `ClockFit.warning`. Until the contradiction is certain, the distance between the two
explanations is part of the standard deviation.
"""

import math
from collections import deque
from collections.abc import Sequence

from pydantic import Field

from tactiled.samples.bucket import UNKNOWN_WAIT_S
from tactiled.samples.envelope import Band
from tactiled.samples.fast import Bucket, Lines, lines_through
from tactiled.tomlfile import Params

# A UART receiver fails at a baud rate error of 5 % (half a bit in ten). Frames arrive, and the UART usually
# runs from the clock that the board counts, so this clock is not further off.
STEEPEST_PPM = 50_000.0


class ClockParams(Params):
    """Parameters of the fit of the board's clock to the host's."""

    # One fit for each bucket: 300 buckets of 0.1 s cost 15 ms of a core each second.
    bucket_s: float = Field(
        default=1.0, ge=0.1, le=60, description="the earliest arrival of each bucket is kept"
    )
    # Crystals drift by about 1e-6 per kelvin: well below 0.1 ms over two minutes.
    # A fit takes 5 us for each bucket, on the event loop, which may wait 2 ms: 300 buckets are 1.5 ms.
    window_buckets: int = Field(default=120, ge=3, le=300, description="number of buckets in the fit")
    # Crystals of 100 ppm each on board and host, the largest tolerance that is common.
    max_drift_ppm: float = Field(
        default=200.0, gt=0, description="largest expected difference of the clocks; beyond it, a warning"
    )
    handover_s: float | None = Field(
        default=None, ge=0, le=1, description="timer of the adapter; 0: none; omitted: estimated from reads"
    )
    gate_s: float = Field(
        default=0.02, gt=0, description="several arrivals earlier by this mean that the clock stepped"
    )


class ClockFit:
    """Streaming fit of ``time_s = offset + rate * board_s`` under the earliest arrivals.

    Parameters
    ----------
    min_latency_s : float
        Time from the start of a scan to the arrival of its last byte on an ideal line: sampling of
        all channels plus transfer. A constant further delay of the line cannot be measured from one end.
    """

    EARLY_ARRIVALS = 5  # in a row, after which the board's clock is taken to have stepped
    # A drift of 0.1 % (of oscillators, not of crystals) cannot be separated from delays in fewer than four
    # buckets.
    UNSEEN_DRIFT = 1e-3
    BANDS_TO_SEE = 4
    FLOOR_SD_S = 50e-6  # host scheduling and tick resolution: a lower bound of the standard deviation
    # A bucket in which everything is late is the backlog of a stall and gives no bound. After so many of them
    # the board's clock is taken to have lost time.
    LATE_BUCKETS = 10
    # Pings come about once in a bucket. After so many without an answer, reads bound delays from below again.
    UNANSWERED_BUCKETS = 5

    def __init__(self, params: ClockParams, min_latency_s: float) -> None:
        self._params = params
        self._min_latency_s = min_latency_s
        self._limit = params.max_drift_ppm * 1e-6
        self.handover_s = params.handover_s
        """Timer of the adapter; may be set at any time, and applies from the current bucket on."""
        self.reset()

    def reset(self) -> None:
        """Forget all arrivals."""
        self._origin: tuple[float, float] | None = None
        self._bands: deque[Band] = deque(maxlen=self._params.window_buckets)
        self._bucket = Bucket(self._params.bucket_s)
        self._running: Band | None = None  # of the current bucket; used only until there are lines
        self._lines: Lines | None = None
        self._lowering = 0.0  # 0 or less: change of the line by arrivals since the last fit
        self._n_early = 0
        self._n_unanswered = 0  # buckets without an answer since the last one
        self._is_pinged = False  # pings are answered fast: reads bound no delay from below any more
        self._late_since_s: float | None = None
        self._wait_s = math.inf  # usual wait between hand-overs, as of the last bucket

    @property
    def drift_ppm(self) -> float:
        """Relative excess of a second of the board over a second of the host, in 1e-6."""
        return self._lines.line.slope * 1e6 if self._lines else 0.0

    @property
    def warning(self) -> str:
        """Fault of the board's clock and its remedy; empty while it is within `max_drift_ppm`."""
        if self._lines is None or not self._lines.is_steep:
            return ""
        ppm = self.drift_ppm
        room_ppm = 10 ** math.ceil(math.log10(1.5 * abs(ppm)))
        return (
            f"the board's clock is {abs(ppm) / 1e4:.2g} % too {'slow' if ppm > 0 else 'fast'}, more than "
            f"max_drift_ppm = {self._params.max_drift_ppm:g} allows: scan times follow it with a larger "
            f"standard deviation; if the board has no crystal, set samples.clock.max_drift_ppm = "
            f"{room_ppm:g}, otherwise check the unit of its ticks (per_unit in the layout)"
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
        """Add an arrival; all frames of one read have the same `arrival_s`.

        Parameters
        ----------
        waited_s : float
            Time since the hand-over before the one that completed this frame; infinity where unknown.
        whole : bool
            True where that earlier read ended with a frame and not within one.
        whole_by_s : float, optional
            Upper bound of the instant at which the frame was complete, where its first bytes came in an
            earlier read; default: `arrival_s`.
        """
        if self._origin is None:
            self._origin = (board_s, arrival_s)
        x = board_s - self._origin[0]
        delay = (arrival_s - self._origin[1]) - x
        whole_delay = delay if whole_by_s is None else min(delay, (whole_by_s - self._origin[1]) - x)
        if self._lines is not None:
            above = whole_delay - self._height(x)
            if above < -self._params.gate_s:
                self._n_early += 1
                if self._n_early >= self.EARLY_ARRIVALS:
                    self.reset()
                    self.add(board_s, arrival_s, waited_s, whole=whole, whole_by_s=whole_by_s)
                return
            self._n_early = 0
            self._lowering += min(above, 0.0)
        number = math.floor(x / self._params.bucket_s)
        if number > self._bucket.number:  # ticks that go back belong to the bucket that is open
            if len(self._bucket):
                self._close_bucket()
            self._bucket = Bucket(self._params.bucket_s, number)
        self._bucket.add(x, delay, waited_s, whole, whole_delay)
        if self._lines is None:
            self._running = self._bucket.running_band(self.handover_s, self._wait_s, self._is_pinged)

    def is_behind(self, board_s: float, sent_s: float) -> bool:
        """Return True where the board read its clock after `sent_s`, and the fit puts that reading before.

        A difference of up to `gate_s` and three standard deviations is taken for an error of the fit.
        """
        time_s, sd_s = self.time_of(board_s)
        return sent_s > time_s + self._params.gate_s + 3 * sd_s

    def answered(self, board_s: float, sent_s: float, arrival_s: float) -> None:
        """Add an answered ping: the board's clock read `board_s` between two instants of the host.

        Parameters
        ----------
        sent_s, arrival_s : float
            Instants before and after the board read its clock; a backlog only makes the interval longer.
        """
        if self._origin is None or not len(self._bucket):
            return
        x = board_s - self._origin[0]
        if x < self._bucket.number * self._params.bucket_s:
            return  # its bucket is closed
        ideal_s = self._min_latency_s - self._origin[1] - x  # instant of a scan to delay of an ideal arrival
        low, high = sent_s + ideal_s, arrival_s + ideal_s
        # A fit that is still wide is wrong by more than the gate, and nothing but an answer corrects it.
        height, gate_s = self._height(x), self._params.gate_s + 3 * self._sd(x)
        if low > height + gate_s or high < height - gate_s:
            return  # ticks of another clock than that of the scans
        self._bucket.answer(x, low, high)
        if not self._is_pinged and self._bucket.is_answered(self._wait_s):
            self._is_pinged = True
            for k, band in enumerate(self._bands):
                if not band.is_answered:
                    self._bands[k] = band._replace(low=-math.inf)

    def time_of(self, board_s: float) -> tuple[float, float]:
        """Host instant of a board instant, and its standard deviation."""
        if self._origin is None:
            return board_s, math.inf
        x = board_s - self._origin[0]
        time_s = self._origin[1] + x + self._height(x) - self._min_latency_s
        return time_s, self._sd(x)

    def _height(self, x: float) -> float:
        """Delay of an ideal arrival at `x`."""
        if self._lines is not None:
            return self._lines.line.at(x) + self._lowering
        low, high = self._bounds()
        return (low + high) / 2

    def _bounding(self) -> Sequence[Band]:
        """Bands of all buckets, before there is a line with that of the current one."""
        return [*self._bands, self._running] if self._running is not None else self._bands

    def _bounds(self) -> tuple[float, float]:
        """Common bounds of all bands, before there is a line; equal where the bands contradict each other."""
        bands = self._bounding()
        high = min(band.high for band in bands)
        low = max(band.low for band in bands)
        return (min(low, high) if low > -math.inf else high - UNKNOWN_WAIT_S), high

    def _sd(self, x: float) -> float:
        bands = self._bounding()
        unseen = 0.0  # effect of a slope that so few bands cannot reveal
        if len(self._bands) < self.BANDS_TO_SEE and bands:
            unseen = max(self._limit, self.UNSEEN_DRIFT) * (x - bands[0].high_x) / math.sqrt(3)
        if self._lines is not None:
            return math.hypot(self.FLOOR_SD_S, self._lines.sd_at(x), unseen)
        if not bands:
            return math.inf
        low, high = self._bounds()  # uniform between them
        # Until there are lines, a trend of the delays may be a clock that deviates.
        late = self._bucket.doubt_s + bands[-1].high - high
        return math.hypot(self.FLOOR_SD_S, unseen, (high - low) / math.sqrt(12), late)

    def _left_out_as_late(self, band: Band, newest_s: float) -> bool:
        """Return True for a bucket that is the backlog of a stall; discard the lines after many of them.

        `newest_s` is the host time of its last arrival since the origin.
        """
        lines = self._lines
        if band.low == -math.inf:
            return False  # only an upper bound, which a delay cannot make wrong
        if lines is None or band.low <= self._params.gate_s + max(
            lines.line.at(band.low_x) + self._lowering, lines.free.at(band.low_x)
        ):
            self._late_since_s = None
            return False
        if self._late_since_s is None:
            self._late_since_s = newest_s
        if newest_s < self._late_since_s + self.LATE_BUCKETS * self._params.bucket_s:
            return True  # by host time, since the backlog of a stall arrives at once
        self._late_since_s = None
        self._bands.clear()
        self._lines = None
        return False

    def _close_bucket(self) -> None:
        bucket = self._bucket
        band = bucket.band(self.handover_s, self._wait_s, self._is_pinged)
        self._wait_s = bucket.usual_wait_s(self._wait_s)
        self._n_unanswered = 0 if bucket.has_answer else self._n_unanswered + 1
        if self._n_unanswered >= self.UNANSWERED_BUCKETS:
            self._is_pinged = False
        # Ticks that went back may make a band no later than the one before: a line needs two instants.
        is_later = not self._bands or band.high_x > self._bands[-1].high_x
        if not is_later or self._left_out_as_late(band, bucket.newest_s):
            return
        self._bands.append(band)
        if len(self._bands) > 1:
            steepest = max(STEEPEST_PPM * 1e-6, self._limit)
            self._lines = lines_through(self._bands, self._limit, steepest)
            self._running = None
            self._lowering = 0.0
