"""The parts of the coherent slip detector: response, filters, floor, kink, course."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import FloatArray, load_array
from tactiled.detect.signal.quantise import HeldReadings
from tactiled.detect.slip.evidence import ShearEvidence
from tactiled.detect.slip.filters import LEVELS, N_BASELINE, RampFilters
from tactiled.detect.slip.friction_limit import FrictionLimitTest
from tactiled.detect.slip.kink import KinkEstimate
from tactiled.detect.slip.noise_floor import GROUP_SCANS, GroupedNoiseFloor
from tactiled.detect.slip.phases import SlipPhaseTracker
from tactiled.detect.slip.plateau import PlateauTracker
from tactiled.detect.slip.response import AXES, FALLING, PRESSURE, ResponseModel, motion, moved, responses

ARRAY = load_array("wang2019-3x3")
ALL = np.ones(ARRAY.n_taxels, dtype=np.bool_)


def shown(direction_deg: float) -> FloatArray:
    """Readings of every channel when the skin moves in a direction."""
    return np.asarray(-np.cos(np.radians(direction_deg - ARRAY.azimuth_deg)))


@given(st.floats(-180, 180), st.lists(st.booleans(), min_size=9, max_size=9).filter(any))
def test_the_response_points_along_the_motion_whatever_taxels_are_left(
    direction_deg: float, whole: list[bool]
) -> None:
    weights = ResponseModel(ARRAY).weights(np.array(whole))
    x, y, turn = motion(responses(weights, 1e6 * shown(direction_deg)[np.newaxis]))[0]
    assert np.hypot(x, y) == pytest.approx(2e6, rel=1e-5)
    assert np.cos(np.arctan2(y, x) - np.radians(direction_deg)) == pytest.approx(1, abs=1e-9)
    assert abs(turn) < 10


def test_a_skin_that_turns_on_the_spot_shows_on_its_own_axis() -> None:
    away = np.degrees(np.arctan2(ARRAY.y_mm - ARRAY.y_mm.mean(), ARRAY.x_mm - ARRAY.x_mm.mean()))
    of_taxel = np.concatenate([shown(a + 90)[4 * k : 4 * k + 4] for k, a in enumerate(away)])
    x, y, turn = motion(responses(ResponseModel(ARRAY).weights(ALL), 1e6 * of_taxel[np.newaxis]))[0]
    assert turn > 5 * np.hypot(x, y)


@given(st.floats(0.1, 2.0))
def test_pressure_alone_is_no_motion(level: float) -> None:
    row = responses(ResponseModel(ARRAY).weights(ALL), np.full((1, ARRAY.n_channels), round(1e6 * level)))[0]
    assert np.abs(motion(row)).max() <= 2
    assert row[PRESSURE] == pytest.approx(1e6 * level, rel=ARRAY.n_channels * 2.0**-21)  # weights are whole


def test_a_side_that_bottomed_out_does_not_bend_the_direction() -> None:
    rest, along = np.full(ARRAY.n_channels, 1e6), shown(30.0)
    weights = ResponseModel(ARRAY).weights(ALL)
    free, bottomed = rest + 9e5 * along, np.maximum(rest + 9e5 * along, 4e5)
    change = moved(*responses(weights, np.stack([rest, bottomed])))
    assert np.degrees(np.arctan2(change[1], change[0])) == pytest.approx(30.0, abs=0.01)
    assert moved(*responses(weights, np.stack([rest, free]))) == pytest.approx(change, rel=1e-3, abs=5)
    bent = motion(responses(weights, (bottomed - rest)[np.newaxis]))[0]
    assert abs(np.degrees(np.arctan2(bent[1], bent[0])) - 30.0) > 3


@pytest.mark.parametrize("rate_hz", [20.0, 100.0, 350.0, 1000.0])
def test_ramps_measure_ramps_and_nothing_else(rate_hz: float) -> None:
    filters = RampFilters(rate_hz)
    k = np.arange(filters.window, dtype=np.float64)[:, np.newaxis]
    flat, _ = filters.apply(np.full((filters.window, 1), 2.0**24))
    assert np.all(flat == 0)
    for ramp, m in enumerate(filters.lengths.tolist()):
        rise = 7 * np.maximum(k - (filters.window - 1 - m), 0)
        out, _ = filters.apply(rise + 12345.0)
        assert out[0, 0, ramp] * filters.rise_scale[ramp] == pytest.approx(7.0 * m)
        assert filters.rise(ramp, rise)[0] == pytest.approx(7.0 * m)


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_filters_are_exact_on_the_largest_numbers(rate_hz: float) -> None:
    filters = RampFilters(rate_hz)
    rng = np.random.default_rng(1)
    seen = rng.choice([-(2.0**25), 2.0**25], size=(filters.window + 40, AXES))
    ramps, details = filters.apply(seen)
    for start in (0, 17, 40):
        one = filters.apply(seen[start : start + filters.window])
        assert np.array_equal(one[0][0], ramps[start])
        assert np.array_equal(one[1][0], details[start])


@pytest.mark.parametrize("smooth", [0.0, 0.5, 0.9])
def test_the_noise_of_every_ramp_follows_from_its_octaves(smooth: float) -> None:
    """Noise of any colour, from the floors that the bank has of it."""
    rng = np.random.default_rng(2)
    noise = rng.normal(size=60_000)
    for k in range(1, len(noise)):
        noise[k] += smooth * noise[k - 1]
    filters = RampFilters(100.0)
    ramps, details = filters.apply(np.rint(1000 * noise)[:, np.newaxis])
    stated = filters.ramp_sd(details[:, 0].std(axis=0)[:, np.newaxis])[0]
    # What is below the last octave is drawn on from it.
    assert np.all(ramps[:, 0].std(axis=0) < 1.15 * stated)
    assert np.all(ramps[:, 0].std(axis=0) > 0.6 * stated)


def add(floor: GroupedNoiseFloor, row: FloatArray, *, disturbed: bool) -> None:
    """Add the details (columns, levels) of one scan."""
    floor.add(row[np.newaxis], np.zeros((1, len(LEVELS), 0)), disturbed)


def floor_of(sd: FloatArray, seed: int, **disturbed: bool) -> FloatArray:
    """The floor after details of white noise with these standard deviations, scan by scan."""
    floor = GroupedNoiseFloor(len(LEVELS), 1, 100.0)
    rng = np.random.default_rng(seed)
    for row in sd[:, np.newaxis, np.newaxis] * rng.normal(size=(len(sd), 1, len(LEVELS))):
        add(floor, row, **({"disturbed": False} | disturbed))
    return np.asarray(floor.sd[:, 0])


def test_the_floor_is_the_noise_s_standard_deviation() -> None:
    assert floor_of(np.full(4000, 500.0), 3) == pytest.approx(np.full(len(LEVELS), 500.0), rel=0.25)


@pytest.mark.parametrize("factor", [100.0, 0.01])
def test_a_floor_that_changes_a_hundredfold_is_followed(factor: float) -> None:
    sd = np.concatenate([np.full(2000, 2000.0), np.full(1000, 2000.0 * factor)])
    wanted = max(2000.0 * factor, 64.0)
    assert floor_of(sd, 4)[0] == pytest.approx(wanted, rel=0.3)


def test_the_floor_is_frozen_while_something_happens_but_not_for_ever() -> None:
    before = floor_of(np.full(2000, 500.0), 5)
    for scans, is_frozen in ((GROUP_SCANS * 6, True), (3000, False)):
        floor = GroupedNoiseFloor(len(LEVELS), 1, 100.0)
        rng = np.random.default_rng(5)
        for row in 500.0 * rng.normal(size=(2000, 1, len(LEVELS))):
            add(floor, row, disturbed=False)
        for row in 5000.0 * rng.normal(size=(scans, 1, len(LEVELS))):
            add(floor, row, disturbed=True)
        assert np.array_equal(floor.sd[:, 0], before) == is_frozen


def alarms_per_hour(allowed: float, smooth: float, scans: int, seed: int) -> float:
    """Alarms on noise, of any size of rise, after two seconds in which the floor is learnt."""
    evidence = ShearEvidence(ARRAY, 100.0, allowed, 1e-9)
    rng = np.random.default_rng(seed)
    state = np.zeros(ARRAY.n_channels)
    alarms, last, index = 0, -100, 0
    for _ in range(scans // 256):
        steps = rng.normal(size=(256, ARRAY.n_channels))
        for row in steps if smooth else ():
            row += smooth * state
            state = row.copy()
        held = HeldReadings(np.rint(1e6 + 3000 * steps), np.ones(steps.shape, dtype=np.bool_), True)
        for stretch in evidence.segments(held):
            for row in range(len(stretch.fits)):
                if index > 400 and evidence.growth(stretch, row, 10**6, 0.0) is not None:
                    alarms += index - last > 30  # one noise, one alarm
                    last = index
                evidence.learn(stretch, row, disturbed=False)
                index += 1
    return alarms * 360_000 / scans


@pytest.mark.parametrize(("allowed", "scans"), [(120.0, 100_000), (360.0, 60_000), (1200.0, 20_000)])
def test_white_noise_raises_as_many_alarms_as_are_stated(allowed: float, scans: int) -> None:
    """Within a factor of 1.5; some 50 alarms are counted at each rate."""
    assert allowed / 1.5 < alarms_per_hour(allowed, 0.0, scans, 6) < allowed * 1.5


@pytest.mark.parametrize(("smooth", "times"), [(0.5, 2.5), (0.8, 2.5)])
def test_coloured_noise_raises_few_more(smooth: float, times: float) -> None:
    """Without its octaves the floor would be a third of the noise, and everything an alarm."""
    assert alarms_per_hour(360.0, smooth, 60_000, 7) < 360 * times


def odds_of_slip(
    travel: float, *, noise: float = 0.0, seed: int = 0, taxels: int = 9, spread: float = 0.2, scans: int = 60
) -> float | None:
    """Of taxels of unequal loads and gains, when an even pull has come to rest there.

    Travel is in that of gross slip; taxels are balls on Mindlin's curve.
    """
    rng = np.random.default_rng(seed)
    load = 1 + rng.uniform(-spread, spread, taxels)
    gain = 1 + rng.uniform(-spread / 2, spread / 2, taxels)
    late, none, eye = rng.uniform(0.0, 0.7, taxels), np.zeros(taxels), np.eye(taxels)
    weights = np.zeros((7, 2 * taxels))
    weights[0], weights[6] = np.r_[gain / 2, none], np.r_[none, gain]
    weights[3] = -weights[0]
    own_load, start = np.hstack([0 * eye, np.diag(gain)]), np.concatenate([none, load])
    limit = FrictionLimitTest(
        weights, np.arange(taxels), np.hstack([eye, eye]), own_load, start, np.r_[late, none]
    )
    even = np.linspace(0, 1, 20 * scans)
    rest = []
    total = mindlin(travel * even[:, np.newaxis] / load ** (2 / 3)) @ load
    for scan in range(1, scans + 5):
        # Such travel that the whole grows evenly, and rests after the last scan.
        part = np.minimum((scan + late) / scans, 1.0)
        now = np.interp(part, total / total[-1], travel * even)
        seen = load * mindlin(now / load ** (2 / 3)) + noise * rng.normal(size=taxels)
        readings = np.concatenate([seen, load])
        if scan <= scans:
            limit.take(float(scan), readings)
        else:
            rest.append(readings)
    return limit.odds(np.stack(rest))


def test_rising_sides_that_cancel_tell_nothing() -> None:
    """Falling sides bottom out; of the rising ones seven rise by as much as two fall: no whole to share."""
    eye, none = np.eye(9), np.zeros((9, 9))
    weights = np.zeros((7, 27))
    weights[0, :9], weights[3, 9:18], weights[6, 18:] = 1.0, 1.0, 1.0
    load, rise, fall = np.linspace(0.8, 1.2, 9), np.r_[np.full(7, 0.25), -0.875, -0.875], np.full(9, -14.4)
    start = np.r_[np.full(18, 32.0), load]
    own_load = np.hstack([none, none, eye])
    limit = FrictionLimitTest(
        weights, np.arange(9), np.hstack([eye, eye, eye]), own_load, start, np.zeros(27)
    )
    end = start + np.r_[rise, fall, np.zeros(9)]
    for scan in range(1, 20):
        limit.take(float(scan), start + (end - start) * scan / 20)
    assert limit.odds(np.tile(end, (4, 1))) is None


@given(st.floats(0.05, 0.5), st.integers(0, 99))
@settings(max_examples=40)
def test_taxels_that_keep_their_shares_hold(travel: float, seed: int) -> None:
    odds = odds_of_slip(travel, seed=seed)
    assert odds is not None
    assert odds < -1


@pytest.mark.parametrize("spread", [0.06, 0.2])
@pytest.mark.parametrize("travel", [1.2, 1.5, 2.0, 3.0])
def test_taxels_at_friction_s_limit_do_not(travel: float, spread: float) -> None:
    found = [odds_of_slip(travel, seed=seed, taxels=9 + seed % 8, spread=spread) for seed in range(60)]
    odds = [each for each in found if each is not None]
    assert len(odds) > 50
    assert np.mean(np.array(odds) > 0) >= 0.95
    assert min(odds) > -1.1


@pytest.mark.parametrize("noise", [1e-3, 3e-3, 1e-2])
def test_noise_makes_it_unsure_not_wrong(noise: float) -> None:
    """Of the mean taxel's limit, loads alike to 6 %: what is surely said is right."""
    slips = [odds_of_slip(1.2, noise=noise, seed=seed, spread=0.06) for seed in range(50)]
    loads = [odds_of_slip(0.4, noise=noise, seed=seed, spread=0.06) for seed in range(50)]
    assert np.mean([odds is not None and odds < -1.1 for odds in slips]) <= 0.04
    assert np.mean([odds is not None and odds > 1.1 for odds in loads]) <= 0.04


