"""Recordings run again: the same bytes at the same instants through the same pipeline, so the same events.

A file begins where the pipeline was new, or it is a later part of a rotated recording: then its header tells
what was known of the board, and detectors begin anew, as they do after a restart. Bit by bit the events of a
later part come again only behind the parts before it.
"""

import json
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from pathlib import Path

from tactiled.errors import ContractError, DataError
from tactiled.events.codec import to_map
from tactiled.events.types import Event
from tactiled.pipeline import Output, Pipeline
from tactiled.recording import contents
from tactiled.recording.contents import Header, Input, Read, Said
from tactiled.recording.extent import Extent
from tactiled.recording.reader import in_order, read_items
from tactiled.recording.writer import ACTIVE
from tactiled.wire.frames import Hello


@dataclass(frozen=True)
class Step:
    """One thing that went into the pipeline, what came of it now, and what had come of it live."""

    told: Read | Input
    now: tuple[Said, ...]
    live: tuple[Said, ...]
    is_cut: bool
    """What had come of it live may be missing: the file ends behind it, or is damaged there."""

    @property
    def time_s(self) -> float:
        return self.told.arrival_s if isinstance(self.told, Read) else self.told.time_s


class Replay:
    """The steps of a recording, to be iterated once.

    Parameters
    ----------
    paths : sequence of Path
        One file, or consecutive parts of one recording, in any order.

    Attributes
    ----------
    header : Header
        Of the first part.
    pipeline : Pipeline
    extents : mapping of Path to Extent
        How far each file is good, once it has been read.

    Raises
    ------
    DataError
        A file is no recording, or the parts do not follow each other.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        parts = in_order(paths)
        for (_, before), (path, header) in pairwise(parts):
            if (header.run, header.part) != (before.run, before.part + 1):
                raise DataError(
                    f"{path}: is part {header.part}, and part {header.part - 1} of its run was not given: "
                    "give consecutive parts of one recording, each once"
                )
        self.header: Header = parts[0][1]
        self.extents = {path: Extent() for path, _ in parts}
        self.pipeline = Pipeline(self.header.source.layout, self.header.source.array, self.header.pipeline)

    def __iter__(self) -> Iterator[Step]:
        pipeline = self.pipeline
        if self.header.hello:
            pipeline.receive_data(self.header.hello, 0.0)
        board = pipeline.hello.board_serial if pipeline.hello is not None else ""
        for path, extent in self.extents.items():
            for told, live, is_cut in _steps(path, extent):
                now: list[Said] = []
                for output in _run(pipeline, told, path):
                    if isinstance(output, Hello):
                        board = output.board_serial
                    elif isinstance(output, Event):
                        now.append(Said(output, board, told.unix_offset_s, "pipeline"))
                yield Step(told, tuple(now), live, is_cut)


def _run(pipeline: Pipeline, told: Read | Input, path: Path) -> Sequence[Output]:
    """Tell the pipeline what it was told then."""
    if isinstance(told, Read):
        return pipeline.receive_data(told.data, told.arrival_s)
    if told.name == "disconnected":
        pipeline.disconnected()
    elif told.name in ("damaged", "dropped"):
        pipeline.interrupted()
    else:
        try:
            return pipeline.command(told.name, told.values(), told.time_s)[1]
        except (ContractError, KeyError, ValueError):
            raise DataError(f"{path}: holds {told.name!r}, which this tactiled does not know") from None
    return ()


def _steps(path: Path, extent: Extent) -> Iterator[tuple[Read | Input, tuple[Said, ...], bool]]:
    """What went in, each with the pipeline's events that are recorded behind it."""
    told: Read | Input | None = None
    live: list[Said] = []
    for item in read_items(path, extent):
        if not isinstance(item, Said):
            if told is not None:
                yield told, tuple(live), _is_damage(item)
            told, live = item, []
        elif item.origin == "pipeline":
            live.append(item)
    if told is not None:
        yield told, tuple(live), True


def _is_damage(told: Read | Input) -> bool:
    return isinstance(told, Input) and told.name == "damaged"


