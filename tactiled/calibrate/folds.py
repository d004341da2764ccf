"""Cross-validation by contacts, because both halves of a press are nearly the same."""

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray

_LONGEST_S = 5.0  # of a segment; longer contacts are cut
_FOLDS = 5
_LEAST_SEGMENTS = 10
_GAP_BINS = 2  # a shorter pause does not end a contact


def segments(quiet: NDArray[np.bool_], step_s: float) -> NDArray[np.int64]:
    """Number of the segment of each bin (n,): one contact from the middle of a pause to the next.

    A press that is half inside a fold and half outside would make the fold look better than other motions do.
    Contacts longer than five seconds are cut. Where that gives fewer than ten segments, they are of equal
    length.
    """
    n = len(quiet)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], quiet, [False]]).astype(np.int8)))
    pauses = [(a + b) // 2 for a, b in edges.reshape(-1, 2) if b - a >= _GAP_BINS]
    starts = [0, *(p for p in pauses if 0 < p < n), n]
    longest = max(1, round(_LONGEST_S / step_s))
    out = np.zeros(n, dtype=np.int64)
    number = 0
    for a, b in itertools.pairwise(starts):
        parts = max(1, -(-(b - a) // longest))
        out[a:b] = number + (np.arange(b - a) * parts) // max(b - a, 1)
        number += parts
    if number < _LEAST_SEGMENTS:
        return np.arange(n) * _LEAST_SEGMENTS // max(n, 1)
    return out


def folds(segment: NDArray[np.int64]) -> Iterator[NDArray[np.bool_]]:
    """Yield the bins (n,) that each fold leaves out: every fifth segment."""
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
