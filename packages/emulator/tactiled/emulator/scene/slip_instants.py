"""Instants of slip, from the slipping share of the contact and the tangential load."""

import math
from dataclasses import dataclass

from tactiled.array import FloatArray

INCIPIENT_SHARE = 0.1
GROSS_SHARE = 0.9
# A tangential load grows or falls where it changes by more than this part of the normal load: less than a
# percent of the friction limit, more than rounding.
_GROWS = 0.002
_BEGINNING_MM = 0.5  # travel that gives the direction: beyond presliding, before the motion turns
_MOST_EPISODES = 10_000  # kept: an hour of stick-slip at 3 Hz


@dataclass
class SlipEpisode:
    """One time that a tenth or more of the contact slipped."""

    shear_s: float  # the tangential load began to grow
    # incipient_s, gross_s: 10 % of the contact slips; 90 % slips, None where that share was not reached
    incipient_s: float
    gross_s: float | None = None
    end_s: float | None = None  # less than 10 % slips again; None while it continues
    # x_mm, y_mm: first half millimetre of travel since `incipient_s`
    x_mm: float = 0.0
    y_mm: float = 0.0

    @property
    def direction_deg(self) -> float | None:
        """Direction at the beginning; None where the skin turned on the spot."""
        if math.hypot(self.x_mm, self.y_mm) < 1e-9:
            return None
        return math.degrees(math.atan2(self.y_mm, self.x_mm))


class SlipEpisodeTracker:
    """Find slip episodes in grid rows, which come in order, any number at a time.

    Rows that come again, because a scene is played anew for a look back, change nothing.
    """

    def __init__(self) -> None:
        self._until_s = -math.inf
        self.episodes: list[SlipEpisode] = []  # the newest ones; the last may continue
        self._last = (0.0, 0.0, 0.0, 0.0)  # instant, share, x, y
        self._low_s = self._low_n = self._peak_n = 0.0

    def feed(
        self,
        time_s: FloatArray,
        share: FloatArray,
        load_n: FloatArray,
        shear_n: FloatArray,
        way_mm: FloatArray,
    ) -> None:
        """Follow rows (n,) with the size of the total tangential load and the place (n, 2) of the skin."""
        columns = (time_s, share, load_n, shear_n, way_mm[:, 0], way_mm[:, 1])
        for t, s, load, shear, x, y in zip(*(column.tolist() for column in columns), strict=True):
            if t <= self._until_s:
                continue
            self._until_s = t
            self._follow_load(t, shear, _GROWS * load)
            self._follow_share(t, s, x, y)
            self._last = (t, s, x, y)

    def _follow_load(self, t: float, shear: float, least: float) -> None:
        """Update the last instant before the tangential load began to grow."""
        fell = shear < self._peak_n - max(least, 0.05 * self._peak_n)
        if fell or shear <= self._low_n + least:
            self._low_s = t
            self._low_n = shear if fell else min(shear, self._low_n)
            self._peak_n = shear
        self._peak_n = max(self._peak_n, shear)

    def _follow_share(self, t: float, share: float, x: float, y: float) -> None:
        before_s, before, x0, y0 = self._last
        now = self.episodes[-1] if self.episodes and self.episodes[-1].end_s is None else None

        def crossed(level: float) -> float:
            return before_s + (t - before_s) * (level - before) / (share - before)

        if now is None and share >= INCIPIENT_SHARE:
            instant = crossed(INCIPIENT_SHARE)
            now = SlipEpisode(min(self._low_s, instant), instant)
            self.episodes = [*self.episodes[1 - _MOST_EPISODES :], now]
        if now is None:
            return
        if share < INCIPIENT_SHARE:
            now.end_s = crossed(INCIPIENT_SHARE)
            return
        if math.hypot(now.x_mm, now.y_mm) < _BEGINNING_MM:
            now.x_mm += x - x0
            now.y_mm += y - y0
        if now.gross_s is None and share >= GROSS_SHARE:
            now.gross_s = crossed(GROSS_SHARE) if before < GROSS_SHARE else t
