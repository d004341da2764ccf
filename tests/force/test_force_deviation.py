"""Standard deviations, centre of pressure and flags of a force, against their definition."""

import math

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.events.types import UNKNOWN_SD_N, ForceEvent
from tactiled.force.calibration import (
    CalibrationFile,
    ForceRange,
    LoadCurve,
    PairsModelParams,
    SmoothModelParams,
    Uncertainty,
    load_calibration,
)
from tactiled.force.estimator import ForceEstimator
from tactiled.samples.block import Gap, regular_block

ARRAY = load_array("wang2019-3x3")
N = ARRAY.n_channels
RNG = np.random.default_rng(5)
WEIGHTS = RNG.uniform(0.5, 1.5, size=(6, N))
FACTOR = [RNG.normal(size=(rank, N)) for rank in (2, 1, 3)]
READING = RNG.uniform(0.3, 0.9, size=N)
FEATURES = READING / 2.0
FLOOR, OWN, NORMAL, PER_UNIT = [0.1, 0.2, 0.3], [0.02, 0.03, 0.04], [0.05, 0.06, 0.07], [2.0, 3.0, 4.0]
ZERO_SD = 0.05
EVERYTHING = Uncertainty(
    factor=[matrix.tolist() for matrix in FACTOR],
    floor_n=FLOOR,
    own=OWN,
    of_normal=NORMAL,
    noise=0.001,
    zero_sd=ZERO_SD,
    n_per_unit=PER_UNIT,
)
NOTHING = Uncertainty(floor_n=[0.0] * 3, own=[0.0] * 3, of_normal=[0.0] * 3)


def calibration(**changes: object) -> CalibrationFile:
    """Linear calibration, in which every reading and force is within what was calibrated."""
    smooth = SmoothModelParams(scale=[2.0] * N, has_squares=False, weights=WEIGHTS.tolist())
    file = CalibrationFile(
        name="mine",
        array=ARRAY.name,
        channels=N,
        axes=["fx", "fy", "fz"],
        range=ForceRange(fx_n=(-99, 99), fy_n=(-99, 99), fz_n=(0, 99)),
        largest_reading=[1.0] * N,
        smooth=smooth,
        uncertainty=EVERYTHING,
    )
    return file.model_copy(update=changes)


def force(
    file: CalibrationFile, reading: np.ndarray = READING, n: int = 1, valid: np.ndarray | None = None
) -> ForceEvent:
    """Force at the last of n equal scans at 1 Hz; `valid` (channels,) holds for all."""
    flags = None if valid is None else np.tile(valid, (n, 1))
    return ForceEstimator(ARRAY, file).process(regular_block(np.tile(reading, (n, 1)), 1.0, valid=flags))[-1]


def deviations(event: ForceEvent) -> list[float]:
    return [event.fx_sd_n, event.fy_sd_n, event.fz_sd_n]


def expected(
    forces: np.ndarray,
    touched_s: float,
    extrapolated2: float = 0.0,
    missing2: tuple[float, ...] = (0, 0, 0),
    features: np.ndarray = FEATURES,
) -> list[float]:
    zero2 = ZERO_SD**2 + 1.7e-5**2 * touched_s
    warming2 = 0.03**2 * min(touched_s / 1800, 1)  # 3 % within half an hour
    return [
        math.sqrt(
            FLOOR[axis] ** 2
            + (OWN[axis] ** 2 + warming2 + extrapolated2) * forces[axis] ** 2
            + (NORMAL[axis] * forces[2]) ** 2
            + PER_UNIT[axis] ** 2 * zero2
            + missing2[axis]
            + float(np.sum((FACTOR[axis] @ features) ** 2))
        )
        for axis in range(3)
    ]


@pytest.mark.parametrize("n", [1, 900, 2500])
def test_every_source_of_error_is_in_the_standard_deviation(n: int) -> None:
    event = force(calibration(), n=n)
    forces = WEIGHTS @ FEATURES
    outputs = (event.fx_n, event.fy_n, event.fz_n, event.tx_nmm, event.ty_nmm, event.tz_nmm)
    assert outputs == pytest.approx(tuple(forces))
    assert deviations(event) == pytest.approx(expected(forces, touched_s=n))
    assert not event.beyond_range
    assert event.calibration == "mine"
    taxels = np.array([event.taxel_fx_n, event.taxel_fy_n, event.taxel_fz_n])
    own = [ARRAY.channel_taxel == taxel for taxel in range(9)]
    assert taxels == pytest.approx(np.stack([WEIGHTS[:3, of] @ FEATURES[of] for of in own], axis=1))


