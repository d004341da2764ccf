"""Age of recordings, as far as recordings themselves prove that time has passed.

A wall clock may be wrong by months: a host without a battery for it, a wrong date typed in, a spoofed time
server. Recordings hold two clocks at each read from the port, the wall clock and CLOCK_MONOTONIC, which
nobody can set and which begins at 0 with each start of the host. From one instant in recordings to the next,
time has passed as far as *both* say so, where the difference of the two is the same at both instants: the
host was not started anew and its wall clock was not set between them. Anywhere else nothing tells how long
the host was off or by how much the clock was set, so such a pause counts at most `PAUSE_PART` of the age at
which recordings are removed. A wrong clock makes recordings older by one such part, and not by what it says.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

from mcap.records import Message

from tactiled.errors import DataError
from tactiled.recording import contents
from tactiled.recording.chunks import Index, read_chunk, read_index
from tactiled.recording.directory import Finished
from tactiled.recording.reader import open_recording, topic_of

# Of `keep_days`. At 30 days a pause counts at most a day: a host that is used daily loses nothing, and its
# recordings are removed late by the weekends; thirty errors of the clock would have to come together.
PAUSE_PART = 1 / 30
# Change of the difference of both clocks that is neither a start of the host nor a clock that was set: time
# servers slew a clock by at most 500 ppm, and step it by less than a second while they follow it.
_SLEW, _STEP_S = 500e-6, 1.0
MOST_READ = 10  # files read for their times at each check, once a minute, beside the recording
_MOST_CHUNKS = 20  # searched for a read from the port, at either end; each second closes a chunk


@dataclass(frozen=True)
class Instant:
    """Both clocks at one read from the port, in seconds."""

    unix_s: float
    monotonic_s: float


@dataclass(frozen=True)
class RecordedSpan:
    """First and last read from the port in a recording."""

    first: Instant
    last: Instant


def proven_ages_s(spans: Mapping[Path, RecordedSpan], pause_s: float) -> dict[Path, float]:
    """Return the least time (s) from the end of each recording to the end of the newest.

    Parameters
    ----------
    spans : mapping of Path to RecordedSpan
    pause_s : float
        The most that counts of a time that only the wall clock proves.
    """
    instants = sorted(
        {instant for span in spans.values() for instant in (span.first, span.last)},
        key=lambda instant: (instant.unix_s, instant.monotonic_s),
    )
    ages_s = {instants[-1]: 0.0} if instants else {}
    for later, earlier in pairwise(reversed(instants)):
        by_wall_s = later.unix_s - earlier.unix_s
        by_monotonic_s = later.monotonic_s - earlier.monotonic_s
        goes_on = abs(by_wall_s - by_monotonic_s) <= _STEP_S + _SLEW * by_wall_s
        ages_s[earlier] = ages_s[later] + min(by_wall_s, max(by_monotonic_s if goes_on else 0.0, pause_s))
    return {path: ages_s[span.last] for path, span in spans.items()}


class SpanCache:
    """Spans of finished recordings, each read once: nothing changes a finished recording."""

    def __init__(self) -> None:
        self._known: dict[tuple[Path, float], RecordedSpan | None] = {}

    def of(self, files: Iterable[Finished]) -> dict[Path, RecordedSpan]:
        """Return the spans that are known after reading at most `MOST_READ` more files."""
        keys = [(file.path, file.ended_unix_s) for file in files]
        unread = [key for key in keys if key not in self._known]
        self._known = {key: self._known[key] for key in keys if key in self._known}
        self._known |= {key: span_of(key[0]) for key in unread[:MOST_READ]}
        return {path: span for (path, _), span in self._known.items() if span is not None}


def span_of(path: Path) -> RecordedSpan | None:
    """Read both ends of a finished recording; None where it has no reads, or cannot be read."""
    try:
        with open_recording(path) as stream:
            index = read_index(stream)
            if index is None:
                return None
            first = next(_instants(stream, index, index.chunks[:_MOST_CHUNKS]), None)
            last = next(_instants(stream, index, index.chunks[: -_MOST_CHUNKS - 1 : -1], step=-1), None)
    except (OSError, DataError):
        return None
    return RecordedSpan(first, last) if first is not None and last is not None else None


def _instants(stream: BinaryIO, index: Index, chunks: Iterable[int], step: int = 1) -> Iterator[Instant]:
    """Yield the instants of the reads in some chunks; backwards in each with `step` = -1."""
    raw = {channel.id for channel in index.channels if topic_of(channel) == contents.RAW_TOPIC}
    for at in chunks:
        for record in read_chunk(stream, at)[::step]:
            if isinstance(record, Message) and record.channel_id in raw:
                read = contents.decode_read(record.data)
                if math.isfinite(read.arrival_s + read.unix_offset_s):
                    yield Instant(read.arrival_s + read.unix_offset_s, read.arrival_s)
