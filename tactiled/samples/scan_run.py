"""Timed scan frames of one board, and their conversion to readings in the unit of the array."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from tactiled.samples.block import FloatArray, ScanBlock
from tactiled.wire.frames import Hello, Scan


class TimedScan(NamedTuple):
    """Frame of a scan with what counting and timing say of it; `number` is its index in a `ScanBlock`."""

    frame: Scan
    number: int
    time_s: float
    time_sd_s: float
    late: bool


@dataclass(frozen=True, eq=False)
class Conversion:
    """Conversion of the frames of a board to readings, from its hello.

    Attributes
    ----------
    per_count : float
        Unit of the array for each count of the frames.
    full_count : int
        Largest count of the converter: the true reading may be higher.
    channel_offset_s : (channels,) float64
        As in `ScanBlock`.
    fault_flag : int
        Flag of a frame none of whose readings is valid; 0 where the layout has none.
    in_range : callable, optional
        Returns True for the readings that are not saturated, where frames carry readings in a unit.
    """

    hello: Hello
    per_count: float
    full_count: int
    channel_offset_s: FloatArray
    fault_flag: int
    in_range: Callable[[FloatArray], NDArray[np.bool_]] | None

    def readings(self, frames: Sequence[Scan]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the readings (frames, channels), and which of them are valid."""
        counts = np.array([frame.counts for frame in frames])
        # At full scale the true voltage may be higher; zero is a valid reading without contact.
        if self.in_range is None:
            valid = counts < self.full_count
        else:
            valid = self.in_range(counts)
            counts = np.where(np.isfinite(counts), counts, 0.0)
        if self.fault_flag:
            sound = [not frame.flags & self.fault_flag for frame in frames]
            if not all(sound):
                valid &= np.array(sound)[:, np.newaxis]
        return np.asarray(counts * self.per_count, dtype=np.float64), valid


@dataclass(frozen=True, eq=False)
class ScanRun:
    """One or more consecutive scans of one board, before they are a block; never straddles a gap."""

    scans: list[TimedScan]
    conversion: Conversion

    @classmethod
    def of(cls, runs: Sequence[Self]) -> Self:
        """Return consecutive runs of one board as one."""
        return runs[0] if len(runs) == 1 else cls([s for run in runs for s in run.scans], runs[0].conversion)

    def rows(self) -> list[tuple[tuple[float, ...], tuple[bool, ...]]]:
        """Return the readings of each scan, and which of them are valid."""
        conversion = self.conversion
        if len(self.scans) == 1 and conversion.in_range is None:
            # As `Conversion.readings` has it, without small arrays, for whose time a subscriber would wait.
            frame = self.scans[0].frame
            if not frame.flags & conversion.fault_flag:
                counts: list[int] = frame.counts.tolist()
                per_count, full_count = conversion.per_count, conversion.full_count
                volts = tuple([count * per_count for count in counts])
                return [(volts, tuple([count < full_count for count in counts]))]
        of_all, are_valid = self._readings
        pairs = zip(of_all.tolist(), are_valid.tolist(), strict=True)
        return [(tuple(volts), tuple(valid)) for volts, valid in pairs]

    def block(self) -> ScanBlock:
        """Return the scans as a block."""
        scans = self.scans
        volts, valid = self._readings
        return ScanBlock(
            volts=volts,
            time_s=np.array([scan.time_s for scan in scans]),
            time_sd_s=np.array([scan.time_sd_s for scan in scans]),
            index=np.arange(scans[0].number, scans[0].number + len(scans), dtype=np.int64),
            valid=valid,
            rate_hz=self.conversion.hello.rate_hz,
            channel_offset_s=self.conversion.channel_offset_s,
            late=np.array([scan.late for scan in scans], dtype=np.bool_),
        )

    @cached_property
    def _readings(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        return self.conversion.readings([scan.frame for scan in self.scans])
