"""`tactiled replay`: run recordings through the pipeline, print the events and compare them."""

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path

from tactiled.array import numerics_words
from tactiled.events.codec import to_map
from tactiled.recording import contents
from tactiled.recording.chunks import Extent
from tactiled.recording.contents import Input, RecordedEvent
from tactiled.recording.reader import Reached
from tactiled.recording.steps import Replay, ReplayStep
from tactiled.recording.writer import ACTIVE


@dataclass
class ReplayComparison:
    """Comparison of a replay with the live run, byte by byte, up to the first input that is missing."""

    # The pipeline was new where the recording begins; otherwise the live detectors had earlier data
    fresh: bool
    computed_with: str = ""  # libraries and processor of the live run
    compared: int = 0  # number of events compared
    difference: str = ""  # description of the first difference; empty where there is none
    dropped_reads: int = 0  # reads that the recorder had to drop
    damaged_bytes: int = 0  # unreadable bytes
    # What cannot be read, one description a file: of finished files, and of those that a recorder has not
    # finished
    unread: list[str] = field(default_factory=list)
    unfinished: list[str] = field(default_factory=list)

    def compare(self, step: ReplayStep) -> None:
        """Compare the next step; after the first that cannot be compared, none is."""
        if isinstance(step.cause, Input) and step.cause.name == "dropped":
            self.dropped_reads += step.cause.count("reads")
        elif isinstance(step.cause, Input) and step.cause.name == "damaged":
            self.damaged_bytes += step.cause.count("bytes")
        if self.dropped_reads or self.damaged_bytes or self.difference:
            return
        for now, live in zip_longest(step.now, step.live):
            if live is None and step.is_cut:
                return
            if now is None or live is None or contents.encode_event(now) != contents.encode_event(live):
                self.difference = f"at {step.time_s:.6f} s: live {_show(live)}, replayed {_show(now)}"
                return
            self.compared += 1

    def finish(self, extents: Mapping[Path, Extent]) -> None:
        """Take the readable extent of each file, once all steps are compared."""
        for path, extent in extents.items():
            if not extent.is_whole:
                # A recorder that was killed, or still writes, leaves an incomplete end, which is expected.
                is_expected = path.name.endswith(ACTIVE) and not extent.is_damaged
                (self.unfinished if is_expected else self.unread).append(f"{path.name}: {extent.words()}")

    @property
    def is_good(self) -> bool:
        """All data was read, and all events were reproduced."""
        return self.compared > 0 and not (self.difference or self.damaged_bytes or self.unread)

    def words(self) -> str:
        """Describe the outcome for the user."""
        words = f"{self.compared} events {'reproduced bit for bit' if self.is_good else 'compared and equal'}"
        if not self.compared:
            words = "no event is equal" if self.difference else "no events: nothing could be compared"
        if self.difference:
            words += f"; first difference {self.difference}"
            if self.computed_with not in ("", here := numerics_words()):
                words += (
                    f"; the live run was computed with {self.computed_with}, this replay with {here}: "
                    "these may differ in the last bits"
                )
        if not self.fresh:
            words += "; the recording begins in the middle of a run: add the earlier parts, if there are any"
        if self.dropped_reads:
            words += f"; compared up to the place where the recorder dropped {self.dropped_reads} reads"
        if self.damaged_bytes:
            words += f"; compared up to the place where {self.damaged_bytes} bytes are damaged"
        if self.unread:
            words += f"; not everything could be read: {'; '.join(self.unread)}"
        if self.unfinished:
            words += f"; compared to the end of the readable data: {'; '.join(self.unfinished)}"
        return words


def replay(
    paths: Sequence[Path],
    write_line: Callable[[str], None],
    *,
    topics: Collection[str] = (),
    reached: Reached | None = None,
) -> ReplayComparison:
    """Run recordings through the pipeline and print each event as JSON, as `tactiled listen` did live.

    Raises as `Replay`.

    Parameters
    ----------
    topics : collection of str
        Topics to print; empty for all.
    """
    seqs: dict[str, int] = {}
    steps = Replay(paths, reached)
    comparison = ReplayComparison(steps.header.fresh, steps.header.computed_with)
    for step in steps:
        comparison.compare(step)
        for replayed in step.now:
            topic = replayed.event.topic
            seqs[topic] = seq = seqs.get(topic, -1) + 1
            if not topics or topic in topics:
                message = to_map(
                    replayed.event, seq=seq, board=replayed.board, unix_offset_s=replayed.unix_offset_s
                )
                write_line(json.dumps({"topic": topic, **message}, allow_nan=False))
    comparison.finish(steps.extents)
    return comparison


def _show(replayed: RecordedEvent | None) -> str:
    return "nothing" if replayed is None else f"{replayed.board} {replayed.event}"
