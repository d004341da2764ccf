"""Scans in the recordings of the guest, counted from the bytes of the line beside the daemon's own count."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from tactiled.events.types import ScanEvent, StatusEvent
from tactiled.recording.contents import Input, Read, RecordedEvent
from tactiled.recording.reader import read_items
from tactiled.wire.codec import Decoder
from tactiled.wire.frames import Hello, Scan
from tactiled.wire.layout import load_layout

_SEQUENCES = 1 << 16  # the sequence of a scan wraps on the wire of board-v1


@dataclass
class Recorded:
    """Scans of one recording; times are CLOCK_MONOTONIC of the guest."""

    # Arrival of the first read after a step of the wall clock, and the step
    steps_s: list[tuple[float, float]] = field(default_factory=list)
    last_unix_s: float = 0.0  # wall clock at the last read
    last_offset_s: float = 0.0  # wall clock less CLOCK_MONOTONIC, as the daemon had it at the last read
    scan_s: list[float] = field(default_factory=list)  # instants of the scans that were published
    # Age of each of them when its bytes arrived
    age_s: list[float] = field(default_factory=list)
    # Scans missing between two that were published, without a loss of the port between these
    lost_with_board: int = 0
    # Scans that the board took from the first that arrived after it had introduced itself to the last, less
    # those that were published and those that the daemon counts as missing
    unaccounted: int = 0


def read_recording(path: Path) -> Recorded:
    """Count the scans of a recording whose board has not restarted."""
    found, decoder = Recorded(), Decoder(load_layout("board-v1"))
    taken = missing = 0
    last_sequence = last_index = offset_s = None
    arrival_s = 0.0
    is_known = was_lost = False
    for item in read_items(path):
        if isinstance(item, Read):
            if offset_s is not None and abs(item.unix_offset_s - offset_s) > 1.0:
                found.steps_s.append((item.arrival_s, item.unix_offset_s - offset_s))
            offset_s = found.last_offset_s = item.unix_offset_s
            arrival_s = item.arrival_s
            found.last_unix_s = item.arrival_s + item.unix_offset_s
            for frame in decoder.feed(item.data):
                if isinstance(frame, Hello):
                    is_known = True
                elif isinstance(frame, Scan) and is_known:
                    taken += 1 if last_sequence is None else (frame.sequence - last_sequence) % _SEQUENCES
                    last_sequence = frame.sequence
        elif isinstance(item, Input) and item.name == "disconnected":
            decoder.reset()
            was_lost = True
        elif isinstance(item, RecordedEvent):
            if isinstance(item.event, ScanEvent):
                if last_index is not None and not was_lost:
                    found.lost_with_board += item.event.index - last_index - 1
                last_index, was_lost = item.event.index, False
                found.scan_s.append(item.event.time_s)
                found.age_s.append(arrival_s - item.event.time_s)
            elif isinstance(item.event, StatusEvent):
                missing = item.event.scans_missing
    found.unaccounted = taken - len(found.scan_s) - missing
    return found


def first_after(times_s: Iterable[float], time_s: float) -> float:
    """Time from an instant to the first of others after it; infinite where there is none."""
    return next((later_s - time_s for later_s in times_s if later_s > time_s), float("inf"))
