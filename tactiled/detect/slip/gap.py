"""Detection of a slip inside a gap, from the readings before and after it.

While a contact holds, its shear is constant, or changes in proportion to the pressure. If the shear after a
gap in mid-contact differs by more, either a slip or a load without slip happened inside the gap; readings
cannot tell which. For a grasp controller a missed slip is worse than a false one, so a slip is reported, with
a standard deviation of the onset of half the gap and with half the confidence.
"""

from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.slip.evidence import ShearEvidence
from tactiled.detect.slip.gross import NOISE_SDS
from tactiled.detect.slip.response import PRESSURE, motion

LOOK_SCANS = 8  # averaged before and after the gap
# Of shear over pressure: a tenth of the contact slips at a friction of 0.4, creep of a held load is far less.
_LEAST = 0.1
# Twice what `slip.evidence` asks of a rise: in a gap pressure and shear may have changed one after the other.
_LEAKED_PART = 0.5
_LONGEST_S = 2.0  # longer, and what is held is held anew


class PreGapReadings(NamedTuple):
    """Readings and evidence before a gap.

    Attributes
    ----------
    time_s : float
        Time of the last scan.
    steps : (LOOK_SCANS, channels) float64
        The last readings.
    evidence : ShearEvidence
        Evidence at that time.
    """

    time_s: float
    steps: FloatArray
    evidence: ShearEvidence

    @property
    def readings(self) -> FloatArray:
        """Mean (channels,) of the last readings."""
        return np.asarray(self.steps.mean(axis=0))


class GapShearChange(NamedTuple):
    """Change of shear over a gap.

    Attributes
    ----------
    gap_s : float
    change : (channels,) float64
        Of the readings.
    along : (3,) float64
        Unit vector of the change of shear.
    size : float
        Of that.
    statistic : float
        Its square over its variance, as `slip.evidence` has it.
    """

    gap_s: float
    change: FloatArray
    along: FloatArray
    size: float
    statistic: float


def moved_in_gap(
    before: PreGapReadings, steps: FloatArray, first_s: float, evidence: ShearEvidence, least: float
) -> GapShearChange | None:
    """Return the change of shear over a gap, or None if there was no significant one.

    Parameters
    ----------
    before : PreGapReadings
    steps : (LOOK_SCANS, channels) float64
        The first readings after it.
    first_s : float
        Instant of the first of them.
    evidence : ShearEvidence
        Evidence after the gap.
    least : float
        Shear over pressure of a change that counts.
    """
    gap_s = first_s - before.time_s
    if not 0 < gap_s <= _LONGEST_S:  # 0 or less: the nominal rate, which places the first scan, is wrong
        return None
    if not evidence.taxels.any() or (evidence.taxels & ~before.evidence.taxels).any():
        return None  # a taxel that was not read before has nothing to be compared with
    readings, after = before.readings, steps.mean(axis=0)
    then, now = evidence.weights @ readings, evidence.weights @ after
    if then[PRESSURE] <= 0 or now[PRESSURE] <= 0:
        return None
    pressed = now[PRESSURE] / then[PRESSURE]
    news = motion(now) - motion(then) * pressed
    size = float(np.sqrt((news**2).sum()))
    if size <= 0:
        return None
    along = news / size
    noise = before.evidence.noise(along) * np.sqrt(2 / LOOK_SCANS)
    enough = max(least, _LEAST) * now[PRESSURE]
    if size < max(enough, NOISE_SDS * noise, _LEAKED_PART * abs(now[PRESSURE] - then[PRESSURE])):
        return None
    change = after - readings * pressed
    if not evidence.is_shared(news, change, after):
        return None
    return GapShearChange(gap_s, change, along, size, float((size / noise) ** 2))
