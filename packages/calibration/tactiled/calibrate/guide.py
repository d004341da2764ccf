"""Motions that a calibration still lacks, from the readings alone.

How well a fit will know a sensitivity depends on which loads occurred, not on what the force sensor reads.
The guide keeps the information of a linear map of the readings, and asks for the motion whose sensitivity
would be known least.
"""

from dataclasses import dataclass

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.errors import DataError

GOOD, TAXEL_GOOD = 0.05, 0.15
"""Relative standard deviations of a sensitivity, and of one taxel's, at which no more is asked for."""
_PRIOR = 0.5  # relative standard deviation of a sensitivity before any press
_ERROR = 0.003  # of the largest response: what a fit leaves over a second (`./run bench force`)
_LEAST_NOISES = 20.0  # a response below so many standard deviations of the noise is none
_QUIET_SCANS = 20  # of the beginning, whose spread is the noise


@dataclass(frozen=True)
class Advice:
    """Next motion, and how well each sensitivity would be known now."""

    motion: str  # empty where nothing is lacking
    sd: dict[str, float]  # relative standard deviations: "normal", "shear x", "shear y", "taxel 0", ...

    @property
    def worst(self) -> float:
        """Largest relative standard deviation."""
        return max(self.sd.values())


class Guide:
    """Information about the sensitivities of an array, updated with each second of scans.

    Raises
    ------
    DataError
        The array has no channel whose kind is known to respond to pressure or shear.

    Examples
    --------
    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> guide = Guide(load_array("load-cell"))
    >>> guide.advice().motion
    'press hard, and let go, at several places'
    """

    def __init__(self, array: Array) -> None:
        self._array = array
        normal, (shear_x, shear_y) = array.normal_weights(), array.shear_weights()
        patterns = {
            "normal": normal.sum(axis=0),
            "shear x": shear_x.sum(axis=0),
            "shear y": shear_y.sum(axis=0),
        }
        if array.n_taxels > 1:
            patterns |= {f"taxel {taxel}": row for taxel, row in enumerate(normal)}
        self._patterns = {
            name: row / np.linalg.norm(row) for name, row in patterns.items() if np.linalg.norm(row) > 0
        }
        if not self._patterns:
            raise DataError(f"array {array.name} has no channels of a known kind: nothing can be asked for")
        n = array.n_channels
        self._information = np.zeros((n, n))
        self._largest = np.full(len(self._patterns), 0.0)
        self._smallest = np.full(len(self._patterns), 0.0)
        self._zero: FloatArray | None = None
        self._noise = 0.0

    def add(self, readings: FloatArray) -> None:
        """Take the scans (n, channels) of about a second; NaN where missing."""
        known = np.nan_to_num(readings)
        if self._zero is None:
            first = known[:_QUIET_SCANS]
            self._zero = np.median(first, axis=0) if self._array.zero_first_s else self._array.zero
            change = np.diff(known, axis=0)
            self._noise = float(np.median(change.std(axis=0)) / np.sqrt(2)) if len(change) > 1 else 0.0
        relative = known - self._zero
        # Neighbouring scans are nearly the same: a second counts as one look at each of its directions.
        self._information += relative.T @ relative / max(len(relative), 1)
        patterns = np.array(list(self._patterns.values()))
        responses = relative @ patterns.T
        self._largest = np.maximum(self._largest, responses.max(axis=0))
        self._smallest = np.minimum(self._smallest, responses.min(axis=0))

    def advice(self) -> Advice:
        """Return the motion to add next."""
        span = np.maximum(self._largest, -self._smallest)
        least = _LEAST_NOISES * max(self._noise, 1e-6 * (self._array.high - self._array.low))
        error = max(_ERROR * float(span.max()), least / _LEAST_NOISES)
        names = list(self._patterns)
        covariance = np.linalg.inv(self._information / error**2 + np.eye(len(self._information)) / _PRIOR**2)
        sd = {name: float(np.sqrt(max(row @ covariance @ row, 0.0))) for name, row in self._patterns.items()}
        for name, size in zip(names, span.tolist(), strict=True):
            if size < least:
                sd[name] = _PRIOR
        over = {name: sd[name] / (TAXEL_GOOD if name.startswith("taxel") else GOOD) for name in names}
        lacking = [name for name in names if over[name] > 1.0]
        if not lacking:
            return Advice("", sd)
        # A taxel that was left out makes every sum uncertain, so it comes before sums that did occur.
        never = [name for name in lacking if not name.startswith("taxel") and span[names.index(name)] < least]
        taxels = [name for name in lacking if name.startswith("taxel")]
        return Advice(self._motion(max(never or taxels or lacking, key=lambda name: over[name])), sd)

    def _motion(self, name: str) -> str:
        """Words for the person who presses."""
        at = list(self._patterns).index(name)
        if name == "normal":
            return "press hard, and let go, at several places"
        if name.startswith("shear"):
            axis = name[-1]
            # The response is to motion of the skin, which is opposite to the force.
            sign = "-" if -self._smallest[at] > self._largest[at] else "+"
            return f"press, and push sideways along {sign}{axis} and back"
        taxel = int(name.split()[1])
        place = ""
        if self._array.has_places:
            place = f" at x = {self._array.x_mm[taxel]:g} mm, y = {self._array.y_mm[taxel]:g} mm"
        return f"press with a finger tip on taxel {taxel}{place}"
