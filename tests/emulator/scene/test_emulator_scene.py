"""Scene files: what ships loads, what is impossible is refused with its place."""

from pathlib import Path
from typing import Any

import pytest

from tactiled import resources
from tactiled.array import load_array
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.emulator.scene.phases import FlatPlate, GroovedPlate
from tactiled.emulator.scene.truth import Truth
from tactiled.errors import ConfigError

PRESS = {"kind": "press", "duration_s": 1.0, "force_n": 10.0}
SLIDE = {"kind": "slide", "duration_s": 2.0, "speed_mm_s": 1.0}


def scene(*phases: dict[str, Any], **rest: Any) -> Scene:
    return Scene.model_validate({"name": "test", "phases": list(phases), **rest})


@pytest.mark.parametrize("name", resources.shipped_names("config/scenes"))
def test_every_shipped_scene_loads_and_has_its_name(name: str) -> None:
    loaded = load_scene(name)
    assert loaded.name == name
    assert load_array(loaded.array).n_channels == 36
    assert Truth(loaded).phases[-1].end_s == pytest.approx(loaded.duration_s)


def test_prescribed_is_a_flat_slip_and_then_grooves() -> None:
    demo = load_scene("prescribed")
    assert demo.duration_s <= 38.0
    flat, grooves = Truth(demo).slips
    assert isinstance(flat.surface, FlatPlate)
    assert isinstance(grooves.surface, GroovedPlate)
    assert (grooves.surface.period_mm, grooves.surface.angle_deg) == (1.2, 30.0)
    assert flat.direction_deg == grooves.direction_deg == 0.0
    assert grooves.onset_s > flat.end_s + 1.0


BAD = {
    "a negative period": (
        'surface = { kind = "grooves", period_mm = -1.2 }\n[[phases]]\nkind = "rest"\nduration_s = 1',
        r"surface\.period_mm: .*greater than",
    ),
    "a period in a phase": (
        '[[phases]]\nkind = "press"\nduration_s = 1\nforce_n = 1\n'
        'surface = { kind = "grooves", period_mm = 0 }',
        r"phases\[0\]\.surface\.period_mm",
    ),
    "a wrong unit": (
        '[[phases]]\nkind = "press"\nduration_s = 1\nforce_kg = 1',
        r"force_kg: unknown key; units belong to the name here: use force_n",
    ),
    "an unknown phase": ('[[phases]]\nkind = "wiggle"\nduration_s = 1', r"phases\[0\].*wiggle"),
    "no phases": ("phases = []", r"phases"),
    "a slide in the air": (
        '[[phases]]\nkind = "slide"\nduration_s = 1\nspeed_mm_s = 1',
        r"phases\[0\]: a slide",
    ),
    "a rest while pressed": (
        '[[phases]]\nkind = "press"\nduration_s = 1\nforce_n = 1\n[[phases]]\nkind = "rest"\nduration_s = 1',
        r"phases\[1\]: a rest",
    ),
    "no duration": ('[[phases]]\nkind = "rest"', r"phases\[0\]\.duration_s: missing"),
    "nan": ('[[phases]]\nkind = "rest"\nduration_s = nan', r"phases\[0\]\.duration_s"),
    "an unknown model": (
        'contact = "magic"\n[[phases]]\nkind = "rest"\nduration_s = 1',
        r"contact: .*signal",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_scene_files_are_refused_with_the_key(tmp_path: Path, case: str) -> None:
    text, finding = BAD[case]
    path = tmp_path / "bad.toml"
    path.write_text(f'name = "bad"\n{text}\n')
    with pytest.raises(ConfigError, match=finding) as refusal:
        load_scene(str(path))
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize(
    ("slide", "finding"),
    [
        ({"speed_mm_s": None}, "valid number"),
        ({"speed_mm_s": 0.0}, "greater than 0"),
        ({"ramp_s": 3.0}, "the length of the phase"),
        ({"ramp_s": 1e-9}, "ramp_s must be 0"),
    ],
)
def test_impossible_slides_are_refused(slide: dict[str, Any], finding: str) -> None:
    with pytest.raises(ValueError, match=finding):
        scene(PRESS, SLIDE | slide)
