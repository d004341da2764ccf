"""What is printed, drawn and written of cases made by hand."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from bench.slip import alarms as slip_alarms
from bench.slip import tables as slip_tables
from bench.slip.aims import aims_table, limit_table
from bench.slip.bench import Each
from bench.slip.cost import Cost
from bench.slip.latency import CURVE_PER_HOUR, Case, fastest_level
from bench.slip.limit import GROWTHS, LATENCIES_S, Exceeded, exceeded, growth_by, per_hour
from bench.slip.noise import Tail
from bench.slip.picture import draw_slip
from bench.slip.quiet import HELD, QUIET_NOISES_V, Alarms, Counted, Quiet, count
from bench.slip.report import Measured, numbers_of, text_of
from bench.slip.rest import BANDS, Rest, rest_table, rests
from bench.slip.rivals import Knobs, rivals
from bench.slip.rules import COHERENT, LEVELS, RULES
from bench.slip.scenes import (
    NOISES_V,
    SPEEDS_MM_S,
    Announcement,
    Played,
    announcements,
    play,
    speed_name,
)
from bench.slip.score import Found
from tactiled.array import load_array
from tactiled.detect.slip.coherent import SETTINGS as DETECTOR_SETTINGS
from tactiled.emulator.scene.families import QUIET
from tactiled.progress import ProgressBar

TAIL = Tail(5.0, 0.5, 1.0)
KEYS = [(rule, level) for rule in RULES for level in LEVELS] + [COHERENT]
KNOBS = Knobs(dict.fromkeys(KEYS, TAIL), dict.fromkeys(NOISES_V, 2))
NAMES = list(rivals(KNOBS))
SETTINGS = [name for name, rival in rivals(KNOBS).items() if rival.is_setting]
SAID = Found(0.02, 0.1, -0.01, 0.03, 0.01, 0.02, 0.03, 0.01, 3.0, 5.0, early=1, on_press=0)
_NAN = float("nan")
MISSED = Found(_NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, early=0, on_press=2)
ALARMS = Alarms(hours=2.0, apart_hours=1.0, false=6, gross=1, on_press=2, partial=3, told_false=6)


def case(seed: int, noise_v: float, found: Found) -> Case:
    """Level 2 is the fastest, the oracle takes 10 ms."""
    n = len(CURVE_PER_HOUR)
    rule_s = {key: np.full(n, 0.01 * (1 + abs(key[1] - 2))) for key in KNOBS.tails}
    return Case(
        family="slide" if seed < 2 else "braking-drag",
        seed=seed,
        noise_v=noise_v,
        found=dict.fromkeys(NAMES, found),
        oracle_s=np.full(n, 0.01),
        rule_s=rule_s,
        becoming_s=0.12,
        growth=np.array(LATENCIES_S),
    )


@pytest.fixture
def cases() -> list[Case]:
    found = (SAID, replace(SAID, first_s=0.04, to_gross_s=-0.01), MISSED)
    return [case(seed, noise, one) for noise in NOISES_V for seed, one in enumerate(found)]


@pytest.fixture
def counted() -> Counted:
    quiet = Counted()
    for noise in NOISES_V:
        for name in NAMES:
            quiet["taps", noise, name] = ALARMS
            quiet[HELD, noise, name] = replace(ALARMS, false=0, gross=0, told_false=0)
            quiet["walking", noise, name] = ALARMS
    return quiet


def cells(text: str, *starts: str) -> list[str]:
    """Of the first row that begins so."""
    for line in text.splitlines():
        row = [cell.strip() for cell in line.strip("|").split("|")]
        if row[: len(starts)] == list(starts):
            return row[len(starts) :]
    raise AssertionError(f"no row {starts} in\n{text}")


def test_latency_table(cases: list[Case]) -> None:
    text = slip_tables.latency_table(cases, NAMES)
    assert cells(text, "1 mV", "oracle")[:5] == ["10 ms", "10 ms", "0 of 3", "1.0", "1.0"]
    row = cells(text, "1 mV", NAMES[0])
    assert row[:4] == ["40 ms", "-", "1 of 3", "4.0"]  # of three, one missed: p95 is a miss
    assert row[5:] == ["33 %", "-10 ms / -10 ms (2)", "30 ms", "2", "2"]


def test_speeds_have_rows_of_their_own(cases: list[Case]) -> None:
    steady = [replace(one, family=speed_name(speed)) for speed in SPEEDS_MM_S for one in cases]
    text = slip_tables.speed_table(steady, NAMES)
    assert cells(text, "20 mm/s", "3 mV")[:2] == ["10 ms / 10 ms", "40 ms / -, 1 missed"]
    assert len(text.splitlines()) == 2 + len(SPEEDS_MM_S) * len(NOISES_V)


def test_a_missed_slip_comes_first_among_the_worst(cases: list[Case]) -> None:
    assert cells(slip_tables.worst_table(cases, NAMES, most=1), NAMES[0])[:4] == [
        "braking-drag",
        "2",
        "0.3 mV",
        "missed",
    ]


def test_estimates(cases: list[Case]) -> None:
    row = cells(slip_tables.estimate_table(cases, NAMES), NAMES[0], "1 mV")
    assert row == ["3.0 deg", "3.0 deg", "100 %", "10 ms", "100 %", "30 ms", "0 %"]


def test_false_alarms_a_minute(counted: Counted) -> None:
    text = slip_alarms.quiet_table(counted, NAMES)
    assert cells(text, "0.3 mV", "taps")[:2] == ["120 min", "0.050, 1 gross (+3 right)"]
    assert cells(text, "0.3 mV", HELD)[1] == "0.000 (+3 right)"
    holds = {(HELD, noise, NAMES[0]): ALARMS for noise in NOISES_V}
    assert (
        cells(slip_alarms.hold_table(holds, {NAMES[0]: lambda _: 1.5}), NAMES[0])
        == ["4 of 3, 2 on the press"] * 4
    )


def test_false_alarms_an_hour_are_those_of_families_of_one_weight(counted: Counted) -> None:
    name = NAMES[0]
    counted["taps", 3e-3, name] = replace(ALARMS, told_false=2)
    counted["cable-tug", 3e-3, name] = replace(ALARMS, false=90)
    # Taps 3, tugs 45, a hold none an hour; nobody can tell of tugs, nor of walking, which is held out.
    total = slip_alarms.total
    assert total(counted, name, "tuned on", [3e-3], told=False).per_hour == pytest.approx(16.0)
    assert total(counted, name, "tuned on", [3e-3], told=True, outside=False).per_hour == pytest.approx(0.5)
    assert total(counted, name, "held out", [3e-3], told=False).per_hour == pytest.approx(3.0)
    assert np.isnan(total(counted, name, "held out", [3e-3], told=True, outside=False).per_hour)


def test_the_interval_is_that_of_the_count_of_motions(counted: Counted) -> None:
    one = slip_alarms.mean_rate([ALARMS], told=False)
    # 6 in 2 h, of which one hour differs by more than noise: as 3 in that hour, exactly (Garwood).
    assert one == pytest.approx((3.0, chi2.ppf(0.025, 6) / 2, chi2.ppf(0.975, 8) / 2))
    none = slip_alarms.mean_rate([replace(ALARMS, false=0)], told=False)
    assert none == pytest.approx((0, 0, 3.689), abs=1e-3)
    # Two families of one hour each are one of two hours.
    assert slip_alarms.mean_rate([ALARMS, ALARMS], told=False) == pytest.approx(
        (3.0, chi2.ppf(0.025, 12) / 4, chi2.ppf(0.975, 14) / 4)
    )
    # The same motion at another noise is no other motion.
    assert slip_alarms.total(counted, NAMES[0], "held out", QUIET_NOISES_V, told=False) == pytest.approx(one)


def test_alarms_add_up() -> None:
    told = replace(ALARMS, told_false=2)
    assert told + ALARMS == Alarms(4.0, 2.0, 12, 2, 4, 6, 8)
    assert told.again(ALARMS) == Alarms(4.0, 1.0, 12, 2, 4, 6, 8)


def test_aims_are_met_or_missed_by_setting(cases: list[Case], counted: Counted) -> None:
    said = [one for one in cases if one.seed < 2]
    text = aims_table(said, counted, "held out", SETTINGS)
    assert cells(text, "first event, median, 1 mV")[:2] == ["at most 1.5 x oracle", "2.0 x, MISSED"]
    assert cells(text, "gross event, median distance from truth")[1] == "30 ms, met"
    assert cells(text, "an event before gross, slips of 50 ms and more")[1] == "50.0 % of 8, MISSED"
    assert cells(text, "false alarms, unannounced")[1] == "3.00 (0.62..8.77), met"
    assert cells(text, "false alarms, announced")[1].endswith("MISSED")
    assert cells(text, "onset inside one stated sigma")[1] == "100 %, MISSED"


def by_hand(motion_v: NDArray[np.float64]) -> Played:
    """A hold in which every taxel's pair moves apart by so much."""
    volts = np.full((len(motion_v), 36), 1.0)
    volts[:, 0::4] += motion_v[:, np.newaxis] / 2
    volts[:, 2::4] -= motion_v[:, np.newaxis] / 2
    return Played("by-hand", 1, volts, 1.0, None, (), ())


