"""Recordings of a held object: lost scans, times of contact, noise of each channel."""

from array import array as buffer
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.contact_gate import ContactTracker
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.wang2019.slip import PUBLISHED_CONTACT
from tactiled.errors import DataError
from tactiled.events.types import ScanEvent
from tactiled.samples.block import Gap, GapCause, ScanBlock

# A shorter contact shows less than the model needs: 0.6 s for its zero, then a second to settle.
LEAST_S = 4.0
LOADING_S = 1.0  # after first contact, excluded from the hold: the press itself, and creep of the skin


@dataclass(frozen=True, eq=False)
class Recording:
    """Scans of one hold."""

    name: str  # name in the report: a file name, or "quiet hold"
    array: Array
    items: tuple[ScanBlock | Gap, ...]

    @property
    def blocks(self) -> list[ScanBlock]:
        """Blocks without the gaps."""
        return [item for item in self.items if isinstance(item, ScanBlock)]

    @property
    def seconds(self) -> float:
        """Duration of all blocks."""
        return sum(len(block) / block.rate_hz for block in self.blocks)

    @property
    def lost(self) -> int:
        """Number of missing scans."""
        return sum(item.n_missing for item in self.items if isinstance(item, Gap))

    @property
    def late(self) -> int:
        """Number of late scans."""
        return sum(int(block.late.sum()) for block in self.blocks)

    def touching_s(self) -> float:
        """Total time in which some taxel was in contact (s)."""
        return sum(float(touching(b, self.array).sum()) / b.rate_hz for b in self.blocks)


class Collector:
    """Compact collector of published scans, in order; hours of scans fit into memory."""

    def __init__(self, array: Array) -> None:
        self._array = array
        self._numbers = buffer("d")  # time, its sigma, volts
        self._flags = bytearray()  # late, valid
        self._index = buffer("q")

    def __len__(self) -> int:
        return len(self._index)

    def add(self, scan: ScanEvent) -> None:
        """Append the next scan."""
        self._index.append(scan.index)
        self._numbers.extend((scan.time_s, scan.time_sd_s, *scan.volts))
        self._flags.extend((scan.late, *scan.valid))

    def recording(self, name: str, rate_hz: float, channel_offset_s: Sequence[float]) -> Recording:
        """Return all scans as a recording, with a gap where scan numbers jump."""
        n = len(self)
        numbers = np.frombuffer(self._numbers.tobytes()).reshape(n, 2 + self._array.n_channels)
        flags = np.frombuffer(bytes(self._flags), dtype=np.bool_).reshape(n, 1 + self._array.n_channels)
        index = np.frombuffer(self._index.tobytes(), dtype=np.int64)
        items: list[ScanBlock | Gap] = []
        starts = [0, *(np.flatnonzero(np.diff(index) != 1) + 1).tolist()] if n else []
        for start, end in zip(starts, [*starts[1:], n], strict=True):
            if start:
                missing = int(index[start] - index[start - 1]) - 1
                cause: GapCause = "missing" if missing > 0 else "restart"
                items.append(Gap(max(missing, 0), cause, int(index[start])))
            items.append(
                ScanBlock(
                    volts=numbers[start:end, 2:],
                    time_s=numbers[start:end, 0],
                    time_sd_s=numbers[start:end, 1],
                    index=index[start:end],
                    valid=flags[start:end, 1:],
                    rate_hz=rate_hz,
                    channel_offset_s=np.array(channel_offset_s, dtype=np.float64),
                    late=flags[start:end, 0],
                )
            )
        return Recording(name, self._array, tuple(items))


def touching(block: ScanBlock, array: Array) -> NDArray[np.bool_]:
    """Flags (n,) of scans in which some taxel is above the contact threshold."""
    tracker = ContactTracker(array, PUBLISHED_CONTACT, block.rate_hz)
    return tracker.measure(block, Quantiser(array).process(block)).touches


def quiet_part(recording: Recording) -> Recording:
    """Cut out the longest contact of a recording, without its first second.

    Raises
    ------
    DataError
        There is no contact, or it is too short.
    """
    best, held_s = None, 0.0
    for block in recording.blocks:
        touches = np.concatenate([[False], touching(block, recording.array), [False]])
        for start, stop in np.flatnonzero(np.diff(touches.astype(np.int8))).reshape(-1, 2).tolist():
            loaded = start + round(LOADING_S * block.rate_hz)
            if (stop - loaded) / block.rate_hz > held_s:
                best, held_s = block[loaded:stop], (stop - loaded) / block.rate_hz
    if best is None or held_s < LEAST_S:
        raise DataError(f"{recording.name}: {_too_short(recording, held_s)}")
    return Recording(recording.name, recording.array, (best,))


def check_motion(recording: Recording) -> float:
    """Return the time in contact (s); raise `DataError` where it is too little."""
    held_s = recording.touching_s()
    if held_s < LEAST_S:
        raise DataError(f"{recording.name}: {_too_short(recording, held_s)}")
    return held_s


def _too_short(recording: Recording, held_s: float) -> str:
    least_v = PUBLISHED_CONTACT.contact_volts
    if not recording.touching_s():
        return (
            f"no contact in {recording.seconds:.1f} s (no taxel above {least_v:g} V): grip an object and "
            "hold it for the whole recording"
        )
    return (
        f"{held_s:.1f} s of unbroken contact in {recording.seconds:.1f} s, at least {LEAST_S:g} s are needed "
        f"({recording.lost} scans lost): hold the object longer, or check the line (tactiled doctor)"
    )


def noise_sd_v(quiet: Recording) -> FloatArray:
    """Noise (channels,) of the readings in volts rms; NaN where a channel is never valid.

    Standard deviation of scan-to-scan differences over root two, insensitive to creep and drift; then the
    median over windows of one second, insensitive to single knocks. ADC quantisation is included.
    """
    seconds: list[FloatArray] = []
    for block in quiet.blocks:
        n = max(2, round(block.rate_hz))
        change = np.where(block.valid[1:] & block.valid[:-1], np.diff(block.volts, axis=0), np.nan)
        for k in range(0, len(change) - n + 1, n):
            part = change[k : k + n]
            enough = np.isfinite(part).sum(axis=0) > n // 2
            sd = np.full(part.shape[1], np.nan)
            sd[enough] = np.nanstd(part[:, enough], axis=0) / np.sqrt(2)
            seconds.append(sd)
    table = np.array(seconds).reshape(len(seconds), quiet.array.n_channels)
    known = np.isfinite(table).any(axis=0)
    floor = np.full(quiet.array.n_channels, np.nan)
    floor[known] = np.nanmedian(table[:, known], axis=0)
    return floor
