"""Scan rate of a board whose hello does not state it, from the arrivals of its scans."""


class RateMeter:
    """Count scans over time until their rate is known.

    Adapters hand over bytes up to 16 ms late (the timer of FTDI). At one end of `LEAST_S` that is an error of
    1 % at most, which the clock fit follows from then on (`STEEPEST_PPM` in `clock`). Scans that waited in
    the host are handed over at one instant, and the measurement ends with the last of them.
    """

    LEAST_S = 2.0
    LEAST_SCANS = 20  # for slow boards, whose last period is not complete: 5 %

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin anew: bytes were lost."""
        self._begin_s: float | None = None
        self._newest_s = 0.0  # when the newest scan was handed over
        self._n_scans = 0

    @property
    def has_begun(self) -> bool:
        """True when a scan has come since the reset."""
        return self._begin_s is not None

    def add(self, now_s: float) -> float | None:
        """Take a scan that was handed over at `now_s`; return the rate in hertz once it is known."""
        if self._begin_s is None:
            self._begin_s = self._newest_s = now_s
        if now_s <= self._begin_s:  # how long the first bytes waited is unknown: only what follows counts
            return None
        if now_s > self._newest_s:
            elapsed_s = self._newest_s - self._begin_s
            if elapsed_s >= self.LEAST_S and self._n_scans >= self.LEAST_SCANS:
                return float(f"{self._n_scans / elapsed_s:.4g}")  # no more digits than it has
            self._newest_s = now_s
        self._n_scans += 1
        return None
