"""Slips that are found without being told: worlds of sensors that are not ours, and a baseline beside."""

from dataclasses import dataclass

import numpy as np

from bench.sensors.baseline import rate_of_change_slides
from bench.sensors.worlds import FINGERTIP, MAGNETS, SHEAR, Played, Skin, World, play
from tactiled import tomlfile
from tactiled.array import ArrayFile, build
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.detect.tuning import TunedSuite
from tactiled.events.types import SlipEvent
from tactiled.recording.table import to_blocks

FIRST_SEED = 100  # constants were set on the worlds of seeds 0 to 7
_LATE_S = 1.0  # an onset that is detected so long after a slide is still its own
_SLIDING: tuple[World, ...] = ("ridges", "ridges from the first scan on", "rough", "smooth")
_QUIET: tuple[World, ...] = ("hold", "taps", "grip changes", "motor hum", "cable tug", "load and back")
_STILL: tuple[World, ...] = ("hold", "taps", "grip changes", "motor hum")
CASES: tuple[tuple[Skin, tuple[World, ...], tuple[World, ...]], ...] = (
    (FINGERTIP, _SLIDING, _QUIET),
    (MAGNETS, ("tug", "jerk"), _STILL),
    (SHEAR, ("tug", "jerk"), _STILL),
)


# Changes that the baseline looks for: from scan to scan over a surface, in a quarter of a second in a tug;
# and how many times as fast they are as at rest. Of 2, 3, 5 and 10 these find most on seeds 0 to 7: 17 of 32
# slides with 155 false onsets, and all 16 tugs and jerks of the shear sensor with 36.
_CHANGES = {FINGERTIP.name: (0.0, 3.0), MAGNETS.name: (0.25, 10.0), SHEAR.name: (0.25, 10.0)}


@dataclass(frozen=True)
class SlipTrial:
    """Onsets on one recording.

    Attributes
    ----------
    found : bool
        An onset was reported during the slide.
    n_false : int
        Onsets at other times.
    delay_s : float
        From the beginning of the slide (of the load, for a tug) to the first onset; NaN for none.
    """

    skin: str
    world: World
    duration_s: float
    has_slide: bool
    found: bool
    n_false: int
    delay_s: float
    baseline_found: bool
    baseline_false: int
    baseline_delay_s: float


def run_slips(skin: Skin, world: World, seed: int) -> SlipTrial:
    """Play a world and detect its slips, as `tactiled detect` does."""
    played = play(skin, world, seed)
    array = build(tomlfile.parse(skin.array, ArrayFile, skin.name))
    suite = TunedSuite(array, DetectParams(), lambda a, p: build_suite(a, p, topics=("slip", "contact")))
    blocks = to_blocks(played.time_s, played.readings, None, array.in_range(played.readings))
    events = [event for item in blocks for event in suite.process(item)]
    onsets = [e.detected_s for e in events if isinstance(e, SlipEvent) and e.state == "onset"]
    found, n_false, delay_s = _score(played, np.array(onsets))
    plain = _score(played, rate_of_change_slides(played.time_s, played.readings, *_CHANGES[skin.name]))
    duration_s = float(played.time_s[-1] - played.time_s[0])
    has_slide = bool(played.spans())
    return SlipTrial(skin.name, world, duration_s, has_slide, found, n_false, delay_s, *plain)


def _score(played: Played, onsets_s: np.ndarray) -> tuple[bool, int, float]:
    spans = played.spans()
    own = [t for t in onsets_s if any(a <= t <= b + _LATE_S for a, b in spans)]
    return bool(own), len(onsets_s) - len(own), min(own) - spans[0][0] if own else float("nan")
