"""Timing of a playback: recorded times at their own speed, or scaled."""

import time
from collections.abc import Callable


class PlaybackPace:
    """Wait so that recorded times pass at `speed` times real time; 0 never waits."""

    def __init__(
        self,
        speed: float,
        sleep: Callable[[float], None] = time.sleep,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._speed, self._sleep, self._monotonic = speed, sleep, monotonic
        self._origin_s: float | None = None

    def wait(self, time_s: float) -> None:
        """Sleep until the recorded time `time_s` is due."""
        if not self._speed:
            return
        now_s = self._monotonic()
        if self._origin_s is None:
            self._origin_s = now_s - time_s / self._speed
        if (rest_s := self._origin_s + time_s / self._speed - now_s) > 0:
            self._sleep(rest_s)
