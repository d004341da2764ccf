"""Random families keep their promise: what slips slips, what is quiet never does."""

from collections.abc import Callable

import numpy as np
import pytest

from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families import FAMILIES, QUIET, SLIPPING
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.emulator.scene.truth import Truth


def short_scene(family: Callable[[int], Scene]) -> Scene:
    """The shortest of a family's first scenes: each second takes long to play."""
    return min(map(family, range(24)), key=lambda scene: scene.duration_s)


@pytest.mark.parametrize("name", SLIPPING)
def test_slipping_families_slip(name: str) -> None:
    truth = Truth(short_scene(SLIPPING[name]))
    assert truth.slips
    for slip in truth.slips:
        instants = [slip.shear_s, slip.incipient_s, slip.gross_s, slip.end_s]
        assert instants == sorted(instants, key=lambda instant: instant or 0.0)


@pytest.mark.parametrize("name", QUIET)
def test_quiet_families_have_no_gross_slip(name: str) -> None:
    truth = Truth(short_scene(QUIET[name]))
    assert truth.slips == []
    assert isinstance(truth.contact, PhysicalContact)
    assert not truth.contact.has_fallen
    assert truth.state(np.array([truth.scene.duration_s])).load_n[0] > 0


@pytest.mark.parametrize("name", FAMILIES)
def test_a_seed_gives_one_scene(name: str) -> None:
    family = FAMILIES[name]
    assert family(3) == family(3)
    assert family(3) != family(4)
    assert family(3).name == f"{name}-3"


def test_families_draw_different_numbers() -> None:
    assert len({family(0).surface.friction for family in FAMILIES.values()}) == len(FAMILIES)
