"""What one scan can tell of a slip: which way, which taxels, how much they agree."""

from dataclasses import dataclass, replace

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.detect.slip.direction import direction
from tactiled.detect.slip.evidence import ShearEvidence, ShearGrowth
from tactiled.detect.slip.limit import START_SCANS, FrictionLimitTest
from tactiled.detect.slip.response import PRESSURE, motion, moved
from tactiled.detect.slip.stretch import TaxelSetSegment
from tactiled.events.types import UNKNOWN_SD_DEG
from tactiled.samples.block import ScanBlock

_TAKES_PART = 0.5  # of the mean of those that move along: what moves less may be leak


@dataclass(frozen=True)
class SlipDescription:
    """Of a change of the response.

    Attributes
    ----------
    direction_deg, direction_sd_deg : float
    confidence : float
    taxels : tuple of int
    """

    direction_deg: float
    direction_sd_deg: float
    confidence: float
    taxels: tuple[int, ...]

    def with_half_confidence(self) -> "SlipDescription":
        """Of a contact whose beginning, or a slip whose course nobody saw: half the confidence."""
        return replace(self, confidence=self.confidence / 2)


class ScanEvidence:
    """A scan with the scans before it.

    Parameters
    ----------
    array : Array
    evidence : ShearEvidence
    block : ScanBlock
    stretch : TaxelSetSegment
        Of the block, with the scan in it.
    row : int
        The scan's, in the stretch.
    index : int
        The scan's, since the detector began.

    Attributes
    ----------
    seen : (window, 7) float64
        Responses, newest last.
    steps : (window, channels) float64
        The readings that they are of.
    """

    def __init__(
        self,
        array: Array,
        evidence: ShearEvidence,
        block: ScanBlock,
        stretch: TaxelSetSegment,
        row: int,
        index: int,
    ) -> None:
        self._array, self._evidence, self._block = array, evidence, block
        self.index = index
        self.scan = stretch.scans.start + row
        self.seen = stretch.seen[row : row + evidence.window]
        self.steps = stretch.steps[row : row + evidence.window]

    @property
    def time_s(self) -> float:
        return float(self._block.time_s[self.scan])

    @property
    def rate_hz(self) -> float:
        return self._block.rate_hz

    @property
    def time_sd_s(self) -> float:
        return float(self._block.time_sd_s[self.scan])

    @property
    def is_late(self) -> bool:
        return bool(self._block.late[self.scan])

    @property
    def shear(self) -> FloatArray:
        """Motion (3,) over pressure."""
        return motion(self.seen[-1]) / max(float(self.seen[-1, PRESSURE]), 1.0)

    def ago(self, scans: float) -> int:
        """Row of `seen` that is so long before the newest, at most the oldest."""
        return -1 - int(min(max(round(scans), 0), len(self.seen) - 1))

    def without_skew(self, growth: ShearGrowth, delay: float) -> ShearGrowth:
        """What grew since so many scans ago, as if the channels of a taxel were sampled at one instant."""
        return self._evidence.without_skew(growth, delay, self._block.channel_offset_s * self.rate_hz)

    def skew_s(self, along: FloatArray) -> float:
        """How long after the scan began its channels were sampled, on the average of their weights."""
        weights = np.abs(along @ motion(self._evidence.weights.T).T)
        return float(np.average(self._block.channel_offset_s, weights=weights)) if weights.any() else 0.0

    def along(self, scans: float) -> FloatArray:
        """Unit vector (3,) of the change since so long ago; zero where nothing changed."""
        change = moved(self.seen[self.ago(scans)], self.seen[-1])
        size = float(np.sqrt((change**2).sum()))
        return change / size if size > 0 else change

    def changed(self, scans: float) -> FloatArray:
        """Change (channels,) of the readings since so long ago."""
        return np.asarray(self.steps[-1] - self.steps[self.ago(scans)])

    def limit(self, scans: float) -> FrictionLimitTest:
        """Of a shear that began to grow so long ago."""
        began = len(self.steps) + self.ago(scans)
        start = self.steps[max(0, began + 1 - START_SCANS) : began + 1].mean(axis=0)
        return self._evidence.limit(start, self._block.channel_offset_s * self._block.rate_hz)

    def describe_change(self, along: FloatArray, change: FloatArray) -> SlipDescription:
        """About a change of the readings (channels,) that is one along a unit vector (3,)."""
        shares = self._evidence.shares(along, change)
        agreement = max(0.0, float(shares.sum())) / max(float(np.abs(shares).sum()), 1.0)
        response = self._evidence.weights @ change
        opposed, common = float(np.sqrt((motion(response) ** 2).sum())), abs(float(response[PRESSURE]))
        part = shares >= _TAKES_PART * max(float(np.maximum(shares, 0.0).mean()), 1.0)
        if self._array.has_shear:
            direction_deg, direction_sd_deg = direction(self._evidence, along, change, self.seen[-1])
        else:
            direction_deg, direction_sd_deg = 0.0, UNKNOWN_SD_DEG
        return SlipDescription(
            direction_deg,
            direction_sd_deg,
            agreement * opposed / max(opposed + common, 1.0),
            tuple(np.flatnonzero(part).tolist()),
        )
