"""Recordings run again: the same bytes at the same instants through the same pipeline, so the same events.

A file begins where the pipeline was new, or it is a later part of a rotated recording: then its header tells
what was known of the board, and detectors begin anew, as they do after a restart. Bit by bit the events of a
later part come again only behind the parts before it.
"""

import json
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from tactiled.errors import ContractError, DataError
from tactiled.events.codec import to_map
from tactiled.events.types import Event
from tactiled.pipeline import Output, Pipeline
from tactiled.recording import contents
from tactiled.recording.contents import Header, Input, Read, Said
from tactiled.recording.reader import read_header, read_items
from tactiled.wire.frames import Hello


@dataclass(frozen=True)
class Step:
    """One thing that went into the pipeline, what came of it now, and what had come of it live."""

    told: Read | Input
    now: tuple[Said, ...]
    live: tuple[Said, ...]
    is_last: bool
    """Of its file: what had come of it live may be cut off."""

    @property
    def time_s(self) -> float:
        return self.told.arrival_s if isinstance(self.told, Read) else self.told.time_s


class Replay:
    """The steps of a recording, to be iterated once.

    Parameters
    ----------
    paths : sequence of Path
        One file, or consecutive parts of one recording.

    Raises
    ------
    DataError
        A file is no recording, or the parts do not follow each other.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = paths
        headers = [read_header(path) for path in paths]
        for path, header, before in zip(paths[1:], headers[1:], headers, strict=False):
            if (header.run, header.part) != (before.run, before.part + 1):
                raise DataError(
                    f"{path}: is not the part that follows; give the parts in order, without gaps"
                )
        self.header: Header = headers[0]
        self.pipeline = Pipeline(self.header.source.layout, self.header.source.array, self.header.pipeline)

    def __iter__(self) -> Iterator[Step]:
        pipeline = self.pipeline
        if self.header.hello:
            pipeline.receive_data(self.header.hello, 0.0)
        board = pipeline.hello.board_serial if pipeline.hello is not None else ""
        for path in self._paths:
            for told, live, is_last in _steps(path):
                now: list[Said] = []
                for output in _run(pipeline, told, path):
                    if isinstance(output, Hello):
                        board = output.board_serial
                    elif isinstance(output, Event):
                        now.append(Said(output, board, told.unix_offset_s, "pipeline"))
                yield Step(told, tuple(now), live, is_last)


def _run(pipeline: Pipeline, told: Read | Input, path: Path) -> Sequence[Output]:
    """Tell the pipeline what it was told then."""
    if isinstance(told, Read):
        return pipeline.receive_data(told.data, told.arrival_s)
    if told.name == "disconnected":
        pipeline.disconnected()
    elif told.name != "dropped":
        try:
            return pipeline.command(told.name, told.values(), told.time_s)[1]
        except (ContractError, KeyError, ValueError):
            raise DataError(f"{path}: holds {told.name!r}, which this tactiled does not know") from None
    return ()


def _steps(path: Path) -> Iterator[tuple[Read | Input, tuple[Said, ...], bool]]:
    """What went in, each with the pipeline's events that are recorded behind it."""
    told: Read | Input | None = None
    live: list[Said] = []
    for item in read_items(path):
        if not isinstance(item, Said):
            if told is not None:
                yield told, tuple(live), False
            told, live = item, []
        elif item.origin == "pipeline":
            live.append(item)
    if told is not None:
        yield told, tuple(live), True


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
    """

    compared: int
    difference: str
    dropped_reads: int
    fresh: bool

    @property
    def is_good(self) -> bool:
        return self.compared > 0 and not self.difference

    def words(self) -> str:
        """For the person who asked."""
        words = f"{self.compared} events came again bit for bit"
        if self.difference:
            words += f", then they differ {self.difference}"
        if not self.fresh:
            words += "; this began in the middle of a run: give the parts before it too, if there are any"
        if self.dropped_reads:
            words += f"; compared up to where the recorder dropped {self.dropped_reads} reads"
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
        pace.wait(step.time_s)
        verdict.compare(step)
        for said in step.now:
            topic = said.event.topic
            seqs[topic] = seq = seqs.get(topic, -1) + 1
            if not topics or topic in topics:
                message = to_map(said.event, seq=seq, board=said.board, unix_offset_s=said.unix_offset_s)
                say(json.dumps({"topic": topic, **message}, allow_nan=False))
    return verdict.result(again.header.fresh)


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
        self._compared = self._dropped = 0
        self._difference = ""

    def compare(self, step: Step) -> None:
        if isinstance(step.told, Input) and step.told.name == "dropped":
            self._dropped += step.told.values()["reads"]
        if self._dropped or self._difference:
            return
        for now, live in zip_longest(step.now, step.live):
            if live is None and step.is_last:
                return
            if now is None or live is None or contents.encode_said(now) != contents.encode_said(live):
                self._difference = f"at {step.time_s:.6f} s: live {_show(live)}, again {_show(now)}"
                return
            self._compared += 1

    def result(self, fresh: bool) -> Verdict:
        return Verdict(self._compared, self._difference, self._dropped, fresh)


def _show(said: Said | None) -> str:
    return "nothing" if said is None else f"{said.board} {said.event}"
