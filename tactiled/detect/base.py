"""Promises of every detector; `tests/detect/test_detect_contract.py` checks them for each.

1. ``process`` takes blocks and gaps in order and returns the events that they complete.
2. Any chunking of the same scans gives bit-identical events.
3. ``reset()`` equals a new detector, and so does a Gap in which the board began anew. Every Gap ends slip
   and contact, and no window straddles it (gaps of up to 50 ms never reach a detector: `bridge`). What is
   known of friction, noise and zero may be kept over a gap in which the board kept scanning.
4. Memory is bounded and nothing drifts: no running sum that never forgets.
5. Finite in or NaN in, finite out: NaN and invalid readings are left out and never spread.
"""

from collections.abc import Iterable
from operator import attrgetter
from typing import Protocol

from tactiled.events.types import Event
from tactiled.samples.block import Gap, ScanBlock

_evidence_s = attrgetter("evidence_s")


def in_order(first: Iterable[Event], second: Iterable[Event]) -> list[Event]:
    """Return two series of events in order of their evidence; of the same scan, the first series is first."""
    return sorted(
        [*first, *second], key=_evidence_s
    )  # each is in order: a third of the time of `heapq.merge`


class Detector(Protocol):
    """An online detector or estimator."""

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that `item` completes, in order of their evidence."""
        ...

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        ...


class ContactDetector(Detector, Protocol):
    """Detector that reports contact."""

    @property
    def hidden_below(self) -> float:
        """Load of a taxel, in the unit of the array, that is no contact beside the largest load of late."""
        ...
