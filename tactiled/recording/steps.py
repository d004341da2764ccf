"""Replay of recordings: the same bytes at the same times through the same pipeline give the same events.

A file begins with a new pipeline, or it is a later part of a rotated recording: then its header holds the
hello of the board, and the detectors start from their initial state, as after a restart. The events of a
later part are reproduced bit for bit only if the parts before it are replayed first.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from tactiled.errors import ContractError, DataError
from tactiled.events.types import Event
from tactiled.pipeline import Pipeline
from tactiled.received import Output
from tactiled.recording.chunks import Extent
from tactiled.recording.contents import Header, Input, Read, RecordedEvent
from tactiled.recording.reader import Reached, batches, in_order, read_items
from tactiled.wire.frames import Hello


@dataclass(frozen=True)
class ReplayStep:
    """One input of the pipeline with its events in this replay (`now`) and in the live run (`live`)."""

    cause: Read | Input
    now: tuple[RecordedEvent, ...]
    live: tuple[RecordedEvent, ...]
    is_cut: bool
    """Live events may be missing: the file ends after this input, or is damaged there."""

    @property
    def time_s(self) -> float:
        """Time of the input, host monotonic seconds of the recording."""
        return self.cause.arrival_s if isinstance(self.cause, Read) else self.cause.time_s


class Replay:
    """Replay of a recording as an iterable of steps; iterate once.

    `DataError` if a file is not a recording, or the parts are not consecutive.

    Parameters
    ----------
    paths : sequence of Path
        One file, or consecutive parts of one recording, in any order.
    """

    def __init__(self, paths: Sequence[Path], reached: Reached | None = None) -> None:
        parts = in_order(paths)
        for (_, before), (path, header) in pairwise(parts):
            if (header.run, header.part) != (before.run, before.part + 1):
                fault = f"this is part {header.part}, and part {header.part - 1} of its run was not given"
                if (header.run, header.part) == (before.run, before.part):
                    fault = f"part {header.part} of its run was given twice"
                elif header.run != before.run:
                    fault = "this is another recording than the file before it"
                raise DataError(f"{path}: {fault}: give consecutive parts of one recording, each once")
        self._reached = reached
        self.header: Header = parts[0][1]  # of the first part
        self.extents = {path: Extent() for path, _ in parts}  # readable part of each file, once it is read
        self.pipeline = Pipeline(self.header.source.layout, self.header.source.array, self.header.pipeline)

    def __iter__(self) -> Iterator[ReplayStep]:
        pipeline = self.pipeline
        if self.header.hello is not None:
            pipeline.know(self.header.hello)
        board = pipeline.hello.board_serial if pipeline.hello is not None else ""
        for number, (path, extent) in enumerate(self.extents.items()):
            steps = _steps(path, extent, self._share_of(number))
            for batch in batches(steps, lambda step: isinstance(step[0], Read), Pipeline.MOST_READS):
                outputs = _run(pipeline, [cause for cause, _, _ in batch], path)
                for (cause, live, is_cut), found in zip(batch, outputs, strict=True):
                    now: list[RecordedEvent] = []
                    for output in found:
                        if isinstance(output, Hello):
                            board = output.board_serial
                        elif isinstance(output, Event):
                            now.append(RecordedEvent(output, board, cause.unix_offset_s, "pipeline"))
                    yield ReplayStep(cause, tuple(now), live, is_cut)

    def _share_of(self, number: int) -> Reached | None:
        """Convert the progress in one part to the progress in all parts, which are about equal in size."""
        reached = self._reached
        return reached and (lambda share: reached((number + share) / len(self.extents)))


def _run(pipeline: Pipeline, causes: Sequence[Read | Input], path: Path) -> Sequence[Sequence[Output]]:
    """Feed recorded reads, or one other input, to the pipeline; return the outputs of each."""
    received = [pipeline.receive(read.data, read.arrival_s) for read in causes if isinstance(read, Read)]
    if received:
        return pipeline.detect(received)
    return [run_input(pipeline, cause, path) for cause in causes if isinstance(cause, Input)]


def run_input(pipeline: Pipeline, cause: Input, path: Path) -> Sequence[Output]:
    """Give the pipeline an input that is no read; return its outputs. `DataError` for an unknown input."""
    if cause.name == "disconnected":
        pipeline.disconnected()
    elif cause.name in ("damaged", "dropped"):
        pipeline.interrupted()
    else:
        try:
            return pipeline.command(cause.name, cause.values(), cause.time_s)[1]
        except (ContractError, KeyError, ValueError):
            raise DataError(
                f"{path}: contains the input {cause.name!r}, which this version of tactiled does not support"
            ) from None
    return ()


def _steps(
    path: Path, extent: Extent, reached: Reached | None
) -> Iterator[tuple[Read | Input, tuple[RecordedEvent, ...], bool]]:
    """Yield each input with the pipeline events recorded after it, and whether these may be incomplete."""
    cause: Read | Input | None = None
    live: list[RecordedEvent] = []
    for item in read_items(path, extent, reached):
        if not isinstance(item, RecordedEvent):
            if cause is not None:
                yield cause, tuple(live), isinstance(item, Input) and item.name == "damaged"
            cause, live = item, []
        elif item.origin == "pipeline":
            live.append(item)
    if cause is not None:
        yield cause, tuple(live), True