def test_the_limit_is_how_often_motion_without_slip_grows_as_much_in_that_time() -> None:
    array = load_array("wang2019-3x3")
    time_s = np.arange(3000) / 100
    growth = growth_by(array, by_hand(2.0 * np.maximum(time_s - 10, 0)), 10.0)  # 0.02 of the pressure a scan
    assert growth[LATENCIES_S.index(0.1)] == pytest.approx(0.18, abs=0.021)
    assert (np.diff(growth) >= 0).all()
    # Three jolts of 0.3 within 0.1 s, and one on the press, which does not count.
    jolts = np.sum([0.15 * (1 + np.tanh((time_s - at) / 0.02)) for at in (0.5, 5.0, 12.0, 20.0)], axis=0)
    found = exceeded(array, by_hand(jolts))
    assert found.hours == pytest.approx(30 / 3600)
    assert per_hour([found], 0.2, 0.25) == pytest.approx(360)
    assert per_hour([found], 0.01, 0.25) == 0  # not within one scan
    assert per_hour([found, Exceeded(found.hours, 0 * found.times)], 0.2, 0.25) == pytest.approx(180)
    assert per_hour([found], 1.0, 2 * GROWTHS[-1]) == 0
    pressed = by_hand(jolts)
    pressed.volts[:] += 2 * jolts[:, np.newaxis]
    assert per_hour([exceeded(array, pressed)], 0.2, 0.01) == 0  # the pressure changes more


