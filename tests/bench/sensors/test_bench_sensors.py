"""Bench of other sensors: its recordings have the truth that they state, and its baseline finds it."""

import numpy as np
import pytest

from bench.sensors.baseline import strongest_line_hz
from bench.sensors.bench import run
from bench.sensors.recordings import FLAT, SENSORS, Sensor, make
from bench.sensors.slips import FIRST_SEED, run_slips
from bench.sensors.worlds import FINGERTIP, play


@pytest.mark.parametrize("sensor", SENSORS, ids=[sensor.name for sensor in SENSORS])
def test_a_strong_ripple_has_the_stated_frequency(sensor: Sensor) -> None:
    recording = make(sensor, "ridges", 20.0, seed=1)
    found_hz = strongest_line_hz(recording.time_s, recording.readings)
    assert found_hz == pytest.approx(recording.ripple_hz, rel=0.01)
    expected_mm = recording.speed_mm_s * np.cos(np.radians(recording.tilt_deg)) / recording.ripple_hz
    assert recording.period_mm == pytest.approx(expected_mm)


@pytest.mark.parametrize("surface", FLAT)
def test_flat_surfaces_state_no_ripple_and_readings_stay_in_range(surface: str) -> None:
    for sensor in SENSORS:
        recording = make(sensor, surface, 0.0, seed=2)  # type: ignore[arg-type]
        low, high = sensor.array["range"]
        assert recording.ripple_hz == 0.0
        assert low <= recording.readings.min() < recording.readings.max() < high


def test_a_trial_judges_ridges_and_flat_surfaces() -> None:
    ridges = run(SENSORS[0], "ridges", 10.0, seed=0)
    assert (ridges.status, ridges.is_right, ridges.is_inside) == ("period-only", True, True)
    assert ridges.baseline_is_right
    flat = run(SENSORS[0], "white noise", 0.0, seed=0)
    assert (flat.status, flat.is_right, flat.baseline_is_right) == ("", False, False)


def test_a_world_states_when_it_slides_and_its_slip_is_judged() -> None:
    played = play(FINGERTIP, "rough", FIRST_SEED)
    ((start_s, end_s),) = played.spans()
    assert played.time_s[0] < start_s < end_s < played.time_s[-1]
    assert played.readings.min() >= 0
    trial = run_slips(FINGERTIP, "rough", FIRST_SEED)
    assert trial.has_slide
    assert trial.n_false == 0
    hold = run_slips(FINGERTIP, "hold", FIRST_SEED)
    assert (hold.has_slide, hold.found, hold.n_false) == (False, False, 0)
