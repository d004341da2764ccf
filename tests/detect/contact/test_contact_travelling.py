"""A ripple that travels is seen; what a hand does to a rigid body, noise and drift are not."""

from dataclasses import replace

import numpy as np
import pytest
from gratings import ARRAY, Grating, Slide
from hypothesis import given, settings
from hypothesis import strategies as st
from touches import onsets

from tactiled.array import ContactLevels, FloatArray, load_array
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.detect.contact.travelling import TravellingRipple
from tactiled.detect.signal.front_end import response_weights
from tactiled.events.types import GripEvent
from tactiled.samples.block import regular_block

RATE_HZ = 100.0
RESPONSES = response_weights(ARRAY)
TIME_S = np.arange(2000) / RATE_HZ
LOADS = np.repeat(np.array([0.4, 0.8, 0.5, 0.9, 1.8, 1.1, 0.6, 1.2, 0.7]), 4)
SIDES = np.sign(ARRAY.shear_weights().sum(axis=1))


def seen(readings: FloatArray, rate_hz: float = RATE_HZ, least_step: float = 0.0) -> FloatArray:
    ripple = TravellingRipple(ARRAY, rate_hz, np.full(36, least_step))
    return np.array([ripple.take((RESPONSES @ row).ravel()) for row in readings])


def noise(size: float = 1e-3, seed: int = 0) -> FloatArray:
    return size * np.random.default_rng(seed).standard_normal((len(TIME_S), 36))


def over_grating(speed_mm_s: float = 2.0, period_mm: float = 1.6, amplitude: float = 5e-3) -> FloatArray:
    slide = Slide(
        (Grating(period_mm=period_mm, amplitude=amplitude),), speed_mm_s, duration_s=20.0, noise=1e-3
    )
    return LOADS + slide.volts(ARRAY)


@pytest.mark.parametrize("speed_mm_s", [0.8, 2.0, 8.0])
def test_a_slide_over_a_grating_is_seen_from_its_fourth_period_on(speed_mm_s: float) -> None:
    found = seen(over_grating(speed_mm_s))
    four_periods_s = 4 * 1.6 / (speed_mm_s * np.cos(np.radians(20.0)))
    first_s = TIME_S[np.flatnonzero(found)[0]]
    assert four_periods_s - 0.6 < first_s < max(1.5 * four_periods_s, 2.1) + 0.5
    assert found[first_s < TIME_S].all()


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_unit_of_the_readings_does_not_matter(scale: float) -> None:
    readings = over_grating()
    np.testing.assert_array_equal(seen(scale * readings), seen(readings))


