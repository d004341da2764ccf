"""Worlds and scores of the grip bench against what is known of them."""

import dataclasses
from collections import Counter

import numpy as np
import pytest

from bench.grip.bench import ANNOUNCED, KNOWN, LEARNT, LEFT_OUT, aims
from bench.grip.cost import ScanCost
from bench.grip.hands import Minute, _event_row, count_reports
from bench.grip.judge import Course, course, score
from bench.worlds.laws import USUAL, Population, draw_worlds
from bench.worlds.world import INCIPIENT_USED, World
from tactiled.detect.contact.grip_detector import GripParams


@pytest.fixture(scope="module")
def worlds() -> list[World]:
    return draw_worlds(range(20_000, 20_012))


def test_truth_stays_within_physics(worlds: list[World]) -> None:
    for world in worlds:
        assert len(world.utilisation) == len(world.block) == len(world.gross)
        assert np.all((world.utilisation >= 0) & (world.utilisation <= 1.0 + 1e-6))
        assert np.isfinite(world.block.volts).all()
        assert all(0 < gross_s < USUAL.duration_s for gross_s in world.gross_s)
        assert all(a <= b for a, b in zip(world.tenth_s, world.gross_s, strict=True))
        assert world.gross.any() == world.slips or world.gross_s[-1] > USUAL.duration_s - 0.1
    assert any(world.slips for world in worlds)
    assert not all(world.slips for world in worlds)


def truth(world: World) -> Course:
    """Answers that are the truth and foresee it."""
    at = np.arange(len(world.block))
    sliding = world.gross.astype(np.float64)
    used = np.where(world.gross, 1.0, np.minimum(world.utilisation, 1.0))
    ratio = used * np.nan_to_num(world.friction)
    course = Course(world, at, sliding, np.stack([used] * 3, axis=1), sliding, world.gross, ratio)
    return dataclasses.replace(course, p_gross_300ms=np.maximum(sliding, course.soon))


def test_scores_of_the_truth_are_perfect(worlds: list[World]) -> None:
    found = score([truth(world) for world in worlds])
    assert (found.auc, found.skill_300ms) == pytest.approx((1.0, 1.0))
    assert (found.used_rms, found.coverage) == (0.0, 1.0)
    assert found.friction_rms == pytest.approx(0.0, abs=1e-12)
    assert (found.told_gross, found.rests_while_gross, found.resting_false_per_h) == (1.0, 0.0, 0.0)
    assert (found.auc_new, found.told_gross_new) == pytest.approx((1.0, 1.0))
    assert found.auc_interval == (1.0, 1.0)
    assert found.false_per_h == 0.0


def test_a_constant_probability_has_no_skill(worlds: list[World]) -> None:
    courses = [truth(world) for world in worlds]
    rate = float(np.concatenate([c.soon[~c.slides] for c in courses]).mean())
    same = [np.full(len(c.at), rate) for c in courses]
    told = [dataclasses.replace(c, p_sliding=p, p_gross_300ms=p) for c, p in zip(courses, same, strict=True)]
    found = score(told)
    assert found.skill_300ms == pytest.approx(0.0, abs=1e-9)
    assert found.auc == pytest.approx(0.5)
    assert found.auc_interval == pytest.approx((0.5, 0.5))


def test_worlds_that_disagree_make_the_interval_of_the_area_wide(worlds: list[World]) -> None:
    slipping = [truth(world) for world in worlds if world.slips]
    turned = [dataclasses.replace(c, p_sliding=1 - c.p_sliding) for c in slipping[::2]]
    found = score(slipping[1::2] + turned)
    low, high = found.auc_interval
    assert low < found.auc < high
    assert high - low > 0.3


