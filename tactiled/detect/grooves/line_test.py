"""Test which bins of a pooled spectrum are lines in noise of an even colour.

1. The spectrum of each channel is divided by a floor: a parabola through the logarithm of power over the
   logarithm of frequency, which follows noise of any even colour.
2. Noise that channels share is whitened by their coherence matrix C, shrunk towards the unit matrix by
   ``channels / (channels + bins)`` because few bins know it badly. T = z* C^-1 z / channels is then about 1
   without a line.
3. The cube root of T is nearly normal (Wilson and Hilferty 1931). It is fitted by a polynomial in the
   logarithm of frequency without the bins of lines found so far. A bin is a line where its externally
   studentised residual exceeds the t quantile of the permitted false alarms over the number of bins, against
   the whole spectrum and against the bins around it: a broad resonance passes the first test only.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import TINY

_FLOOR_ORDER = 2  # choice
_LEVEL_ORDER = 4  # choice
LOBE = 2  # derived: bins to either side that a Hann window spreads a line over
# prior: bins to either side whose level a line must exceed, and the order of the polynomial through them:
# enough for a t test with few degrees of freedom lost, and able to follow a resonance that is as wide as ten
# bins.
AROUND = 20
_AROUND_ORDER = 2  # choice
_MOST_LINES = 8  # prior: of two gratings with their harmonics


def pooled_power(spectra: NDArray[np.complex128], log_cycles: FloatArray) -> FloatArray:
    """Power (bins,) of spectra (bins, channels) over their own and their shared noise."""
    m, c = spectra.shape
    power = np.abs(spectra) ** 2
    log_power = np.log(np.maximum(power, power.mean(axis=0) * 1e-12))
    basis = np.linalg.qr(np.polynomial.legendre.legvander(_scaled(log_cycles), _FLOOR_ORDER))[0]
    whitened = spectra / np.exp(basis @ (basis.T @ log_power) / 2)
    # Each bin counts once, however strong: a line is no noise that channels share.
    directions = whitened / np.maximum(np.linalg.norm(whitened, axis=1, keepdims=True), TINY)
    coherence = c * (directions.T @ directions.conj()) / m
    shrunk = c / (c + m)
    coherence = (1 - shrunk) * coherence + shrunk * np.eye(c)
    solved = np.linalg.solve(coherence, whitened.T).T
    pooled = (whitened.conj() * solved).real.sum(axis=1) / c
    return np.asarray(np.maximum(pooled, 1e-12))


def significant_bins(
    y: FloatArray, log_cycles: FloatArray, false_alarms: float, in_band: NDArray[np.bool_]
) -> list[int]:
    """Bins of the significant lines, in the order in which they were found."""
    basis = np.asarray(np.polynomial.legendre.legvander(_scaled(log_cycles), _LEVEL_ORDER), np.float64)
    bins = np.arange(len(y))
    chance = false_alarms / len(y)
    free = np.ones(len(y), dtype=np.bool_)  # bins of no line
    found: list[int] = []
    while len(found) < _MOST_LINES and (free & in_band).any():
        fitted = np.linalg.lstsq(basis[free], y[free], rcond=None)[0]
        peak = int(np.argmax(np.where(free & in_band, y - basis @ fitted, -np.inf)))
        is_own = abs(bins - peak) <= LOBE
        if _studentised(y, basis, free & ~is_own, peak, chance) < 1.0:
            break
        found.append(peak)
        free &= ~is_own
    near = basis[:, : _AROUND_ORDER + 1]
    return [
        peak
        for peak in found
        if _studentised(y, near, free & (abs(bins - peak) <= AROUND), peak, chance) >= 1.0
    ]


def _studentised(y: FloatArray, basis: FloatArray, rest: NDArray[np.bool_], at: int, chance: float) -> float:
    """Residual of a bin from a fit to others, over its standard deviation and the t quantile."""
    design = basis[rest]
    freedom = len(design) - design.shape[1]
    if freedom < 4:
        return 0.0
    fitted, _, rank, _ = np.linalg.lstsq(design, y[rest], rcond=None)
    if rank < design.shape[1]:
        return 0.0
    variance = float(((y[rest] - design @ fitted) ** 2).sum()) / freedom
    leverage = float(basis[at] @ np.linalg.solve(design.T @ design, basis[at]))
    sd = np.sqrt(max(variance, 1e-24) * (1 + leverage))
    return float((basis[at] @ fitted - y[at]) / sd / special.stdtrit(freedom, chance))


def noise_power(spectra: NDArray[np.complex128], beside: NDArray[np.bool_]) -> FloatArray:
    """Power (channels,) of the noise in the bins beside a line."""
    power = (np.abs(spectra[beside]) ** 2).mean(axis=0)
    return np.asarray(np.maximum(power, power.mean() * 1e-9))


def _scaled(x: FloatArray) -> FloatArray:
    """Map to -1..1."""
    return np.asarray(2 * (x - x[0]) / (x[-1] - x[0]) - 1)
