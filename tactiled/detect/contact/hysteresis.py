"""Slips that open and close by thresholds on the posterior of a contact.

The file is plain Python, which Cython compiles with the types of `hysteresis.pxd` (`tactiled.compiled`).
"""

from collections.abc import Mapping
from typing import NamedTuple

# tuned: a slip closes when its probability was below this part of the threshold for so long. With half of it
# and 80 ms, one slide over an even surface is told several times (chosen on the worlds of `bench grip`).
CLOSING_PART, _CLOSING_S = 1.0 / 3.0, 0.15
# prior: probability below which a slip closes at once, if its threshold is higher: a slide that turns back
# is another one
SURELY_OVER = 0.02
_GROWN = 1.1  # prior: of the least ratio since a slip closed, beyond which the next incipient one may open
_SURELY = 3.0  # choice: standard deviations: what noise may make is no slip
# choice: in which scans are averaged for a direction: so long after a gap or a touch, no slip opens
DIRECTION_S = 0.06
_INFINITE = float("inf")


class SlipThresholds(NamedTuple):
    """Probabilities that a tenth of the area slips, or all of it, from which a slip is open."""

    incipient: float
    gross: float


SETTINGS: Mapping[str, SlipThresholds] = {
    "fast": SlipThresholds(incipient=0.7, gross=0.3),
    "balanced": SlipThresholds(incipient=0.9, gross=0.4),
    "quiet": SlipThresholds(incipient=0.98, gross=0.55),
}
"""Probabilities from which incipient and gross slip are reported, by setting (docs/slip.md).

Tuned on worlds of all generators, seeds from 500,000 and, of hands that hold, from 520,000, when results of
other values on the reported worlds were known.
"""


class SlipHysteresis:
    """Open and close the slips of one contact.

    A slip opens at a probability and closes when that was below a third of it for 150 ms.

    Parameters
    ----------
    incipient_p, gross_p : float
        Probabilities that a tenth of the area slips, or all of it, from which a slip is open.
    look_s : float
        Time from one look to the next.
    """

    def __init__(self, incipient_p: float, gross_p: float, look_s: float) -> None:
        self.incipient_p, self.gross_p = incipient_p, gross_p
        self.n_closing = max(1, round(_CLOSING_S / look_s))
        self.n_settle = round(DIRECTION_S / look_s)
        self.begin()

    def begin(self, *, is_seen: bool = True) -> None:
        """Begin a contact: one that was seen to begin had no shear before."""
        self.is_open = self.is_gross = False
        self.n_low = self.n_looks = 0
        self.least, self.ratio = 0.0 if is_seen else _INFINITE, _INFINITE

    @property
    def kind(self) -> str:
        """Kind of the slip that is open; empty for none."""
        return "gross" if self.is_gross else "incipient" if self.is_open else ""

    def settle(self) -> None:
        """Let no slip open or close for some looks; then an incipient one needs a ratio that has grown since.

        Where taxels are lost, the ratio changes, and what was seen of it before was in part their fault.
        """
        self.least, self.n_looks = _INFINITE, 0

    def close(self) -> None:
        """Close the slip, and let none open for some looks."""
        if self.is_open:
            self.least = self.ratio
        self.is_open = self.is_gross = False
        self.n_low = self.n_looks = 0

    def look(self, p_incipient: float, p_sliding: float, ratio: float, ratio_sd: float) -> None:
        """Take the posterior of a look, and the ratio of shear and load with the sd of its noise."""
        self.n_looks += 1
        self.ratio = ratio
        self.least = min(self.least, ratio)
        if self.n_looks <= self.n_settle:
            return
        if not self.is_gross and p_sliding >= self.gross_p:
            self.is_open = self.is_gross = True
            self.n_low = 0
        elif self.is_open:
            p = p_sliding if self.is_gross else p_incipient
            low = CLOSING_PART * (self.gross_p if self.is_gross else self.incipient_p)
            self.n_low = self.n_low + 1 if p < low else 0
            if self.n_low >= self.n_closing or p < min(low, SURELY_OVER):
                self.is_open = self.is_gross = False
                self.least = ratio
        elif p_incipient >= self.incipient_p and ratio >= _GROWN * self.least + _SURELY * ratio_sd:
            self.is_open = True
            self.n_low = 0
