"""Slip events as the daemon publishes them where a controller announces its own motion."""

from collections.abc import Sequence

from bench.slip.scenes import Announcement
from tactiled.array import Array
from tactiled.detect.suite import DetectParams
from tactiled.detect.tuning import TunedSuite
from tactiled.events.types import Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock


class _RecordedEvents:
    """Suite that returns the events of a detector that ran before, each with the scan that completed it."""

    texture = None
    learns_friction = ()
    takes_motion = ()

    def __init__(self, events: Sequence[SlipEvent]) -> None:
        self._events = events
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._left = list(self._events)

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events up to the last scan of the item."""
        if isinstance(item, Gap):
            return []
        ripe = [event for event in self._left if event.detected_s <= float(item.time_s[-1])]
        self._left = self._left[len(ripe) :]
        return list(ripe)


def as_announced(
    array: Array, block: ScanBlock, events: Sequence[SlipEvent], announcements: Sequence[Announcement]
) -> list[SlipEvent]:
    """Return the events with those marked that the announcements explain.

    Parameters
    ----------
    block : ScanBlock
        The scans that the events are of.
    announcements : sequence of Announcement
        Each is announced at the scan at which its motion begins.
    """
    suite = TunedSuite(array, DetectParams(), lambda *_: _RecordedEvents(events))
    announce = {"inhibit": suite.inhibit, "load-change": suite.expect_load_change}
    marked: list[Event] = []
    row = 0
    for motion in sorted(announcements, key=lambda one: one.start_s):
        begins = min(round((motion.start_s - float(block.time_s[0])) * block.rate_hz), len(block))
        if begins > row:
            marked += suite.process(block[row:begins])
            row = begins
        announce[motion.kind](motion.start_s, motion.duration_s)
    if row < len(block):
        marked += suite.process(block[row:])
    return [event for event in marked if isinstance(event, SlipEvent)]
