"""`tactiled replay`: run recordings through the pipeline, print the events and compare them."""

import json
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from tactiled.events.codec import to_map
from tactiled.recording import contents
from tactiled.recording.contents import Input, RecordedEvent
from tactiled.recording.playback import PlaybackPace
from tactiled.recording.reader import Reached
from tactiled.recording.steps import Replay, ReplayStep, is_damage
from tactiled.recording.writer import ACTIVE


@dataclass(frozen=True)
class ReplayComparison:
    """Outcome of the comparison of a replay with the live run."""

    compared: int  # number of events compared
    difference: str  # description of the first difference; empty where there is none
    dropped_reads: int  # reads that the recorder had to drop. Nothing is compared after the first of them
    # The pipeline was new where the recording begins; otherwise the live detectors had earlier data
    fresh: bool
    damaged_bytes: int = 0  # unreadable bytes. Nothing is compared after the first of them
    unread: str = ""  # description of what cannot be read in finished files; empty where everything can
    unfinished: str = ""  # the same for files that a recorder has not finished

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
        for now, live in zip_longest(step.now, step.live):
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
        )


def replay(
    paths: Sequence[Path],
    write_line: Callable[[str], None],
    *,
    topics: Collection[str] = (),
    speed: float = 0.0,
    sleep: Callable[[float], None] = time.sleep,
    reached: Reached | None = None,
) -> ReplayComparison:
    """Run recordings through the pipeline and print each event as JSON, as `tactiled listen` did live.

    Parameters
    ----------
    topics : collection of str
        Topics to print; empty for all.
    speed : float
        1 is real time, 2 twice as fast, 0 as fast as possible.
    reached : callable, optional
        Called with the completed fraction, 0 to 1.

    Raises
    ------
    DataError
        See `Replay`.
    """
    seqs: dict[str, int] = {}
    pace = PlaybackPace(speed, sleep)
    replayed_run = Replay(paths, reached)
    verdict = ReplayVerifier(replayed_run)
    for step in replayed_run:
        if not is_damage(step.cause):  # a damage mark has no time on this clock
            pace.wait(step.time_s)
        verdict.compare(step)
        for replayed in step.now:
            topic = replayed.event.topic
            seqs[topic] = seq = seqs.get(topic, -1) + 1
            if not topics or topic in topics:
                message = to_map(
                    replayed.event, seq=seq, board=replayed.board, unix_offset_s=replayed.unix_offset_s
                )
                write_line(json.dumps({"topic": topic, **message}, allow_nan=False))
    return verdict.result()


def _show(replayed: RecordedEvent | None) -> str:
    return "nothing" if replayed is None else f"{replayed.board} {replayed.event}"
