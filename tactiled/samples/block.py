"""Input of the detectors: blocks of consecutive scans and the gaps between them, made from runs of frames."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.errors import ContractError
from tactiled.wire.frames import Hello, Scan

GapCause = Literal["corrupt", "missing", "restart", "disconnect", "rate", "start", "command"]
LOSSES: tuple[GapCause, ...] = ("corrupt", "missing")
"""Causes of gaps during which the board kept scanning."""


@dataclass(
    slots=True, eq=False
)  # not frozen: each read makes one, and one that is frozen takes longer to make
class ScanBlock:
    """One or more consecutive scans; never straddles a gap."""

    volts: FloatArray  # (n, channels): readings; NaN where the source had no number
    # (n,): estimated instant at which each scan began (host monotonic clock, or the file's own)
    time_s: FloatArray
    time_sd_s: FloatArray  # (n,): standard deviation of that estimate
    # (n,): scan number since the source began, unwrapped; consecutive inside a block
    index: NDArray[np.int64]
    # (n, channels): False where a reading is saturated, dead or flagged, so that no conclusion may rest on it
    valid: NDArray[np.bool_]
    rate_hz: float  # nominal scan rate
    # (channels,): delay from the beginning of the scan to the sampling of each channel
    channel_offset_s: FloatArray
    # (n,): True for scans that were delivered long after their instant (backlog behind a stall): recorded,
    # but too old to act on
    late: NDArray[np.bool_]

    def __post_init__(self) -> None:
        shape, n = self.volts.shape, len(self.volts)
        is_even = 0 < n == len(self.time_s) == len(self.time_sd_s) == len(self.index) == len(self.late)
        if not is_even or self.valid.shape != shape:
            parts = self.time_s, self.time_sd_s, self.index, self.valid, self.late
            raise ContractError(f"a ScanBlock's parts differ in length: {n} scans, {[*map(len, parts)]}")
        channels = shape[1:]
        if len(channels) != 1 or self.channel_offset_s.shape != channels or self.valid.dtype != np.bool_:
            raise ContractError(
                f"a ScanBlock has {channels} channels and {self.channel_offset_s.shape} offsets"
            )
        if n > 1 and np.any(np.diff(self.index) != 1):
            raise ContractError("a ScanBlock straddles a gap")

    def __len__(self) -> int:
        return len(self.volts)

    def __getitem__(self, part: slice) -> "ScanBlock":
        """Return consecutive scans of the block, e.g. ``block[3:5]``."""
        if part == slice(None) or part == slice(0, None):
            return self
        return ScanBlock(
            volts=self.volts[part],
            time_s=self.time_s[part],
            time_sd_s=self.time_sd_s[part],
            index=self.index[part],
            valid=self.valid[part],
            rate_hz=self.rate_hz,
            channel_offset_s=self.channel_offset_s,
            late=self.late[part],
        )


@dataclass(frozen=True)
class Gap:
    """Break before a block: scans are missing there, or those before belong to another run or setting."""

    n_missing: int  # 0 where none is missing, or where the number is not known (restart)
    # ``"corrupt"`` (bytes arrived damaged), ``"missing"`` (bytes never arrived), ``"restart"`` (the board
    # rebooted or counts anew), ``"disconnect"``, ``"rate"`` (the rate was changed), ``"start"``,
    # ``"command"`` (a command changed the zero or the thresholds)
    cause: GapCause
    index: int  # of the first scan after the gap


def regular_block(
    volts: FloatArray,
    rate_hz: float,
    *,
    start_s: float = 0.0,
    index: int = 0,
    channel_offset_s: FloatArray | None = None,
    valid: NDArray[np.bool_] | None = None,
) -> ScanBlock:
    """Make a block of evenly timed scans, for data of files and tests.

    Parameters
    ----------
    volts : (n, channels) float64
        NaN readings are marked invalid.
    start_s : float
        Instant of scan ``index``.
    """
    volts = np.ascontiguousarray(volts, dtype=np.float64)
    n, channels = volts.shape
    numbers = np.arange(index, index + n, dtype=np.int64)
    return ScanBlock(
        volts=volts,
        time_s=start_s + (numbers - index) / rate_hz,
        time_sd_s=np.zeros(n),
        index=numbers,
        valid=np.isfinite(volts) if valid is None else valid & np.isfinite(volts),
        rate_hz=rate_hz,
        channel_offset_s=np.zeros(channels) if channel_offset_s is None else channel_offset_s,
        late=np.zeros(n, dtype=np.bool_),
    )


class TimedScan(NamedTuple):
    """Frame of a scan with what counting and timing say of it; `number` is its index in a `ScanBlock`."""

    frame: Scan
    number: int
    time_s: float
    time_sd_s: float
    late: bool


@dataclass(frozen=True, eq=False)
class Conversion:
    """Conversion of the frames of a board to readings, from its hello."""

    hello: Hello
    per_count: float  # unit of the array for each count of the frames
    # (channels,): least count that is no reading. That is the largest of the converter, beyond which the load
    # may be higher; one more for channels that fall under load, which rest there. None: frames carry units
    full_count: NDArray[np.int64] | None
    channel_offset_s: FloatArray  # (channels,): as in `ScanBlock`
    fault_flag: int  # flag of a frame none of whose readings is valid; 0 where the layout has none
    # Returns True for the readings in the range of the array, and neither saturated nor NaN
    in_range: Callable[[FloatArray], NDArray[np.bool_]]

    def readings(self, frames: Sequence[Scan]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the readings (frames, channels), and which of them are valid."""
        counts = np.array([frame.counts for frame in frames])
        readings = np.asarray(counts * self.per_count, dtype=np.float64)
        valid = self.in_range(readings)
        if self.full_count is None:
            readings = np.where(np.isfinite(readings), readings, np.nan)
        else:
            valid = valid & (counts < self.full_count)
        if self.fault_flag:
            sound = [not frame.flags & self.fault_flag for frame in frames]
            if not all(sound):
                valid &= np.array(sound)[:, np.newaxis]
        return readings, valid


class ScanRun:
    """One or more consecutive scans of one board, before they are a block; never straddles a gap."""

    def __init__(self, scans: list[TimedScan], conversion: Conversion) -> None:
        self.scans, self.conversion = scans, conversion
        self._readings: tuple[FloatArray, NDArray[np.bool_]] | None = None

    @classmethod
    def of(cls, runs: Sequence[Self]) -> Self:
        """Return consecutive runs of one board as one."""
        return runs[0] if len(runs) == 1 else cls([s for run in runs for s in run.scans], runs[0].conversion)

    def readings(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the readings (scans, channels), and which of them are valid."""
        if self._readings is None:
            self._readings = self.conversion.readings([scan.frame for scan in self.scans])
        return self._readings

    def rows(self) -> list[tuple[tuple[float, ...], tuple[bool, ...]]]:
        """Return the readings of each scan, and which of them are valid."""
        of_all, are_valid = self.readings()
        if self.conversion.full_count is None:  # readings in a unit need not be finite, as messages must
            of_all = np.where(np.isfinite(of_all), of_all, 0.0)
        return list(zip(map(tuple, of_all.tolist()), map(tuple, are_valid.tolist()), strict=True))

    def block(self) -> ScanBlock:
        """Return the scans as a block."""
        scans = self.scans
        volts, valid = self.readings()
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
