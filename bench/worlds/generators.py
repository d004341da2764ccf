"""All generators of worlds by name."""

from collections.abc import Callable, Mapping

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
