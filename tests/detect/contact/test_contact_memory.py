"""Parts of the contact filter: memory, friction, thresholds, trees, and the posterior that is published."""

import math
from array import array
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.train.rows import silent
from tactiled.detect.contact.filter import ContactFilter
from tactiled.detect.contact.friction import FrictionMemory
from tactiled.detect.contact.hysteresis import SlipHysteresis
from tactiled.detect.contact.memory import MEMORY_NAMES, Memory, kept_load
from tactiled.detect.contact.posterior import N_STATES, RIPPLE_P, Posterior
from tactiled.detect.contact.signs import Signs
from tactiled.detect.contact.trees import Trees

LOOK_S = 0.02


def contact_filter() -> ContactFilter:
    """Filter of two taxels whose trees tell nothing."""
    return ContactFilter(
        Signs([-1.0, 1.0], [0.0, 0.0], LOOK_S),
        silent(),
        Memory(-2.0),
        FrictionMemory(0.6, 0.6),
        Posterior(LOOK_S),
        SlipHysteresis(0.9, 0.5, LOOK_S),
        100.0,
    )


def told(p: float, ratio: float, seconds: float, one: Memory | None = None) -> Memory:
    """Memory after a time of the same odds and ratio."""
    one = one or Memory(-2.0)
    for _ in range(round(seconds / LOOK_S)):
        one.take(p, ratio, LOOK_S, 1.0)
    return one


def slid(p: float, ratio: float, seconds: float, one: FrictionMemory | None = None) -> FrictionMemory:
    """Friction after a time of the same ratio, at a probability of sliding."""
    one = one or FrictionMemory(0.6, 0.6)
    for _ in range(round(seconds / LOOK_S)):
        one.learn(p, ratio, 1.0, LOOK_S)
    return one


def test_a_slide_teaches_friction_and_the_next_contact_keeps_it() -> None:
    one = slid(0.95, 0.35, 1.5)
    assert math.exp(one.log_mean) == pytest.approx(0.35, rel=0.1)
    sd = math.sqrt(one.variance)
    assert sd < 0.15
    assert (math.exp(one.contact_log_mean), math.sqrt(one.contact_variance)) == pytest.approx((0.6, 0.6))
    one.end_contact()
    one.begin_contact()
    assert math.exp(one.contact_log_mean) == pytest.approx(0.35, rel=0.1)
    assert sd < math.sqrt(one.contact_variance) < 0.3


def test_a_doubtful_rest_of_minutes_teaches_no_friction() -> None:
    one = slid(0.45, 0.3, 300.0)
    assert math.exp(one.log_mean) == pytest.approx(0.6)
    stated = FrictionMemory(0.6, 0.1)
    slid(0.45, 0.3, 300.0, stated)
    assert (math.exp(stated.log_mean), math.sqrt(stated.variance)) == pytest.approx((0.6, 0.1))


def test_shear_that_is_borne_is_a_lower_bound_of_friction() -> None:
    one = slid(0.001, 0.9, 1.0)
    assert math.exp(one.log_mean) >= 0.9
    assert math.sqrt(one.variance) > 0.4


@pytest.mark.parametrize("p", [0.95, 0.001])
def test_a_lift_teaches_no_friction(p: float) -> None:
    """Shear that is left while the load goes makes a large ratio, which the next contact need not bear."""
    one = slid(0.95, 0.35, 1.5)
    for look in range(24):
        one.learn(p, 0.35 / (1 - look / 50), 1 - look / 25, LOOK_S)
    assert math.exp(one.log_mean) == pytest.approx(0.35, rel=0.15)


def test_stated_friction_has_a_floor_of_what_one_number_can_say() -> None:
    one = FrictionMemory(0.6, 0.6)
    one.expect(0.5, 0.001)
    assert math.exp(one.log_mean) == pytest.approx(0.5)
    assert math.sqrt(one.variance) >= 0.05


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1e6), st.floats(-1e3, 1e3)), max_size=200))
@settings(max_examples=30, deadline=None)
def test_friction_is_finite_and_no_wider_than_before(looks: list[tuple[float, float, float]]) -> None:
    one = FrictionMemory(0.6, 0.6)
    for p, ratio, log_load_change in looks:
        one.learn(p, ratio, kept_load(log_load_change), LOOK_S)
        assert math.isfinite(one.log_mean)
        assert 0 < one.variance <= 0.36 + 1e-12


