"""Calibration on the emulated rig: right forces with honest intervals, or a refusal that says what to do."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tactiled.array import ArrayFile, TaxelChannel, build, load_array
from tactiled.calibrate.checks import check_reference
from tactiled.calibrate.data import AlignedReference, ReferenceTable, bin_log
from tactiled.calibrate.pairs import PairsFitter, _peaks
from tactiled.calibrate.study import CalibrationStudy, calibrate
from tactiled.emulator.rig.motion import Loads
from tactiled.emulator.rig.reference import ReferenceSensor
from tactiled.emulator.rig.session import Rig, RigRun, draw_rig
from tactiled.errors import DataError
from tactiled.events.types import UNKNOWN_SD_N, ForceEvent
from tactiled.force.calibration import load_calibration, save_calibration
from tactiled.force.estimator import ForceEstimator
from tactiled.samples.block import regular_block

ARRAY = load_array("wang2019-3x3")
SECONDS = 20.0
Z90 = 1.645


@cache
def rig_run(seed: int = 3, seconds: float = SECONDS) -> tuple[Rig, RigRun, RigRun]:
    rig, rng = draw_rig(ARRAY, seed)
    return rig, rig.run("walk", seconds, rng), rig.run("hold", 30.0, rng)


def table(run: RigRun, columns: str = "fx fy fz tx ty tz") -> ReferenceTable:
    names = ("fx", "fy", "fz", "tx", "ty", "tz")
    values = run.reference.copy()
    values[:, [k for k, name in enumerate(names) if name not in columns.split()]] = np.nan
    return ReferenceTable(run.reference_s, values)


def study(run: RigRun, reference: ReferenceTable, readings: np.ndarray | None = None) -> CalibrationStudy:
    volts = run.readings if readings is None else readings
    return calibrate(ARRAY, run.loads.time_s, volts, reference, "mine")


@cache
def fitted() -> CalibrationStudy:
    """The study of the run that most tests take."""
    _, run, _ = rig_run()
    return study(run, table(run))


def estimates(found: CalibrationStudy, readings: np.ndarray) -> list[ForceEvent]:
    return ForceEstimator(ARRAY, found.file).process(regular_block(readings, 100.0))


def errors(found: CalibrationStudy, rig: Rig, test: RigRun) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n, 3) of the force on other motions, and stated standard deviations."""
    events = estimates(found, test.readings)
    force = np.array([(e.fx_n, e.fy_n, e.fz_n) for e in events])
    sd = np.array([(e.fx_sd_n, e.fy_sd_n, e.fz_sd_n) for e in events])
    return force - rig.reference.seen(test.loads.wrench(ARRAY))[:, :3], sd


def test_forces_of_other_motions_are_right_and_within_their_intervals() -> None:
    rig, _, test = rig_run()
    found = fitted()
    error, sd = errors(found, rig, test)
    fx, fy, fz = np.sqrt((error**2).mean(axis=0)) / 20.0
    assert fz < 0.007
    assert max(fx, fy) < 0.005
    assert (np.abs(error) < Z90 * sd).mean() > 0.8
    assert np.median(sd[:, 2]) < 0.2  # an interval that holds everything says nothing
    assert found.model == "pairs"
    assert found.late_s == pytest.approx(rig.reference.late_s, abs=0.005)


def test_a_file_gives_the_forces_of_the_fit(tmp_path: Path) -> None:
    _, _, test = rig_run()
    found = fitted()
    save_calibration(tmp_path / "mine.toml", found.file)
    again = load_calibration(str(tmp_path / "mine.toml"))
    one = ForceEstimator(ARRAY, found.file).process(regular_block(test.readings[:500], 100.0))
    other = ForceEstimator(ARRAY, again).process(regular_block(test.readings[:500], 100.0))
    assert [e.fz_n for e in other] == pytest.approx([e.fz_n for e in one], abs=1e-3)
    assert other[0].calibration == "mine"


def test_a_reference_that_is_late_by_3_s_and_drifts_by_200_ppm() -> None:
    rig, run, _ = rig_run()
    reference = table(run)
    clock_s = (reference.time_s - rig.reference.late_s) * (1 + 200e-6) + 3.0
    found = study(run, replace(reference, time_s=clock_s))
    assert found.late_s == pytest.approx(3.0, abs=0.01)
    assert found.drift_ppm == pytest.approx(200 + rig.reference.drift_ppm, abs=40)
    assert found.rms[2] < 0.2


