"""Direction, taxels and confidence of a slip, from one scan and those before it."""

from dataclasses import dataclass, replace

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.detect.slip.direction import direction
from tactiled.detect.slip.evidence import ShearEvidence, ShearGrowth
from tactiled.detect.slip.friction_limit import START_SCANS, FrictionLimitTest
from tactiled.detect.slip.response import PRESSURE, motion, moved
from tactiled.detect.slip.segments import TaxelSetSegment
from tactiled.events.types import UNKNOWN_SD_DEG
from tactiled.samples.block import ScanBlock

_TAKES_PART = 0.5  # of the mean of those that move along: what moves less may be leak


@dataclass(frozen=True)
class SlipDescription:
    """Direction, confidence and taxels of a change of the response.

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
        """Return a copy with half the confidence, for a contact or slip whose beginning was not observed."""
        return replace(self, confidence=self.confidence / 2)


class ScanEvidence:
    """One scan in its window of earlier scans, with the measurements that slip events need.

    Parameters
    ----------
    array : Array
    evidence : ShearEvidence
    block : ScanBlock
    segment : TaxelSetSegment
        Segment of the block that holds the scan.
    row : int
        Row of the scan in the segment.
    index : int
        Number of the scan since the detector started.

    Attributes
    ----------
    seen : (window, 7) float64
        Responses, newest last.
    steps : (window, channels) float64
        Readings of these responses.
    """

    def __init__(
        self,
        array: Array,
        evidence: ShearEvidence,
        block: ScanBlock,
        segment: TaxelSetSegment,
        row: int,
        index: int,
    ) -> None:
        self._array, self._evidence, self._block = array, evidence, block
        self.index = index
        self.scan = segment.scans.start + row
        self.seen = segment.seen[row : row + evidence.window]
        self.steps = segment.steps[row : row + evidence.window]

    @property
    def time_s(self) -> float:
        """Time of the scan."""
        return float(self._block.time_s[self.scan])

    @property
    def rate_hz(self) -> float:
        """Scan rate."""
        return self._block.rate_hz

    @property
    def time_sd_s(self) -> float:
        """Standard deviation of the time of the scan."""
        return float(self._block.time_sd_s[self.scan])

    @property
    def is_late(self) -> bool:
        """True if the scan arrived late."""
        return bool(self._block.late[self.scan])

    @property
    def shear(self) -> FloatArray:
        """Shear response (3,) over pressure."""
        return motion(self.seen[-1]) / max(float(self.seen[-1, PRESSURE]), 1.0)

    def ago(self, scans: float) -> int:
        """Return the row of `seen` that is `scans` before the newest, at most the oldest."""
        return -1 - int(min(max(round(scans), 0), len(self.seen) - 1))

    def without_skew(self, growth: ShearGrowth, delay: float) -> ShearGrowth:
        """Correct a growth that began `delay` scans ago for the sampling skew within each taxel."""
        return self._evidence.without_skew(growth, delay, self._block.channel_offset_s * self.rate_hz)

    def skew_s(self, along: FloatArray) -> float:
        """Return the mean sampling time of the channels after the start of the scan, by weight."""
        weights = np.abs(along @ motion(self._evidence.weights.T).T)
        return float(np.average(self._block.channel_offset_s, weights=weights)) if weights.any() else 0.0

    def along(self, scans: float) -> FloatArray:
        """Return the unit vector (3,) of the change over the last `scans`; zero if nothing changed."""
        change = moved(self.seen[self.ago(scans)], self.seen[-1])
        size = float(np.sqrt((change**2).sum()))
        return change / size if size > 0 else change

    def changed(self, scans: float) -> FloatArray:
        """Return the change (channels,) of the readings over the last `scans`."""
        return np.asarray(self.steps[-1] - self.steps[self.ago(scans)])

    def limit(self, scans: float) -> FrictionLimitTest:
        """Make the friction limit test of a shear that began to grow `scans` ago."""
        began = len(self.steps) + self.ago(scans)
        start = self.steps[max(0, began + 1 - START_SCANS) : began + 1].mean(axis=0)
        return self._evidence.limit(start, self._block.channel_offset_s * self._block.rate_hz)

    def describe_change(self, along: FloatArray, change: FloatArray) -> SlipDescription:
        """Describe a change of the readings (channels,) along a unit vector (3,)."""
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
