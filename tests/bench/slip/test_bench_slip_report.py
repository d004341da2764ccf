"""Tables, aims, picture and numbers of readings that are made by hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from bench.report import BenchOptions, aims_table
from bench.slip import bench as slip_bench
from bench.slip import tables
from bench.slip.aims import AIMS, SettingFound
from bench.slip.bench import QUICK, SlipFound, bench_slip
from bench.slip.cost import PLAIN, DetectorCost
from bench.slip.detectors import Tuning, compared_detectors
from bench.slip.growth import (
    GROWTHS,
    LATENCIES_S,
    Exceedances,
    alarms_per_hour,
    count_exceedances,
    growth_after,
)
from bench.slip.noise import NoiseTail
from bench.slip.quiet import (
    GROUPS,
    HOLD,
    QUIET_NOISES_V,
    QuietReading,
    QuietScene,
    alarm_rate,
    family_exceedances,
    read_quiet,
)
from bench.slip.resting import LOAD_DETECTORS, LOADS, RestingLoad, read_load
from bench.slip.rules import COHERENT, LEVELS, RULES
from bench.slip.scenes import (
    ARRAY,
    NOISES_V,
    STEADY_SLIDES,
    Announcement,
    PlayedScene,
    announcements,
    play,
)
from bench.slip.score import SlipScore
from bench.slip.slips import CURVE_PER_HOUR, SlipReading, fastest_level
from tactiled.emulator.scene.families import QUIET
from tactiled.progress import ProgressBar

TAIL = NoiseTail(5.0, 0.5, 1.0)
KEYS = [(rule, level) for rule in RULES for level in LEVELS] + [COHERENT]
TUNING = Tuning(dict.fromkeys(KEYS, TAIL), dict.fromkeys(NOISES_V, 2))
NAMES = list(compared_detectors(TUNING))
SETTINGS = [name for name, detector in compared_detectors(TUNING).items() if detector.is_setting]
DETECTED = SlipScore(0.02, 0.1, -0.01, 0.03, 0.01, 0.02, 0.03, 0.01, 3.0, 5.0, n_early=1, n_on_press=0)
_NAN = float("nan")
MISSED = SlipScore(_NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, n_early=0, n_on_press=2)
READING = QuietReading(
    "taps", 1, 3e-3, NAMES[0], hours=2.0, distinct_hours=1.0, n_false=6, n_gross=1, n_on_press=2,
    n_partial=3, n_announced_false=6,
)  # fmt: skip


def slip(seed: int, noise_v: float, score: SlipScore) -> SlipReading:
    """Reading with level 2 as the fastest, and an oracle that takes 10 ms."""
    n = len(CURVE_PER_HOUR)
    return SlipReading(
        family="slide" if seed < 2 else "braking-drag",
        seed=seed,
        noise_v=noise_v,
        scores=dict.fromkeys(NAMES, score),
        oracle_s=np.full(n, 0.01),
        rule_s={key: np.full(n, 0.01 * (1 + abs(key[1] - 2))) for key in TUNING.tails},
        to_gross_s=0.12,
        growth=np.array(LATENCIES_S),
    )


@pytest.fixture
def slips() -> list[SlipReading]:
    scores = (DETECTED, replace(DETECTED, latency_s=0.04, lead_s=-0.01), MISSED)
    return [slip(seed, noise, score) for noise in NOISES_V for seed, score in enumerate(scores)]


@pytest.fixture
def quiet() -> list[QuietReading]:
    return [
        READING._replace(family=family, noise_v=noise_v, detector=name, **counts)
        for noise_v in NOISES_V
        for name in NAMES
        for family, counts in (
            ("taps", {}),
            (HOLD, {"n_false": 0, "n_gross": 0, "n_announced_false": 0}),
            ("walking", {}),
        )
    ]


def cells(text: str, *starts: str) -> list[str]:
    """Cells of the first row that begins so."""
    for line in text.splitlines():
        row = [cell.strip() for cell in line.strip("|").split("|")]
        if row[: len(starts)] == list(starts):
            return row[len(starts) :]
    raise AssertionError(f"no row {starts} in\n{text}")


def test_latency_table(slips: list[SlipReading]) -> None:
    text = tables.latency_table(slips, NAMES)
    assert cells(text, "1 mV", "oracle")[:5] == ["10 ms", "10 ms", "0 of 3", "1.0", "1.0"]
    row = cells(text, "1 mV", NAMES[0])
    assert row[:4] == ["40 ms", "-", "1 of 3", "4.0"]  # of three, one missed: p95 is a miss
    assert row[5:] == ["33 %", "-10 ms / -10 ms (2)", "30 ms", "2", "2"]


def test_speed_table_has_a_row_for_each_speed_and_noise(slips: list[SlipReading]) -> None:
    steady = [replace(one, family=speed) for speed in STEADY_SLIDES for one in slips]
    text = tables.speed_table(steady, NAMES)
    assert cells(text, "20 mm/s", "3 mV")[:2] == ["10 ms / 10 ms", "40 ms / -, 1 missed"]
    assert len(text.splitlines()) == 2 + len(STEADY_SLIDES) * len(NOISES_V)


def test_a_missed_slip_comes_first_among_the_worst(slips: list[SlipReading]) -> None:
    row = cells(tables.worst_table(slips, NAMES, n_worst=1), NAMES[0])
    assert row[:4] == ["braking-drag", "2", "0.3 mV", "missed"]


def test_estimate_table(slips: list[SlipReading]) -> None:
    row = cells(tables.estimate_table(slips, NAMES), NAMES[0], "1 mV")
    assert row == ["3.0 deg", "3.0 deg", "100 %", "10 ms", "100 %", "30 ms", "0 %"]


def test_false_alarms_a_minute(quiet: list[QuietReading]) -> None:
    text = tables.quiet_table(quiet, NAMES)
    assert cells(text, "0.3 mV", "taps")[:2] == ["120 min", "0.050, 1 gross (+3 correct)"]
    assert cells(text, "0.3 mV", HOLD)[1] == "0.000 (+3 correct)"
    detector = replace(compared_detectors(TUNING)[NAMES[0]], per_hour=lambda _: 1.5)
    holds = [READING._replace(family=HOLD, noise_v=noise_v) for noise_v in NOISES_V]
    assert cells(tables.hold_table(holds, {NAMES[0]: detector}), NAMES[0]) == ["4 of 3, 2 on the press"] * 4


def test_false_alarms_an_hour_are_the_mean_of_families_of_equal_weight() -> None:
    tuned_on = [
        READING._replace(n_announced_false=2),
        READING._replace(family="cable-tug", n_false=90),
        READING._replace(family=HOLD, n_false=0, n_announced_false=0),
    ]
    # Taps 3, tugs 45, a hold none an hour; tugs and walking, which is held out, cannot be announced.
    assert alarm_rate(tuned_on).per_hour == pytest.approx(16.0)
    announced = alarm_rate(tuned_on, is_announced=True, with_external=False)
    assert announced.per_hour == pytest.approx(0.5)
    held_out = [READING._replace(family="walking")]
    assert alarm_rate(held_out).per_hour == pytest.approx(3.0)
    assert np.isnan(alarm_rate(held_out, is_announced=True, with_external=False).per_hour)


def test_the_interval_of_the_rate_counts_distinct_motions() -> None:
    one = alarm_rate([READING])
    # 6 in 2 h, of which one hour differs by more than noise: as 3 in that hour, exactly (Garwood).
    assert one == pytest.approx((3.0, chi2.ppf(0.025, 6) / 2, chi2.ppf(0.975, 8) / 2))
    none = alarm_rate([READING._replace(n_false=0)])
    assert none == pytest.approx((0, 0, 3.689), abs=1e-3)
    # Two families of one hour each are one of two hours.
    assert alarm_rate([READING, READING._replace(family="motor-hum")]) == pytest.approx(
        (3.0, chi2.ppf(0.025, 12) / 4, chi2.ppf(0.975, 14) / 4)
    )
    # The same motion at another noise is not a distinct motion; another seed is.
    again = READING._replace(noise_v=0.3e-3)
    assert alarm_rate([READING, again]) == pytest.approx(one)
    assert alarm_rate([READING, READING._replace(seed=2)]).high < one.high


def test_hourly_table_leaves_out_groups_without_readings(quiet: list[QuietReading]) -> None:
    text = tables.hourly_table(quiet, SETTINGS)
    assert cells(text, "3 mV", "held out", "unannounced")[0] == "3.00 (0.62..8.77)"
    assert "of these, line faults" not in text
    assert "held out | announced, external" not in text


def test_aims_are_met_or_missed_by_setting(slips: list[SlipReading], quiet: list[QuietReading]) -> None:
    detected = [one for one in slips if one.seed < 2]
    held_out = [one for one in quiet if GROUPS["held out"](one.family) and one.noise_v in QUIET_NOISES_V]
    name = SETTINGS[0]
    found = SettingFound(name, detected, [one for one in held_out if one.detector == name])
    text = aims_table(AIMS, {name: found})
    assert cells(text, "latency over the oracle's, median, 1 mV") == ["at most 1.5 x", "MISSED: 2.0 x"]
    assert cells(text, "gross event, median distance from truth")[1] == "met: 30 ms"
    assert cells(text, "an event before gross slip, slips of 50 ms and more")[1] == "MISSED: 50.0 % of 8"
    assert cells(text, "false alarms, unannounced")[1] == "met: 3.00 (0.62..8.77)"
    assert cells(text, "false alarms, announced")[1].startswith("MISSED")
    assert cells(text, "onset within one stated sigma")[1] == "MISSED: 100 %"


def by_hand(motion_v: NDArray[np.float64]) -> PlayedScene:
    """A hold in which the two sides of every taxel's pair differ by so much."""
    volts = np.full((len(motion_v), 36), 1.0)
    volts[:, 0::4] += motion_v[:, np.newaxis] / 2
    volts[:, 2::4] -= motion_v[:, np.newaxis] / 2
    return PlayedScene("by-hand", 1, volts, 1.0, None, (), (), np.zeros(len(volts)))


