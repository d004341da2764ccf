"""Cases of ``./run bench slip``: worlds, with the truth that events are compared with."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.worlds.laws import HELD_OUT_LAW, USUAL, Population, draw_worlds
from bench.worlds.world import INCIPIENT_USED, World
from tactiled.array import Array, FloatArray
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.events.types import Event, SlipEvent
from tactiled.samples.block import ScanBlock

REPORTED_FROM = 3_000
"""First seed of the worlds of laws: nothing was learnt from these."""
_HELD_OUT_EACH, _BATCH = 4, 12  # one batch in so many has a contact law that was never learnt from
_JUST_NOW_S = 0.1  # an onset reported so soon after a partial slip ended belongs to it


@dataclass(frozen=True, eq=False)
class Case:
    """Scans of one world, and the truth of its first gross slip."""

    block: ScanBlock
    utilisation: FloatArray  # (n,): tangential load over its limit
    touching: NDArray[np.bool_]  # (n,)
    # gross_s, gross_end_s, tenth_s: first gross slip: from where all of the contact slips until it stops; a
    # tenth of the area slips since. Infinite where there is none.
    gross_s: float
    gross_end_s: float
    tenth_s: float
    direction_deg: float  # of the skin's motion in that slip; NaN where it turns on the spot
    is_falling: bool = False  # friction falls at constant load

    @property
    def slips(self) -> bool:
        """True where gross slip happens."""
        return bool(np.isfinite(self.gross_s))

    @property
    def partial(self) -> NDArray[np.bool_]:
        """Scans (n,) at which a tenth of the area slips."""
        return np.asarray(self.utilisation >= INCIPIENT_USED)

    @property
    def nothing(self) -> NDArray[np.bool_]:
        """Scans (n,) at which less than a tenth of the area slips, as in the 0.1 s before."""
        before = round(_JUST_NOW_S * self.block.rate_hz)
        recent = np.convolve(self.partial, np.ones(before + 1))[: len(self.utilisation)] > 0.5
        return np.asarray(~recent)


def from_world(world: World) -> Case:
    """Make a case of a world."""
    gross_s = world.gross_s[0] if world.slips else np.inf
    direction_deg, end_s = np.nan, np.inf
    if world.slips:
        row = min(round(gross_s * world.rate_hz), len(world.gross) - 1)
        after = np.flatnonzero(~world.gross[row + 1 :])
        end_s = float(row + 1 + after[0]) / world.rate_hz if len(after) else np.inf
        direction_deg = np.nan if world.hand == "twist" else float(world.direction_deg[row])
    return Case(
        block=world.block,
        utilisation=np.minimum(world.utilisation, 1.0),
        touching=world.touching,
        gross_s=gross_s,
        gross_end_s=end_s,
        tenth_s=world.tenth_s[0] if world.slips else np.inf,
        direction_deg=direction_deg,
        is_falling=world.hand == "falling-friction",
    )


def draw_reported(seeds: range) -> list[World]:
    """Draw a batch of worlds of laws; one batch in four has a contact law that was never learnt from."""
    is_held_out = (seeds[0] // _BATCH) % _HELD_OUT_EACH == 0
    return draw_worlds(seeds, Population(laws=(HELD_OUT_LAW,)) if is_held_out else USUAL)


NAMES = (*SETTINGS, "wang2019")


class Reported(NamedTuple):
    """One case and the slip events of one setting."""

    case: Case
    events: Sequence[SlipEvent]


def run_settings(array: Array, block: ScanBlock) -> dict[str, list[Event]]:
    """Return the events of the contact filter by setting."""
    params = {name: DetectParams.model_validate({"setting": name}).grip for name in SETTINGS}
    return {name: GripDetector(array, of).process(block) for name, of in params.items()}


def run_case(world: World) -> dict[str, Reported]:
    """Run all detectors over a world; what they report by name."""
    published = build_suite(world.array, DetectParams(setting="wang2019"), topics=("slip", "contact"))
    events = {**run_settings(world.array, world.block), "wang2019": published.process(world.block)}
    case = from_world(world)
    return {
        name: Reported(case, [one for one in some if isinstance(one, SlipEvent)])
        for name, some in events.items()
    }
