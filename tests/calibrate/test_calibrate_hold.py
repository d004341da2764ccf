"""A contact of an hour keeps its force within the stated interval, while the sensor creeps and grows warm."""

import numpy as np

from tactiled.array import load_array
from tactiled.calibrate.data import ReferenceTable
from tactiled.calibrate.study import calibrate
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.force.estimator import ForceEstimator
from tactiled.samples.block import regular_block
from tactiled.tomlfile import parse

ARRAY = load_array("wang2019-3x3")
ADC_V, BITS = 3.0, 12
Z90 = 1.645
HELD_N = 15.0  # of the scene persistent-contact


def sensor_of(scene: Scene) -> Sensor:
    return Sensor(scene, ARRAY, adc_bits=BITS, adc_reference_v=ADC_V)


def instants(time_s: np.ndarray) -> list[np.ndarray]:
    """Instants of all channels, in parts that the emulator remembers."""
    every = np.repeat(time_s[:, np.newaxis], ARRAY.n_channels, axis=1)
    return [every[start : start + 100] for start in range(0, len(every), 100)]


def played(scene: Scene, time_s: np.ndarray) -> np.ndarray:
    """Readings (n, channels) of an emulated board."""
    sensor = sensor_of(scene)
    counts = [sensor.counts(100 * k, part) for k, part in enumerate(instants(time_s))]
    return np.asarray(np.concatenate(counts) * (ADC_V / 2**BITS))


def presses() -> Scene:
    rng = np.random.default_rng(0)
    phases: list[dict[str, object]] = []
    for force_n in rng.uniform(2, 20, 14).tolist():
        phases += [
            {"kind": "rest", "duration_s": 0.6},
            {"kind": "press", "duration_s": 0.5, "force_n": force_n},
            {"kind": "hold", "duration_s": float(rng.uniform(1.5, 4.0))},
            {"kind": "lift", "duration_s": 0.5},
        ]
    return parse({"name": "presses", "contact": "signal", "phases": phases}, Scene, "test")


def test_the_persistent_contact_of_the_emulator_stays_within_its_interval() -> None:
    scene = presses()
    time_s = np.arange(0, sum(phase.duration_s for phase in scene.phases) - 0.1, 0.01)
    volts, contact = played(scene, time_s), sensor_of(scene).contact
    load = contact.state(time_s).load_n
    values = np.full((len(load), 6), np.nan)
    values[:, 2] = load + 0.02 * np.random.default_rng(1).standard_normal(len(load))
    table = ReferenceTable(time_s, values)
    file = calibrate(ARRAY, time_s, volts, table, "balance").file
    rate_hz = 0.5
    hour_s = np.arange(0, 3600.0, 1 / rate_hz)
    # The scene names no contact model; prescribed signals are 40 times faster than the physical one.
    hour = load_scene("persistent-contact").model_copy(update={"contact": "signal"})
    volts = played(hour, hour_s)
    events = ForceEstimator(ARRAY, file).process(regular_block(volts, rate_hz))
    held = hour_s > 3.0
    force = np.array([event.fz_n for event in events])[held]
    sd = np.array([event.fz_sd_n for event in events])[held]
    error = np.abs(force - HELD_N)
    assert (error < Z90 * sd).mean() > 0.9
    assert error[-1] > 0.2  # warmth is not eaten: the sensitivity has changed by 3 %
    assert sd[-1] > 2 * sd[0]
    assert sd[-1] < 0.1 * HELD_N
