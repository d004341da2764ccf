"""The verdict of the demo, against events that are made up: missing, extra, wrong and none."""

import dataclasses
import math
import re

import numpy as np
import pytest

from tactiled.demo.comparison import REFINED_S, Host, compare, finds_end_s, true_slides
from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.scene.phases import FlatPlate, GroovedPlate
from tactiled.emulator.scene.truth import TrueSlip, Truth
from tactiled.events.types import Event, GripEvent, SlipEvent, TextureEvent

T0_S = 100.0
FLAT = TrueSlip(6.0, 11.0, 0.0, FlatPlate(), shear_s=6.0, incipient_s=6.03, gross_s=6.23)
GROOVES = TrueSlip(
    15.5, 30.0, 0.0, GroovedPlate(kind="grooves", period_mm=1.2, angle_deg=30.0),
    shear_s=15.5, incipient_s=15.53, gross_s=15.73,
)  # fmt: skip
SLIDES = [FLAT, GROOVES]


def onsets(slide: TrueSlip, *, error_s: float = 0.01, direction_deg: float = 1.0) -> list[SlipEvent]:
    """What is reported of a slide: part of the contact slips, then all of it."""
    assert slide.incipient_s is not None
    assert slide.gross_s is not None
    at_s = T0_S + slide.incipient_s + error_s
    incipient = SlipEvent(
        time_s=at_s, state="onset", kind="incipient", onset_s=at_s, onset_sd_s=0.02,
        direction_deg=direction_deg, direction_sd_deg=1.0, confidence=1.0, taxels=(0,), detector="x",
        statistic=1.0, threshold=1.0, valid=True, detected_s=at_s + 0.03,
    )  # fmt: skip
    gross_s = T0_S + slide.gross_s + error_s
    return [incipient, dataclasses.replace(incipient, time_s=gross_s, kind="gross", onset_s=gross_s)]


TEXTURE = TextureEvent(
    time_s=T0_S + 18.0, answered_s=T0_S + 18.0, status="ok", period_mm=1.202, angle_deg=30.1
)
FIRST, LAST = onsets(FLAT), onsets(GROOVES)


def grips(slide: TrueSlip, *, until_s: float = math.inf) -> list[GripEvent]:
    """What is reported of each scan of a slide; after some time, that it sticks."""
    assert slide.gross_s is not None
    sliding = GripEvent(time_s=0.0, state="gross", utilisation=1.0)
    return [
        dataclasses.replace(sliding, time_s=T0_S + at_s)
        if at_s < until_s
        else dataclasses.replace(sliding, time_s=T0_S + at_s, state="sticking", utilisation=0.5)
        for at_s in np.arange(slide.gross_s, slide.end_s, 0.01).tolist()
    ]


GRIPS = [*grips(FLAT), *grips(GROOVES)]
ALL: list[Event] = [*FIRST, *LAST, TEXTURE, *GRIPS]


def wrong(events: list[Event]) -> list[str]:
    return compare(SLIDES, events, T0_S).wrong


def test_an_onset_is_judged_by_the_certainty_that_it_states() -> None:
    late = [dataclasses.replace(e, onset_s=e.onset_s + 0.1) if e.kind == "gross" else e for e in FIRST]
    assert any("gross at" in words for words in wrong([*late, *LAST, TEXTURE, *GRIPS]))
    less_certain = [dataclasses.replace(e, onset_sd_s=0.05) for e in late]
    assert wrong([*less_certain, *LAST, TEXTURE, *GRIPS]) == []


def test_late_groove_fits_excuse_groove_estimates_alone() -> None:
    assert compare(SLIDES, [*FIRST, *LAST, *GRIPS], T0_S).is_groove_wrong
    assert not compare(SLIDES, [*LAST, TEXTURE, *GRIPS], T0_S).is_groove_wrong
    assert not compare(SLIDES, ALL, T0_S).is_groove_wrong


def test_slip_during_a_lift_may_be_reported_and_need_not_be() -> None:
    release = TrueSlip(12.0, 12.5, None, FlatPlate(), shear_s=12.0, incipient_s=12.0, gross_s=12.01)
    lifted = [dataclasses.replace(e, detected_s=T0_S + 12.4, onset_s=T0_S + 12.3) for e in FIRST]
    events = [*ALL, *lifted]
    assert compare(SLIDES, events, T0_S, [release]).wrong == []
    assert compare(SLIDES, ALL, T0_S, [release]).wrong == []
    assert any("slides reported" in words for words in wrong(events))


def test_everything_found_is_right() -> None:
    verdict = compare(SLIDES, ALL, T0_S)
    assert verdict.wrong == []
    assert {row[-1] for row in verdict.rows} == {"good"}


