"""Bayesian linear regression of forces and moments on features, with Gaussian priors.

Every output is a weighted sum of the features of a bin: forces have weights of their own, and moments are the
same weights times the places of the taxels. All normal equations follow from the one matrix of products of
features. Offsets of the reference are those that it read while nothing touched the array; where it was never
free, they have no prior and are eliminated by centring.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

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
    offset: FloatArray  # (6,): of the reference
    prior_loss: FloatArray  # (rows,): whitened differences of the weights from their prior
    factors: tuple[Any, Any]  # of the precisions of fx with fy, and of fz, as `cho_factor` gives them

    @cached_property
    def covariance(self) -> list[FloatArray]:
        """Covariances of the weights of fx, fy and fz."""
        n = self.weights.shape[1]
        shear, normal = (
            linalg.cho_solve(factor, np.eye(size), check_finite=False)
            for factor, size in zip(self.factors, (2 * n, n), strict=True)
        )
        return [shear[:n, :n], shear[n:, n:], normal]


class Regression:
    """Regression of a reference on features (n, features), each of a taxel at `x_mm`, `y_mm` (features,).

    `outputs` (n, 6) are fx, fy, fz, tx, ty, tz, of which those `used` are known; `priors` are for fx, fy, fz.
    `offset` (6,) are the outputs of the reference without a load, where they are known: a fitted offset would
    be a force that the running model, which reads 0 at rest, does not have.
    """

    def __init__(
        self,
        features: FloatArray,
        outputs: FloatArray,
        used: list[int],
        x_mm: FloatArray,
        y_mm: FloatArray,
        priors: list[Prior],
        offset: FloatArray | None = None,
    ) -> None:
        self._features, self._outputs, self._used = features, outputs, used
        self._x, self._y = x_mm, y_mm
        self._priors, self._offset = priors, offset
        self._roots = [linalg.cholesky(prior.precision) for prior in priors]

    def solve(self, sd: FloatArray, rows: NDArray[np.bool_] | slice = slice(None)) -> LinearFit:
        """Return the posterior for standard deviations `sd` (6,) of the outputs, from some of the rows."""
        f, y = self._features[rows], self._outputs[rows]
        if self._offset is None:
            mean, level = f.mean(axis=0), y.mean(axis=0)
        else:
            mean, level = np.zeros(f.shape[1]), self._offset
            y = y - level
        gram = f.T @ f - len(f) * np.outer(mean, mean)
        cross = f.T @ y - len(f) * np.outer(mean, level)
        w = np.zeros(6)
        w[self._used] = 1.0 / sd[self._used] ** 2
        x, yy = self._x, self._y
        size = len(x)
        normal = w[2] * gram + w[3] * _outer(yy, gram, yy) + w[4] * _outer(x, gram, x)
        right = w[2] * cross[:, 2] + w[3] * yy * cross[:, 3] - w[4] * x * cross[:, 4]
        fz, of_fz = _posterior(normal, right, self._priors[2])
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
        shear, of_shear = _posterior(both, shear_right, prior)
        weights = np.stack([shear[:size], shear[size:], fz])
        losses = [
            root @ (row - prior.mean)
            for root, row, prior in zip(self._roots, weights, self._priors, strict=True)
        ]
        offset = level - self._outputs_of(weights, mean[np.newaxis])[0]
        return LinearFit(weights, offset, np.concatenate(losses), (of_shear, of_fz))

    def _outputs_of(self, weights: FloatArray, features: FloatArray) -> FloatArray:
        """Fx, fy, fz, tx, ty, tz (n, 6) of features (n, features), without offset."""
        fx, fy, fz = weights
        x, y = self._x, self._y
        return np.asarray(features @ np.stack([fx, fy, fz, y * fz, -x * fz, x * fy - y * fx], axis=1))

    def residuals(self, fit: LinearFit) -> FloatArray:
        """Return reference minus model (n, 6), 0 for outputs that are not known."""
        difference = self._outputs - self._outputs_of(fit.weights, self._features) - fit.offset
        out = np.zeros_like(difference)
        out[:, self._used] = difference[:, self._used]
        return out


def _outer(left: FloatArray, matrix: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(left[:, np.newaxis] * matrix * right)


def _posterior(normal: FloatArray, right: FloatArray, prior: Prior) -> tuple[FloatArray, Any]:
    """Mean (features,), and the factor of its precision."""
    factor = linalg.cho_factor(normal + prior.precision, check_finite=False)
    mean = linalg.cho_solve(factor, right + prior.precision @ prior.mean, check_finite=False)
    return mean, factor
