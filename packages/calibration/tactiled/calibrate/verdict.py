"""Verdict of a calibration in words: what is known how well, and which motion to add."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.calibrate.data import FitData, FittedModel
from tactiled.force.calibration import AXES
from tactiled.force.model import N_KINDS

_POOR = 0.15  # relative standard deviation of a sensitivity above which a motion is asked for
_LITTLE_SHEAR = 0.1  # of the largest normal force
_LITTLE_SD = 0.05  # relative standard deviation at which so little shear is enough
_WORDS, _FORCES = ("shear x", "shear y", "normal force"), ("shear", "shear", "normal force")
_MOTION = ("push sideways along x, both ways", "push sideways along y, both ways", "press")


def _sensitivity_sd(
    array: Array, best: FittedModel, covariance: list[FloatArray], taxels: NDArray[np.bool_]
) -> FloatArray:
    """Relative standard deviations (3,) of the sensitivities of some taxels to fx, fy, fz.

    The sensitivity is that to the pattern of loads that a pure force makes on the electrodes.
    """
    # Loads, readings and products rise together: a pure change of one of them is no change of force.
    n = array.n_channels
    load = best.features[:, :n].sum(axis=1)
    level = best.features[load > np.median(load)].mean(axis=0).reshape(N_KINDS, n).mean(axis=1)
    ratios = level / max(float(level[0]), 1e-12)
    mine = taxels[array.channel_taxel]
    azimuth = np.deg2rad(array.azimuth_deg)
    out = np.zeros(3)
    for axis, pattern in enumerate((np.cos(azimuth) * mine, np.sin(azimuth) * mine, 1.0 * mine)):
        direction = np.concatenate([pattern * ratio for ratio in ratios])
        sd = float(np.sqrt(max(direction @ covariance[axis] @ direction, 0.0)))
        out[axis] = sd / max(abs(float(best.weights[axis] @ direction)), 1e-12)
    return out


def verdict(data: FitData, best: FittedModel, covariance: list[FloatArray]) -> list[str]:
    """Return sentences, by the covariances of the file."""
    array, used, outputs = data.array, data.used, data.shown
    words = [f"{_WORDS[k]} is not known: the reference has no {AXES[k]}_n" for k in range(3) if k not in used]
    largest = np.abs(outputs[:, :3]).max(axis=0)
    is_pairs = best.name == "pairs"
    every = np.ones(array.n_taxels, dtype=np.bool_)
    relative = _sensitivity_sd(array, best, covariance, every) if is_pairs else np.zeros(3)
    known = [k for k in range(3) if k in used]
    for k in known:
        is_little = k < 2 and largest[k] < _LITTLE_SHEAR * max(largest[2], 1e-9)
        if relative[k] > _POOR or (is_little and (not is_pairs or relative[k] > _LITTLE_SD)):
            what = f"no {_FORCES[k]} beyond {largest[k]:.2g} N" + f" along {'xy '[k]}" * (k < 2)
            how_well = "is poorly known"
            if is_pairs:
                how_well = f"has {100 * relative[k]:.0f} % sd" if relative[k] < 1 else "is not known"
            words.append(f"{what}: {_WORDS[k]} {how_well}; {_MOTION[k]}")
        else:
            sensitivity = f": sensitivity to {100 * relative[k]:.1f} %" if is_pairs else ""
            words.append(f"{_WORDS[k]} to {largest[k]:.3g} N{sensitivity}")
    if is_pairs and 2 in used:
        sds = [_sensitivity_sd(array, best, covariance, one)[2] for one in np.eye(array.n_taxels, dtype=bool)]
        if poor := [f"{taxel} ({100 * sd:.0f} %)" for taxel, sd in enumerate(sds) if sd > _POOR]:
            words.append(
                f"taxels that were hardly separated, with sd of their normal force: {', '.join(poor)}; press "
                "with a finger tip on each of them"
            )
    rms = np.sqrt((best.left_out**2).mean(axis=0))
    errors = ", ".join(f"{AXES[k]} {rms[k]:.3g} N" for k in known)
    return [*words, f"rms error in segments that were left out: {errors}"]