@pytest.mark.parametrize(
    ("until_s", "says"),
    [(10.9, ["part reported as gross"]), (7.0, ["utilisation", "part reported as gross"])],
)
def test_messages_that_deny_the_slide_are_wrong(until_s: float, says: list[str]) -> None:
    found = wrong([*FIRST, *LAST, TEXTURE, *grips(FLAT, until_s=until_s), *grips(GROOVES)])
    assert [words.partition(": ")[2].partition(": ")[0] for words in found] == says


def test_a_missing_first_slide_is_wrong_and_named() -> None:
    found = wrong([*LAST, TEXTURE, *GRIPS])
    assert "slip 1, flat: incipient at: not reported" in found
    assert "slip 1, flat: gross at: not reported" in found
    assert "slides reported: 1" in found
    assert not [words for words in found if "slip 2" in words]


def test_a_missing_last_slide_is_wrong_and_named() -> None:
    """A demo that ended after its first slide said "good" four times: all that was reported was right."""
    found = wrong([*FIRST, *GRIPS])
    assert "slip 2, grooves: gross at: not reported" in found
    assert "slip 2, grooves: period: not reported" in found
    assert not [words for words in found if "slip 1" in words]


def test_no_estimate_at_all_is_wrong() -> None:
    found = wrong([])
    for name in ("slip 1, flat", "slip 2, grooves"):
        assert f"{name}: gross at: not reported" in found
    assert "good" not in {row[-1] for row in compare(SLIDES, [], T0_S).rows[:-1]}


def test_a_scene_without_slides_is_an_error() -> None:
    assert compare([], [], T0_S).wrong == ["the scene plays no slide: there is nothing to find"]


@pytest.mark.parametrize("extra_s", [3.0, 6.1, 13.0, 20.0])
def test_an_extra_slip_is_wrong(extra_s: float) -> None:
    extra = dataclasses.replace(FIRST[1], onset_s=T0_S + extra_s)
    assert wrong([*ALL, extra]) == ["slides reported: 3"]


def test_a_texture_where_there_are_no_grooves_is_wrong() -> None:
    extra = dataclasses.replace(TEXTURE, time_s=T0_S + 8.0)
    assert wrong([extra, *ALL]) == ["textures where there are no grooves: 1"]


@pytest.mark.parametrize(
    ("events", "quantity"),
    [
        ([*FIRST, *LAST], "answer after"),
        ([*FIRST, LAST[0], TEXTURE], "gross at"),
        ([*FIRST, LAST[1], TEXTURE], "incipient at"),
        ([*FIRST, *onsets(GROOVES, direction_deg=180.0), TEXTURE], "direction"),
        ([*FIRST, *onsets(GROOVES, error_s=0.07), TEXTURE], "gross at"),
        ([*FIRST, *LAST, dataclasses.replace(TEXTURE, period_mm=1.22)], "period"),
        ([*FIRST, *LAST, dataclasses.replace(TEXTURE, angle_deg=29.0)], "angle"),
        ([*FIRST, *LAST, dataclasses.replace(TEXTURE, answered_s=T0_S + 18.8)], "answer after"),
        ([*FIRST, *LAST, dataclasses.replace(TEXTURE, status="low-snr")], "period"),
    ],
)
def test_an_estimate_that_is_wrong_is_called_so(events: list[Event], quantity: str) -> None:
    assert [words for words in wrong(events) if words.startswith(f"slip 2, grooves: {quantity}")]


def test_the_expected_slips_follow_from_the_scene_alone() -> None:
    truth = Truth(load_scene("demo"))
    slides = true_slides(truth)
    assert [slide.surface.kind for slide in slides] == ["flat", "grooves"]
    assert len(slides) == sum(phase.kind == "slide" for phase in truth.phases)
    last_s = slides[-1].gross_s
    assert last_s is not None
    assert last_s + REFINED_S < finds_end_s(slides, truth.scene.duration_s) <= truth.scene.duration_s


def test_a_host_that_kept_up_is_not_too_slow() -> None:
    assert Host(scans=2000, late=20, lost=3, oldest_s=0.2).too_slow() == ""
    assert Host(scans=2000, fits_late=50).too_slow(is_wrong=False) == ""


@pytest.mark.parametrize(
    ("host", "words"),
    [
        (Host(scans=2000, late=800, oldest_s=1.58), "800 of 2000 scans were late, the latest 1.58 s old"),
        (Host(scans=2000, lost=300), "300 scans were lost on the way"),
        (Host(scans=2000, fits_late=12), "12 groove fits were not ready in time"),
    ],
)
def test_a_host_that_did_not_keep_up_is_named_with_numbers(host: Host, words: str) -> None:
    assert re.search(words, host.too_slow())
