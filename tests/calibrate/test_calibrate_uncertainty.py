"""Intervals hold where a model has more features than independent errors are kept."""

import numpy as np
import pytest

from tactiled.calibrate.uncertainty import axis_uncertainty


@pytest.mark.parametrize("n_features", [5, 60, 200])
def test_nine_of_ten_differences_are_inside_whatever_the_number_of_features(n_features: int) -> None:
    rng = np.random.default_rng(n_features)
    features = rng.standard_normal((2000, n_features))
    covariance = np.eye(n_features) / n_features  # most of the error is that of the weights
    left_out = rng.standard_normal(2000)
    force = rng.uniform(0, 5, 2000)
    found = axis_uncertainty("fz", features, covariance, left_out, force, force, 0.0, 200)
    inside = np.abs(left_out) < 1.645 * np.sqrt(found.variance(features, force, force))
    assert 0.88 < inside.mean() < 0.96
