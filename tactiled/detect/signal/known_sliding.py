"""Sliding that is known from outside, in place of a slip detector's events."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tactiled.events.types import UNKNOWN_SD_DEG, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock


@dataclass(frozen=True)
class KnownSliding:
    """Interval in which the skin is known to slide, in the clock of the scans."""

    from_s: float = -np.inf
    to_s: float = np.inf


class GatedEstimator(Protocol):
    """Estimator that slip events start and stop."""

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        ...

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Set the sliding speed from scan `from_index` on."""
        ...

    def process(self, item: ScanBlock | Gap, slip: Sequence[Event] = ()) -> list[Event]:
        """Return the events that the item completes."""
        ...

    def expect_late_fit(self, due_index: int) -> None:
        """Treat the fit that is due at a scan as not ready."""
        ...

    def take_late_fits(self) -> list[int]:
        """Return the due scans of the fits that were not ready since the last call."""
        ...


class KnownSlidingTexture:
    """Texture estimator that is started and stopped by a known interval; slip events are ignored."""

    def __init__(self, texture: GatedEstimator, sliding: KnownSliding) -> None:
        self._texture = texture
        self._sliding = sliding
        self._slides = False

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._slides = False
        self._texture.reset()

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Set the sliding speed from scan `from_index` on."""
        self._texture.set_speed(speed_mm_s, from_index)

    def expect_late_fit(self, due_index: int) -> None:
        """Treat the fit that is due at a scan as not ready."""
        self._texture.expect_late_fit(due_index)

    def take_late_fits(self) -> list[int]:
        """Return the due scans of the fits that were not ready since the last call."""
        return self._texture.take_late_fits()

    def process(self, item: ScanBlock | Gap, slip: Sequence[Event] = ()) -> list[Event]:  # noqa: ARG002
        """Return the events that the item completes; sliding goes on after a gap."""
        if isinstance(item, Gap):
            self._slides = False
            return self._texture.process(item)
        return self._texture.process(item, self._changes(item))

    def _changes(self, block: ScanBlock) -> list[SlipEvent]:
        first = int(np.searchsorted(block.time_s, self._sliding.from_s))
        last = int(np.searchsorted(block.time_s, self._sliding.to_s))
        changes = []
        if not self._slides and first < min(last, len(block)):
            changes.append(_change(float(block.time_s[first]), is_onset=True))
            self._slides = True
        if self._slides and last < len(block):
            changes.append(_change(float(block.time_s[last]), is_onset=False))
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
