"""Bayesian linear regression of forces and moments on features, with Gaussian priors.

Every output is a weighted sum of the features of a bin: forces have weights of their own, and moments are the
same weights times the places of the taxels. All normal equations follow from the one matrix of products of
features. Offsets of the reference are those that it read while nothing touched the array; where it was never
free, they have no prior and are eliminated by centring.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tactiled.array import FloatArray


@dataclass(frozen=True, eq=False)
class Prior:
    """Gaussian prior of the weights of one force component."""

    mean: FloatArray  # (features,)
    precision: FloatArray  # (features, features)


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Posterior of the weights."""

    weights: FloatArray  # (3, features): for fx, fy, fz
    covariance: tuple[FloatArray, FloatArray, FloatArray]  # of the weights of fx, fy and fz
    offset: FloatArray  # (6,): of the reference
    prior_loss: FloatArray  # (rows,): whitened differences of the weights from their prior


class Regression:
    """Sums of products of features and reference over rows.

    Parameters
    ----------
    features : (n, features) float64
    outputs : (n, 6) float64
        fx, fy, fz, tx, ty, tz; 0 where missing.
    used : list of int
        Outputs that are known.
    x_mm, y_mm : (features,) float64
        Place of the taxel that a feature belongs to.
    priors : three of Prior
        For fx, fy, fz.
    offset : (6,) float64, optional
        Outputs of the reference without a load, where they are known. A fitted offset would be a force that
        the running model, which reads 0 at rest, does not have.
    """

    def __init__(
        self,
        features: FloatArray,
        outputs: FloatArray,
        used: list[int],
        x_mm: FloatArray,
        y_mm: FloatArray,
        priors: tuple[Prior, Prior, Prior],
        offset: FloatArray | None = None,
    ) -> None:
        self._features, self._outputs, self._used = features, outputs, used
        self._x, self._y = x_mm, y_mm
        self._priors, self._offset = priors, offset
        self._roots = [linalg.cholesky(prior.precision) for prior in priors]

    def solve(
        self, sd: FloatArray, rows: NDArray[np.bool_] | None = None, *, with_covariance: bool = False
    ) -> LinearFit:
        """Return the posterior for standard deviations `sd` (6,) of the outputs, from some of the rows."""
        f = self._features if rows is None else self._features[rows]
        y = self._outputs if rows is None else self._outputs[rows]
        n = max(len(f), 1)
        if self._offset is None:
            mean, level = f.mean(axis=0), y.mean(axis=0)
        else:
            mean, level = np.zeros(f.shape[1]), self._offset
            y = y - level
        gram = f.T @ f - n * np.outer(mean, mean)
        cross = f.T @ y - n * np.outer(mean, level)
        w = np.zeros(6)
        w[self._used] = 1.0 / sd[self._used] ** 2
        x, yy = self._x, self._y
        size = len(x)
        normal = w[2] * gram + w[3] * _outer(yy, gram, yy) + w[4] * _outer(x, gram, x)
        right = w[2] * cross[:, 2] + w[3] * yy * cross[:, 3] - w[4] * x * cross[:, 4]
        fz, fz_cov = _posterior(normal, right, self._priors[2], with_covariance)
        both = np.zeros((2 * size, 2 * size))
        both[:size, :size] = w[0] * gram + w[5] * _outer(yy, gram, yy)
        both[size:, size:] = w[1] * gram + w[5] * _outer(x, gram, x)
        both[:size, size:] = -w[5] * _outer(yy, gram, x)
        both[size:, :size] = both[:size, size:].T
        shear_right = np.concatenate(
            [w[0] * cross[:, 0] - w[5] * yy * cross[:, 5], w[1] * cross[:, 1] + w[5] * x * cross[:, 5]]
        )
        prior = Prior(
            np.concatenate([self._priors[0].mean, self._priors[1].mean]),
            linalg.block_diag(self._priors[0].precision, self._priors[1].precision),
        )
        shear, shear_cov = _posterior(both, shear_right, prior, with_covariance)
        weights = np.stack([shear[:size], shear[size:], fz])
        losses = [
            root @ (row - prior.mean)
            for root, row, prior in zip(self._roots, weights, self._priors, strict=True)
        ]
        offset = level - self.outputs_of(weights, mean[np.newaxis])[0]
        covariance = (shear_cov[:size, :size], shear_cov[size:, size:], fz_cov)
        return LinearFit(weights, covariance, offset, np.concatenate(losses))

    def outputs_of(self, weights: FloatArray, features: FloatArray) -> FloatArray:
        """Return fx, fy, fz, tx, ty, tz (n, 6) of features (n, features), without offset."""
        fx, fy, fz = weights
        x, y = self._x, self._y
        return np.asarray(features @ np.stack([fx, fy, fz, y * fz, -x * fz, x * fy - y * fx], axis=1))

    def residuals(self, fit: LinearFit) -> FloatArray:
        """Return reference minus model (n, 6), 0 for outputs that are not known."""
        difference = self._outputs - self.outputs_of(fit.weights, self._features) - fit.offset
        out = np.zeros_like(difference)
        out[:, self._used] = difference[:, self._used]
        return out


def _outer(left: FloatArray, matrix: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(left[:, np.newaxis] * matrix * right)


def _posterior(
    normal: FloatArray, right: FloatArray, prior: Prior, with_covariance: bool
) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance (zeros unless asked for)."""
    factor = linalg.cho_factor(normal + prior.precision, check_finite=False)
    mean = linalg.cho_solve(factor, right + prior.precision @ prior.mean, check_finite=False)
    if not with_covariance:
        return mean, np.zeros_like(normal)
    return mean, linalg.cho_solve(factor, np.eye(len(mean)), check_finite=False)
