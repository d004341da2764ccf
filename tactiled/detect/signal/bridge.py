"""Linear interpolation over short gaps, so that a lost scan does not hide a slip beside it.

A gap empties every filter, and a detector is blind until they are full again: a third of a second for one
lost scan. Up to `BRIDGE_S` of missing scans are therefore interpolated linearly between the last reading
before the gap and the first after it, and the detector sees no gap. Longer gaps, restarts and replugs reach
the detector, because the signal in them is unknown. Interpolated scans are never published, recorded or
counted.
"""

import numpy as np

from tactiled.detect.base import Detector
from tactiled.events.types import Event, GripEvent
from tactiled.samples.block import LOSSES, Gap, ScanBlock

BRIDGE_S = 0.05  # prior: the onset of a slip bends the signal for longer; corruption seldom lasts so long


class GapBridge:
    """Detector that is given interpolated scans in place of short gaps."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector
        self._last: ScanBlock | None = None
        self._gap: Gap | None = None

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._last = self._gap = None
        self._detector.reset()

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes."""
        if isinstance(item, Gap):
            return self._take_gap(item)
        last = self._last if self._gap is not None else None
        block = item if last is None else _joined(last, item)
        self._gap = None
        self._last = item
        events = self._detector.process(block)
        return [event for event in events if last is None or not _of_no_scan(event, item)]

    def _take_gap(self, gap: Gap) -> list[Event]:
        last = self._last
        if last is not None and gap.cause in LOSSES and 0 < gap.n_missing <= BRIDGE_S * last.rate_hz:
            self._gap = gap
            return []
        self._last = self._gap = None
        return self._detector.process(gap)


def _of_no_scan(event: Event, block: ScanBlock) -> bool:
    """Return True for the message of an interpolated scan, before the block; the end of a contact is news."""
    return isinstance(event, GripEvent) and event.state != "none" and event.time_s < block.time_s[0]


def _joined(last: ScanBlock, block: ScanBlock) -> ScanBlock:
    """Prepend to `block` the scans missing since the end of `last`, interpolated linearly."""
    last, first = last[-1:], block[:1]
    n = int(first.index[0] - last.index[0]) - 1
    part = (np.arange(1, n + 1) / (n + 1))[:, np.newaxis]
    finite = np.isfinite(last.volts) & np.isfinite(first.volts)  # interpolate only between finite readings
    before, after = np.where(finite, last.volts, np.nan), np.where(finite, first.volts, np.nan)
    volts = before + part * (after - before)
    return ScanBlock(
        volts=np.concatenate([volts, block.volts]),
        time_s=np.concatenate([last.time_s + part[:, 0] * (first.time_s - last.time_s), block.time_s]),
        time_sd_s=np.concatenate([np.repeat(first.time_sd_s, n), block.time_sd_s]),
        index=np.concatenate([np.arange(last.index[0] + 1, first.index[0]), block.index]),
        valid=np.concatenate([np.repeat(last.valid & first.valid, n, axis=0), block.valid]),
        rate_hz=block.rate_hz,
        channel_offset_s=block.channel_offset_s,
        late=np.concatenate([np.repeat(first.late, n), block.late]),
    )