def test_a_balance_gives_the_normal_force_alone() -> None:
    rig, run, test = rig_run()
    found = study(run, table(run, "fz"))
    assert found.file.axes == ["fz"]
    assert any("shear x is not known" in words for words in found.file.verdict)
    error, _ = errors(found, rig, test)
    assert np.sqrt((error[:, 2] ** 2).mean()) < 0.3
    event = estimates(found, test.readings[:1])[0]
    assert (event.fx_n, event.fx_sd_n) == (0.0, UNKNOWN_SD_N)


def test_presses_without_shear_ask_for_shear() -> None:
    rig, rng = draw_rig(ARRAY, 5)
    run = rig.run("flat", SECONDS, rng)
    found = study(run, table(run))
    assert any("along y" in words and "push sideways" in words for words in found.file.verdict)
    assert not any("push sideways" in words for words in fitted().file.verdict)


def test_a_taxel_that_was_never_touched_says_so() -> None:
    _, run, _ = rig_run()
    volts = run.readings.copy()
    volts[:, 32:36] = 0.0  # its chip has come off
    found = study(run, table(run), volts)
    assert any("hardly separated" in words and "8 (" in words for words in found.file.verdict)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: scaled(t, [1, 1, -1, 1, 1, 1]), "Multiply fz_n by -1"),
        (lambda t: scaled(t, [-1, 1, 1, 1, 1, 1]), "Multiply fx_n by -1"),
        (lambda t: replace(t, values=t.values[:, [1, 0, 2, 3, 4, 5]]), "exchange the columns"),
        (lambda t: scaled(t, [101.97]), "grams"),
        (lambda t: scaled(t, [0.0]), "never changes"),
        (
            lambda t: replace(t, values=np.random.default_rng(0).standard_normal(t.values.shape)),
            "do not resemble",
        ),
        (
            lambda t: replace(t, values=t.values[::-1]),
            "do not explain|do not resemble",
        ),  # chance may align it
    ],
    ids=["sign", "reversed", "swapped", "grams", "dead", "noise", "other-presses"],
)
def test_a_wrong_reference_is_refused_with_advice(
    change: Callable[[ReferenceTable], ReferenceTable], says: str
) -> None:
    _, run, _ = rig_run(seconds=30.0)
    with pytest.raises(DataError, match=says):
        study(run, change(table(run)))


def scaled(reference: ReferenceTable, factors: list[float]) -> ReferenceTable:
    return replace(reference, values=reference.values * np.array(factors))


def test_a_log_that_begins_under_load_is_refused_with_advice() -> None:
    rng = np.random.default_rng(0)
    time_s = np.arange(6000) / 100.0
    fz_n = 10.0 * (np.sin(0.9 * time_s + 1.5) > 0)
    pad = build(
        ArrayFile(
            name="pad",
            unit="count",
            range=(0, 4095),
            zero="first 0.3 s",
            taxel_count=1,
            taxel_channels=(TaxelChannel(name="N", kind="normal"),),
        )
    )
    values = np.full((6000, 6), np.nan)
    values[:, 2] = fz_n + 0.01 * rng.normal(size=6000)
    reference = ReferenceTable(time_s, values)
    readings = np.rint(1000.0 + 100.0 * fz_n + 3.0 * rng.normal(size=6000))[:, np.newaxis]
    with pytest.raises(DataError, match="begins under load"):
        calibrate(pad, time_s, readings, reference, "pad")


@pytest.mark.parametrize("is_free", [True, False])
def test_a_log_that_is_never_at_the_zero_of_the_array_says_so(is_free: bool) -> None:
    """Then the force without a load is unknown: a fitted one is wrong by what the reference reads there."""
    array = replace(load_array("magnetometers-5"), zero=np.zeros(15), zero_first_s=0.0)
    rig, rng = draw_rig(array, 1)
    run = rig.run("walk", SECONDS, rng)
    offset = 0.0 if is_free else 0.05 * run.readings.std() * np.linspace(1.0, 2.0, array.n_channels)
    reference = ReferenceTable(run.reference_s, run.reference)
    study = calibrate(array, run.loads.time_s, run.readings + offset, reference, "it")
    assert any("never come near the array's zero" in words for words in study.file.verdict) is not is_free


