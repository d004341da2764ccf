"""Values between the two phases of the pipeline: what reads gave, and what the detectors found in it."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from tactiled.events.types import Event, ScanEvent, new_event
from tactiled.samples.block import Gap, ScanBlock, ScanRun
from tactiled.wire.frames import Acknowledge, Hello

Output = Event | Hello | Acknowledge


class Received:
    """Scans, gaps, hellos and answers of one read, in the order of the stream; a gap precedes its run.

    Parameters
    ----------
    now_s : float
        Time at which the bytes were handed over, host monotonic seconds.
    """

    def __init__(self, items: list[Hello | Acknowledge | Gap | ScanRun], now_s: float) -> None:
        self.items, self.now_s = items, now_s

    @property
    def boards(self) -> set[str]:
        """Serial numbers of the boards that sent the scans."""
        return {item.conversion.hello.board_serial for item in self.items if isinstance(item, ScanRun)}

    @cached_property
    def scan_events(self) -> list[ScanEvent]:
        """Events of all scans; read once the items are complete."""
        return [
            new_event(
                ScanEvent,
                time_s=scan.time_s,
                index=scan.number,
                volts=volts,
                valid=valid,
                time_sd_s=scan.time_sd_s,
                age_s=self.now_s - scan.time_s,
                late=scan.late,
            )
            for run in self.items
            if isinstance(run, ScanRun)
            for scan, (volts, valid) in zip(run.scans, run.rows(), strict=True)
        ]


class Detected(NamedTuple):
    """Input of the detectors, and the events that they made of it."""

    item: Hello | Acknowledge | Gap | ScanBlock
    events: list[Event]
    # list of (int, int): numbers of the reads that gave it, and of the scans of each; 0 scans of what is no
    # block
    shares: list[tuple[int, int]]

    def by_read(self, block: ScanBlock, known_s: float) -> Iterator[tuple[int, int, list[Event]]]:
        """Yield the shares of a block, each with the events whose evidence its scans completed.

        Events of scans that were held back until the zero was known came with the scan at `known_s`.
        """
        events: list[list[Event]] = [[] for _ in self.shares]
        if len(events) == 1:
            events = [self.events]
        elif self.events:
            ends = list(accumulate(n_scans for _, n_scans in self.shares))
            last_s: list[float] = block.time_s[np.array(ends[:-1]) - 1].tolist()
            for event in self.events:
                events[bisect_left(last_s, max(event.evidence_s, known_s))].append(event)
        for (read, n_scans), found in zip(self.shares, events, strict=True):
            yield read, n_scans, found


def joined(
    received: Sequence[Received],
) -> Iterator[tuple[Hello | Acknowledge | Gap | ScanRun, list[tuple[int, int]]]]:
    """Yield the items of all reads with their shares (see `Detected`); runs with nothing between as one."""
    runs: list[ScanRun] = []
    shares: list[tuple[int, int]] = []
    for read, one in enumerate(received):
        for item in one.items:
            run = item if isinstance(item, ScanRun) else None
            if runs and (run is None or run.conversion is not runs[0].conversion):
                yield ScanRun.of(runs), shares
                runs, shares = [], []
            if run is None:
                yield item, [(read, 0)]
            else:
                runs.append(run)
                shares.append((read, len(run.scans)))
    if runs:
        yield ScanRun.of(runs), shares
