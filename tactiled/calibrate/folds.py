"""Cross-validation by segments of seconds, because neighbouring scans are nearly the same."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray

_SEGMENT_S = 3.0  # about one press of a person
_FOLDS = 5
_LEAST_SEGMENTS = 10


def folds(n: int, step_s: float) -> Iterator[NDArray[np.bool_]]:
    """Yield the bins (n,) that each fold leaves out: every fifth segment of three seconds or less."""
    length = max(1, min(round(_SEGMENT_S / step_s), n // _LEAST_SEGMENTS))
    segment = np.arange(n) // length
    for fold in range(_FOLDS):
        left_out = segment % _FOLDS == fold
        if left_out.any() and not left_out.all():
            yield left_out


def correlation_bins(residuals: FloatArray) -> float:
    """Number of neighbouring bins (n,) that count as one: the integrated autocorrelation, at least 1.

    The sum ends where the correlation first falls below 0.05 (Sokal, Monte Carlo Methods in Statistical
    Mechanics, 1997, uses a window of the same kind).
    """
    centred = residuals - residuals.mean()
    variance = float(centred @ centred)
    if variance <= 0 or len(centred) < 4:
        return 1.0
    total = 1.0
    for lag in range(1, len(centred) // 4):
        part = float(centred[lag:] @ centred[:-lag]) / variance
        if part < 0.05:
            break
        total += 2 * part
    return total
