"""Standard deviations of a calibrated force, from the covariance of its weights and from the folds.

The covariance counts neighbouring bins as one where residuals are correlated. What the folds show beyond it
is put on a floor, on a part of the component itself, and on a part of the normal force. One factor then makes
nine tenths of the folds lie within their 90 % interval.
"""

from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.optimize import nnls

from tactiled.array import FloatArray
from tactiled.force.calibration import Axis

_RANK = 24  # independent errors of each component that a file keeps
_Z90 = 1.6449  # standard deviations of a normal distribution within which 90 % lie
# Shear errs more on other motions than in folds of the same: set on emulated rigs with seeds 0 to 11.
_OTHER_MOTIONS = {"fx": 1.15, "fy": 1.15, "fz": 1.0}
_LEAST_SCALE = 0.7  # folds never make the stated deviation much smaller than the fit does


@dataclass(frozen=True, eq=False)
class AxisUncertainty:
    """Standard deviation of one component."""

    factor: FloatArray  # (rank, features): its products with the features are independent errors
    floor_n: float
    own: float
    of_normal: float
    covariance: FloatArray  # (features, features): of the weights, scaled as the rest

    def variance(self, features: FloatArray, force: FloatArray, normal: FloatArray) -> FloatArray:
        """Variance (n,) for features (n, features) and forces (n,)."""
        parts = ((features @ self.factor.T) ** 2).sum(axis=1)
        parts = parts + self.floor_n**2 + (self.own * force) ** 2 + (self.of_normal * normal) ** 2
        return np.asarray(parts)


def axis_uncertainty(
    axis: Axis,
    features: FloatArray,
    covariance: FloatArray,
    left_out: FloatArray,
    force: FloatArray,
    normal: FloatArray,
    reference_sd: float,
    n_segments: int,
) -> AxisUncertainty:
    """Fit the standard deviation of one component to its differences in the folds, `left_out` (n,).

    `force` and `normal` (n,) are the component and the normal force; `features` are (n, features).
    `reference_sd` is the noise of the reference in a bin, which is no error of the model; the data has
    `n_segments` contacts.
    """
    factor = _factor(covariance, features)
    explained = ((features @ factor.T) ** 2).sum(axis=1)  # of the part that is kept: the rest is fitted
    target = left_out**2 - explained - reference_sd**2
    largest = max(float(np.abs(force).max()), 1e-9), max(float(np.abs(normal).max()), 1e-9)
    columns = np.stack([np.ones_like(force), (force / largest[0]) ** 2, (normal / largest[1]) ** 2], axis=1)
    parts, _ = nnls(columns, target)
    variance = explained + columns @ parts
    score = np.abs(left_out) / np.sqrt(variance + reference_sd**2 + 1e-30)
    scale = max(float(np.quantile(score, 0.9)) / _Z90, _LEAST_SCALE)
    # Few contacts estimate a deviation badly: the quantile is that of Student's distribution.
    scale *= float(special.stdtrit(max(n_segments - 1, 2), 0.95)) / _Z90 * _OTHER_MOTIONS[axis]
    floor, own, of_normal = np.sqrt(parts) * scale / np.array([1.0, *largest])
    scaled = covariance * scale**2
    return AxisUncertainty(scale * factor, float(floor), float(own), float(of_normal), scaled)


def _factor(covariance: FloatArray, features: FloatArray) -> FloatArray:
    """Rows whose outer products sum to the covariance, the largest in the data kept."""
    size = np.sqrt((features**2).mean(axis=0))
    size = np.maximum(size, 0.05 * max(float(size.max()), 1e-12))
    values, vectors = np.linalg.eigh(covariance * size[:, np.newaxis] * size)
    order = np.argsort(values)[::-1][:_RANK]
    return np.asarray((vectors[:, order] * np.sqrt(np.maximum(values[order], 0.0))).T / size)