@pytest.mark.parametrize(("noise", "least"), [(3e-3, 0.9), (1e-2, 0.6)])
def test_noise_leaves_most_loads_that_stay_known_as_such(noise: float, least: float) -> None:
    odds = [odds_of_slip(0.4, noise=noise, seed=seed) for seed in range(50)]
    assert np.mean([each is not None and each < 0 for each in odds]) >= least


def test_a_long_rise_is_told_as_a_short_one() -> None:
    """Rows become one in twos: no more memory, no other answer."""
    short, long = odds_of_slip(1.2, scans=100, seed=3), odds_of_slip(1.2, scans=3000, seed=3)
    assert short is not None
    assert long is not None
    assert abs(long - short) < 0.3 * short


def test_few_taxels_equal_loads_or_a_rise_within_some_scans_tell_nothing() -> None:
    assert odds_of_slip(0.3, taxels=6) is None
    assert odds_of_slip(0.3, spread=0.0) is None
    assert odds_of_slip(0.3, scans=4) is None


@pytest.mark.parametrize(("odds", "may_slip"), [(-5.0, False), (-1.0, True)])
def test_a_rest_of_small_odds_may_be_a_slip_until_it_is_known_better(odds: float, may_slip: bool) -> None:
    rest = PlateauTracker(100.0)
    assert not rest.is_gross(2, 1.0, 0.001, lambda: odds)
    assert np.isfinite(rest.doubtful_at) == may_slip
    rest.goes_on()
    assert np.isfinite(rest.doubtful_at) == may_slip
    assert not rest.is_gross(2, 1.05, 0.001, lambda: -9.0)
    assert not np.isfinite(rest.doubtful_at)


