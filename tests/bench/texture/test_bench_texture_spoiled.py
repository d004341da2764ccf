"""Windows are spoiled as their names say."""

import numpy as np
import pytest

from bench.texture.signal import turns, wave_volts
from bench.texture.spoiled import GROOVELESS, MISFITS, SpoiledWindow, model_window
from tactiled.array import load_array

ARRAY = load_array("wang2019-3x3")


def window(name: str, seed: int = 0) -> tuple[SpoiledWindow, np.random.Generator]:
    rng = np.random.default_rng(seed)
    made = model_window(ARRAY, rng, 2.0)
    (MISFITS | GROOVELESS)[name](made, rng)
    return made, rng


@pytest.mark.parametrize("name", sorted(MISFITS | GROOVELESS))
def test_readings_are_within_the_converters_range(name: str) -> None:
    made, rng = window(name)
    volts = made.volts(rng)
    assert volts.shape == (200, 36)
    assert np.isfinite(volts).all()
    assert volts.min() >= 0
    assert volts.max() <= 3


def test_model_window_is_the_wave_of_the_bound() -> None:
    made, rng = window("none")
    ripple = made.volts(rng) - made.level_volts
    # The same wave up to where its phases count from.
    middle = turns(made.wave, made.sensed, np.array([made.time_s.mean()])).mean()
    assert abs(middle) < 10
    expected = wave_volts(made.wave, made.sensed, made.time_s - made.time_s.mean())
    assert np.std(ripple - expected, axis=0) == pytest.approx(made.sensed.noise_volts, rel=0.25)


def test_given_speeds_are_those_of_the_travel() -> None:
    made, _ = window("the same, given each 0.1 s")
    speeds = np.repeat([speed for _, speed in made.given_mm_s], 10)
    true = np.diff(made.travel_mm[:, 0]) * 100
    assert np.abs(speeds[:-1] - true).max() < 0.05 * 1.5
    assert speeds[:-1].sum() / 100 == pytest.approx(made.travel_mm[-1, 0] - made.travel_mm[0, 0], rel=1e-4)


def test_windows_without_grooves_have_none() -> None:
    made, rng = window("flat plate")
    assert np.std(made.volts(rng), axis=0) == pytest.approx(made.sensed.noise_volts, rel=0.25)
    made, _ = window("sand paper, grain 0.3 mm")
    assert (made.sensed.amplitude_volts == 0).all()
    # Taxels of a row see the same strip, each later by its place: not the same thing at one instant.
    at_once = np.abs(np.asarray(np.corrcoef(made.added_volts[:, ::4].T)))
    assert at_once[~np.eye(9, dtype=np.bool_)].mean() < 0.5


def test_strays_of_taxels_are_alike_in_their_channels() -> None:
    made = model_window(ARRAY, np.random.default_rng(0), 1.0)
    MISFITS["the same, channels of a taxel alike"](made, np.random.default_rng(1))
    by_taxel = made.phase_off_rad.reshape(9, 4)
    assert np.ptp(by_taxel, axis=1).max() < 1e-6
    assert 0.03 < by_taxel[:, 0].std() < 0.3