def test_silence_refutes_what_was_said() -> None:
    filtered = MEMORY_NAMES.index("filtered_odds")
    one = told(0.9, 0.5, 1.0)
    assert one.row[filtered] > 2
    assert told(0.001, 0.5, 1.0, one).row[filtered] < -2


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1e6)), max_size=200))
@settings(max_examples=30, deadline=None)
def test_memory_is_finite(looks: list[tuple[float, float]]) -> None:
    one = Memory(-2.0)
    for p, ratio in looks:
        one.take(p, ratio, LOOK_S, 1.0)
        assert all(math.isfinite(value) for value in one.row)


def test_a_slip_opens_at_its_probability_and_closes_well_below_it() -> None:
    gate = SlipHysteresis(0.9, 0.5, LOOK_S)
    states = []
    course = [*10 * [0.1], 0.6, *5 * [0.3], *3 * [0.1], 0.3, *10 * [0.1]]
    for p in course:
        gate.look(p, p, 0.5, 0.0)
        states.append(gate.is_gross)
    assert states == [*10 * [False], *17 * [True], *3 * [False]]


def test_no_slip_opens_right_after_a_gap() -> None:
    gate = SlipHysteresis(0.9, 0.5, LOOK_S)
    found = []
    for _ in range(5):
        gate.look(1.0, 1.0, 0.5, 0.0)
        found.append(gate.is_open)
    assert found == [False, False, False, True, True]
    gate.close()
    assert (gate.is_open, gate.is_gross) == (False, False)


def test_a_ratio_that_does_not_grow_is_no_new_incipient_slip() -> None:
    gate = SlipHysteresis(0.9, 0.5, LOOK_S)
    gate.begin(is_seen=False)
    for _ in range(20):
        gate.look(0.95, 0.0, 0.5, 0.0)
    assert not gate.is_open
    gate.look(0.95, 0.0, 0.56, 0.0)
    assert (gate.is_open, gate.is_gross) == (True, False)


def test_what_noise_may_make_of_the_ratio_is_no_slip() -> None:
    gate = SlipHysteresis(0.9, 0.5, LOOK_S)
    for _ in range(20):
        gate.look(0.95, 0.0, 0.2, 0.1)
    assert not gate.is_open
    gate.look(0.95, 0.0, 0.31, 0.1)
    assert gate.is_open


def test_a_slide_that_is_surely_over_closes_at_once() -> None:
    gate = SlipHysteresis(0.9, 0.5, LOOK_S)
    for p in (*5 * [0.9], 0.01):
        gate.look(p, p, 0.5, 0.0)
    assert not gate.is_open


def test_a_slip_at_a_low_threshold_stays_open_while_it_is_as_likely() -> None:
    gate = SlipHysteresis(0.9, 0.01, LOOK_S)
    for _ in range(20):
        gate.look(0.015, 0.015, 0.5, 0.0)
        assert gate.is_gross == (gate.n_looks > gate.n_settle)


def odds_of(scores: Sequence[float]) -> float:
    """Log odds of sliding by scores of the states."""
    return scores[-1] - math.log(sum(map(math.exp, scores[:-1])))


def posterior(cells: Sequence[float]) -> Posterior:
    """Posterior after scores that are cells; a ratio that nearly every friction of the prior may bear.

    The signs give sliding the same odds.
    """
    one = Posterior(LOOK_S)
    scores = [math.log(max(p, 1e-9)) for p in cells]
    one.take(scores, [0.0, -2.0, -3.0, -4.0], odds_of(scores), 0.16, math.log(0.6), 0.36, True, False)
    return one


POSITIVE = st.lists(st.floats(0.001, 1), min_size=N_STATES, max_size=N_STATES)


