"""Verdict of a calibration in words: what is known how well, and which motion to add."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.calibrate.uncertainty import unknown_axes
from tactiled.force.calibration import CalibrationFile
from tactiled.force.model import N_KINDS

POOR = 0.15  # relative standard deviation of a sensitivity above which a motion is asked for
_LITTLE_SHEAR, _LITTLE_SD = (
    0.1,
    0.05,
)  # of the largest normal force; relative sd at which that little is enough
_WORDS = {"fx": "shear x", "fy": "shear y", "fz": "normal force"}
_MOTION = {"fx": "push sideways along x, both ways", "fy": "push sideways along y, both ways", "fz": "press"}


def sensitivity_sd(
    array: Array,
    features: FloatArray,
    weights: FloatArray,
    covariance: list[FloatArray],
    taxels: NDArray[np.bool_] | None = None,
) -> FloatArray:
    """Relative standard deviations (3,) of the sensitivities to fx, fy, fz, of some taxels or all.

    The sensitivity is that to the pattern of loads that a pure force makes on the electrodes.
    """
    # Loads, readings and products rise together: a pure change of one of them is no change of force.
    n = array.n_channels
    loaded = features[features[:, :n].sum(axis=1) > np.median(features[:, :n].sum(axis=1))]
    level = loaded.mean(axis=0).reshape(N_KINDS, n).mean(axis=1)
    ratios = level / max(float(level[0]), 1e-12)
    chosen = np.ones(array.n_taxels, dtype=np.bool_) if taxels is None else taxels
    mine = chosen[array.channel_taxel]
    azimuth = np.deg2rad(array.azimuth_deg)
    patterns = (np.cos(azimuth) * mine, np.sin(azimuth) * mine, 1.0 * mine)
    out = np.zeros(3)
    for axis, pattern in enumerate(patterns):
        direction = np.concatenate([pattern * ratio for ratio in ratios])
        sd = float(np.sqrt(max(direction @ covariance[axis] @ direction, 0.0)))
        out[axis] = sd / max(abs(float(weights[axis] @ direction)), 1e-12)
    return out


def verdict(
    array: Array,
    file: CalibrationFile,
    features: FloatArray,
    weights: FloatArray,
    covariance: list[FloatArray],
    used: list[int],
    outputs: FloatArray,
    model: str,
) -> list[str]:
    """Return sentences."""
    words: list[str] = []
    largest = np.abs(outputs[:, :3]).max(axis=0)
    for name in unknown_axes(used):
        words.append(f"{_WORDS[name]} is not known: the reference has no {name}_n")
    relative = sensitivity_sd(array, features, weights, covariance) if model == "pairs" else np.zeros(3)
    for axis, name in enumerate(("fx", "fy", "fz")):
        if axis not in used:
            continue
        little = name != "fz" and largest[axis] < _LITTLE_SHEAR * max(largest[2], 1e-9)
        if relative[axis] > POOR or (little and (model != "pairs" or relative[axis] > _LITTLE_SD)):
            words.append(
                f"no {'shear' if name != 'fz' else 'normal force'} beyond {largest[axis]:.2g} N"
                f"{'' if name == 'fz' else ' along ' + name[1]}: {_WORDS[name]} "
                f"{_how_well(relative[axis], model)}; {_MOTION[name]}"
            )
        elif model == "pairs":
            words.append(
                f"{_WORDS[name]} to {largest[axis]:.3g} N: sensitivity to {100 * relative[axis]:.1f} %"
            )
        else:
            words.append(f"{_WORDS[name]} to {largest[axis]:.3g} N")
    if model == "pairs" and 2 in used:
        poor = []
        for taxel in range(array.n_taxels):
            one = np.arange(array.n_taxels) == taxel
            own = sensitivity_sd(array, features, weights, covariance, one)
            if own[2] > POOR:
                poor.append(f"{taxel} ({100 * own[2]:.0f} %)")
        if poor:
            words.append(
                f"taxels that were hardly separated, with sd of their normal force: {', '.join(poor)}; press "
                "with a finger tip on each of them"
            )
    known = [
        r
        for k, r in enumerate(file.residuals.model_dump(include={"fx_n", "fy_n", "fz_n"}).values())
        if k in used and r is not None
    ]
    rms = ", ".join(
        f"{name} {value:.3g} N"
        for name, value in zip([n for k, n in enumerate(("fx", "fy", "fz")) if k in used], known, strict=True)
    )
    words.append(f"rms error in segments that were left out: {rms}")
    return words


def _how_well(relative: float, model: str) -> str:
    """Words for a relative standard deviation."""
    if model != "pairs":
        return "is poorly known"
    return f"has {100 * relative:.0f} % sd" if relative < 1 else "is not known"
