"""All generators of worlds by name."""

from collections.abc import Callable, Iterable, Mapping
from itertools import combinations

from bench.worlds import bristles, grasps, laws, plates, sheet, strokes
from bench.worlds.world import World


def _laws(seeds: range, minutes: float, hands: tuple[str, ...] = ()) -> list[World]:
    return laws.draw_worlds(seeds, laws.Population(duration_s=60 * minutes, hands=hands or laws.HANDS))


GENERATORS: Mapping[str, Callable[[range, float, tuple[str, ...]], list[World]]] = {
    "laws": _laws,
    "bristles": bristles.draw_worlds,
    "sheet": sheet.draw_worlds,
    "strokes": strokes.draw_worlds,
    "grasps": grasps.draw_worlds,
    "plates": plates.draw_worlds,
}
"""Functions of seeds, minutes of each world, and hands to draw from (none: the generator's own)."""


def draw(generator: str, seeds: range, minutes: float = 1.0, hands: tuple[str, ...] = ()) -> list[World]:
    """Draw the worlds of some seeds; with `hands`, only these kinds."""
    return GENERATORS[generator](seeds, minutes, hands)


Names = frozenset[str]
"""Names of generators."""
# Both play the emulator's skin, array and electronics: what has learnt from one has seen the physics of both.
_SAME_SKIN: Names = frozenset({"grasps", "plates"})


def same_physics(generator: str) -> Names:
    """Return the generators of the same physics."""
    return _SAME_SKIN if generator in _SAME_SKIN else frozenset({generator})


def pairs_of_physics(generators: Iterable[str]) -> list[Names]:
    """Return the generators of each two kinds of physics."""
    return [one | other for one, other in combinations(dict.fromkeys(map(same_physics, generators)), 2)]