@given(POSITIVE, st.booleans())
def test_what_is_published_follows_the_slip_that_is_open(weights: list[float], is_gross: bool) -> None:
    contact = contact_filter()
    contact.posterior = posterior(weights)
    contact.hysteresis.is_gross = contact.hysteresis.is_open = is_gross
    contact.ratio = contact.slid_at = 0.5
    contact.publish()
    low, median, high = contact.posterior.utilisation
    contact.posterior.publish(False, 0.0, contact.ratio, 0.0, 0.1)
    assert low == contact.posterior.utilisation[0]  # that of the looks alone
    contact.publish()
    assert 0 <= low <= median <= high <= 1
    assert contact.friction[0] <= contact.friction[1] <= contact.friction[2]
    assert contact.p_gross[0] <= contact.p_gross[1] <= contact.p_gross[2] <= 1
    assert contact.posterior.p_sliding <= 1
    if is_gross:
        assert median >= 0.9
        assert contact.p_gross == (1.0, 1.0, 1.0)
        assert contact.posterior.p_sliding >= 0.5 / 3
        assert contact.friction == pytest.approx((0.45, 0.5, 0.5 / 0.9))
    else:
        assert contact.posterior.p_sliding == contact.p_sliding_now


@given(POSITIVE, st.floats(-30, 30), st.floats(1e-6, 1e6), st.floats(0.05, 3), st.booleans(), st.booleans())
def test_the_posterior_is_a_distribution_for_any_ratio(
    weights: list[float], odds: float, ratio: float, sd: float, has_zero: bool, ripple_travels: bool
) -> None:
    one = Posterior(LOOK_S)
    scores = [math.log(weight) for weight in weights]
    for now in (1.0, ratio, ratio):
        one.take(scores, [0.0, 1.0, 2.0, 3.0], odds, now, math.log(0.6), sd * sd, has_zero, ripple_travels)
    assert sum(one.cells) == pytest.approx(1.0)
    assert min(one.cells) > 0
    assert 0 < one.soon[0] < one.soon[1] < one.soon[2] < 1
    assert not ripple_travels or one.cells[-1] >= RIPPLE_P - 1e-12


def test_the_odds_of_sliding_are_the_mean_of_those_by_state_and_by_signs() -> None:
    scores = [0.0, *[-40.0] * (N_STATES - 2), -1.0]
    here = math.log(0.6), 0.36, True, False
    of_state, of_both = Posterior(LOOK_S), Posterior(LOOK_S)
    of_state.take(scores, [0.0] * 4, -1.0, 0.3, *here)
    of_both.take(scores, [0.0] * 4, 3.0, 0.3, *here)
    odds = [math.log(one.cells[-1] / (1.0 - one.cells[-1])) for one in (of_state, of_both)]
    assert odds[1] - odds[0] == pytest.approx(2.0)


def test_a_friction_that_nothing_has_is_not_believed() -> None:
    """A ratio of 3 with a fifth of friction in use would need a friction of 13."""
    one = Posterior(LOOK_S)
    alike = [0.0] * N_STATES
    one.take(alike, [0.0] * 4, odds_of(alike), 3.0, math.log(0.6), 0.36, True, False)
    assert max(one.cells[:3]) < 0.15 * one.cells[-1]
    one.begin()
    one.take(alike, [0.0] * 4, odds_of(alike), 0.3, math.log(0.6), 0.36, True, False)
    assert min(one.cells[1:]) == pytest.approx(max(one.cells[1:]))


def test_a_slide_does_not_go_on_with_a_quarter_of_what_it_bore() -> None:
    alike, known = [0.0] * N_STATES, (math.log(0.6), 0.01, True)
    one = Posterior(LOOK_S)
    one.take(alike, [0.0] * 4, odds_of(alike), 0.55, *known, False)
    whole = one.cells[-1]
    for _ in range(10):
        one.take(alike, [0.0] * 4, odds_of(alike), 0.15, *known, False)
    assert one.cells[-1] < 0.02 < whole


def test_one_look_counts_by_what_is_new_in_it() -> None:
    """The first look is taken as it is; later ones move the log odds by their part of the averaging time."""
    rests, slides = [0.0] * N_STATES, [*[0.0] * (N_STATES - 1), 6.0]
    here = 0.3, math.log(0.6), 0.36, True, False
    one, at_once = Posterior(LOOK_S), Posterior(LOOK_S)
    odds = []
    for posterior_of, scores in ((one, rests), (one, slides), (one, slides), (at_once, slides)):
        posterior_of.take(scores, [0.0] * 4, odds_of(scores), *here)
        p = posterior_of.cells[-1]
        odds.append(math.log(p / (1.0 - p)))
    new = 1.0 - math.exp(-1.0)
    assert odds[3] - odds[0] == pytest.approx(6.0)
    assert odds[1] - odds[0] == pytest.approx(6.0 * new)
    assert odds[2] - odds[1] == pytest.approx(6.0 * new * (1.0 - new))