@given(st.floats(0.3, 5.0), st.lists(st.floats(-1, 1), min_size=6, max_size=6), st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_loads_tilts_and_shears_of_a_rigid_body_do_not_travel(
    frequency_hz: float, sizes: list[float], seed: int
) -> None:
    """Each with a phase of its own, and taxels whose gains differ by 5 %."""
    rng = np.random.default_rng(seed)
    x, y = (places[ARRAY.channel_taxel] / 4 for places in (ARRAY.x_mm, ARRAY.y_mm))
    patterns = LOADS * (1 + 0.05 * rng.standard_normal(36)) * np.stack([x**0, x, y, *SIDES, SIDES[0] * y])
    phases = 2 * np.pi * frequency_hz * TIME_S[:, np.newaxis] + rng.uniform(0, 6, 6)
    assert not seen(LOADS + 0.1 * (np.sin(phases) * sizes) @ patterns + noise(seed=seed)).any()


def test_noise_drift_and_steps_do_not_travel() -> None:
    rng = np.random.default_rng(1)
    slow = np.cumsum(1e-3 * rng.standard_normal((len(TIME_S), 36)), axis=0)
    steps = 0.2 * LOADS * (TIME_S[:, np.newaxis] > 8.0) * rng.uniform(0.8, 1.2, 36)
    for readings in (noise(), slow, steps + noise()):
        assert not seen(LOADS + readings).any()


@pytest.mark.parametrize("least_step", [0.0, 2.4e-3])
def test_readings_that_creep_over_steps_of_the_converter_do_not_travel(least_step: float) -> None:
    """Rounding errors of one frequency, with phases of their own: only the size differs from a ripple."""
    rng = np.random.default_rng(2)
    creeps = LOADS + 5e-3 * TIME_S[:, np.newaxis] + rng.uniform(0, 2.4e-3, 36) + noise(1e-4)
    rounded = 2.4e-3 * np.round(creeps / 2.4e-3)
    assert seen(rounded, least_step=least_step).any() == (least_step == 0.0)
    assert seen(2.4e-3 * np.round(over_grating() / 2.4e-3), least_step=least_step).any()


@pytest.mark.parametrize("contact", [ARRAY.contact, None])
def test_a_contact_that_creeps_over_steps_of_the_converter_is_no_slide(contact: ContactLevels | None) -> None:
    """Also where the array file gives the levels of contact, which do without a noise."""
    pressed = np.clip((TIME_S - 1.0) / 0.5, 0.0, 1.0)[:, np.newaxis]
    phases = np.random.default_rng(2).uniform(0, 2.4e-3, 36)

    def kinds(readings: FloatArray) -> set[str]:
        rounded = 2.4e-3 * np.round((pressed * readings + phases) / 2.4e-3)
        detector = GripDetector(replace(ARRAY, contact=contact))
        return {event.kind for event in onsets(detector.process(regular_block(rounded, RATE_HZ)))}

    assert "gross" not in kinds(LOADS + 5e-3 * TIME_S[:, np.newaxis] + noise(1e-4))
    assert "gross" in kinds(over_grating())


def test_a_ripple_is_over_when_the_skin_stops_and_forgotten_with_the_contact() -> None:
    ripple = TravellingRipple(ARRAY, RATE_HZ, np.zeros(36))
    slide = over_grating()
    assert [ripple.take((RESPONSES @ row).ravel()) for row in slide[:1000]][-1] > 0
    rest = LOADS + slide[999] - LOADS + noise()
    assert [ripple.take((RESPONSES @ row).ravel()) for row in rest[:600]][-1] == 0.0
    ripple.take((RESPONSES @ slide[0]).ravel())
    ripple.reset()
    assert ripple.seen_s == 0.0


def test_few_taxels_cannot_tell() -> None:
    array = load_array("normal-4x4")
    assert TravellingRipple(array, RATE_HZ, np.zeros(16)).can_tell
    ripple = TravellingRipple(load_array("load-cell"), RATE_HZ, np.zeros(1))
    assert not ripple.can_tell
    assert ripple.take(np.ones(3)) == 0.0


def test_a_slide_on_an_even_contact_is_told_by_its_ripple_alone() -> None:
    """Equal loads and a shear that stays: only the ripple shows that the skin slides."""
    touches = np.interp(TIME_S, [0.5, 1.0], [0.0, 1.0])[:, np.newaxis]
    pulled = np.interp(TIME_S, [3.0, 3.5], [0.0, 0.2])[:, np.newaxis]
    ripple = np.where(TIME_S[:, np.newaxis] > 3.5, over_grating() - LOADS, over_grating()[350] - LOADS)
    readings = touches * (1.0 + pulled * SIDES[0] + ripple) + noise(1e-3)
    events = GripDetector(ARRAY).process(regular_block(readings, RATE_HZ))
    gross = [event for event in onsets(events) if event.kind == "gross"]
    assert 3.5 < gross[0].detected_s < 9.5
    assert abs(gross[0].direction_deg) < 10.0
    told = [e for e in events if isinstance(e, GripEvent) and e.time_s > gross[0].detected_s]
    gross_part = [event.state == "gross" for event in told]
    assert np.mean(gross_part) > 0.9  # noise hides the ripple now and then
    assert min(event.utilisation for event in told if event.state == "gross") >= 0.9


def test_a_ripple_without_any_shear_is_gross_slip_in_an_unknown_direction() -> None:
    touches = np.interp(TIME_S, [0.5, 1.0], [0.0, 1.0])[:, np.newaxis]
    loads = np.repeat((over_grating() - LOADS).reshape(-1, 9, 4).mean(axis=2), 4, axis=1)
    events = GripDetector(ARRAY).process(regular_block(touches * (1.0 + loads) + noise(1e-5), RATE_HZ))
    assert [event.kind for event in onsets(events)] == ["incipient", "gross"]