def test_exceedances_count_growth_of_shear_within_a_latency() -> None:
    time_s = np.arange(3000) / 100
    # 0.02 of the pressure a scan
    growth = growth_after(ARRAY, by_hand(2.0 * np.maximum(time_s - 10, 0)), 10.0)
    assert growth[LATENCIES_S.index(0.1)] == pytest.approx(0.18, abs=0.021)
    assert (np.diff(growth) >= 0).all()
    # Three jolts of 0.3 within 0.1 s, and one on the press, which does not count.
    jolts = np.sum([0.15 * (1 + np.tanh((time_s - at) / 0.02)) for at in (0.5, 5.0, 12.0, 20.0)], axis=0)
    found = count_exceedances(ARRAY, by_hand(jolts))
    assert found.hours == pytest.approx(30 / 3600)
    assert alarms_per_hour([found], 0.2, 0.25) == pytest.approx(360)
    assert alarms_per_hour([found], 0.01, 0.25) == 0  # not within one scan
    none = Exceedances(found.hours, 0 * found.times)
    assert alarms_per_hour([found, none], 0.2, 0.25) == pytest.approx(180)
    assert alarms_per_hour([found], 1.0, 2 * GROWTHS[-1]) == 0
    pressed = by_hand(jolts)
    pressed.volts[:] += 2 * jolts[:, np.newaxis]
    # the pressure changes more
    assert alarms_per_hour([count_exceedances(ARRAY, pressed)], 0.2, 0.01) == 0