def test_the_first_look_after_a_gap_is_not_averaged_with_one_from_before() -> None:
    contact = contact_filter()
    rests, slides = [0.0] * N_STATES, [*[0.0] * (N_STATES - 1), 6.0]
    here = [0.0] * 4, 0.0, 0.3, math.log(0.6), 0.36, True, False
    contact.posterior.take(rests, *here)
    contact.restart()
    contact.posterior.take(slides, *here)
    fresh = Posterior(LOOK_S)
    fresh.take(slides, *here)
    assert list(contact.posterior.cells) == list(fresh.cells)


def test_quantiles_are_those_of_the_cells() -> None:
    cells = [0.0] * N_STATES
    cells[4] = 1.0  # 0.6 to 0.7
    one = posterior(cells)
    one.publish(False, 0.25, 0.3, math.log(0.6), 0.36)
    assert list(one.utilisation) == pytest.approx([0.605, 0.65, 0.695], abs=1e-6)
    assert one.friction[1] == pytest.approx(0.3 / 0.65)
    one = posterior([0.0] * (N_STATES - 1) + [1.0])
    one.publish(False, 0.25, 0.3, math.log(0.6), 0.36)
    assert list(one.utilisation) == [1.0, 1.0, 1.0]


def test_trees_add_the_leaf_that_a_row_reaches_and_nan_goes_where_it_was_told() -> None:
    table = {
        "first": [1.0], "root": [0, 3], "output": [0, 0],
        "links": [(0, 2), (-1, 0), (-1, 0), (3, 5), (-1, 0), (-1, 0)],  # the second: feature 1, NaN goes left
        "value": [0.5, 10.0, 20.0, -1.0, 100.0, 200.0],
    }  # fmt: skip
    forest = Trees(table)
    for row, wanted in (([0.5, 0.0], 211.0), ([0.6, -1.0], 121.0), ([math.nan, math.nan], 121.0)):
        forest.evaluate(array("d", row))
        assert forest.scores[0] == wanted


@given(seed=st.integers(0, 2**32), n_leaves=st.integers(1, 32))
def test_trees_give_what_walking_them_gives(seed: int, n_leaves: int) -> None:
    """Rows have values at limits, too, and values that are missing."""
    rng = np.random.default_rng(seed)
    limits = [-1.0, 0.0, 0.5, 2.0]
    links: list[tuple[int, int]] = []
    value: list[float] = []

    def grow(n: int) -> None:
        at, left = len(links), int(rng.integers(1, n)) if n > 1 else 0
        links.append((int(rng.integers(10)) if left else -1, 0))
        value.append(float(rng.choice(limits) if left else rng.standard_normal()))
        if left:
            grow(left)
            links[at] = links[at][0], len(links)
            grow(n - left)

    def walk(node: int, row: "array[float]") -> float:
        link, right = links[node]
        if link < 0:
            return value[node]
        x = row[link >> 1]
        return walk(node + 1 if (link & 1 if math.isnan(x) else x <= value[node]) else right, row)

    roots = []
    for _ in range(3):
        roots.append(len(links))
        grow(n_leaves)
    forest = Trees({"first": [0.0] * 3, "root": roots, "output": [2, 0, 1], "links": links, "value": value})
    row = array("d", rng.choice([*limits, 0.2, -3.0, 9.0, math.nan], 5))
    forest.evaluate(row)
    assert list(forest.scores) == [walk(roots[k], row) for k in (1, 2, 0)]


def test_trees_have_at_most_32_leaves() -> None:
    links = [one for k in range(32) for one in ((0, 2 * k + 2), (-1, 0))] + [(-1, 0)]
    with pytest.raises(ValueError, match="more than 32 leaves"):
        Trees({"first": [0.0], "root": [0], "output": [0], "links": links, "value": [0.0] * 65})