@dataclass(frozen=True)
class Verdict:
    """Whether the events that were live came again.

    Attributes
    ----------
    compared : int
        Events of the file that were compared.
    difference : str
        The first difference, in words; empty where there is none.
    dropped_reads : int
        Reads that the recorder had to drop. Behind the first of them nothing is compared.
    fresh : bool
        The pipeline was new where the recording begins; else detectors knew more live than now.
    damaged_bytes : int
        That cannot be read. Behind the first of them nothing is compared.
    unread : str
        What of finished files cannot be read, in words; empty where that is nothing.
    unfinished : str
        The same of files that a recorder has not finished.
    """

    compared: int
    difference: str
    dropped_reads: int
    fresh: bool
    damaged_bytes: int = 0
    unread: str = ""
    unfinished: str = ""

    @property
    def is_good(self) -> bool:
        """All that should be there was there, and came again."""
        return self.compared > 0 and not (self.difference or self.damaged_bytes or self.unread)

    def words(self) -> str:
        """For the person who asked."""
        came = "came again bit for bit" if self.is_good else "were compared and came again"
        words = f"{self.compared} events {came}"
        if self.difference:
            words += f", then they differ {self.difference}"
        if not self.fresh:
            words += "; this began in the middle of a run: give the parts before it too, if there are any"
        if self.dropped_reads:
            words += f"; compared up to where the recorder dropped {self.dropped_reads} reads"
        if self.damaged_bytes:
            words += f"; compared up to where {self.damaged_bytes} bytes are damaged"
        if self.unread:
            words += f"; not all could be read: {self.unread}"
        if self.unfinished:
            words += f"; as far as the file goes: {self.unfinished}"
        return words


def replay(
    paths: Sequence[Path],
    say: Callable[[str], None],
    *,
    topics: Collection[str] = (),
    speed: float = 0.0,
    sleep: Callable[[float], None] = time.sleep,
) -> Verdict:
    """Run recordings again and say each event as the JSON line that `tactiled listen` printed live.

    Parameters
    ----------
    paths : sequence of Path
    say : callable
        Takes a line.
    topics : collection of str
        Only these; empty for all.
    speed : float
        1 is real time, 2 twice as fast, 0 as fast as can be.

    Raises
    ------
    DataError
        See `Replay`.
    """
    seqs: dict[str, int] = {}
    verdict = _Verifier()
    pace = Pace(speed, sleep)
    again = Replay(paths)
    for step in again:
        if not _is_damage(step.told):  # which has no instant of this clock
            pace.wait(step.time_s)
        verdict.compare(step)
        for said in step.now:
            topic = said.event.topic
            seqs[topic] = seq = seqs.get(topic, -1) + 1
            if not topics or topic in topics:
                message = to_map(said.event, seq=seq, board=said.board, unix_offset_s=said.unix_offset_s)
                say(json.dumps({"topic": topic, **message}, allow_nan=False))
    return verdict.result(again)


class Pace:
    """Waits so that recorded instants pass at `speed` times their own pace; 0 never waits."""

    def __init__(
        self,
        speed: float,
        sleep: Callable[[float], None] = time.sleep,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._speed, self._sleep, self._monotonic = speed, sleep, monotonic
        self._origin_s: float | None = None

    def wait(self, time_s: float) -> None:
        """Return when it is time for what happened at `time_s`."""
        if not self._speed:
            return
        now_s = self._monotonic()
        if self._origin_s is None:
            self._origin_s = now_s - time_s / self._speed
        if (rest_s := self._origin_s + time_s / self._speed - now_s) > 0:
            self._sleep(rest_s)


class _Verifier:
    """Compares the events of now with those of then, byte by byte."""

    def __init__(self) -> None:
        self._compared = self._dropped = self._damaged_bytes = 0
        self._difference = ""

    def compare(self, step: Step) -> None:
        if isinstance(step.told, Input) and step.told.name == "dropped":
            self._dropped += step.told.values()["reads"]
        if isinstance(step.told, Input) and _is_damage(step.told):
            self._damaged_bytes += step.told.values()["bytes"]
        if self._dropped or self._damaged_bytes or self._difference:
            return
        for now, live in zip_longest(step.now, step.live):
            if live is None and step.is_cut:
                return
            if now is None or live is None or contents.encode_said(now) != contents.encode_said(live):
                self._difference = f"at {step.time_s:.6f} s: live {_show(live)}, again {_show(now)}"
                return
            self._compared += 1

    def result(self, again: Replay) -> Verdict:
        """What to say of a replay that has come to its end."""
        unread: list[str] = []
        unfinished: list[str] = []
        for path, extent in again.extents.items():
            # A recorder that was killed, or still writes, leaves a torn end by right, and no torn middle.
            by_right = path.name.endswith(ACTIVE) and not extent.is_damaged
            if not extent.is_whole:
                (unfinished if by_right else unread).append(f"{path.name}: {extent.words()}")
        return Verdict(
            self._compared,
            self._difference,
            self._dropped,
            again.header.fresh,
            self._damaged_bytes,
            "; ".join(unread),
            "; ".join(unfinished),
        )


def _show(said: Said | None) -> str:
    return "nothing" if said is None else f"{said.board} {said.event}"
