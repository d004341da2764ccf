"""Thresholds on the posterior of a contact: when a slip is open, and whether it is gross."""

import math
from collections.abc import Mapping
from typing import NamedTuple

# tuned: a slip closes when its probability was below this part of the threshold for so long. With half of it
# and 80 ms, one slide over an even surface is told several times (chosen on the worlds of `bench grip`).
OFF, _OFF_S = 1 / 3, 0.15
# prior: probability below which a slip closes at once: a slide that turns back is another one
_SURELY_OVER = 0.02
_GROWN = 1.1  # prior: of the least ratio since a slip closed, beyond which the next incipient one may open
_SURELY = 3.0  # choice: standard deviations: what noise may make is no slip
_SETTLE_S = 0.06  # prior: after a gap or a touch, before a slip may open: its direction needs some scans


class SlipThresholds(NamedTuple):
    """Probabilities that a tenth of the area slips, or all of it, from which a slip is open."""

    incipient: float
    gross: float


SETTINGS: Mapping[str, SlipThresholds] = {
    "fast": SlipThresholds(incipient=0.7, gross=0.35),
    "balanced": SlipThresholds(incipient=0.9, gross=0.5),
    "quiet": SlipThresholds(incipient=0.98, gross=0.65),
}
"""Probabilities from which incipient and gross slip are reported, by setting (docs/grip.md)."""


class SlipHysteresis:
    """Open and close the slips of one contact.

    A slip opens at a probability and closes when that was below a third of it for 150 ms.

    Parameters
    ----------
    incipient_p, gross_p : float
        Probabilities that a tenth of the area slips, or all of it, from which a slip is open.
    """

    def __init__(self, incipient_p: float, gross_p: float, look_s: float) -> None:
        self.incipient_p, self.gross_p = incipient_p, gross_p
        self._n_off = max(1, round(_OFF_S / look_s))
        self._n_settle = round(_SETTLE_S / look_s)
        self.begin()

    def begin(self, *, is_seen: bool = True) -> None:
        """Begin a contact: one that was seen to begin had no shear before."""
        self._shut()
        self._least, self._ratio = 0.0 if is_seen else math.inf, math.inf

    def settle(self) -> None:
        """Let no slip open or close for some looks; then an incipient one needs a ratio that has grown since.

        Where taxels are lost, the ratio changes, and what was seen of it before was in part their fault.
        """
        self._least, self._n_looks = math.inf, 0

    def close(self) -> None:
        """Close the slip, and let none open for some looks."""
        if self.is_open:
            self._least = self._ratio
        self._shut()

    def _shut(self) -> None:
        self.is_open = self.is_gross = False
        self._n_low = self._n_looks = 0

    def look(self, p_incipient: float, p_sliding: float, ratio: float, ratio_sd: float) -> None:
        """Take the posterior of a look, and the ratio of shear and load with the sd of its noise."""
        self._n_looks += 1
        self._ratio = ratio
        self._least = min(self._least, ratio)
        if self._n_looks <= self._n_settle:
            return
        if not self.is_gross and p_sliding >= self.gross_p:
            self.is_open = self.is_gross = True
            self._n_low = 0
        elif self.is_open:
            p, threshold = (p_sliding, self.gross_p) if self.is_gross else (p_incipient, self.incipient_p)
            is_low = p < OFF * threshold
            self._n_low = self._n_low + 1 if is_low else 0
            if self._n_low >= self._n_off or p < _SURELY_OVER:
                self.is_open = self.is_gross = False
                self._least = ratio
        elif p_incipient >= self.incipient_p and ratio >= _GROWN * self._least + _SURELY * ratio_sd:
            self.is_open, self._n_low = True, 0
