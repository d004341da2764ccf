"""Ripple that travels over the array: a line of the spectrum whose phases differ between channels.

A ridge passes the taxels one after the other, so that the phases of its ripple fill the circle. A hum of the
gripper or a tremor of the hand shakes the load and tilts it: phasors in phase, and phasors of both signs in
quadrature to these. Then either the phases have a mean, or twice the phases have. Places of the taxels are
not needed. Ridges as far apart as twice the array, or as the taxels, are not told from a hum.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray

# Mean phasor over mean size of phasors, of the phases or of twice the phases: 0 for phases that fill the
# circle, at least 0.45 for a hum in any proportion of load and tilt on a row of taxels.
_MOST_ALIKE = 0.4
_NEAR, _FAR = (
    3,
    20,
)  # bins beside a line that show the noise: outside its lobe, and no farther than a resonance
_MAD_TO_SD = 1.4826  # of a normal distribution
_LEAST_CHANNELS = 6  # phases of fewer that are noise fill the circle by chance, or have a mean by chance


def travelling_line(z: NDArray[np.complex128]) -> float:
    """Measure the strongest travelling line of spectra (bins, channels) of even noise.

    Returns
    -------
    float
        Logarithm of the line's power over that of the bins beside it, in their standard deviations; 0 where
        the strongest line does not travel.
    """
    bins, channels = z.shape
    if channels < _LEAST_CHANNELS or bins <= _FAR:
        return 0.0
    total = (np.abs(z) ** 2).sum(axis=1)
    across = (total - np.abs((z**2).sum(axis=1))) / 2  # without what is in phase
    peak = int(np.argmax(across))
    size = np.abs(z[peak])
    doubled = z[peak] ** 2 / np.maximum(size, 1e-30)
    if max(abs(z[peak].sum()), abs(doubled.sum())) > _MOST_ALIKE * float(size.sum()):
        return 0.0
    distance = np.abs(np.arange(bins) - peak)
    beside = np.log(np.maximum(across[(distance > _NEAR) & (distance <= _FAR)], 1e-12))
    level = float(np.median(beside))
    sd = max(_MAD_TO_SD * float(np.median(np.abs(beside - level))), float(1 / np.sqrt(channels)))
    return float(np.log(max(across[peak], 1e-12)) - level) / sd


def without_colour(z: NDArray[np.complex128], floor: FloatArray) -> NDArray[np.complex128]:
    """Divide spectra by their own even noise: the fit of a smooth basis `floor` to their log power."""
    power = np.abs(z) ** 2
    log_power = np.log(np.maximum(power, np.maximum(power.mean(axis=0) * 1e-9, 1e-30)))
    return np.asarray(z / np.exp(floor @ (floor.T @ log_power) / 2))