def test_what_is_known_of_a_rest_is_not_asked_again_until_it_has_grown() -> None:
    rest, asked = PlateauTracker(100.0), list[float]()

    def odds() -> float:
        asked.append(1.0)
        return -9.0

    for shear in (1.0, 1.005, 0.99, 1.01, 1.03):
        assert not rest.is_gross(9, shear, 0.001, odds)
    assert len(asked) == 2


def mindlin(x: FloatArray) -> FloatArray:
    return np.asarray(1 - np.maximum(1 - x, 0) ** 1.5)


def follow(shear: FloatArray, *, noise: float = 0.0, seed: int = 0) -> list[tuple[str, float, int]]:
    """Fates of a slip along x whose shear over pressure is this from its onset on, at 100 Hz.

    Returns
    -------
    list of (fate, scan, scan at which it was known)
    """
    rows = np.zeros((len(shear) + 200, FALLING.stop + 1))
    rows[:, :6] = rows[:, 6:] = 1e6
    rows[200:, 0] += 5e5 * shear
    rows[200:, 3] -= 5e5 * shear
    rows[:, :6] = np.rint(rows[:, :6] + noise * np.random.default_rng(seed).normal(size=(len(rows), 6)))
    even = np.ones(7)
    slope = max(1e6 * float(shear[4]) / 4, 1.0)
    readings = np.zeros((156, 0))
    limit = FrictionLimitTest.unobserved(readings.shape[1])
    course = SlipPhaseTracker(
        np.eye(3)[0],
        rows[200],
        even,
        204,
        KinkEstimate(4.0, 1.0),
        slope,
        100.0,
        least=0.1,
        gross=0.45,
        limit=limit,
    )
    fates: list[tuple[str, float, int]] = []
    for index in range(205, len(rows)):
        if verdict := course.step(index, rows[index - 155 : index + 1], readings, noise * np.sqrt(2)):
            fates.append((verdict.outcome, verdict.at_index - 200, index - 200))
            if verdict.outcome not in ("gross", "back"):
                break
    return fates


