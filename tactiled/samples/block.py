"""Input of the detectors: blocks of consecutive scans, and the gaps between them."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import ContractError

FloatArray = NDArray[np.float64]
GapCause = Literal["corrupt", "missing", "restart", "disconnect", "rate", "start", "command"]


@dataclass(frozen=True, eq=False)
class ScanBlock:
    """One or more consecutive scans; never straddles a gap.

    Attributes
    ----------
    volts : (n, channels) float64
        Readings; NaN where the source had no number.
    time_s : (n,) float64
        Estimated instant at which each scan began (host monotonic clock, or the file's own).
    time_sd_s : (n,) float64
        Standard deviation of that estimate.
    index : (n,) int64
        Scan number since the source began, unwrapped; consecutive inside a block.
    valid : (n, channels) bool
        False where a reading is saturated, dead or flagged, so that no conclusion may rest on it.
    rate_hz : float
        Nominal scan rate.
    channel_offset_s : (channels,) float64
        Delay from the beginning of the scan to the sampling of each channel.
    late : (n,) bool
        True for scans that were delivered long after their instant (backlog behind a stall): recorded, but
        too old to act on.
    """

    volts: FloatArray
    time_s: FloatArray
    time_sd_s: FloatArray
    index: NDArray[np.int64]
    valid: NDArray[np.bool_]
    rate_hz: float
    channel_offset_s: FloatArray
    late: NDArray[np.bool_]

    def __post_init__(self) -> None:
        n = len(self.volts)
        lengths = {len(self.time_s), len(self.time_sd_s), len(self.index), len(self.valid), len(self.late)}
        if n < 1 or lengths != {n} or self.volts.shape != self.valid.shape:
            raise ContractError(f"a ScanBlock's parts differ in length: {n} scans, {sorted(lengths)}")
        channels = self.volts.shape[1:]
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
    """Missing scans between two blocks, or before the first.

    Attributes
    ----------
    n_missing : int
        Number of missing scans; 0 where it cannot be known (restart).
    cause : str
        ``"corrupt"`` (bytes arrived damaged), ``"missing"`` (bytes never arrived), ``"restart"`` (the
        board rebooted or counts anew), ``"disconnect"``, ``"rate"`` (the rate was changed), ``"start"``,
        ``"command"`` (a command changed the zero or the thresholds).
    index : int
        Index of the first scan after the gap.
    """

    n_missing: int
    cause: GapCause
    index: int


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
