"""Contact model signal: signs and phases of the geometry, derived in another way; the paper's findings."""

import cmath

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tactiled.array import Array, load_array
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.prescribed import SignalContact

WANG = load_array("wang2019-3x3")
PRESS = {"kind": "press", "duration_s": 1.0, "force_n": 18.0}
HOLD = {"kind": "hold", "duration_s": 1.0}
EVEN = {"kind": "flat", "unevenness": 0.0}


def forces(
    phases: list[dict[str, object]],
    time_s: NDArray[np.float64] | list[float],
    array: Array = WANG,
    **rest: object,
) -> NDArray[np.float64]:
    scene = Scene.model_validate({"name": "test", "surface": EVEN, "phases": phases, **rest})
    instants = np.repeat(np.asarray(time_s, dtype=float)[:, None], array.n_channels, axis=1)
    return SignalContact(SceneMotion(scene), array).forces(instants)[0]


def slide(direction_deg: float = 0.0, speed_mm_s: float = 1.0, duration_s: float = 10.0) -> dict[str, object]:
    return {
        "kind": "slide",
        "duration_s": duration_s,
        "speed_mm_s": speed_mm_s,
        "direction_deg": direction_deg,
    }


def grooves(period_mm: float, angle_deg: float, **rest: object) -> dict[str, object]:
    return {"kind": "grooves", "period_mm": period_mm, "angle_deg": angle_deg, **rest}


def taxel_ripple(
    surface: dict[str, object], phases: list[dict[str, object]], time_s: list[float]
) -> NDArray[np.float64]:
    """(n, taxels) relative change of each taxel's normal force against a flat plate."""
    weights = WANG.normal_weights().T
    return forces(phases, time_s, surface=surface) @ weights / (forces(phases, time_s) @ weights) - 1


@given(
    period_mm=st.floats(0.3, 5.0),
    angle_deg=st.floats(-85.0, 85.0),
    direction_deg=st.floats(-180.0, 180.0),
    way_mm=st.floats(0.0, 9.0),
)
@settings(max_examples=60, deadline=None)
def test_groove_phase_is_the_distance_to_the_ridge(
    period_mm: float, angle_deg: float, direction_deg: float, way_mm: float
) -> None:
    # The ridges are the lines through k * D * n, at right angles to n. Turn the plane by -a with complex
    # numbers: ridges then stand upright at multiples of D, and a place's phase is its real part over D.
    surface = grooves(period_mm, angle_deg, ripple=0.4)
    found = taxel_ripple(surface, [PRESS, slide(direction_deg)], [1.0 + way_mm])[0]
    travel = way_mm * cmath.exp(1j * np.deg2rad(direction_deg))
    ridge_frame = cmath.exp(-1j * np.deg2rad(angle_deg))
    places = WANG.x_mm + 1j * WANG.y_mm
    phase = 2 * np.pi * ((places + travel) * ridge_frame).real / period_mm
    amplitude = 0.4 * np.cos(np.deg2rad(angle_deg)) * np.exp(-2 * (np.pi * 0.2 / period_mm) ** 2)
    wave = np.cos(phase) + 0.2 * np.cos(2 * phase) + 0.05 * np.cos(3 * phase)
    np.testing.assert_allclose(found, amplitude * wave, atol=1e-9)


def test_ripple_grows_with_the_period_and_halves_at_60_degrees() -> None:
    time_s = np.arange(2.0, 10.0, 0.01).tolist()

    def swing(period_mm: float, angle_deg: float) -> float:
        return float(np.ptp(taxel_ripple(grooves(period_mm, angle_deg), [PRESS, slide()], time_s)[:, 4]))

    assert swing(0.9, 0) < swing(1.2, 0) < swing(1.5, 0)
    assert swing(1.2, 60) / swing(1.2, 0) == pytest.approx(0.5, abs=0.01)
    # 0.08 N peak to trough of 15 N / 9 on one unit at 0 degrees (Wang 2019)
    assert swing(1.2, 0) * 15 / 9 == pytest.approx(0.08, rel=0.07)


def test_load_is_carried_by_all_areas_a_little_unequally() -> None:
    pressed = forces([PRESS, HOLD], [0.5, 1.5])
    np.testing.assert_allclose(pressed.sum(axis=1), [9.0, 18.0])
    relative = pressed[1] * 36 / 18.0
    assert 0.01 < relative.std() < 0.06
    np.testing.assert_array_equal(pressed, forces([PRESS, HOLD], [0.5, 1.5]))
    assert not np.array_equal(pressed, forces([PRESS, HOLD], [0.5, 1.5], seed=2))


def test_sliding_along_x_raises_r1_and_lowers_r3_by_almost_all() -> None:
    before, after = forces([PRESS, HOLD, slide()], [1.99, 4.0])
    change = (after / before).reshape(9, 4)
    np.testing.assert_allclose(change[:, [0, 2]], np.tile([1.9, 0.1], (9, 1)), atol=1e-6)
    np.testing.assert_allclose(change[:, [1, 3]], 1.0)


@given(st.floats(-180.0, 180.0))
@settings(max_examples=30, deadline=None)
def test_the_pairs_point_along_the_motion(direction_deg: float) -> None:
    before, after = forces([PRESS, HOLD, slide(direction_deg)], [1.99, 4.0])
    # Relative to the load of each area, so that unequal shares drop out.
    x, y = (WANG.shear_weights() @ (after / before - 1)).sum(axis=1)
    difference = np.rad2deg(np.arctan2(y, x)) - direction_deg
    assert abs((difference + 180) % 360 - 180) < 1e-6


def test_normal_channels_see_load_and_ripple_only() -> None:
    pad = load_array("normal-4x4")
    flat = forces([PRESS, HOLD, slide()], [1.99, 4.0], pad)
    np.testing.assert_allclose(flat.sum(axis=1), 18.0)
    np.testing.assert_allclose(flat[0], flat[1])
    rippled = forces([PRESS, HOLD, slide()], [1.99, 4.0], pad, surface=grooves(1.3, 0.0))
    assert np.all(rippled[0] != rippled[1])


def test_shear_channels_carry_friction_with_the_sign_of_motion() -> None:
    pads = load_array("xyz-two-pads-4x4")
    kinds = np.array(pads.channel_kind)
    for direction, x_sign, y_sign in ((0, 1, 0), (180, -1, 0), (90, 0, 1), (-90, 0, -1)):
        slid = forces([PRESS, slide(direction)], [4.0], pads)[0]
        assert slid[kinds == "normal"].sum() == pytest.approx(18.0)
        assert slid[kinds == "shear_x"].sum() == pytest.approx(18.0 * 0.6 * x_sign, abs=1e-9)
        assert slid[kinds == "shear_y"].sum() == pytest.approx(18.0 * 0.6 * y_sign, abs=1e-9)


def test_without_friction_a_slide_on_a_flat_plate_changes_nothing() -> None:
    slid = forces([PRESS, HOLD, slide()], [1.9, 5.0], surface={"kind": "flat", "friction": 0.0})
    np.testing.assert_allclose(slid[0], slid[1])
