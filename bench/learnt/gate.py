"""Thresholds on the posterior of a contact: when a slip is open, and whether it is gross."""

import math

_OFF_S = 0.08  # a slip closes when it was unlikely for so long
_GROWN = 1.1  # of the least ratio since a slip closed, beyond which the next incipient one may open
_SETTLE_S = 0.06  # after a gap or a touch, before a slip may open: its direction needs some scans


class SlipGate:
    """Open and close the slips of one contact.

    A slip opens at a probability and closes when that was below half of it for 80 ms.

    Parameters
    ----------
    incipient_p, gross_p : float
        Probabilities that a tenth of the area slips, or all of it, from which a slip is open.
    look_s : float
        Time between looks.

    Attributes
    ----------
    is_open, is_gross : bool
    """

    def __init__(self, incipient_p: float, gross_p: float, look_s: float) -> None:
        self.incipient_p, self.gross_p = incipient_p, gross_p
        self._n_off = max(1, round(_OFF_S / look_s))
        self._n_settle = round(_SETTLE_S / look_s)
        self.close()

    def close(self) -> None:
        """Close the slip, and let none open for some looks."""
        self.is_open = self.is_gross = False
        self._n_low = self._n_looks = 0
        self._least = math.inf

    def look(self, p_partial: float, p_sliding: float, ratio: float) -> None:
        """Take the posterior of a look, and the ratio of shear and load."""
        self._n_looks += 1
        self._least = min(self._least, ratio)
        if self._n_looks <= self._n_settle:
            return
        if not self.is_gross and p_sliding >= self.gross_p:
            self.is_open = self.is_gross = True
            self._n_low = 0
        elif self.is_open:
            is_low = p_sliding < self.gross_p / 2 if self.is_gross else p_partial < self.incipient_p / 2
            self._n_low = self._n_low + 1 if is_low else 0
            if self._n_low >= self._n_off:
                self.is_open = self.is_gross = False
                self._least = ratio
        elif p_partial >= self.incipient_p and ratio >= _GROWN * self._least:
            self.is_open, self._n_low = True, 0