def test_exceedances_of_scenes_add_up_and_line_faults_have_those_of_the_hold() -> None:
    some = Exceedances(1.0, np.ones((2, 2), dtype=np.int64))
    scenes = [QuietScene("taps", some, ()), QuietScene(HOLD, some, ()), QuietScene(HOLD, some, ())]
    found = family_exceedances([*scenes, QuietScene("walking", None, ())])
    assert {name: one.hours for name, one in found.items()} == {
        "taps": 1.0, HOLD: 2.0, "emi-spikes": 2.0, "stuck-bits": 2.0, "gaps": 2.0, "restarts": 2.0,
    }  # fmt: skip


def test_the_fastest_level_has_the_least_median_latency(slips: list[SlipReading]) -> None:
    assert fastest_level(slips, "any channel") == dict.fromkeys(NOISES_V, 2)


def test_the_bench_prints_tables_writes_finite_numbers_and_draws(
    slips: list[SlipReading], quiet: list[QuietReading], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    some = Exceedances(1.0, np.ones((len(LATENCIES_S), len(GROWTHS)), dtype=np.int64))
    steady = [replace(one, family=speed) for speed in STEADY_SLIDES for one in slips]
    found = SlipFound(
        sizes=QUICK,
        tuning=TUNING,
        oracle=TAIL,
        slips=[*slips, *steady],
        quiet=[QuietScene("taps", some, quiet)],
        loads=[
            RestingLoad(next(iter(LOADS)), 0.3e-3, "coherent, quiet", is_gross)
            for is_gross in (True, False, False)
        ],
        costs={"some": DetectorCost(30.0, 1e5), PLAIN: DetectorCost(300.0, 1e4)},
    )
    monkeypatch.setattr(slip_bench, "_measure", lambda *_, with_sweep: found if with_sweep else None)
    options = BenchOptions(plot=tmp_path / "slip.png", json=tmp_path / "slip.json")
    report = bench_slip(ProgressBar("slips", None), options)
    report.write(options)
    written = json.loads((tmp_path / "slip.json").read_text())
    assert written["slips"][2]["scores"][NAMES[0]]["latency_s"] is None
    assert written["slips"][0]["scores"][NAMES[0]]["latency_s"] == 0.02
    assert written["slips"][0]["rule_s"]["any channel, level 2"][0] == 0.01
    assert written["quiet"][0]["n_false"] == 6
    assert written["exceedances"]["families"]["taps"]["times"][0][0] == 1
    assert written["loads"][0]["is_gross"] is True
    assert "Held out, nothing set on them: braking-drag" in report.text
    assert "1 of 3" in tables.resting_table(found.loads, found.slips)
    assert cells(tables.bound_table(slips, [some]), "1 mV")[0] == "15 ms"
    assert (tmp_path / "slip.png").stat().st_size > 10_000


@pytest.mark.parametrize("load", LOADS)
def test_a_resting_load_is_read_at_every_noise_by_every_setting(load: str) -> None:
    readings = read_load(load, 1)
    assert len(readings) == 3 * len(LOAD_DETECTORS)
    assert read_load(load, 1) == readings


def test_a_quiet_scene_is_read_at_every_draw_by_settings_and_once_by_others() -> None:
    names = (NAMES[0], SETTINGS[0])
    found = read_quiet(TUNING, names, 2, "taps", 1)
    once_h = play("taps", QUIET["taps"], 1).duration_s / 3600
    assert [(one.noise_v, one.detector) for one in found.readings] == [
        (noise_v, name) for noise_v in QUIET_NOISES_V for name in (*names, names[1])
    ]
    assert [one.hours for one in found.readings] == pytest.approx([once_h] * 6)
    assert [one.distinct_hours for one in found.readings] == pytest.approx([once_h, once_h, 0.0] * 2)
    assert found.exceedances is not None
    assert found.exceedances.hours == pytest.approx(once_h)


@pytest.mark.parametrize(
    ("family", "kinds"),
    [
        ("arm-acceleration", {"inhibit", "load-change"}),
        ("motor-hum", {"inhibit", "load-change"}),
        ("taps", {"load-change"}),
    ],
)
def test_only_motion_of_gripper_and_arm_is_announced(family: str, kinds: set[str]) -> None:
    scene = QUIET[family](1)
    announced = announcements(scene)
    assert {one.kind for one in announced} == kinds
    assert announced[0] == Announcement("load-change", 0.0, scene.phases[0].duration_s)  # the press
    assert all(one.start_s < scene.duration_s for one in announced)
