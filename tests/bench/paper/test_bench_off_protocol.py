"""How the rule is scored, on runs whose events are written by hand, and on one that is played."""

import dataclasses

import numpy as np
import pytest

from bench.paper.off_protocol import CONDITIONS, SlideConditions, row
from bench.paper.play import ScenePlay, play
from tactiled.emulator.scene.truth import Truth
from tactiled.events.types import SlipEvent

SLIDE = SlideConditions(1.0)
TRUTH = Truth(SLIDE.scene(0)).slips[0]
DIRECTION_DEG = TRUTH.direction_deg or 0.0


def onset(late_s: float, off_deg: float, sd: float = 1.0) -> SlipEvent:
    """Onset event with these errors, and sigmas of `sd` times 10 ms and 1 degree."""
    return SlipEvent(
        time_s=TRUTH.onset_s + late_s,
        state="onset",
        kind="gross",
        onset_s=TRUTH.onset_s + late_s,
        onset_sd_s=0.01 * sd,
        direction_deg=DIRECTION_DEG + off_deg,
        direction_sd_deg=sd,
        confidence=1.0,
        taxels=(0,),
        detector="test",
        statistic=1.0,
        threshold=0.002,
        valid=True,
        detected_s=TRUTH.onset_s + late_s + 0.1,
    )


def end(late_s: float) -> SlipEvent:
    return dataclasses.replace(onset(0.0, 0.0), state="end", time_s=TRUTH.end_s + late_s)


def scored(*events: list[SlipEvent]) -> dict[str, str]:
    """Row by heading, a play for each list of events."""
    truth = Truth(SLIDE.scene(0))
    return row("x", [ScenePlay(np.zeros((0, 36)), np.zeros(0), list(one), truth) for one in events])


def test_errors_are_those_of_the_nearest_events_and_early_ones_are_counted() -> None:
    found = scored([onset(-2.0, 90.0), onset(0.01, 1.5), end(-0.05)], [onset(-0.04, -3.0), end(1.0)])
    assert list(found.values()) == [
        "x", "3 / 2", "2", "-15 ± 25 ms", "10 ms", "1 of 2", "2.4 deg", "1.0 deg", "1 of 2", "1 of 2",
        "-50 ± 0 ms",
    ]  # fmt: skip


def test_direction_errors_wrap_at_180_degrees() -> None:
    assert scored([onset(0.0, 359.0)])["direction error (rms)"] == "1.0 deg"


def test_without_events_nothing_is_right() -> None:
    assert list(scored([]).values()) == [
        "x",
        "0 / 1",
        "0",
        "-",
        "-",
        "0 of 0",
        "-",
        "-",
        "0 of 0",
        "0 of 1",
        "-",
    ]


@pytest.mark.parametrize(
    "conditions", [CONDITIONS[1], next(one for one in CONDITIONS if one.turns)], ids=lambda one: one.name
)
def test_a_slide_that_is_played_is_right_at_low_noise(conditions: SlideConditions) -> None:
    found = row(conditions.name, [play(conditions.scene(1), 1)])
    n = len(Truth(conditions.scene(1)).slips)
    assert found["onsets detected / true"] == f"{n} / {n}"
    assert found["right"] == f"{n}"
    assert found["ends right"] == f"{n} of {n}"
