"""Drawn rigs: repeatable, within physics, and different from one another."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.emulator.rig.motion import LARGEST_N, Motion, play
from tactiled.emulator.rig.reference import COLUMNS
from tactiled.emulator.rig.sensor import draw_sensor
from tactiled.emulator.rig.session import draw_rig, write_rig

ARRAY = load_array("wang2019-3x3")
MOTIONS: tuple[Motion, ...] = ("press", "walk", "hold", "flat", "tip")


def test_the_same_seed_gives_the_same_rig_and_another_seed_another() -> None:
    readings = []
    for seed in (1, 1, 2):
        rig, rng = draw_rig(ARRAY, seed)
        readings.append(rig.run("press", 10.0, rng).readings)
    np.testing.assert_array_equal(readings[0], readings[1])
    assert np.abs(readings[0] - readings[2]).max() > 0.1


@pytest.mark.parametrize("motion", MOTIONS)
def test_loads_are_within_range_and_friction(motion: Motion) -> None:
    loads = play(motion, ARRAY, np.ones(9), 30.0, np.random.default_rng(0))
    wrench = loads.wrench(ARRAY)
    assert 0.5 * LARGEST_N < wrench[:, 2].max() <= LARGEST_N * 1.001
    assert (loads.taxels_n[:, :, 2] >= 0).all()
    assert (np.hypot(wrench[:, 0], wrench[:, 1]) <= 0.9 * wrench[:, 2] + 1e-9).all()
    assert (wrench[:50] == 0).all()  # begins without contact


def test_a_sensor_reads_zero_without_load_and_more_with_more_load() -> None:
    sensor = draw_sensor(ARRAY, np.random.default_rng(3), noise_v=0.0)
    loads = np.zeros((300, 9, 3))
    loads[:, :, 2] = np.linspace(0, 2, 300)[:, np.newaxis]
    volts = sensor.readings(loads, 100.0, np.random.default_rng(0))
    assert (volts[0] == 0).all()
    assert (np.diff(volts.mean(axis=1)) >= 0).all()
    assert volts.max() < 3.0


def test_shear_along_x_lowers_the_electrode_on_the_side_it_comes_from() -> None:
    sensor = draw_sensor(ARRAY, np.random.default_rng(3), noise_v=0.0)
    loads = np.zeros((2, 9, 3))
    loads[:, :, 2] = 2.0
    loads[1, :, 0] = 0.5  # the object pushes the skin towards +x
    before, after = sensor.readings(loads, 100.0, np.random.default_rng(0))
    assert (after[0::4] < before[0::4]).all()  # R1, on the -x side
    assert (after[2::4] > before[2::4]).all()  # R3


def test_creep_and_warmth_change_the_reading_of_a_constant_load() -> None:
    sensor = draw_sensor(ARRAY, np.random.default_rng(3), noise_v=0.0)
    loads = np.zeros((3000, 9, 3))
    loads[:, :, 2] = 2.0
    crept = sensor.readings(loads, 100.0, np.random.default_rng(0)).mean(axis=1)
    warm = sensor.readings(loads, 100.0, np.random.default_rng(0), 10.0).mean(axis=1)
    assert crept[-1] > crept[0]
    assert warm[-1] < crept[-1]
    softer = replace(sensor, creep=4.0 * sensor.creep)
    more = softer.readings(loads, 100.0, np.random.default_rng(0)).mean(axis=1)
    assert more[-1] - more[0] > 2 * (crept[-1] - crept[0])


def test_a_reference_keeps_the_size_of_a_force() -> None:
    rig, _ = draw_rig(ARRAY, 4)
    wrench = np.random.default_rng(0).normal(size=(5, 6))
    seen = rig.reference.seen(wrench)
    assert np.linalg.norm(seen[:, :3], axis=1) == pytest.approx(np.linalg.norm(wrench[:, :3], axis=1))


def test_files_of_a_rig_are_tables_that_can_be_read(tmp_path: Path) -> None:
    written = write_rig(tmp_path / "rig", ARRAY, 0, 6.0)
    assert [path.name for path in written] == [
        "log.npz", "reference.csv", "test.npz", "test-reference.csv",
    ]  # fmt: skip
    assert written[1].read_text().splitlines()[0] == ",".join(("time_s", *COLUMNS))
    with np.load(written[0]) as log:
        assert log["volts"].shape == (600, 36)


def test_magnetometer_skins_respond_and_have_signs_of_their_own() -> None:
    array = load_array("magnetometers-5")
    signs = []
    for seed in (0, 1):
        rig, rng = draw_rig(array, seed)
        readings = rig.run("walk", 10.0, rng).readings
        assert readings.shape == (1000, 15)
        assert np.abs(readings).max() < 5000
        signs.append(np.sign(readings.sum(axis=0)))
    assert (signs[0] != signs[1]).any()
