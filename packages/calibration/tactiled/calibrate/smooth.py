"""Ridge regression for arrays of any channels: readings, squares, products, low-passed copies, curves.

Which of these features are used, and how strongly weights are held back, is chosen by cross-validation over
segments. The plain choice, readings and squares, is always among them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.calibrate.clock import CREEP_S
from tactiled.calibrate.data import BinnedLog, FitData, FittedModel
from tactiled.calibrate.folds import correlation_bins, folds
from tactiled.force.calibration import Curve, SmoothFeatures, SmoothModelParams
from tactiled.force.model import FeatureMaker, bent, product_pairs

_STRENGTHS = 10.0 ** np.arange(-9.0, 1.0)  # over the mean square of the features
_PROBES = 8  # random patterns of a zero error, whose effect is averaged
_MOST_PRODUCTS = 600  # more features than this cannot be determined by a calibration of minutes


@dataclass(frozen=True)
class FeatureTerms:
    """Features besides the readings themselves, and the curve that all readings go through first."""

    squares: bool = True
    products: bool = False
    creep: bool = False
    curve: Curve = "linear"

    def params(self, log: BinnedLog) -> SmoothFeatures:
        """Return the features for the readings of a log."""
        sizes = np.abs(bent(log.readings, self.curve, log.zero))
        return SmoothFeatures(
            scale=np.maximum(np.quantile(sizes, 0.98, axis=0), 1e-9).tolist(),
            curve=self.curve,
            zero=[] if self.curve == "linear" else log.zero.tolist(),
            has_squares=self.squares,
            has_products=self.products,
            creep_s=list(CREEP_S) if self.creep else [],
        )


PLAIN = FeatureTerms()
"""Ridge regression with squares, the baseline."""
_CHOICES = (
    FeatureTerms(squares=False), PLAIN, FeatureTerms(creep=True), FeatureTerms(products=True),
    FeatureTerms(products=True, creep=True),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class SmoothFit:
    """Fitted regression."""

    kinds: SmoothFeatures  # scaled to the readings
    weights: FloatArray  # (6, features): 0 in rows that the reference does not have
    covariance: list[FloatArray]  # of the weights of fx, fy, fz, for residuals of 1
    features: FloatArray  # (n, features): of all bins
    of_zero: FloatArray  # (6,): mean squares of the errors that an error of the zero causes
    left_out: FloatArray  # (n, 6): differences from the reference in the folds; 0 in bins that were not used

    def model(self, data: FitData) -> FittedModel:
        """Return the fit with a covariance that counts correlated bins as one."""
        array, log, rows = data.array, data.log, data.rows
        left = self.left_out[rows]
        variances = [
            float((errors**2).mean()) * (correlation_bins(errors) if axis in data.used else 1.0)
            for axis, errors in enumerate(left[:, :3].T)
        ]
        return FittedModel(
            name="smooth",
            weights=self.weights[:3],
            covariance=[c * variance for c, variance in zip(self.covariance, variances, strict=True)],
            features=self.features[rows],
            left_out=left,
            moved=lambda change: _features(array, self.kinds, log, change)[rows],
            table=self._params(array, data.used),
            feature_units=np.ones(self.weights.shape[1]),
        )

    def _params(self, array: Array, used: list[int]) -> SmoothModelParams:
        """Model as it goes into a file; unknown moments follow from forces and places."""
        weights = self.weights.copy()
        if array.has_places:
            taxel = FeatureMaker(array, self.kinds).taxel
            fx, fy, fz = weights[:3]
            x, y = array.x_mm[taxel], array.y_mm[taxel]
            for row, own in enumerate((y * fz, -x * fz, x * fy - y * fx), 3):
                if row not in used:
                    weights[row] = own
        return SmoothModelParams(**self.kinds.model_dump(), weights=weights.tolist())


def _features(
    array: Array, kinds: SmoothFeatures, log: BinnedLog, change: FloatArray | float = 0.0
) -> FloatArray:
    """Features (n, features) of all bins, of other readings by `change`, as the running model makes them."""
    return FeatureMaker(array, kinds).features(log.readings + change, log.steps_s.tolist())


def fit_smooth(data: FitData, terms: FeatureTerms) -> SmoothFit:
    """Fit one choice of features; the strength of the ridge of each output by cross-validation."""
    log, rows, y = data.log, data.rows, data.shown
    kinds = terms.params(log)
    features = _features(data.array, kinds, log)
    f = features[rows]
    strengths = _STRENGTHS * float((f**2).sum(axis=0).mean())
    errors = np.zeros((len(strengths), *y.shape))
    for left_out in folds(data.segment):
        for k, found in enumerate(_ridges(f[~left_out], y[~left_out], strengths)):
            errors[k, left_out] = y[left_out] - f[left_out] @ found
    whole = _ridges(f, y, strengths)
    by_zero = _by_zero(data, kinds, features)
    of_zero = np.stack([((by_zero @ found) ** 2).sum(axis=0) for found in whole])
    squares = (errors**2).mean(axis=1) + of_zero  # (strengths, 6)
    best = squares.argmin(axis=0)
    weights = np.zeros((6, f.shape[1]))
    left = np.zeros_like(data.outputs)
    at = np.flatnonzero(rows)
    for output in data.used:
        weights[output] = whole[best[output]][:, output]
        left[at, output] = errors[best[output], :, output]
    gram = f.T @ f
    return SmoothFit(
        kinds=kinds,
        weights=weights,
        covariance=[np.linalg.inv(gram + strengths[best[axis]] * np.eye(len(gram))) for axis in range(3)],
        features=features,
        of_zero=of_zero[best, np.arange(6)],
        left_out=left,
    )


def _by_zero(data: FitData, kinds: SmoothFeatures, features: FloatArray) -> FloatArray:
    """Rows (probes, features) whose products with weights have the mean square that errors of the zero cause.

    The folds share the zero of the log; another contact begins with a zero of its own. A regression that
    lives on small differences of large weights does well in the folds and not there.
    """
    log, rng = data.log, np.random.default_rng(0)
    total = np.zeros((features.shape[1], features.shape[1]))
    for _ in range(_PROBES):
        pattern = log.zero_sd * rng.standard_normal(log.readings.shape[1])
        change = (_features(data.array, kinds, log, pattern) - features)[data.rows]
        total += change.T @ change / (len(change) * _PROBES)
    values, vectors = np.linalg.eigh(total)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T)


def choose_smooth(data: FitData) -> tuple[SmoothFit, SmoothFit]:
    """Fit all choices of features; return the plain one, and the one with the fewest as good as the best.

    As good means: its mean square error in the folds and by the zero is larger by at most one standard
    error, contact by contact (Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 2nd ed.,
    section 7.10). The plain choice stays where it is as good: it is the one that does well
    in motions of other kinds, too.
    """
    log, used = data.log, data.used
    count = np.bincount(data.segment)
    spread = np.maximum(data.shown[:, used].std(axis=0), 1e-12)
    fits: dict[FeatureTerms, SmoothFit] = {}
    errors: dict[FeatureTerms, FloatArray] = {}
    for terms in (replace(terms, curve=curve) for curve in log.curves for terms in _CHOICES):
        is_too_much = terms.products and len(product_pairs(data.array)) > _MOST_PRODUCTS
        if is_too_much or (terms.creep and log.are_poses):
            continue
        fits[terms] = fit = fit_smooth(data, terms)
        squares = ((fit.left_out[data.rows][:, used] ** 2 + fit.of_zero[used]) / spread**2).mean(axis=1)
        errors[terms] = np.bincount(data.segment, squares) / count
    least = min(errors.values(), key=np.mean)
    excess = {terms: found - least for terms, found in errors.items()}
    good = [fits[terms] for terms, e in excess.items() if e.mean() <= e.std() / math.sqrt(len(e))]
    plain = fits[PLAIN]
    return plain, plain if plain in good else min(good, key=lambda fit: fit.features.shape[1])


def _ridges(features: FloatArray, outputs: FloatArray, strengths: FloatArray) -> list[FloatArray]:
    """Weights (features, 6) for each strength."""
    values, vectors = np.linalg.eigh(features.T @ features)
    turned = vectors.T @ (features.T @ outputs)
    values = np.maximum(values, 0.0)[:, np.newaxis]
    return [vectors @ (turned / (values + strength)) for strength in strengths]