def test_the_fastest_level_is_found(cases: list[Case]) -> None:
    assert fastest_level(cases, "any channel") == dict.fromkeys(NOISES_V, 2)


def test_all_is_printed_written_without_nan_and_drawn(
    cases: list[Case], counted: Counted, tmp_path: Path
) -> None:
    some = Exceeded(1.0, np.ones((len(LATENCIES_S), len(GROWTHS)), dtype=np.int64))
    steady = [replace(one, family=speed_name(speed)) for speed in SPEEDS_MM_S for one in cases]
    found = Measured(
        seeds={"tune": [1], "slips": [5, 6], "quiet": [7], "noise": [2]},
        noise_hours=1.0,
        knobs=KNOBS,
        oracle=TAIL,
        cases=[*cases, *steady],
        quiet=Quiet(counted, {"taps": some}, {"taps": 1}),
        resting=[Rest(next(iter(BANDS)), 0.3e-3, "quiet", is_gross) for is_gross in (True, False, False)],
        cost={"some": Cost(30.0, 1e5), "pywt.swt, plain": Cost(300.0, 1e4)},
    )
    read = json.loads(json.dumps(numbers_of(found), allow_nan=False))
    assert read["slips"][2]["found"][NAMES[0]]["first_s"] is None
    assert read["slips"][0]["found"][NAMES[0]]["first_s"] == 0.02
    assert read["quiet"][0]["false"] == 6
    assert read["limit"]["families"]["taps"]["times"][0][0] == 1
    text = text_of(found)
    assert "held out, nothing set on them: braking-drag" in text
    assert "1 of 3" in rest_table(found.resting, found.cases)
    assert read["resting"][0]["is_gross"] is True
    assert cells(limit_table(cases, {"taps": some}), "1 mV")[0] == "15 ms"
    draw_slip(tmp_path / "slip.png", found.cases, found.quiet, KNOBS)
    assert (tmp_path / "slip.png").stat().st_size > 10_000


def test_work_is_done_longest_first_and_given_in_order() -> None:
    begun = list[str]()

    def work(name: str) -> str:
        begun.append(name)
        return name.upper()

    with ThreadPoolExecutor(1) as pool:
        found = Each(pool, ProgressBar("slips", 8.0))("some", work, [("a",), ("b",), ("c",)], [1.0, 5.0, 2.0])
    assert begun == ["b", "c", "a"]
    assert found == ["A", "B", "C"]


@pytest.mark.parametrize("band", BANDS)
def test_a_load_that_rests_is_read_at_every_noise_by_every_setting(band: str) -> None:
    said = rests(band, 1)
    assert len(said) == 3 * len(DETECTOR_SETTINGS)
    assert rests(band, 1) == said


def test_scenes_without_slip_are_counted_for_every_detector() -> None:
    names = [NAMES[0], SETTINGS[0]]
    found = count("taps", 1, 2, KNOBS, names)
    assert set(found.counted) == {("taps", noise, name) for noise in QUIET_NOISES_V for name in names}
    once_h = play("taps", QUIET["taps"], 1).duration_s / 3600
    read = {name: found.counted["taps", 3e-3, name] for name in names}
    assert [read[name].hours for name in names] == pytest.approx([once_h, 2 * once_h])
    assert [read[name].apart_hours for name in names] == pytest.approx([once_h, once_h])
    assert found.motions == {"taps": 1}
    assert found.exceeded["taps"].hours == pytest.approx(once_h)


@pytest.mark.parametrize(
    ("family", "kinds"),
    [
        ("arm-acceleration", {"inhibit", "load-change"}),
        ("motor-hum", {"inhibit", "load-change"}),
        ("taps", {"load-change"}),
    ],
)
def test_only_what_a_controller_does_itself_is_announced(family: str, kinds: set[str]) -> None:
    scene = QUIET[family](1)
    said = announcements(scene)
    assert {one.kind for one in said} == kinds
    assert said[0] == Announcement("load-change", 0.0, scene.phases[0].duration_s)  # the press
    assert all(one.start_s < scene.duration_s for one in said)