@pytest.mark.parametrize("excess", [1.0, 1.5, 3.0])
@pytest.mark.parametrize(("is_pairs", "growth"), [(True, 0.25), (False, 2.0)])
def test_beyond_the_calibrated_readings_the_model_is_extrapolated(
    *, excess: float, is_pairs: bool, growth: float
) -> None:
    file = calibration(uncertainty=NOTHING)
    if is_pairs:
        weights = np.zeros((N, 9))
        weights[:, 5] = 1.0 / N  # fz is the mean reading
        curve = LoadCurve(reading=[0, 1], load=[0, 1])
        file = file.model_copy(
            update={"smooth": None, "pairs": PairsModelParams(curve=curve, weights=weights.tolist())}
        )
    event = force(file, np.full(N, -excess * 1.1 - 1e-9))
    extrapolated = growth * math.log(1.1 * excess) if excess > 1 else growth * math.log(1.1)
    assert event.beyond_range
    assert event.fz_sd_n == pytest.approx(
        abs(event.fz_n) * math.hypot(extrapolated, 0.03 / math.sqrt(1800)), rel=1e-3
    )
    assert not force(file, np.full(N, excess * 1.1 - 1e-9)).beyond_range or excess > 1


def test_a_normal_force_beyond_the_calibrated_ones_is_extrapolated_too() -> None:
    fz = float((WEIGHTS @ FEATURES)[2])
    for most, is_beyond in [(fz / 1.09, False), (fz / 1.11, True)]:
        event = force(calibration(range=ForceRange(fx_n=(0, 0), fy_n=(0, 0), fz_n=(0, most))))
        assert event.beyond_range is is_beyond
    negative = force(calibration(range=ForceRange(fx_n=(0, 0), fy_n=(0, 0), fz_n=(-fz, 0))))
    assert not negative.beyond_range


def test_a_component_that_is_not_calibrated_is_unknown() -> None:
    event = force(calibration(axes=["fy"]))
    assert (event.fx_n, event.fz_n) == (0.0, 0.0)
    assert (event.fx_sd_n, event.fz_sd_n) == (UNKNOWN_SD_N, UNKNOWN_SD_N)
    whole = force(calibration())
    assert (event.fy_n, event.fy_sd_n) == (whole.fy_n, whole.fy_sd_n)


def test_half_of_what_missing_channels_would_add_is_uncertain() -> None:
    valid = np.ones(N, dtype=np.bool_)
    valid[[5, 22]] = False
    event = force(calibration(), valid=valid)
    filled = FEATURES.copy()
    for channel in (5, 22):
        others = (ARRAY.channel_taxel == ARRAY.channel_taxel[channel]) & valid
        filled[channel] = FEATURES[others].mean()
    forces = WEIGHTS @ filled
    missing2 = tuple(np.sum((0.5 * WEIGHTS[:3, ~valid] * filled[~valid]) ** 2, axis=1))
    assert event.channels_missing == 2
    assert event.fz_n == pytest.approx(forces[2])
    assert deviations(event) == pytest.approx(expected(forces, 1.0, missing2=missing2, features=filled))


@pytest.mark.parametrize("part", ["squares", "products", "creep"])
def test_a_missing_channel_is_uncertain_in_every_feature(part: str) -> None:
    """Half of 0.4 newtons of one channel of a taxel: of its square, of three products, or of its creep."""
    first = {"squares": N, "products": 2 * N, "creep": 2 * N + 54}[part]
    n = {"squares": N, "products": 54, "creep": N}[part]
    weights = np.zeros((6, 3 * N + 54))
    weights[2, first : first + n] = 0.4 / 3.0 if part == "products" else 0.4
    smooth = SmoothModelParams(
        scale=[1.0] * N, has_squares=True, has_products=True, creep_s=[1e-6], weights=weights.tolist()
    )
    valid = np.arange(N) != 3
    event = force(calibration(smooth=smooth, uncertainty=NOTHING), np.ones(N), valid=valid)
    assert event.fz_sd_n == pytest.approx(math.sqrt(0.2**2 + (0.03 * event.fz_n) ** 2 / 1800), rel=1e-3)


def test_a_taxel_that_was_never_read_adds_no_force_and_the_deviation_of_a_usual_one() -> None:
    valid = ARRAY.channel_taxel != 4
    event = force(calibration(), valid=valid)
    filled = np.where(valid, FEATURES, 0.0)
    assert event.fz_n == pytest.approx(float((WEIGHTS @ filled)[2]))
    missing2 = tuple(4 * np.mean((0.5 * WEIGHTS[:3, valid] * FEATURES[valid]) ** 2, axis=1))
    forces = (WEIGHTS @ filled)[:3]
    assert deviations(event) == pytest.approx(expected(forces, 1.0, missing2=missing2, features=filled))


@pytest.mark.parametrize(("missing", "is_valid"), [(0, True), (9, True), (10, False)])
def test_a_force_with_more_than_a_quarter_of_the_channels_missing_is_not_valid(
    missing: int, *, is_valid: bool
) -> None:
    assert force(calibration(), valid=np.arange(N) >= missing).valid is is_valid


