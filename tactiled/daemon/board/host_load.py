"""Load of the host, as a board notices it: long turns of the event loop, and late groove fits."""

from collections import deque

_LOAD_WINDOW_S = 10.0  # time for which a warning stays after its cause, as the warnings of the line do
# A stall of a board at 100 Hz is declared after five scans: a loop that is busy for longer delays that, too.
_LONG_TURN_S = 0.05
_KEPT_S = 1.0  # turns are kept for longer than the 0.1 s between two statuses


class LoopTurns:
    """Longest turn of the event loop since any recent instant; the boards of a process share one loop."""

    def __init__(self) -> None:
        # Ends and durations. A turn that is no longer than a later one is never the longest again, so the
        # durations decrease, and few are kept.
        self._turns: deque[tuple[float, float]] = deque()

    def add(self, end_s: float, duration_s: float) -> None:
        """Take a turn that ended at `end_s` (monotonic seconds), or how much too late a timer fired."""
        turns = self._turns
        while turns and turns[-1][1] <= duration_s:
            turns.pop()
        turns.append((end_s, duration_s))
        while turns[0][0] < end_s - _KEPT_S:
            turns.popleft()

    def longest_since(self, since_s: float) -> float:
        """Return the longest turn that ended after `since_s`, at most 1 s ago, in seconds; 0.0 for none."""
        return next((duration_s for end_s, duration_s in self._turns if end_s > since_s), 0.0)


class HostLoad:
    """Delays of one board by a busy host: long turns of the event loop, and late groove fits."""

    def __init__(self, turns: LoopTurns) -> None:
        self._turns = turns
        # Of the statuses of the last 10 s: time, longest turn since the one before, late fits until then
        self._recent: deque[tuple[float, float, int]] = deque()

    def note_status(self, now_s: float, fits_late: int) -> float:
        """Take note of a status, for `warning`; return the longest turn since the one before in seconds."""
        longest_s = self._turns.longest_since(self._recent[-1][0] if self._recent else 0.0)
        self._recent.append((now_s, longest_s, fits_late))
        while self._recent[0][0] < now_s - _LOAD_WINDOW_S:
            self._recent.popleft()
        return longest_s

    def warning(self) -> str:
        """Return what is wrong and its cause; empty for nothing."""
        words = []
        longest_s = max((turn_s for _, turn_s, _ in self._recent), default=0.0)
        if longest_s > _LONG_TURN_S:
            words.append(
                f"the daemon could not react for up to {1e3 * longest_s:.0f} ms: other processes or virtual "
                "machines use this host's processors, or it reads too many boards"
            )
        if self._recent and (late := self._recent[-1][2] - self._recent[0][2]):
            words.append(
                f"{late} groove fits were not ready in time: the host is too slow or too busy; raise "
                "texture.hop_s and texture.answer_after_s, or stop other processes"
            )
        return "; ".join(words)
