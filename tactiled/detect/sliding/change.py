"""Beginning and end of sliding, as the trackers of this room report them."""

from typing import NamedTuple


class Change(NamedTuple):
    """Beginning or end of sliding at a scan.

    Attributes
    ----------
    row : int
        Scan of the block.
    scans_before : int
        Scans from the onset to this scan, about.
    is_gross : bool
        False where it may be that only a part of the contact slips.
    """

    row: int
    is_onset: bool
    statistic: float
    scans_before: int
    is_gross: bool = True