@pytest.mark.parametrize(("reading", "is_saturated"), [(0.89, False), (0.91, True), (-0.91, True)])
def test_an_invalid_reading_near_the_largest_is_saturated(reading: float, *, is_saturated: bool) -> None:
    readings = READING.copy()
    readings[3] = reading
    event = force(calibration(), readings, valid=np.arange(N) != 3)
    assert event.saturated is is_saturated
    if is_saturated:  # the load is at least this
        assert event.fz_n == pytest.approx(float((WEIGHTS @ (readings / 2.0))[2]))


@pytest.mark.parametrize("taxel", range(9))
def test_the_centre_of_pressure_is_where_one_taxel_is_pressed(taxel: int) -> None:
    readings = np.where(ARRAY.channel_taxel == taxel, 0.6, 0.0)
    event = force(load_calibration("wang2019-3x3"), readings)
    assert (event.x_mm, event.y_mm) == pytest.approx((ARRAY.x_mm[taxel], ARRAY.y_mm[taxel]))
    assert event.tx_nmm == pytest.approx(ARRAY.y_mm[taxel] * event.fz_n)
    assert event.ty_nmm == pytest.approx(-ARRAY.x_mm[taxel] * event.fz_n)
    assert [f > 0 for f in event.taxel_fz_n] == [other == taxel for other in range(9)]


def test_a_force_below_three_deviations_of_a_free_array_has_no_centre() -> None:
    weights = np.ones((6, N)) / N
    weights[3], weights[4] = weights[3] * 5.0, weights[4] * -7.0  # a centre at (7, 5) mm
    smooth = SmoothModelParams(scale=[1.0] * N, has_squares=False, weights=weights.tolist())
    free_sd = math.hypot(0.01, 4.0 * 0.003)
    uncertainty = Uncertainty(
        floor_n=[9.0, 9.0, 0.01],
        own=[1.0] * 3,
        of_normal=[1.0] * 3,
        zero_sd=0.003,
        n_per_unit=[0.0, 0.0, 4.0],
        noise=0.1,
    )
    file = calibration(smooth=smooth, uncertainty=uncertainty)
    below, above = (force(file, np.full(N, free_sd * part)) for part in (2.99, 3.01))
    assert (below.x_mm, below.y_mm) == pytest.approx((ARRAY.x_mm.mean(), ARRAY.y_mm.mean()))
    assert (above.x_mm, above.y_mm) == pytest.approx((7.0, 5.0))


def creeping() -> CalibrationFile:
    """Calibration whose normal force is the reading, low-passed over 10 s."""
    weights = np.zeros((6, 2 * N))
    weights[2, N:] = 1.0 / N
    smooth = SmoothModelParams(scale=[1.0] * N, has_squares=False, creep_s=[10.0], weights=weights.tolist())
    return calibration(smooth=smooth, uncertainty=NOTHING)


@pytest.mark.parametrize("cause", ["missing", "restart", "disconnect", "start"])
def test_creep_goes_on_while_scans_are_missing(cause: str) -> None:
    estimator = ForceEstimator(ARRAY, creeping())
    ones = np.ones((1, N))
    estimator.process(regular_block(ones, 1.0))
    estimator.process(Gap(1, cause, 4))  # type: ignore[arg-type]
    (event,) = estimator.process(regular_block(ones, 1.0, start_s=5.0, index=5))
    assert event.fz_n == pytest.approx(1 - math.exp(-(1.0 + 5.0) / 10.0))


def test_a_tare_ends_creep() -> None:
    estimator = ForceEstimator(ARRAY, creeping())
    estimator.process(regular_block(np.ones((100, N)), 1.0))
    estimator.tared()
    (event,) = estimator.process(regular_block(np.zeros((1, N)), 1.0, start_s=100.0, index=100))
    assert event.fz_n == 0.0


@pytest.mark.parametrize("step_s", [0.3, 1.0, 1.45, 1.55])
def test_creep_goes_on_for_as_long_as_the_stamps_say(step_s: float) -> None:
    estimator = ForceEstimator(ARRAY, creeping())
    estimator.process(regular_block(np.ones((1, N)), 1.0))
    (event,) = estimator.process(regular_block(np.ones((1, N)), 1.0, start_s=step_s, index=1))
    assert event.fz_n == pytest.approx(1 - math.exp(-(1.0 + step_s) / 10.0))


def test_a_tare_in_contact_makes_the_zero_certain_again() -> None:
    estimator = ForceEstimator(ARRAY, calibration(uncertainty=EVERYTHING))
    block = regular_block(np.tile(READING, (900, 1)), 1.0)
    estimator.process(block)
    estimator.tared()
    (event,) = estimator.process(regular_block(READING[np.newaxis], 1.0, start_s=900.0, index=900))
    assert deviations(event) == pytest.approx(expected(WEIGHTS @ FEATURES, touched_s=1.0))
