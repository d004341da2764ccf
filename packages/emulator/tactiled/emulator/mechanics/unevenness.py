"""Friction that differs from place to place, as on every real plate: roughness, dirt, wear.

The relative change of friction under a taxel is a sum of plane waves (a Gaussian random field by its
spectrum: Shinozuka and Deodatis, Appl. Mech. Rev. 44, 1991) of all directions, with lengths even by
their logarithm. The contact of a taxel averages shorter ones; longer ones are the same for all taxels. A skin
that sticks stays at its place, and finds no change.
"""

import numpy as np

from tactiled.array import FloatArray

_WAVES = 16
# With these, friction that is uneven by 0.05 changes by 0.027, 0.041 and 0.049 (rms over sqrt 2) over 0.5, 1
# and 2 mm. A uSkin of 16 taxels that slid over boxes in a hand (56 pieces of
# github.com/imanlab/tactile_prediction_flat_dataset) had 0.032, 0.041 and 0.051, noise and tilt of about 0.02
# included.
_LENGTHS_MM = (1.0, 10.0)
_SEED = 19  # one plate, which scenes touch at different places
_LEAST = 0.2  # factor, where large changes would turn friction round


def _plate() -> tuple[FloatArray, FloatArray]:
    """Wave vectors (2, waves) in rad/mm, and phases (waves,)."""
    rng = np.random.default_rng(_SEED)
    shortest, longest = np.log(_LENGTHS_MM)
    length_mm = np.exp(rng.uniform(shortest, longest, _WAVES))
    towards = np.pi * (np.arange(_WAVES) + rng.uniform(size=_WAVES)) / _WAVES
    vectors = 2 * np.pi / length_mm * np.stack([np.cos(towards), np.sin(towards)])
    return vectors, rng.uniform(0, 2 * np.pi, _WAVES)


_VECTORS, _PHASES = _plate()
_WAVE = np.sqrt(2 / _WAVES)  # amplitude of each wave over the standard deviation of all


def friction_factor(unevenness: float | FloatArray, place_mm: FloatArray) -> FloatArray:
    """Return friction at places (..., 2) over its mean; `unevenness` is its standard deviation (...)."""
    phase = place_mm @ _VECTORS
    phase += _PHASES
    waves = np.add.reduce(np.sin(phase, out=phase), axis=-1)
    return np.asarray(np.maximum(1.0 + unevenness * _WAVE * waves, _LEAST))
