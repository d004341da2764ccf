"""Force events: the same for any chunking, honest where readings are missing; the zero stands in contact."""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import ArrayFile, build, load_array
from tactiled.errors import ConfigError
from tactiled.events.types import UNKNOWN_SD_N, ForceEvent
from tactiled.force.calibration import CalibrationFile, CreepState, load_calibration
from tactiled.force.estimator import ForceEstimator, UncalibratedForce
from tactiled.samples.block import Gap, regular_block

ARRAY = load_array("wang2019-3x3")
NOMINAL = load_calibration("wang2019-3x3")
RATE_HZ = 100.0


assert NOMINAL.pairs is not None
CREEPS = [CreepState(time_s=1.5, gain=0.02), CreepState(time_s=20.0, gain=-0.03)]
CREEPING = NOMINAL.model_copy(
    update={
        "pairs": NOMINAL.pairs.model_copy(
            update={"creep": CREEPS, "unloading": 0.05, "taxel_crosstalk": 0.02}
        )
    }
)


def press(n: int, volts: float = 0.5, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    ramp = np.clip((np.arange(n) - n // 4) / (n // 4), 0, 1)
    return np.asarray(volts * ramp[:, np.newaxis] + 1e-3 * rng.standard_normal((n, 36)))


def forces(volts: np.ndarray, valid: np.ndarray | None = None) -> list[ForceEvent]:
    return ForceEstimator(ARRAY, NOMINAL).process(regular_block(volts, RATE_HZ, valid=valid))


def test_nominal_forces_are_the_published_sensitivities() -> None:
    volts = np.full((1, 36), 0.6)
    volts[:, 0::4] += 0.471 / 2  # R1 - R3: one newton on each taxel, towards -x
    volts[:, 2::4] -= 0.471 / 2
    (force,) = forces(volts)
    assert force.fz_n == pytest.approx(9 * 0.6 / 0.201, rel=1e-3)
    assert force.fx_n == pytest.approx(-9.0, rel=1e-3)
    assert force.fy_n == pytest.approx(0.0, abs=1e-6)
    assert sum(force.taxel_fz_n) == pytest.approx(force.fz_n)
    assert force.calibration == "nominal"
    assert force.valid
    assert force.fz_sd_n > 0.6 * force.fz_n


@given(cuts=st.lists(st.integers(1, 199), max_size=8, unique=True))
@settings(deadline=None, max_examples=20)
def test_any_chunking_gives_identical_events(cuts: list[int]) -> None:
    block = regular_block(press(200), RATE_HZ)
    whole = ForceEstimator(ARRAY, CREEPING).process(block)
    estimator = ForceEstimator(ARRAY, CREEPING)
    edges = [0, *sorted(cuts), 200]
    parts = [event for a, b in itertools.pairwise(edges) for event in estimator.process(block[a:b])]
    assert parts == whole


def test_reset_equals_new() -> None:
    estimator = ForceEstimator(ARRAY, CREEPING)
    block = regular_block(press(200), RATE_HZ)
    first = estimator.process(block)
    estimator.reset()
    assert estimator.process(block) == first


def test_a_flagged_scan_is_missing_and_not_saturated() -> None:
    volts = press(100)
    valid = np.ones(volts.shape, dtype=np.bool_)
    valid[-1] = False
    force = forces(volts, valid)[-1]
    assert (force.saturated, force.valid, force.channels_missing) == (False, False, 36)
    assert force.fz_sd_n == UNKNOWN_SD_N


def test_nothing_but_missing_channels_is_finite_and_not_valid() -> None:
    (force,) = forces(np.full((1, 36), np.nan))
    assert not force.valid
    assert all(math.isfinite(v) for v in dataclasses.asdict(force).values() if isinstance(v, float))


def test_drift_is_followed_without_contact_and_not_in_contact() -> None:
    n = 60_000
    time_s = np.arange(n) / RATE_HZ
    drift = 3e-5 * time_s  # 18 mV in 600 s
    pressed = 0.5 * ((time_s > 300) & (time_s < 500))
    volts = np.repeat((drift + pressed)[:, np.newaxis], 36, axis=1)
    volts += 1e-3 * np.random.default_rng(3).standard_normal(volts.shape)
    found = forces(volts)
    free = [f.fz_n for f in found if 250 < f.time_s < 299 or 550 < f.time_s < 600]
    assert abs(np.mean(free)) < 0.05  # 18 mV on 36 channels would be 0.8 N
    held = [f for f in found if 301 < f.time_s < 499]
    grown = np.mean([f.fz_n for f in held[-500:]]) - np.mean([f.fz_n for f in held[:500]])
    assert grown == pytest.approx(9 * 3e-5 * 193 / 0.201, rel=0.02)
    assert held[-1].fz_sd_n > held[0].fz_sd_n


def test_a_light_hold_after_a_hard_press_is_not_taken_for_drift() -> None:
    volts = np.full((40_000, 36), 0.06)
    volts[:500] = 0.0
    volts[500:700] = 1.0
    volts += 1e-3 * np.random.default_rng(4).standard_normal(volts.shape)
    found = forces(volts)
    early, late = (np.mean([f.fz_n for f in found[k : k + 500]]) for k in (1000, 39_500))
    assert late == pytest.approx(early, rel=0.01)


def test_a_calibration_of_another_array_is_refused() -> None:
    with pytest.raises(ConfigError, match="calibrate this array"):
        ForceEstimator(load_array("pillars-3x3"), NOMINAL)


MAGNETIC = build(
    ArrayFile.model_validate(
        {
            "name": "magnetic",
            "unit": "uT",
            "range": [-5000, 5000],
            "taxel_count": 5,
            "taxel_channels": [{"name": kind, "kind": kind} for kind in ("shear_x", "shear_y", "normal")],
        }
    )
)


def of_fields(n_features: int, **uncertainty: Any) -> CalibrationFile:
    """Calibration of the magnetic array by the readings alone: 0.01 N for each uT."""
    weights = np.zeros((6, n_features))
    for axis in range(3):
        weights[axis, axis:15:3] = 0.01
    return CalibrationFile.model_validate(
        {
            "name": "magnetic",
            "array": "magnetic",
            "channels": 15,
            "axes": ["fx", "fy", "fz"],
            "range": {"fx_n": (-5, 5), "fy_n": (-5, 5), "fz_n": (0, 20)},
            "largest_reading": [1000.0] * 15,
            "smooth": {"scale": [1.0] * 15, "has_squares": False, "weights": weights.tolist()},
            "uncertainty": {"floor_n": [0.05] * 3, "own": [0.02] * 3, "of_normal": [0.0] * 3, **uncertainty},
        }
    )


def test_a_channel_that_is_lost_in_a_hold_is_not_replaced_by_channels_of_another_kind() -> None:
    readings = np.zeros((300, 15))
    readings[100:, 2::3], readings[100:, 2] = 100.0, 400.0  # 8 N, half of them on one taxel
    valid = np.ones(readings.shape, dtype=np.bool_)
    valid[200:, 2] = False
    found = ForceEstimator(MAGNETIC, of_fields(15)).process(regular_block(readings, RATE_HZ, valid=valid))
    assert found[250].fz_n == pytest.approx(found[150].fz_n, rel=1e-3) == pytest.approx(8.0, rel=1e-2)
    assert found[250].fz_sd_n > 1.9  # half of the 4 N that it bears
    assert found[250].fx_n == pytest.approx(0.0, abs=1e-6)


def test_a_channel_that_was_never_read_is_as_uncertain_as_others_of_its_kind() -> None:
    readings = np.zeros((300, 15))
    readings[100:, 2::3] = 100.0
    valid = np.ones(readings.shape, dtype=np.bool_)
    whole = ForceEstimator(MAGNETIC, of_fields(15)).process(regular_block(readings, RATE_HZ))[-1]
    valid[:, 2] = False
    found = ForceEstimator(MAGNETIC, of_fields(15)).process(regular_block(readings, RATE_HZ, valid=valid))[-1]
    assert found.fz_sd_n > 0.5
    assert abs(found.fz_n - whole.fz_n) <= 2 * found.fz_sd_n


@pytest.mark.parametrize(
    ("file", "says"),
    [
        (of_fields(14), "smooth.weights: a row has 14 numbers for 15 features"),
        (of_fields(15, factor=[[[1.0] * 5]] * 3), "uncertainty.factor: a row has 5 numbers for 15 features"),
    ],
)
def test_a_calibration_of_other_features_is_refused(file: CalibrationFile, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        ForceEstimator(MAGNETIC, file)


def test_without_a_calibration_every_force_is_unknown() -> None:
    source = UncalibratedForce()
    (force,) = source.process(regular_block(np.zeros((1, 36)), RATE_HZ))
    assert (force.calibration, force.valid, force.fz_sd_n) == ("none", False, UNKNOWN_SD_N)
    assert source.process(Gap(3, "missing", 7)) == []