@given(st.integers(8, 120), st.floats(0.6, 1.2), st.sampled_from([0.0, 1e3, 5e3]))
@settings(max_examples=40)
def test_a_dragged_skin_is_gross_when_nine_tenths_slip(travel: int, limit: float, noise: float) -> None:
    shear = limit * mindlin(np.arange(travel + 300) / travel)
    fates = follow(shear, noise=noise)
    assert [fate for fate, _, _ in fates] == ["gross"]
    _, at, known = fates[0]
    assert at == pytest.approx(0.9 * travel, abs=2 + 0.12 * travel)
    assert known <= travel + 30


@given(st.integers(20, 100), st.floats(0.5, 1.2), st.floats(0.5, 3.0))
@settings(max_examples=40)
def test_a_load_that_comes_and_goes_is_never_gross(up: int, most: float, slower: float) -> None:
    down = round(slower * up)
    shear = np.concatenate([np.linspace(0, most, up), np.linspace(most, 0, down), np.zeros(50)])
    fates = follow(shear)
    assert [fate for fate, _, _ in fates] == ["back", "rests"]
    assert fates[0][1] == pytest.approx(up, abs=0.05 * (up + down) + 2)


@given(st.integers(10, 100), st.floats(0.15, 0.4))
@settings(max_examples=20)
def test_a_load_that_stays_below_what_is_gross_has_stalled(up: int, most: float) -> None:
    fates = follow(np.concatenate([np.linspace(0, most, up), np.full(100, most)]))
    assert [fate for fate, _, _ in fates] == ["stalled"]
    assert fates[0][1] == pytest.approx(up, abs=5)


