"""Scenes on physical contact models: instants of slip, motion with mechanics, refusals."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import Array, load_array
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.scene.contact import make_contact
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.emulator.scene.truth import Truth
from tactiled.emulator.simulate import Simulation
from tactiled.errors import ConfigError
from tactiled.wire.layout import load_layout

WANG = load_array("wang2019-3x3")
PRESS = {"kind": "press", "duration_s": 1.0, "force_n": 15.0}
HOLD = {"kind": "hold", "duration_s": 1.0}
EVEN = {"kind": "flat", "unevenness": 0.0}
SLIDE = {"kind": "slide", "duration_s": 3.0, "speed_mm_s": 1.0}


def scene(*phases: dict[str, Any], **rest: Any) -> Scene:
    document = {"name": "test", "contact": "mechanics", "surface": EVEN, "phases": list(phases), **rest}
    return Scene.model_validate(document)


def contact(played: Scene, array: Array = WANG) -> PhysicalContact:
    model = make_contact(SceneMotion(played), array)
    assert isinstance(model, PhysicalContact)
    return model


def test_instants_of_slip_follow_mindlin() -> None:
    # At 15 N a taxel goes in by 0.17 mm and slips fully after some 0.27 mm, a tenth of it after a tenth.
    (slip,) = Truth(scene(PRESS, HOLD, SLIDE, HOLD)).slips
    assert slip.shear_s == pytest.approx(2.0, abs=0.01)
    assert slip.incipient_s == pytest.approx(2.025, abs=0.01)
    assert slip.gross_s == pytest.approx(2.245, abs=0.03)
    assert slip.end_s == pytest.approx(5.0, abs=0.01)
    assert slip.direction_deg == pytest.approx(0.0, abs=1e-9)
    assert slip.onset_s == slip.incipient_s


def test_utilisation_goes_with_the_slipping_share() -> None:
    truth = Truth(scene({"kind": "rest", "duration_s": 0.5}, PRESS, HOLD, SLIDE), t0_s=100.0)
    used = truth.utilisation(np.array([100.2, 102.0, 105.0]))
    np.testing.assert_allclose(used, [np.nan, 0.0, 1.0], atol=1e-6)
    growing_s = 100.0 + np.arange(2.52, 2.76, 0.02)
    share = truth.state(growing_s).slipping_share
    assert 0.02 < share[0] < share[-1] < 1
    used = truth.utilisation(growing_s)
    assert (np.diff(used) > 0).all()
    # Mindlin's relation for a ball on a half-space; the lumped law follows finite elements of the bump.
    np.testing.assert_allclose(used, 1 - (1 - share) ** 1.5, atol=0.1)


def test_no_slip_while_pressing_and_holding() -> None:
    truth = Truth(scene(PRESS, HOLD, {"kind": "press", "duration_s": 0.1, "force_n": 5.0}, HOLD))
    assert truth.episodes == []
    assert truth.state(np.array([1.5])).load_n[0] == 15.0


@given(st.lists(st.floats(0, 5.5), min_size=1, max_size=20))
@settings(max_examples=20, deadline=None)
def test_any_chunking_gives_the_same_forces(times: list[float]) -> None:
    played = scene(PRESS, HOLD, SLIDE)
    time_s = np.array(times)[:, None] + 2e-4 * np.arange(36)
    whole, one = contact(played).forces(time_s)[0], contact(played)
    np.testing.assert_array_equal(np.concatenate([one.forces(row[None])[0] for row in time_s]), whole)
    assert np.isfinite(whole).all()
    assert np.all(whole >= 0)


@given(st.floats(-180.0, 180.0))
@settings(max_examples=15, deadline=None)
def test_the_pairs_point_along_the_motion(direction_deg: float) -> None:
    played = contact(scene(PRESS, HOLD, SLIDE | {"direction_deg": direction_deg}))
    before, after = played.forces(np.repeat([[1.9], [4.0]], 36, axis=1))[0]
    x, y = (WANG.shear_weights() @ (after / before - 1)).sum(axis=1)
    difference = np.rad2deg(np.arctan2(y, x)) - direction_deg
    # Areas under edges bear no tension, so the pairs are a little off between the axes.
    assert abs((difference + 180) % 360 - 180) < 8.0


def test_shear_and_normal_channels_carry_the_forces() -> None:
    pads = load_array("xyz-two-pads-4x4")
    kinds = np.array(pads.channel_kind)
    played = contact(scene(PRESS, SLIDE | {"direction_deg": 90.0}), pads)
    slid = played.forces(np.full((1, pads.n_channels), 3.0))[0][0]
    assert slid[kinds == "normal"].sum() == pytest.approx(15.0)
    assert slid[kinds == "shear_y"].sum() == pytest.approx(0.6 * 15.0)
    assert slid[kinds == "shear_x"].sum() == pytest.approx(0.0, abs=1e-9)


def test_rotation_slips_without_direction() -> None:
    rotate = {"kind": "rotate", "duration_s": 4.0, "angle_deg": 40.0}
    truth = Truth(scene(PRESS, rotate, contact="mechanics"))
    (slip,) = truth.episodes
    assert slip.direction_deg is None
    state = truth.state(np.array([4.5]))
    places = np.stack([WANG.x_mm - WANG.x_mm.mean(), WANG.y_mm - WANG.y_mm.mean()], axis=-1)
    angle = np.deg2rad(35.0)
    now = places @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    moment = now[:, 0] * state.tangential_n[0, :, 1] - now[:, 1] * state.tangential_n[0, :, 0]
    assert np.all(
        moment[np.arange(9) != 4] < 0
    )  # friction turns against the skin at every taxel but the middle
    assert np.linalg.norm(state.tangential_n[0].sum(axis=0)) < 1.0


def test_taxels_out_of_contact_bear_no_load() -> None:
    played = scene(PRESS, SLIDE, touching=[0, 4, 5], load_gradient_per_mm=(0.1, 0.0))
    normal = Truth(played).state(np.array([2.0])).normal_n[0]
    np.testing.assert_array_equal(np.flatnonzero(normal), [0, 4, 5])
    assert normal.sum() == pytest.approx(15.0)
    assert normal[5] > normal[4] > normal[0]


def test_a_reversal_is_a_separate_slip() -> None:
    truth = Truth(scene(PRESS, SLIDE, SLIDE | {"direction_deg": 180.0}, HOLD))
    directions = [slip.direction_deg for slip in truth.slips]
    assert directions == pytest.approx([0.0, 180.0])
    reversal = truth.slips[1]
    assert reversal.gross_s == pytest.approx(4.0 + 2 * 0.245, abs=0.05)  # Masing: twice the travel


def test_vibration_of_a_held_object_is_no_gross_slip() -> None:
    hum = {"on": "pull_n", "shape": "sine", "amplitude": 5.0, "frequency_hz": 20.0, "start_s": 1.5}
    truth = Truth(scene(PRESS, HOLD, HOLD, held_object={}, disturbances=[hum]))
    assert truth.slips == []
    assert len(truth.episodes) > 5
    assert max(truth.state(np.arange(0, 3, 0.001)).slipping_share) < 0.9


def test_without_friction_everything_slips_without_tangential_force() -> None:
    played = scene(PRESS, HOLD, SLIDE, surface={"kind": "flat", "friction": 0.0})
    felt, _ = contact(played).forces(np.repeat([[1.9], [4.0]], 36, axis=1))
    np.testing.assert_allclose(felt[0], felt[1])
    (slip,) = Truth(played).slips
    assert slip.gross_s == pytest.approx(2.0, abs=0.01)


def test_a_tap_on_an_untouched_skin_is_contact_and_no_slip() -> None:
    tap = {"on": "load_n", "shape": "pulse", "amplitude": 5.0, "start_s": 1.0, "duration_s": 0.05}
    truth = Truth(scene({"kind": "rest", "duration_s": 2.0}, disturbances=[tap]))
    assert truth.state(np.array([1.025])).load_n[0] == pytest.approx(5.0, rel=1e-3)
    assert truth.state(np.array([0.99, 1.06])).load_n.tolist() == [0.0, 0.0]
    assert truth.episodes == []


def test_grooves_as_deep_as_the_bump_are_refused() -> None:
    played = scene(
        PRESS, SLIDE, contact="mechanics", surface={"kind": "grooves", "period_mm": 1.2, "depth_mm": 0.4}
    )
    with pytest.raises(ConfigError, match="as deep as the bump"):
        contact(played)


@pytest.mark.parametrize(
    ("change", "finding"),
    [
        ({"phases": [PRESS, {"kind": "rotate", "duration_s": 1, "angle_deg": 9}]}, "cannot play a rotate"),
        ({"held_object": {}}, "cannot play a held object"),
        ({"touching": [4]}, "cannot play touching"),
        ({"load_gradient_per_mm": [0.0, 0.1]}, "cannot play load_gradient_per_mm"),
    ],
)
def test_motion_that_needs_mechanics_is_refused_on_signal(change: dict[str, Any], finding: str) -> None:
    with pytest.raises(ValueError, match=finding):
        Scene.model_validate({"name": "t", "contact": "signal", "phases": [PRESS], **change})


def test_a_held_object_that_nothing_grips_is_refused() -> None:
    with pytest.raises(ValueError, match="held_object: nothing grips it"):
        scene({"kind": "rest", "duration_s": 1.0}, held_object={})


def test_slips_stay_known_after_a_look_back() -> None:
    """A look back beyond the newest 10 s steps the contact from its beginning again."""
    truth = Truth(scene(PRESS, HOLD, SLIDE, HOLD | {"duration_s": 12.0}))
    slips = truth.slips
    assert len(slips) == 1
    truth.state(np.array([0.5]))
    assert truth.slips == slips
    truth.state(np.array([16.5]))
    assert truth.slips == slips


GROOVES = {"kind": "grooves", "period_mm": 1.2}
FAST = {"on": "load_n", "amplitude": 2.0, "start_s": 1.0}


@pytest.mark.parametrize(
    ("plate", "extra", "finding"),
    [
        (EVEN, {"shape": "sine", "frequency_hz": 200.0}, "frequency_hz: this contact plays 50 Hz at most"),
        (GROOVES, {"shape": "sine"}, "frequency_hz: this contact plays 12.5 Hz at most"),
        (EVEN, {"shape": "pulse", "duration_s": 0.002}, "duration_s: this contact plays pulses of 0.01 s"),
    ],
)
def test_a_disturbance_that_falls_between_the_steps_of_a_contact_is_refused(
    plate: dict[str, Any], extra: dict[str, Any], finding: str
) -> None:
    """A sine at half of the rate of the steps was not there at all, and nothing said so."""
    with pytest.raises(ConfigError, match=rf"disturbances\[0\]\.{finding}"):
        contact(scene(PRESS, HOLD, surface=plate, disturbances=[FAST | extra]))


@pytest.mark.parametrize(
    "extra", [{"shape": "sine", "frequency_hz": 50.0}, {"shape": "pulse", "duration_s": 0.01}]
)
def test_the_fastest_disturbances_reach_the_skin(extra: dict[str, Any]) -> None:
    truth = Truth(scene(PRESS, HOLD, disturbances=[FAST | extra]))
    load_n = truth.state(np.arange(1.0, 2.0, 1e-4)).load_n
    assert load_n.max() == pytest.approx(17.0, abs=0.3)


@pytest.mark.parametrize("model", ["signal", "mechanics"])
def test_truth_of_a_simulation_is_json(model: str) -> None:
    simulation = Simulation(scene(PRESS, HOLD, SLIDE, contact=model), load_layout("board-v1"))
    for _ in simulation:
        pass
    truth = simulation.truth
    (slip,) = truth.slips
    assert slip.onset_s == pytest.approx(truth.t0_s + 2.0, abs=0.04)
    assert truth.speed_mm_s(np.array([truth.t0_s + 4.0])) == 1.0
    said = json.loads(json.dumps(truth.to_map(), allow_nan=False))
    assert said["slips"][0]["onset_s"] == slip.onset_s
    state = truth.state(truth.t0_s + np.array([1.5, 4.0]))
    np.testing.assert_allclose(state.load_n, 15.0)
    np.testing.assert_allclose(state.normal_n.sum(axis=1), 15.0)
    np.testing.assert_allclose(state.slipping_share, [0.0, 1.0])
    np.testing.assert_allclose(state.velocity_mm_s, [[0.0, 0.0], [1.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(state.tangential_n[1].sum(axis=0), [-9.0, 0.0], rtol=1e-6, atol=1e-9)


def test_warming_lowers_the_counts() -> None:
    def last_counts(**rest: Any) -> float:
        sensor = Sensor(scene(PRESS, HOLD, **rest), WANG, adc_bits=12, adc_reference_v=3.0)
        return float(sensor.counts(0, np.full((1, 36), 2.0)).mean())

    warm = {"on": "temperature_k", "shape": "ramp", "amplitude": 30.0, "duration_s": 1.0}
    assert last_counts(disturbances=[warm]) < last_counts() - 20
