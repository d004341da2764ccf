"""When was a scan really taken? Board time fitted against host arrival times.

Bytes arrive late, never early: after the scan began by at least the sampling and the transfer time, and
then by whatever the adapter, the kernel and the scheduler add. So the truth is a line (two crystals) that
no arrival lies under, and the earliest arrivals of each second bound it from above. How far under them it
may lie follows from how unevenly frames arrive: adapters that hand over bytes every 16 ms delay 10 ms scans
by one of eight amounts, and the smallest may be all of a step above zero. That gives each second a band, and
`envelope.line_through` gives all lines through all bands. Stalls push single arrivals up, where they do no
harm; several arrivals far under the line mean that the board's clock stepped.

Words: `board_s` is board time in seconds, unwrapped, any origin; `arrival_s` is host monotonic time when the
last byte of a frame was handed to us; `time_s` is the estimated host monotonic instant of the scan.
"""

import math
from collections import deque
from statistics import fmean

from pydantic import Field

from tactiled.samples.envelope import Line, line_through
from tactiled.tomlfile import Params


class ClockParams(Params):
    """How the board's clock is fitted to the host's."""

    bucket_s: float = Field(default=1.0, gt=0, description="the earliest arrival of each bucket is kept")
    # Crystals wander by about 1e-6 per kelvin: over two minutes that is well under 0.1 ms.
    window_buckets: int = Field(default=120, ge=3, description="buckets that the line is fitted to")
    # Board and host crystals of 100 ppm each, the worst that is sold for clocks.
    max_drift_ppm: float = Field(default=200.0, gt=0, description="no two crystals differ by more")
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
    FLOOR_SD_S = 50e-6  # host scheduling and tick resolution: nobody knows an instant better than this
    # Delays on k evenly spaced steps have a step of 2 / (k - 1) of the distance from their least to their
    # mean; 10 ms scans in 16 ms bunches make k = 8, so 0.29. Without bunches the distance itself is small;
    # with a stall it is large, and a loose bound does no harm. (The median would jump by a whole step.)
    STEP_PER_MEAN = 0.3

    def __init__(self, params: ClockParams, min_latency_s: float) -> None:
        self._params = params
        self._min_latency_s = min_latency_s
        self.reset()

    def reset(self) -> None:
        """Forget all arrivals."""
        self._origin: tuple[float, float] | None = None
        self._bands: deque[tuple[float, float, float]] = deque(maxlen=self._params.window_buckets)
        self._bucket = 0
        self._delays: list[tuple[float, float]] = []  # (x, delay) of the bucket being filled
        self._line: Line | None = None
        self._drop = 0.0  # how far arrivals since the last fit pushed the line down
        self._n_early = 0

    @property
    def drift_ppm(self) -> float:
        """How much longer (+) a second of the board is than one of the host."""
        return self._line.slope * 1e6 if self._line else 0.0

    def add(self, board_s: float, arrival_s: float) -> None:
        """Take one arrival; frames of one read share their `arrival_s`."""
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
                    self.add(board_s, arrival_s)
                return
            self._n_early = 0
            self._drop = min(self._drop, self._drop + above)
        bucket = math.floor(x / self._params.bucket_s)
        if bucket != self._bucket and self._delays:
            self._close_bucket()
        self._bucket = bucket
        self._delays.append((x, delay))

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
        return min((low + high) / 2 for _, low, high in bands)

    def _sd(self, x: float) -> float:
        if self._line is not None:
            return math.hypot(self.FLOOR_SD_S, math.sqrt(self._line.variance_at(x)))
        where, low, high = self._band()
        drift = self._params.max_drift_ppm * 1e-6 * (x - where)
        return math.hypot(self.FLOOR_SD_S, drift, (high - low) / math.sqrt(12))  # uniform in the band

    def _band(self) -> tuple[float, float, float]:
        """Bounds that the bucket being filled puts on the line: (x, low, high)."""
        x, least = min(self._delays, key=lambda point: point[1])
        typical = fmean(delay for _, delay in self._delays)
        return x, least - self.STEP_PER_MEAN * (typical - least), least

    def _close_bucket(self) -> None:
        self._bands.append(self._band())
        self._delays.clear()
        if len(self._bands) > 1:
            self._line = line_through(self._bands, self._params.max_drift_ppm * 1e-6)
            self._drop = 0.0
