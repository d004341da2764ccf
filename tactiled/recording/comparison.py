"""Comparison of the events of a replay with the recorded live events."""

from dataclasses import dataclass
from itertools import zip_longest

from tactiled.recording import contents
from tactiled.recording.contents import Input, RecordedEvent
from tactiled.recording.steps import Replay, ReplayStep, is_damage
from tactiled.recording.writer import ACTIVE


@dataclass(frozen=True)
class ReplayComparison:
    """Outcome of the comparison of a replay with the live run.

    Attributes
    ----------
    compared : int
        Number of events compared.
    difference : str
        Description of the first difference; empty where there is none.
    dropped_reads : int
        Reads that the recorder had to drop. Nothing is compared after the first of them.
    fresh : bool
        The pipeline was new where the recording begins; otherwise the live detectors had earlier data.
    damaged_bytes : int
        Unreadable bytes. Nothing is compared after the first of them.
    unread : str
        Description of what cannot be read in finished files; empty where everything can.
    unfinished : str
        The same for files that a recorder has not finished.
    other_form : str
        Description of events of another version; these are not compared.
    """

    compared: int
    difference: str
    dropped_reads: int
    fresh: bool
    damaged_bytes: int = 0
    unread: str = ""
    unfinished: str = ""
    other_form: str = ""

    @property
    def is_good(self) -> bool:
        """All data was read, and all events were reproduced."""
        return self.compared > 0 and not (self.difference or self.damaged_bytes or self.unread)

    def words(self) -> str:
        """Describe the outcome for the user."""
        words = f"{self.compared} events {'reproduced bit for bit' if self.is_good else 'compared and equal'}"
        if not (self.compared or self.difference):
            words = "no events: nothing could be compared"
        elif not self.compared:
            words = "no event is equal"
        if self.difference:
            words += f"; first difference {self.difference}"
        if not self.fresh:
            words += "; the recording begins in the middle of a run: add the earlier parts, if there are any"
        if self.dropped_reads:
            words += f"; compared up to the place where the recorder dropped {self.dropped_reads} reads"
        if self.damaged_bytes:
            words += f"; compared up to the place where {self.damaged_bytes} bytes are damaged"
        if self.unread:
            words += f"; not everything could be read: {self.unread}"
        if self.other_form:
            words += f"; not compared: {self.other_form}"
        if self.unfinished:
            words += f"; compared to the end of the readable data: {self.unfinished}"
        return words


class ReplayVerifier:
    """Comparison of replayed with live events, byte by byte."""

    def __init__(self, replay: Replay) -> None:
        self._replay = replay
        self._compared = self._dropped = self._damaged_bytes = 0
        self._difference = ""

    def compare(self, step: ReplayStep) -> None:
        """Compare the next step; after the first that cannot be compared, none is."""
        if isinstance(step.cause, Input) and step.cause.name == "dropped":
            self._dropped += step.cause.values()["reads"]
        if isinstance(step.cause, Input) and is_damage(step.cause):
            self._damaged_bytes += step.cause.values()["bytes"]
        if self._dropped or self._damaged_bytes or self._difference:
            return
        others = {topic for extent in self._replay.extents.values() for topic in extent.other_forms}
        replayed = [now for now in step.now if now.event.topic not in others]
        for now, live in zip_longest(replayed, step.live):
            if live is None and step.is_cut:
                return
            if now is None or live is None or contents.encode_event(now) != contents.encode_event(live):
                self._difference = f"at {step.time_s:.6f} s: live {_show(live)}, replayed {_show(now)}"
                return
            self._compared += 1

    def result(self) -> ReplayComparison:
        """Return the outcome after the last step."""
        unread: list[str] = []
        unfinished: list[str] = []
        for path, extent in self._replay.extents.items():
            # A recorder that was killed, or is still writing, leaves an incomplete end, which is expected.
            is_expected = path.name.endswith(ACTIVE) and not extent.is_damaged
            if not extent.is_whole:
                (unfinished if is_expected else unread).append(f"{path.name}: {extent.words()}")
        return ReplayComparison(
            self._compared,
            self._difference,
            self._dropped,
            self._replay.header.fresh,
            self._damaged_bytes,
            "; ".join(unread),
            "; ".join(unfinished),
            "; ".join(
                f"{p.name}: {e.other_words()}" for p, e in self._replay.extents.items() if e.other_forms
            ),
        )


def _show(replayed: RecordedEvent | None) -> str:
    return "nothing" if replayed is None else f"{replayed.board} {replayed.event}"