def test_grams_of_light_presses_are_refused_too() -> None:
    rig, run, _ = rig_run()
    light = replace(run.loads, taxels_n=0.08 * run.loads.taxels_n)  # 1.6 N, which are 163 g
    readings = rig.sensor.readings(light.taxels_n, 100.0, np.random.default_rng(6))
    time_s, values = rig.reference.measure(light, ARRAY, np.random.default_rng(7))
    grams = ReferenceTable(time_s, values * 101.97)
    with pytest.raises(DataError, match="grams"):
        study(replace(run, loads=light), grams, readings)


def test_a_log_without_excitation_is_refused() -> None:
    _, run, _ = rig_run()
    quiet = 1e-3 * np.random.default_rng(1).standard_normal(run.readings.shape)
    with pytest.raises(DataError, match="nothing pressed the array"):
        study(run, table(run), quiet)


def test_missing_readings_cost_little() -> None:
    rig, run, test = rig_run()
    volts = run.readings.copy()
    volts[np.random.default_rng(2).random(volts.shape) < 0.02] = np.nan
    volts[:, 7] = np.nan  # a dead channel
    found = study(run, table(run), volts)
    readings = test.readings.copy()
    readings[:, 7] = 0.0
    error, _ = errors(found, rig, replace(test, readings=readings))
    assert np.sqrt((error[:, 2] ** 2).mean()) < 0.3


@pytest.mark.parametrize("seconds", [6.0, 60.0])
def test_seconds_and_minutes_of_data(seconds: float) -> None:
    rig, run, test = rig_run(seconds=seconds)
    found = study(run, table(run))
    error, sd = errors(found, rig, test)
    assert np.isfinite(error).all()
    assert (np.abs(error) < Z90 * sd).mean() > 0.7
    assert np.sqrt((error[:, 2] ** 2).mean()) < (3.0 if seconds < 10 else 0.15)


def test_too_short_a_log_is_refused() -> None:
    _, run, _ = rig_run()
    part = replace(run, loads=replace(run.loads, time_s=run.loads.time_s[:300]))
    with pytest.raises(DataError, match="press for"):
        study(part, table(run), run.readings[:300])


