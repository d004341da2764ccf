"""Evidence for sliding from the wavelet details of the taxels' shear.

A surface that slides past has friction that differs from place to place, so that each taxel's shear
fluctuates on its own. A hand that moves, a tap or a hum moves all taxels by their stiffness or their load.
What these two patterns leave of the details, over the noise, therefore speaks for sliding, also where the
total shear is silent. Holding makes no fluctuation; smooth sliding makes none either, so that silence says
little.
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.constants import Ripple

_STILL_SD = 0.35  # of log mean square of some 28 squares (0.27), with margin for noise that is not normal
_ROUGH_LOG, _ROUGH_SD = np.log(4.0), 1.0  # log mean square over a rough surface: a wide prior
_CAN_BE_ROUGH = 0.5  # prior: half of the surfaces fluctuate above the noise
_SILENCE = -0.1  # least log odds of a look: silence repeats itself, a prior
_STRAY = 0.05  # part of the looks without sliding whose details have another cause


def sliding_log_odds(details: FloatArray, noise_sd: FloatArray, load: FloatArray) -> float:
    """Return the logarithm of the likelihood ratio of sliding over sticking.

    Parameters
    ----------
    details : (levels, 2, taxels) float64
        Detail coefficients of the shear along x and y.
    noise_sd : (2, taxels) float64
        Standard deviation of their noise, by axis and taxel.
    load : (taxels,) float64
        Normal loads, at least 0.

    Returns
    -------
    float
        0 where there are too few taxels to tell.
    """
    n_taxels = details.shape[2]
    if n_taxels < 4 or load.sum() <= 0:
        return 0.0
    patterns = np.stack([load, np.cbrt(load)], axis=1)
    basis = np.linalg.qr(patterns / np.sqrt((patterns**2).sum(axis=0)))[0]
    common = (details @ basis) @ basis.T
    # Gains and stiffness of taxels differ: a part of the common movement is left in the rest.
    variance = noise_sd**2 + (Ripple.LEAK * common) ** 2
    freedom = (n_taxels - 2) / n_taxels
    square = float(((details - common) ** 2 / variance).mean()) / freedom
    level = np.log(max(square, 1e-3))
    still = np.exp(-0.5 * (max(level, 0.0) / _STILL_SD) ** 2) / _STILL_SD
    rough = np.exp(-0.5 * ((level - _ROUGH_LOG) / _ROUGH_SD) ** 2) / _ROUGH_SD
    if level > _ROUGH_LOG:
        rough = 1 / _ROUGH_SD  # still rougher is not less likely to be sliding
    sliding = _CAN_BE_ROUGH * rough + (1 - _CAN_BE_ROUGH) * still
    sticking = _STRAY * rough + (1 - _STRAY) * still
    return float(Ripple.TEMPER * max(np.log(sliding / sticking), _SILENCE))
