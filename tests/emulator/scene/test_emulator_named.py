"""Every scene has a name that the command line takes."""

from pathlib import Path

import pytest

from tactiled.emulator.scene.families import FAMILIES
from tactiled.emulator.scene.named import named_scene, scene_names
from tactiled.errors import ConfigError


def test_scenes_of_each_kind_are_found_by_name() -> None:
    names = scene_names()
    for name in names["shipped"] + [f"{family}-3" for family in FAMILIES]:
        assert named_scene(name).name == name
    assert named_scene("stick-slip-7") == FAMILIES["stick-slip"](7)


def test_a_scene_is_read_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\n[[phases]]\nkind = "rest"\nduration_s = 1.0\n')
    assert named_scene(str(file)).name == "mine"


@pytest.mark.parametrize("name", ["dmeo", "taps", "taps-x", "nothing-3", "taps-99999999999"])
def test_an_unknown_scene_is_refused_with_all_names(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"no scene '{name}'.*demo.*stick-slip-SEED"):
        named_scene(name)
