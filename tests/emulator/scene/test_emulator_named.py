"""Every scene has a name that the command line takes."""

from pathlib import Path

import pytest

from tactiled.emulator.scene.families.holding import hold
from tactiled.emulator.scene.named import named_scene, scene_names
from tactiled.errors import ConfigError


def test_scenes_of_each_kind_are_found_by_name() -> None:
    *shipped, grasp = scene_names()
    for name in shipped:
        assert named_scene(name).name == name
    assert grasp == "hold-SEED"
    assert named_scene("hold-7") == hold(7)


def test_a_scene_is_read_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\n[[phases]]\nkind = "rest"\nduration_s = 1.0\n')
    assert named_scene(str(file)).name == "mine"


@pytest.mark.parametrize("name", ["dmeo", "hold-x", "nothing-3", "hold-99999999999"])
def test_an_unknown_scene_is_refused_with_all_names(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"no scene '{name}'.*demo.*hold-SEED"):
        named_scene(name)
