"""Ripple that travels over the array: a line of the spectrum whose phases differ between channels.

A ridge passes the taxels one after the other, so that the phases of its ripple fill the circle. A hum of the
gripper or a tremor of the hand shakes the load and tilts it: phasors in phase, and phasors of both signs in
quadrature to these. Then either the phases have a mean, or twice the phases have. Places of the taxels are
not needed. Ridges as far apart as twice the array, or as the taxels, are not told from a hum.
"""

import numpy as np
from numpy.typing import NDArray

# derived: mean phasor over mean size of phasors, of the phases or of twice the phases: 0 for phases that fill
# the circle, at least 0.45 for a hum in any proportion of load and tilt on a row of taxels.
_MOST_ALIKE = 0.4
_LOBE = 2  # derived: bins to either side that a Hann window spreads a line over
_HARMONICS = (2, 3)  # choice
# derived: phases of fewer that are noise fill the circle by chance, or have a mean by chance
_LEAST_CHANNELS = 6


def travelling_line(z: NDArray[np.complex128], first_cycles: int) -> float:
    """Measure how far the strongest line of a window stands out, if it travels.

    Parameters
    ----------
    z : (bins, channels) complex128
        Spectra under a Hann window, each channel over its own standard deviation.
    first_cycles : int
        Periods in the window of the first bin.

    Returns
    -------
    float
        Logarithm of the power of the strongest bin over that of any other, except its lobe and harmonics; 0
        where it does not travel.
    """
    if z.shape[1] < _LEAST_CHANNELS:
        return 0.0
    power = (np.abs(z) ** 2).sum(axis=1)
    cycles = np.arange(len(z)) + first_cycles
    peak = int(np.argmax(power))
    size = np.abs(z[peak])
    doubled = z[peak] ** 2 / np.maximum(size, 1e-30)
    if max(abs(z[peak].sum()), abs(doubled.sum())) > _MOST_ALIKE * float(size.sum()):
        return 0.0
    others = np.abs(cycles - cycles[peak]) > _LOBE
    for harmonic in _HARMONICS:  # their lobes are of uneven ridges, and wider
        others &= np.abs(cycles - harmonic * cycles[peak]) > harmonic + 1
    if not others.any():
        return 0.0
    return float(np.log(max(power[peak], 1e-30) / max(float(power[others].max()), 1e-30)))
