"""Features and weights of both models against loops over channels, and moments against their definition."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tactiled.array import load_array
from tactiled.force.calibration import (
    CreepState,
    LoadCurve,
    PairsModelParams,
    SmoothModelParams,
)
from tactiled.force.model import (
    PairsModel,
    SmoothModel,
    neighbour_means,
    output_weights,
    product_pairs,
    taxel_means,
)

ARRAY = load_array("wang2019-3x3")
N = ARRAY.n_channels
RNG = np.random.default_rng(11)
WEIGHTS = RNG.normal(size=(N, 9))
# Few numbers, so that a step that differs from the one before is tried as well as one that does not.
STEPS_S = [0.01, 0.01, 0.5, 0.01, 2.0]
CURVE = LoadCurve(reading=[-1.0, 0.0, 1.0, 3.0], load=[-1.0, 0.0, 2.0, 3.0])


def pairs_model(**changes: object) -> PairsModel:
    return PairsModel(ARRAY, PairsModelParams(curve=CURVE, weights=WEIGHTS.tolist(), **changes))


def same_taxel(channel: int) -> list[int]:
    return [other for other in range(N) if ARRAY.channel_taxel[other] == ARRAY.channel_taxel[channel]]


def test_neighbours_are_the_taxels_around_one_on_the_same_pad() -> None:
    array = load_array("normal-4x4")
    means = neighbour_means(array)
    near = {
        (a, b)
        for a in range(16)
        for b in range(16)
        if a != b and abs(a // 4 - b // 4) <= 1 and abs(a % 4 - b % 4) <= 1
    }
    assert {(int(a), int(b)) for a, b in zip(*np.nonzero(means), strict=True)} == near
    assert_allclose(means.sum(axis=1), 1.0)
    halves = dataclasses.replace(array, pad=np.arange(16, dtype=np.int64) // 8)
    across = neighbour_means(halves)
    assert not across[:8, 8:].any()
    assert_allclose(across.sum(axis=1), 1.0)
    apart = dataclasses.replace(array, pad=np.arange(16, dtype=np.int64))
    assert not neighbour_means(apart).any()


@pytest.mark.parametrize(("a", "b"), [(0.2, 0.0), (0.0, 0.3), (0.15, 0.1)])
def test_crosstalk_is_removed(a: float, b: float) -> None:
    array = load_array("normal-4x4")
    weights = np.ones((16, 9)).tolist()
    model = PairsModel(
        array, PairsModelParams(taxel_crosstalk=a, neighbour_crosstalk=b, curve=CURVE, weights=weights)
    )
    true = RNG.normal(size=16)
    near = neighbour_means(array) @ true
    read = true + a * (taxel_means(array) @ true - true) + b * (near - true)
    features = model.features(read[np.newaxis], [0.01])
    assert_allclose(features[0, 16:32], true)


def test_features_of_pairs_are_load_reading_and_load_by_mean_load() -> None:
    readings = RNG.normal(size=(2, N))
    load, reading, product = np.split(pairs_model().features(readings, [0.01, 0.01]), 3, axis=1)
    assert_allclose(reading, readings)
    assert_allclose(load, np.interp(readings, CURVE.reading, CURVE.load))
    for scan in range(2):
        assert_allclose(product[scan], [load[scan, c] * np.mean(load[scan, same_taxel(c)]) for c in range(N)])


def test_creep_lowers_the_load_by_what_followed_it() -> None:
    states = [CreepState(time_s=0.3, gain=0.1), CreepState(time_s=4.0, gain=-0.05)]
    model = pairs_model(creep=states)
    readings = RNG.uniform(0.2, 1.0, size=(len(STEPS_S), N))
    for _ in range(2):  # and again after a reset
        relaxed = np.zeros((2, N))
        found = model.features(readings, STEPS_S)
        for scan, step_s in enumerate(STEPS_S):
            load = np.interp(readings[scan], CURVE.reading, CURVE.load)
            load = load / (1 + sum(state.gain * relaxed[k] for k, state in enumerate(states)))
            mean = np.array([load[same_taxel(c)].mean() for c in range(N)])
            for k, state in enumerate(states):
                relaxed[k] += (1 - math.exp(-step_s / state.time_s)) * (mean - relaxed[k])
            assert_allclose(found[scan], np.concatenate([load, readings[scan], load * mean]))
        model.reset()


def test_a_load_that_has_fallen_counts_less_until_the_touch_ends() -> None:
    model = pairs_model(unloading=0.5)

    def load(volts: float) -> float:
        features = model.features(np.full((1, N), volts), [0.01])
        assert_allclose(features[0, :N], features[0, 0])
        return float(features[0, 0])

    assert load(0.5) == pytest.approx(1.0)  # the largest so far: nothing to correct
    assert load(0.25) == pytest.approx(0.5 / 1.25)  # at half of it, half of 0.5
    assert load(0.6) == pytest.approx(1.2)
    assert load(0.01) == pytest.approx(0.02)  # released: the peak is forgotten
    assert load(0.25) == pytest.approx(0.5)
    model.features(np.full((1, N), 1.0), [0.01])
    model.reset()
    assert load(0.25) == pytest.approx(0.5)


def test_the_last_slope_of_the_curve_goes_on_beyond_it() -> None:
    """From (1, 2) to (3, 3), a load of 0.5 for each unit of reading."""
    features = pairs_model().features(np.full((1, N), 5.0), [0.01])
    assert_allclose(features[0, :N], 4.0)


def test_totals_and_moments_are_sums_over_the_channels() -> None:
    taxel_weights = RNG.normal(size=(N, 3, 2))
    found = output_weights(ARRAY, taxel_weights)
    features = RNG.normal(size=(2, N))
    forces = np.einsum("ckn,nc->ck", taxel_weights, features)  # of each channel: fx, fy, fz
    x, y = ARRAY.x_mm[ARRAY.channel_taxel], ARRAY.y_mm[ARRAY.channel_taxel]
    outputs = found @ features.ravel()
    fx, fy, fz = forces.T
    wanted = [fx, fy, fz, y * fz, -x * fz, x * fy - y * fx]
    assert_allclose(outputs[:6], [part.sum() for part in wanted])
    for taxel in range(9):
        of_taxel = ARRAY.channel_taxel == taxel
        assert_allclose(outputs[6 + taxel :: 9][:3], forces[of_taxel].sum(axis=0))


def test_the_weights_of_a_file_are_by_load_then_reading_then_product() -> None:
    features = RNG.normal(size=(3, N))
    wanted = np.einsum("nkc,nk->c", WEIGHTS.reshape(N, 3, 3), features.T)
    assert_allclose((pairs_model().weights @ features.ravel())[:3], wanted)


@pytest.mark.parametrize("has_squares", [False, True])
@pytest.mark.parametrize("has_products", [False, True])
@pytest.mark.parametrize("creep_s", [[], [0.4], [0.4, 3.0]])
def test_features_of_the_smooth_model(*, has_squares: bool, has_products: bool, creep_s: list[float]) -> None:
    products = [(a, b) for a in range(N) for b in same_taxel(a) if a < b]
    assert [tuple(pair) for pair in product_pairs(ARRAY).tolist()] == products
    scale = RNG.uniform(0.5, 2.0, size=N)
    width = N * (1 + has_squares + len(creep_s)) + has_products * len(products)
    weights = RNG.normal(size=(6, width))
    params = SmoothModelParams(
        scale=scale.tolist(),
        has_squares=has_squares,
        has_products=has_products,
        creep_s=creep_s,
        weights=weights.tolist(),
    )
    model = SmoothModel(ARRAY, params)
    readings = RNG.normal(size=(len(STEPS_S), N))
    scaled = readings / scale
    for _ in range(2):
        found = model.features(readings, STEPS_S)
        relaxed = np.zeros((len(creep_s), N))
        for scan, step_s in enumerate(STEPS_S):
            for k, time_s in enumerate(creep_s):
                relaxed[k] += (1 - math.exp(-step_s / time_s)) * (scaled[scan] - relaxed[k])
            wanted = [scaled[scan], scaled[scan] ** 2 if has_squares else []]
            wanted += [[scaled[scan, a] * scaled[scan, b] for a, b in products] if has_products else []]
            assert_allclose(found[scan], np.concatenate([*wanted, relaxed.ravel()]))
        model.reset()
    assert_allclose(model.weights[:6], weights)
    # The force on a taxel is what its own channels contribute to the total.
    taxels = model.weights[6:].reshape(3, 9, width)
    assert_allclose(taxels.sum(axis=1), weights[:3])
    for taxel in range(9):
        others = ARRAY.channel_taxel != taxel
        assert not taxels[:, taxel, :N][:, others].any()