def test_what_breaks_away_was_gross_at_its_top() -> None:
    up, slow = np.linspace(0, 0.9, 200), np.linspace(0.5, 0.55, 60)
    (fate, at, known), *more = follow(np.concatenate([up, slow]))
    assert (fate, at) == ("gross", 199)
    assert known <= 202
    assert more == []


def test_a_gross_slip_that_turns_round_ends_and_is_then_one_the_other_way() -> None:
    there = 0.9 * mindlin(np.arange(120) / 40)
    back = 0.9 - 1.8 * mindlin(np.arange(200) / 80)
    fates = follow(np.concatenate([there, back]))
    assert [fate for fate, _, _ in fates] == ["gross", "back", "reversed"]
    assert fates[1][1] == pytest.approx(120, abs=3)
    assert fates[1][2] < fates[2][2] < 155


def test_a_gross_slip_whose_skin_relaxes_has_ended_and_goes_nowhere() -> None:
    there = 0.9 * mindlin(np.arange(120) / 40)
    relaxed = 0.9 - 0.36 * (1 - np.exp(-np.arange(200) / 30))
    fates = follow(np.concatenate([there, relaxed]))
    assert [fate for fate, _, _ in fates] == ["gross", "back", "rests"]


def test_a_slide_at_a_steady_load_never_ends() -> None:
    shear = 0.9 * mindlin(np.arange(20_000) / 40)
    assert [fate for fate, _, _ in follow(shear, noise=3e3, seed=9)] == ["gross"]


def test_ramps_have_a_baseline_of_their_own() -> None:
    """Evidence may not reach into what is told: a rise that is over is no new one."""
    evidence = ShearEvidence(ARRAY, 100.0, 1.0, 0.05)
    steps = np.full((120, ARRAY.n_channels), 1e6)
    steps += 1e5 * np.clip((np.arange(120)[:, np.newaxis] - 60) / 5, 0, 1) * shown(20.0)
    grown = {}
    for stretch in evidence.segments(
        HeldReadings(np.rint(steps), np.ones(steps.shape, dtype=np.bool_), True)
    ):
        for scan, since in ((64, 64), (90, 90), (90, 90 - 66), (64, N_BASELINE + 1)):
            if stretch.scans.start <= scan < stretch.scans.stop:
                grown[scan, since] = evidence.growth(stretch, scan - stretch.scans.start, since, 0.0)
    assert [key for key, growth in grown.items() if growth is not None] == [(64, 64), (90, 90)]
    assert len(grown) == 4
