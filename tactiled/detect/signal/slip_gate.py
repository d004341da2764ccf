"""Selection of scans for texture estimators: those of a settled slip, each with its sliding speed."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tactiled.array import FloatArray
from tactiled.events.types import UNKNOWN_SD_DEG, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock


@dataclass(frozen=True)
class SlipStart:
    """Start of a slip, at the index of a scan; scans kept from an earlier slip are no longer used."""

    index: int


@dataclass(frozen=True)
class SlipEnd:
    """End of a slip, at the time of a scan."""

    time_s: float
    rate_hz: float


@dataclass(frozen=True, eq=False)
class SlidingScans:
    """Scans of a slip, with the speed from each scan to the next: (n,), 0 where unknown.

    `are_past` says that they came before the slip was detected.
    """

    block: ScanBlock
    speeds_mm_s: FloatArray
    are_past: bool = False


class SlipGate:
    """Select the scans of slips from a stream, with the sliding speeds that were set.

    Parameters
    ----------
    settle_s : float
        Time from detected slip to the first scan that is passed on.
    speed_mm_s : float
        Speed until another is set.
    looks_back_s : float
        Time before the detection of a slip whose scans are passed on, as far as the slip was then under way.

    Attributes
    ----------
    slip : SlipEvent or None
        Newest onset event of the current slip.
    speed_mm_s : float
        Speed at the newest scan.
    """

    def __init__(self, settle_s: float, speed_mm_s: float, looks_back_s: float = 0.0) -> None:
        self.slip: SlipEvent | None = None
        self.speed_mm_s = speed_mm_s
        self._settle_s = settle_s
        self._speeds: list[tuple[int, float]] = []
        self._begin_index = 0
        self._looks_back_s = looks_back_s
        self._past: deque[tuple[ScanBlock, FloatArray]] = deque()

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Set the speed from a scan on (from the next scan, if that one is past)."""
        self._speeds.append((from_index, speed_mm_s))
        self._speeds.sort(key=lambda entry: entry[0])

    def close(self) -> None:
        """Wait for the next onset of slip, as after a gap."""
        self.slip = None
        self._past.clear()

    def pass_through(
        self, block: ScanBlock, slip: Sequence[Event]
    ) -> Iterator[SlipStart | SlipEnd | SlidingScans]:
        """Yield the starts, sliding scans and ends of slips in a block, in order.

        Parameters
        ----------
        slip : sequence of Event
            Events of the slip detector for the block; other topics are ignored.
        """
        done, speeds = 0, self._speeds_of(block)
        for change in slip:
            if not isinstance(change, SlipEvent):
                continue
            scan = min(int(np.searchsorted(block.time_s, change.detected_s)), len(block) - 1)
            if scan > done:
                yield from self._slid(block[done:scan], speeds[done:scan])
                done = scan
            if change.state == "onset":
                self.slip = change
                self._begin_index = int(block.index[scan]) + round(self._settle_s * block.rate_hz)
                yield SlipStart(int(block.index[scan]))
                yield from self._before(change, block, speeds, scan)
            elif self.slip is not None:
                yield SlipEnd(float(block.time_s[scan]), block.rate_hz)
                self.slip = None
        yield from self._slid(block[done:], speeds[done:])
        self._keep(block, speeds)

    def _keep(self, block: ScanBlock, speeds: FloatArray) -> None:
        """Keep the scans that a late detection may need."""
        if not self._looks_back_s:
            return
        self._past.append((block, speeds))
        first = int(block.index[-1]) - round(self._looks_back_s * block.rate_hz)
        while self._past[0][0].index[-1] < first:
            self._past.popleft()

    def _before(
        self, slip: SlipEvent, block: ScanBlock, speeds: FloatArray, scan: int
    ) -> Iterator[SlidingScans]:
        """Yield the scans before a detection in which the slip was under way for the settling time."""
        if not self._looks_back_s:
            return
        from_s = slip.onset_s + max(slip.onset_sd_s, self._settle_s)
        from_s = max(from_s, slip.detected_s - self._looks_back_s)
        if from_s >= slip.detected_s:
            return
        self._begin_index = int(block.index[scan])
        for old, own in [*self._past, *([(block[:scan], speeds[:scan])] if scan else [])]:
            first = int(np.searchsorted(old.time_s, from_s))
            if first < len(old):
                yield SlidingScans(old[first:], own[first:], are_past=True)

    def _slid(self, block: ScanBlock, speeds: FloatArray) -> Iterator[SlidingScans]:
        if self.slip is None:
            return
        wait = max(0, self._begin_index - int(block.index[0]))
        if wait < len(block):
            yield SlidingScans(block[wait:], speeds[wait:])

    def _speeds_of(self, block: ScanBlock) -> FloatArray:
        if not self._speeds:
            return np.full(len(block), self.speed_mm_s)
        starts = np.array([index for index, _ in self._speeds], dtype=np.int64)
        values = np.array([self.speed_mm_s, *(speed for _, speed in self._speeds)])
        speeds = values[np.searchsorted(starts, block.index, side="right")]
        self.speed_mm_s = float(speeds[-1])
        self._speeds = [entry for entry in self._speeds if entry[0] > block.index[-1]]
        return np.asarray(speeds)


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
