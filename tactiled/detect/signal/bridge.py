"""Linear interpolation over short gaps, so that a lost scan does not hide a slip beside it.

A gap empties every filter, and a detector is blind until they are full again: a third of a second for one
lost scan. Up to `BRIDGE_S` of missing scans are therefore interpolated linearly between the last reading
before the gap and the first after it, and the detectors see no gap. Longer gaps, restarts and replugs reach
the detectors, because the signal in them is unknown. Interpolated scans are never published, recorded or
counted.
"""

from dataclasses import replace

import numpy as np

from tactiled.samples.block import LOSSES, Gap, ScanBlock

# prior: the onset of a slip bends the signal for longer; corruption seldom lasts so long. A channel whose
# last good reading stands in for longer takes its taxel out (`front_end`).
BRIDGE_S = 0.05


class GapBridge:
    """Put interpolated scans in place of short gaps."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything seen."""
        self._last: ScanBlock | None = None
        self._gap: Gap | None = None  # after it, which may be bridged

    def process(self, item: ScanBlock | Gap) -> ScanBlock | Gap | None:
        """Return the item, None for a short gap, or the block after one with the missing scans before it."""
        last = self._last
        if isinstance(item, ScanBlock):
            self._last, gap, self._gap = item, self._gap, None
            return _joined(last, item) if gap is not None and last is not None else item
        if self._gap is not None and item.cause in LOSSES:
            item = replace(item, n_missing=self._gap.n_missing + item.n_missing)
        if last is not None and item.cause in LOSSES and 0 < item.n_missing <= BRIDGE_S * last.rate_hz:
            self._gap = item
            return None
        self._last = self._gap = None
        return item


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
