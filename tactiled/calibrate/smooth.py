"""Ridge regression for arrays of any channels: readings, squares, products, low-passed copies.

Which of these features are used, and how strongly weights are held back, is chosen by cross-validation over
segments. The plain choice, readings and squares, is always among them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tactiled.array import Array, FloatArray
from tactiled.calibrate.clock import quiet_bins
from tactiled.calibrate.data import BinnedLog
from tactiled.calibrate.folds import folds, segments
from tactiled.force.calibration import SmoothModelParams
from tactiled.force.model import product_pairs

CREEP_S = (1.5, 20.0)  # low-passed copies: what a calibration of a minute can tell apart
_STRENGTHS = 10.0 ** np.arange(-9.0, 1.0)  # over the mean square of the features
# The plain choice is left only for one that is better by this in the folds: more terms fit the motion of the
# calibration, and less so another one.
_GAIN = 1.3
_MOST_PRODUCTS = 600  # more features than this cannot be determined by a calibration of minutes


@dataclass(frozen=True)
class FeatureTerms:
    """Features besides the readings themselves."""

    squares: bool = True
    products: bool = False
    creep: bool = False


PLAIN = FeatureTerms()
"""Ridge regression with squares, the baseline."""
RICH = FeatureTerms(products=True, creep=True)
CHOICES = (FeatureTerms(squares=False), FeatureTerms(creep=True), FeatureTerms(products=True), RICH)


@dataclass(frozen=True, eq=False)
class SmoothFit:
    """Fitted regression.

    Attributes
    ----------
    terms : FeatureTerms
    scale : (channels,) float64
        Readings that count as 1.
    weights : (6, features) float64
        0 in rows that the reference does not have.
    covariance : tuple of (features, features) float64
        Of the weights of fx, fy, fz, for residuals of 1.
    features : (n, features) float64
        Of all bins.
    left_out : (n, 6) float64
        Differences from the reference in the folds; 0 in bins that were not used.
    """

    terms: FeatureTerms
    scale: FloatArray
    weights: FloatArray
    covariance: tuple[FloatArray, FloatArray, FloatArray]
    features: FloatArray
    left_out: FloatArray

    def params(self, array: Array, used: list[int]) -> SmoothModelParams:
        """Return the model as it goes into a file; unknown moments follow from forces and places."""
        weights = self.weights.copy()
        if not {3, 4, 5} <= set(used) and array.has_places:
            taxel = self.taxels(array)
            fx, fy, fz = weights[:3]
            x, y = array.x_mm[taxel], array.y_mm[taxel]
            own = np.stack([y * fz, -x * fz, x * fy - y * fx])
            for row in range(3):
                if 3 + row not in used:
                    weights[3 + row] = own[row]
        return SmoothModelParams(
            scale=self.scale.tolist(),
            has_squares=self.terms.squares,
            has_products=self.terms.products,
            creep_s=list(CREEP_S) if self.terms.creep else [],
            weights=weights.tolist(),
        )

    def at(self, array: Array, log: BinnedLog) -> FloatArray:
        """Return the features (n, features) of other readings."""
        return smooth_features(array, log, self.scale, self.terms)

    def taxels(self, array: Array) -> NDArray[np.int64]:
        """Taxel (features,) that each feature belongs to."""
        blocks = [array.channel_taxel]
        if self.terms.squares:
            blocks.append(array.channel_taxel)
        if self.terms.products:
            blocks.append(array.channel_taxel[product_pairs(array)[:, 0]])
        if self.terms.creep:
            blocks += [array.channel_taxel] * len(CREEP_S)
        return np.concatenate(blocks)


def smooth_features(array: Array, log: BinnedLog, scale: FloatArray, terms: FeatureTerms) -> FloatArray:
    """Features (n, features) of all bins, in the order of the running model."""
    scaled = log.readings / scale
    parts = [scaled]
    if terms.squares:
        parts.append(scaled**2)
    if terms.products:
        pairs = product_pairs(array)
        parts.append(scaled[:, pairs[:, 0]] * scaled[:, pairs[:, 1]])
    if terms.creep:
        for time_s in CREEP_S:
            follow = -np.expm1(-log.step_s / time_s)
            parts.append(lfilter([follow], [1.0, follow - 1.0], scaled, axis=0))
    return np.concatenate(parts, axis=1)


def fit_smooth(
    array: Array,
    log: BinnedLog,
    outputs: FloatArray,
    used: list[int],
    rows: NDArray[np.bool_],
    terms: FeatureTerms,
) -> SmoothFit:
    """Fit one choice of features; the strength of the ridge of each output by cross-validation.

    Parameters
    ----------
    outputs : (n, 6) float64
        Reference without its offset.
    """
    scale = np.maximum(np.quantile(np.abs(log.readings), 0.98, axis=0), 1e-9)
    features = smooth_features(array, log, scale, terms)
    f, y = features[rows], outputs[rows]
    strengths = _STRENGTHS * float((f**2).sum(axis=0).mean())
    errors = np.zeros((len(strengths), *y.shape))
    for left_out in folds(segments(quiet_bins(log)[rows], log.step_s)):
        for k, found in enumerate(_ridges(f[~left_out], y[~left_out], strengths)):
            errors[k, left_out] = y[left_out] - f[left_out] @ found
    squares = (errors**2).mean(axis=1)  # (strengths, 6)
    best = squares.argmin(axis=0)
    weights = np.zeros((6, f.shape[1]))
    left = np.zeros_like(outputs)
    whole = _ridges(f, y, strengths)
    at = np.flatnonzero(rows)
    for output in used:
        weights[output] = whole[best[output]][:, output]
        left[at, output] = errors[best[output], :, output]
    gram = f.T @ f
    covariance = [np.linalg.inv(gram + strengths[best[axis]] * np.eye(len(gram))) for axis in range(3)]
    return SmoothFit(
        terms,
        scale,
        weights,
        (covariance[0], covariance[1], covariance[2]),
        features,
        left,
    )


def choose_smooth(
    array: Array, log: BinnedLog, outputs: FloatArray, used: list[int], rows: NDArray[np.bool_]
) -> SmoothFit:
    """Fit all choices of features that fit the data; return the one that is best in the folds."""
    best = fit_smooth(array, log, outputs, used, rows, PLAIN)
    least = _error(best, outputs, used, rows)
    for terms in CHOICES:
        if terms.products and len(product_pairs(array)) > _MOST_PRODUCTS:
            continue
        found = fit_smooth(array, log, outputs, used, rows, terms)
        error = _error(found, outputs, used, rows)
        if error * (_GAIN if best.terms == PLAIN else 1.0) < least:
            best, least = found, error
    return best


def _error(fit: SmoothFit, outputs: FloatArray, used: list[int], rows: NDArray[np.bool_]) -> float:
    """Rms error in the folds, over the spread of each output."""
    spread = np.maximum(outputs[rows][:, used].std(axis=0), 1e-12)
    return float(np.sqrt(((fit.left_out[rows][:, used] / spread) ** 2).mean()))


def _ridges(features: FloatArray, outputs: FloatArray, strengths: FloatArray) -> list[FloatArray]:
    """Weights (features, 6) for each strength."""
    values, vectors = np.linalg.eigh(features.T @ features)
    turned = vectors.T @ (features.T @ outputs)
    values = np.maximum(values, 0.0)[:, np.newaxis]
    return [vectors @ (turned / (values + strength)) for strength in strengths]
