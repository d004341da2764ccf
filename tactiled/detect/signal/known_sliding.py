"""Sliding that is known from outside, in place of a slip detector's events."""

from dataclasses import dataclass

import numpy as np

from tactiled.events.types import UNKNOWN_SD_DEG, SlipEvent
from tactiled.samples.block import Gap, ScanBlock


@dataclass(frozen=True)
class KnownSliding:
    """Interval in which the skin is known to slide, in the clock of the scans."""

    from_s: float = -np.inf
    to_s: float = np.inf


class KnownSlips:
    """Slip events of a known interval, for the texture estimator alone; sliding goes on after a gap."""

    def __init__(self, sliding: KnownSliding) -> None:
        self._sliding = sliding
        self.reset()

    def reset(self) -> None:
        """Forget everything seen."""
        self._slides = False

    def process(self, item: ScanBlock | Gap) -> list[SlipEvent]:
        """Return onset and end that lie in the item."""
        if isinstance(item, Gap):
            self._slides = False
            return []
        first = int(np.searchsorted(item.time_s, self._sliding.from_s))
        last = int(np.searchsorted(item.time_s, self._sliding.to_s))
        changes = []
        if not self._slides and first < min(last, len(item)):
            changes.append(_change(float(item.time_s[first]), is_onset=True))
            self._slides = True
        if self._slides and last < len(item):
            changes.append(_change(float(item.time_s[last]), is_onset=False))
            self._slides = False
        return changes


def _change(time_s: float, *, is_onset: bool) -> SlipEvent:
    return SlipEvent(
        time_s=time_s,
        state="onset" if is_onset else "end",
        kind="gross",
        onset_s=time_s,
        onset_sd_s=0.0,
        direction_deg=0.0,
        direction_sd_deg=UNKNOWN_SD_DEG,
        confidence=1.0,
        taxels=(),
        detector="given",
        statistic=0.0,
        threshold=0.0,
        valid=True,
        detected_s=time_s,
    )
