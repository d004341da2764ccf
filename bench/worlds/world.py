"""One drawn contact scene, with its truth at every scan."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.samples.block import ScanBlock

INCIPIENT_USED = 1 - 0.9**1.5  # a tenth of a ball's area slips: sticking share (1 - u)^(2/3)


@dataclass(frozen=True, eq=False)
class World:
    """One drawn scene with its truth at every scan."""

    generator: str
    hand: str  # what it does
    seed: int
    rate_hz: float
    array: Array
    block: ScanBlock
    # (n,): shear of all places of the contact over what they bear; 1 while all of it slides, 0 without
    # contact
    utilisation: FloatArray
    gross: NDArray[np.bool_]  # (n,): all of the contact slides
    gross_s: list[float]  # instants at which gross slip begins
    # for each of these, when a tenth of the contact began to slip, at the latest utilisation
    tenth_s: list[float]
    # (n,): of the motion that the total shear opposes: that of the skin over the surface in gross slip
    direction_deg: FloatArray
    # (n,): reading of shear that the contact bears over its reading of load; NaN without contact
    friction: FloatArray
    # the same for a contact that has not slipped, at the usual load: what a person would state
    static_friction: float
    load: FloatArray  # (n,): normal load, N
    touching: NDArray[np.bool_]  # (n,)
    # (n,): acceleration along the pull that the hand itself causes and announces, gravity's part included;
    # NaN where it announces none
    acceleration_m_s2: FloatArray

    @property
    def slips(self) -> bool:
        """True where gross slip happens."""
        return bool(self.gross_s)

    def used(self, scans: NDArray[np.int64]) -> FloatArray:
        """Utilisation at scans, 1 while all of the contact slides."""
        return np.where(self.gross[scans], 1.0, np.minimum(self.utilisation[scans], 1.0))

    def ahead_s(self, scans: NDArray[np.int64]) -> FloatArray:
        """Time from scans to the next beginning of gross slip; infinite without one."""
        begin_s, time_s = np.array([*self.gross_s, np.inf]), scans / self.rate_hz
        return np.asarray(begin_s[np.searchsorted(begin_s, time_s, side="right")] - time_s)


def onsets(gross: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Steps at which gross slip begins."""
    return np.flatnonzero(np.diff(gross.astype(int)) > 0) + 1


def tenths_s(utilisation: FloatArray, gross_steps: NDArray[np.int64], step_s: float) -> list[float]:
    """Return, for each gross slip, the instant from which at least a tenth of the contact slipped."""
    slipping = utilisation > INCIPIENT_USED
    found = []
    for g in gross_steps:
        below = np.flatnonzero(~slipping[:g])
        found.append(float(below[-1] + 1) * step_s if len(below) else 0.0)
    return found