def test_a_probe_on_one_taxel_at_a_time_separates_them() -> None:
    rig, _, _ = rig_run()
    n = 4500
    rows, taxels, time_s = np.arange(n), np.repeat(np.arange(9), n // 9), np.arange(n) / 100.0
    press = 3.0 * np.sin(np.pi * ((time_s % 2.5) / 2.5)) ** 2
    taxels_n = np.zeros((n, 9, 3))
    taxels_n[rows, taxels, 2] = press
    taxels_n[rows, taxels, 0] = 0.4 * press * np.sin(2 * np.pi * time_s / 1.7)
    taxels_n[rows, taxels, 1] = 0.4 * press * np.cos(2 * np.pi * time_s / 2.3)
    seen = rig.reference.seen(Loads(time_s, taxels_n).wrench(ARRAY))
    readings = rig.sensor.readings(taxels_n, 100.0, np.random.default_rng(4))
    reference = ReferenceTable(time_s, seen)
    found = calibrate(ARRAY, reference.time_s, readings, reference, "probe")
    assert not any("hardly separated" in words for words in found.file.verdict)


def test_loads_beyond_the_calibrated_range_are_flagged_and_uncertain() -> None:
    rig, run, _ = rig_run()
    found = fitted()
    heavy = replace(run.loads, taxels_n=2.5 * run.loads.taxels_n)
    readings = rig.sensor.readings(heavy.taxels_n, 100.0, np.random.default_rng(5))
    events = estimates(found, readings)
    true = rig.reference.seen(heavy.wrench(ARRAY))[:, 2]
    beyond = [(e.fz_n - t) / e.fz_sd_n for e, t in zip(events, true, strict=True) if e.beyond_range]
    assert beyond
    assert np.mean(np.abs(beyond) < Z90) > 0.8


def test_the_drawn_reference_turns_forces_and_moments_alike() -> None:
    sensor = ReferenceSensor(
        100.0, 0.0, 0.0, np.zeros(6), np.zeros(6), np.array([0.0, 0.0, np.pi / 2]), np.zeros(2)
    )
    assert sensor.seen(np.array([[1.0, 0, 0, 0, 2.0, 0]])) == pytest.approx(
        np.array([[0, 1.0, 0, -2.0, 0, 0]]), abs=1e-12
    )


@pytest.mark.parametrize(("stride", "unit_offset"), [(7, 0.0), (1, 38_000.0)])
def test_a_magnetometer_skin_of_any_rate_and_zero(stride: int, unit_offset: float) -> None:
    array = load_array("magnetometers-5")
    rig, rng = draw_rig(array, 4)
    run, test = rig.run("walk", 60.0, rng), rig.run("hold", 20.0, rng)
    time_s, readings = run.loads.time_s[::stride], run.readings[::stride] + unit_offset
    found = calibrate(array, time_s, readings, table(run), "skin")
    assert found.model == "smooth"
    assert found.rms[2] <= 1.01 * found.baseline[2]
    events = ForceEstimator(array, found.file).process(regular_block(test.readings[::stride], 100.0 / stride))
    force = np.array([event.fz_n for event in events])
    true = rig.reference.seen(test.loads.wrench(array))[::stride, 2]
    assert np.sqrt(((force - true) ** 2).mean()) < 0.5
    rest = np.median(readings[:30], axis=0)
    beyond = ForceEstimator(array, found.file).process(
        regular_block(-3.0 * (readings - rest), 100.0 / stride)
    )
    assert np.mean([event.beyond_range for event in beyond]) > 0.3


def _afterglow(loads_n: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Readings of a skin without a dead zone whose creep adds to the load: it reads on after a press."""
    taxel, azimuth = ARRAY.channel_taxel, np.deg2rad(ARRAY.azimuth_deg)
    towards = loads_n[:, taxel, 0] * np.cos(azimuth) + loads_n[:, taxel, 1] * np.sin(azimuth)
    load = np.maximum(0.25 * rng.normal(1, 0.1, 36) * (loads_n[:, taxel, 2] + 0.8 * towards), 0.0)
    follow = -np.expm1(-0.01 / np.array([0.3, 3.0, 30.0]))[:, np.newaxis]
    state, total = np.zeros((3, 36)), np.empty_like(load)
    for k, row in enumerate(load):
        state += follow * (row - state)
        total[k] = row + 0.01 * state.sum(axis=0)
    ratio = rng.lognormal(0, 0.2, 36) * total**0.75
    return np.asarray(3.3 * ratio / (1 + ratio) + 1e-3 * rng.standard_normal(load.shape)).clip(0, 3)


def test_a_free_array_has_no_force_where_the_model_is_wrong() -> None:
    rig, run, test = rig_run(seconds=30.0)
    found = study(run, table(run), _afterglow(run.loads.taxels_n, np.random.default_rng(8)))
    readings = _afterglow(test.loads.taxels_n, np.random.default_rng(8))
    error, sd = errors(found, rig, replace(test, readings=readings))
    assert (np.abs(error) < Z90 * sd)[:, 2].mean() > 0.75
    assert abs(error[:, 2].mean()) < 0.05


def test_the_unit_of_loads_is_that_of_presses_however_long_nothing_touches() -> None:
    _, run, _ = rig_run()
    rest = np.resize(run.readings[:20], (20 * len(run.readings), ARRAY.n_channels))
    units = []
    for readings in (run.readings, np.concatenate([run.readings, rest])):
        log = bin_log(np.arange(len(readings)) / 100, readings, ARRAY)
        reference = AlignedReference(table(run), log)
        fitter = PairsFitter(ARRAY, log, reference, 0.0, reference.inside(0.0, 0.0))
        units.append(fitter._unit)  # noqa: SLF001  all of its numbers are in this unit
    assert units[0] / 3 < units[1] <= units[0]  # the median of the presses, not of the noise


def test_taxels_of_two_pads_at_one_place_bear_a_force() -> None:
    places = [{"x_mm": 0.0, "y_mm": 0.0, "pad": pad} for pad in (0, 1)]
    file = {"name": "two", "unit": "N", "range": [0, 10], "zero": 0.0, "taxels": places}
    array = build(ArrayFile.model_validate(file | {"taxel_channels": [{"name": "z", "kind": "normal"}]}))
    values = np.full((2, 6), np.nan)
    values[:, 2] = 0.0, 30.0
    check_reference(ReferenceTable(np.arange(2.0), values), array)


def test_a_taxel_that_was_let_go_has_no_peak_but_its_load() -> None:
    load = np.array([[1.0], [0.5], [0.01], [0.008]])
    assert _peaks(load).ravel().tolist() == [1.0, 1.0, 0.01, 0.008]