def test_what_happens_later_in_a_long_slide_counts_only_where_the_whole_slide_does(
    worlds: list[World],
) -> None:
    world = next(world for world in worlds if world.slips)
    begin = int(np.argmax(world.gross))
    n_long = round(5 * world.rate_hz)  # as if it slid for seconds, of which two are reported
    gross = np.zeros(len(world.gross), dtype=np.bool_)
    gross[begin : begin + n_long] = True
    lasting = truth(dataclasses.replace(world, gross=gross))
    reported = gross & (np.arange(len(gross)) < begin + 2 * world.rate_hz)
    found = score([dataclasses.replace(lasting, p_sliding=reported.astype(float), told_gross=reported)])
    assert (found.auc_new, found.told_gross_new) == (1.0, 1.0)
    assert found.told_gross == pytest.approx(2 * world.rate_hz / gross.sum(), abs=0.01)
    assert found.auc == pytest.approx((1 + found.told_gross) / 2, abs=0.01)


def test_an_alarm_that_never_ends_finds_no_slip(worlds: list[World]) -> None:
    always = [dataclasses.replace(c, p_sliding=np.full(len(c.at), 0.5)) for c in map(truth, worlds)]
    assert np.isnan(score(always).false_per_h)  # it is no report from 0.1 s before a slip to 0.3 s after it


def test_the_filter_is_run_over_a_world_with_what_is_stated_and_announced(worlds: list[World]) -> None:
    world = next(world for world in worlds if world.slips)
    plain = course(world)
    assert (plain.quantiles[:, 0] <= plain.quantiles[:, 1]).all()
    assert (plain.quantiles[:, 1] <= plain.quantiles[:, 2]).all()
    assert plain.told_gross.any()
    known = course(world, params=GripParams(friction=world.static_friction, friction_log_sd=0.05))
    assert not np.array_equal(known.quantiles, plain.quantiles)
    hand = dataclasses.replace(world, acceleration_m_s2=np.full(len(world.block), 9.81))
    assert not np.array_equal(course(hand, announces=True).p_gross_300ms, plain.p_gross_300ms)


def test_hands_that_hold_stay_where_they_are_planned() -> None:
    worlds = draw_worlds(
        range(40_000, 40_003), Population(hands=("rest", "sway"), duration_s=10.0, most_used=0.3)
    )
    assert [len(world.block) for world in worlds] == [round(10.0 * world.rate_hz) for world in worlds]
    assert {world.hand for world in worlds} <= {"rest", "sway"}
    for world in worlds:
        assert not world.slips
        assert 0.05 < world.utilisation.max() < 0.4
        found = count_reports(world)
        assert found.hours == pytest.approx(9.7 / 3600, rel=0.05)
        before_s = float(np.argmax(world.utilisation >= INCIPIENT_USED)) / world.rate_hz or 10.0
        assert found.unslipped_hours == pytest.approx((before_s - 0.3) / 3600, abs=0.2 / 3600)


def test_false_onsets_are_counted_by_the_hours_in_which_they_can_be_false() -> None:
    one = Minute("rest", 1.0, 0.1, Counter(balanced=1), Counter(balanced=2))
    assert _event_row("rest", [one])["balanced"] == "10.0 (1) / 2.0 (2)"


def test_every_aim_judges_the_worst_generator(worlds: list[World]) -> None:
    best = score([truth(world) for world in worlds])
    kinds = (LEFT_OUT, LEARNT, KNOWN, ANNOUNCED)
    scores = {"one": dict.fromkeys(kinds, best), "other": dict.fromkeys(kinds, best)}
    for aim in aims(scores, ScanCost(39.0, 119.0)):  # the truth has no intervals
        assert (aim.verdict == "met") == (aim.limit != "0.80 to 0.95")
    worse = best._replace(auc=0.9, used_rms=0.2, told_gross=0.5)
    scores["other"] = dict.fromkeys(kinds, worse)
    verdicts = [aim.verdict for aim in aims(scores, ScanCost(41.0, 119.0))]
    assert [verdicts[0], verdicts[1], verdicts[2], verdicts[-1]] == ["MISSED"] * 4
