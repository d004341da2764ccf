"""Closed-form motion against step-by-step integration of the same laws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import PRESLIDING_MM, SceneMotion
from tactiled.emulator.scene.truth import Truth

PRESS = {"kind": "press", "duration_s": 0.5, "force_n": 10.0}
HOLD = {"kind": "hold", "duration_s": 0.4}


def scene(*phases: dict[str, object], **rest: object) -> Scene:
    return Scene.model_validate({"name": "test", "phases": list(phases), **rest})


durations = st.floats(0.05, 3.0).map(lambda x: round(x, 3))
slides = st.fixed_dictionaries(
    {
        "kind": st.just("slide"),
        "duration_s": durations,
        "speed_mm_s": st.floats(0.5, 20),
        "direction_deg": st.floats(-180, 180),
        "ramp_s": st.just(0.0) | st.floats(0.001, 0.05),
    }
)
presses = st.fixed_dictionaries(
    {"kind": st.just("press"), "duration_s": durations, "force_n": st.floats(0.1, 50)}
)
holds = st.fixed_dictionaries({"kind": st.just("hold"), "duration_s": durations})
lifts = st.fixed_dictionaries({"kind": st.just("lift"), "duration_s": durations})


@given(st.lists(st.one_of(slides, presses, holds), min_size=1, max_size=4), lifts)
@settings(max_examples=30, deadline=None)
def test_travel_is_the_integral_of_speed_and_everything_is_finite(
    phases: list[dict[str, object]], lift: dict[str, object]
) -> None:
    motion = SceneMotion(scene(PRESS, *phases, lift))
    end = float(motion.phase_start_s[-1])
    edges = np.unique(np.concatenate([motion.segment_start_s, np.linspace(-1, end + 1, 4000)]))
    state, middle = motion.at(edges), motion.at((edges[1:] + edges[:-1]) / 2)
    angle = np.deg2rad(middle.direction_deg)
    for travel, part in ((state.travel_mm.real, np.cos(angle)), (state.travel_mm.imag, np.sin(angle))):
        # The midpoint rule is exact here: no step straddles a segment, in which speed is linear.
        np.testing.assert_allclose(np.diff(travel), middle.speed_mm_s * part * np.diff(edges), atol=1e-9)
    assert np.all(np.abs(state.shear) <= 1 + 1e-12)
    assert np.all(state.load_n >= -1e-9)
    assert state.load_n[-1] == 0
    assert all(np.all(np.isfinite(values)) for values in vars(state).values())


def test_tangential_state_obeys_dahl_and_reverses() -> None:
    slide = {"kind": "slide", "duration_s": 0.3, "speed_mm_s": 2.0}
    test = scene(PRESS, slide, slide | {"direction_deg": 180.0}, slide | {"direction_deg": 90.0})
    time_s = np.arange(0.5, 1.4, 1e-5)
    state = SceneMotion(test).at(time_s)
    s = np.zeros(2)
    stepped = []
    for dx, dy in zip(np.diff(state.travel_mm.real), np.diff(state.travel_mm.imag), strict=True):
        stepped.append(s)
        s = s + (np.array([dx, dy]) - s * np.hypot(dx, dy)) / PRESLIDING_MM
    expected = np.array(stepped)
    np.testing.assert_allclose(state.shear.real[:-1], expected[:, 0], atol=2e-4)
    np.testing.assert_allclose(state.shear.imag[:-1], expected[:, 1], atol=2e-4)
    assert state.shear.real[int(0.29e5)] > 0.99
    assert state.shear.real[int(0.59e5)] < -0.99


def test_a_stop_relaxes_shear_and_two_holds_equal_one() -> None:
    slide = {"kind": "slide", "duration_s": 1.0, "speed_mm_s": 1.0}
    time_s = np.linspace(0, 3, 301)
    once = SceneMotion(scene(PRESS, slide, {"kind": "hold", "duration_s": 0.8})).at(time_s)
    twice = SceneMotion(scene(PRESS, slide, HOLD, HOLD)).at(time_s)
    np.testing.assert_allclose(once.shear.real, twice.shear.real, atol=1e-12)
    assert once.shear.real[150] - once.shear.real[230] > 0.2


def test_losing_contact_clears_the_tangential_state() -> None:
    slide = {"kind": "slide", "duration_s": 1.0, "speed_mm_s": 1.0}
    lifted = scene(PRESS, slide, {"kind": "lift", "duration_s": 0.1}, PRESS, HOLD)
    state = SceneMotion(lifted).at(np.array([1.49, 2.3]))
    assert state.shear.real[0] > 0.9
    assert state.shear.real[1] == 0.0


def test_a_change_of_plate_in_contact_takes_travel() -> None:
    grooves = {"kind": "grooves", "period_mm": 1.2}
    slide = {"kind": "slide", "duration_s": 2.0, "speed_mm_s": 1.0}
    motion = SceneMotion(
        scene(PRESS, HOLD | {"surface": grooves}, slide, slide | {"surface": {"kind": "flat"}})
    )
    assert [s.kind for s in motion.surfaces] == ["flat", "grooves"]
    share = motion.surface_share(1, np.array([0.4, 0.89, 1.0, 1.4, 1.95, 3.0, 4.9]))
    assert share[[0, 1]].tolist() == [0.0, 0.0]
    assert 0 < share[2] < share[3] < 1
    assert share[[4, 6]].tolist() == [1.0, 0.0]
    away = SceneMotion(scene({"kind": "rest", "duration_s": 1.0}, PRESS | {"surface": grooves}))
    assert away.surface_share(1, np.array([0.9, 1.01])).tolist() == [0.0, 1.0]  # without contact at once
    both = motion.surface_share(0, np.linspace(0, 5, 99)) + motion.surface_share(1, np.linspace(0, 5, 99))
    np.testing.assert_allclose(both, 1.0)


def test_truth_has_each_slip_on_the_callers_clock() -> None:
    slide, hold = {"kind": "slide", "duration_s": 0.5, "speed_mm_s": 1.0}, {"kind": "hold", "duration_s": 0.5}
    faster = {"kind": "slide", "duration_s": 1.0, "speed_mm_s": 2.0, "ramp_s": 0.5}
    other = {"kind": "slide", "duration_s": 1.0, "speed_mm_s": 1.0, "direction_deg": 90.0}
    truth = Truth(scene(PRESS, slide, hold, faster, other), t0_s=500.0)
    found = [(s.onset_s, s.end_s, s.direction_deg) for s in truth.slips]
    assert found == [
        pytest.approx((500.5, 501.0, 0.0)),
        pytest.approx((501.5, 502.5, 0.0)),
        pytest.approx((502.5, 503.5, 90.0)),
    ]
    assert truth.phases[1].start_s == 500.5
    np.testing.assert_allclose(truth.state(np.array([503.5])).travel_mm, [[0.5 + 0.5 + 1.0, 1.0]])
    assert truth.speed_mm_s(np.array([503.0])) == 1.0
    assert truth.state(np.array([500.25])).load_n == pytest.approx(5.0)
