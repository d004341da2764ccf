"""Result of one grasp."""

from dataclasses import dataclass


@dataclass(frozen=True)
class GraspResult:
    """One grasp.

    Attributes
    ----------
    over_least : float
        Mean grip over mean least grip while the object hangs freely; NaN where it was dropped.
    reaction_s : float
        From the beginning of the first gross slip to a command that is a twentieth higher; NaN without a
        slip; infinite without such a command.
    """

    event: str
    dropped: bool
    over_least: float
    slid_mm: float
    reaction_s: float
