"""Lines for people: what they say, how many there are, and that nothing foreign commands the terminal."""

from dataclasses import replace
from itertools import product
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from message_strategies import instances
from messages import CONTACT, SLIP, STATUS

from tactiled.errors import ContractError
from tactiled.events.codec import to_map
from tactiled.events.incoming import checked_map
from tactiled.events.types import (
    EVENT_TYPES,
    CommandEvent,
    Event,
    ForceEvent,
    GripEvent,
    ScanEvent,
    Suppressed,
    TextureEvent,
)
from tactiled.events.words import EventLines, event_words, with_sd

COLUMNS = 80
CLOCK = "12:34:56.789  "
FORCE = ForceEvent(
    time_s=0.0, fx_n=3.0, fy_n=4.0, fz_n=12.0, fx_sd_n=0.1, fy_sd_n=0.1, fz_sd_n=0.5, calibration="finger-7",
    valid=True,
)  # fmt: skip
GRIP = GripEvent(
    time_s=0.0, utilisation=0.62, utilisation_low=0.48, utilisation_high=0.8, state="partial", valid=True,
    load=3.14, unit="N",
)  # fmt: skip
GROOVES = TextureEvent(
    time_s=0.0, answered_s=0.0, status="ok", period_mm=1.2001, period_sd_mm=0.0041, angle_deg=30.03,
    angle_sd_deg=0.17,
)  # fmt: skip
COMMAND = CommandEvent(
    time_s=0.0, request_id="1", command="tare", arguments="{}", who="", key="", uid=0, ok=True, reason="",
    scan_index=0,
)  # fmt: skip


def words(event: Event) -> str:
    return event_words(event.topic, received(event))


def received(event: Event, board: str = "TS1") -> dict[str, Any]:
    return checked_map(event.topic, to_map(event, seq=0, board=board, unix_offset_s=0.0))


@pytest.mark.parametrize(
    ("event", "said"),
    [
        (replace(SLIP, onset_s=-0.04, direction_deg=12.0, direction_sd_deg=9.0, confidence=0.93),
         "gross slip towards +x (12 ± 9°), p 0.93, latency 40 ms"),
        (replace(SLIP, kind="incipient", direction_deg=-0.2, direction_sd_deg=0.1),
         "incipient slip towards +x (0 ± 1°), p 1.00, latency 0 ms"),
        (replace(SLIP, direction_sd_deg=180.0), "gross slip, p 1.00, latency 0 ms"),
        (replace(SLIP, direction_sd_deg=180.0, valid=False), "gross slip, not valid"),
        (replace(SLIP, direction_deg=-179.0, valid=False, suppressed="load-change"),
         "gross slip towards -x (-179 ± 2°), suppressed: load-change"),
        (replace(SLIP, state="end", onset_s=-1.5), "gross slip ended after 1.50 s"),
        (CONTACT, "contact none -> loading"),
        (GRIP, "grip partial, 62 % of the limit in use (48 to 80), load 3.1 N"),
        (replace(GRIP, unit="relative", valid=False),
         "grip partial, 62 % of the limit in use (48 to 80), not valid"),
        (replace(GRIP, state="unknown", unit="relative"),
         "grip unknown, how much of the limit is in use is not known"),
        (replace(GRIP, state="none"), "grip none"),
        (GROOVES, "grooves 1.200 ± 0.004 mm at 30.03 ± 0.17°"),
        (replace(GROOVES, status="period-only"), "ripple 1.200 ± 0.004 mm, angle unknown"),
        (replace(GROOVES, status="too-few-periods"), "no groove estimate: too-few-periods"),
        (FORCE, "force 12.0 ± 0.5 N, shear 5.0 N"),
        (replace(FORCE, saturated=True), "force >= 12.0 ± 0.5 N, shear 5.0 N"),
        (replace(FORCE, fy_n=0.0, fy_sd_n=1e9), "force 12.0 ± 0.5 N, shear not known"),
        (replace(FORCE, calibration="nominal"), "force not calibrated: tactiled calibrate"),
        (replace(FORCE, valid=False), "force not valid"),
        (COMMAND, "tare by ?"),
        (replace(COMMAND, who="arm", ok=False, reason="in contact"), "tare by arm refused: in contact"),
        (STATUS, "status running, 100.0 Hz, 0 of 1 lost"),
        (replace(STATUS, state="stalled", reason="no frames", loss_known=False),
         "status stalled, 100.0 Hz, lost scans not known; no frames"),
    ],
)  # fmt: skip
def test_an_event_is_one_line(event: Event, said: str) -> None:
    assert words(event) == said


def test_the_longest_usual_lines_fit_a_terminal_of_80_columns() -> None:
    reasons: tuple[Suppressed, ...] = ("", "load-change")
    slips = (
        replace(SLIP, kind="incipient", direction_deg=angle, direction_sd_deg=sd, confidence=0.93,
                onset_s=-0.999, suppressed=suppressed, valid=not suppressed)
        for angle, sd, suppressed in product((-135.0, 179.0), (1.0, 44.0, 180.0), reasons)
    )  # fmt: skip
    grips = (replace(GRIP, state="unloading", utilisation=1.0, utilisation_high=1.0, load=99.9),)
    for event in (*slips, *grips, GROOVES, FORCE):
        assert len(CLOCK + words(event)) <= COLUMNS, words(event)


def test_a_state_is_shown_at_once_and_again_each_second() -> None:
    lines = EventLines("{:.2f} s".format)
    grips = [replace(GRIP, time_s=k / 100, state="gross" if k >= 150 else "partial") for k in range(300)]
    shown = [line for grip in grips if (line := lines.line("grip", received(grip)))]
    assert [line.split(",")[0] for line in shown] == [
        "0.00 s  grip partial", "1.00 s  grip partial", "1.50 s  grip gross", "2.50 s  grip gross",
    ]  # fmt: skip


def test_events_are_not_thinned() -> None:
    lines = EventLines(str)
    assert all(lines.line("slip", received(SLIP)) for _ in range(5))


def test_a_clock_that_was_set_back_silences_nothing() -> None:
    lines = EventLines(str)
    assert [bool(lines.line("grip", received(replace(GRIP, time_s=t)))) for t in (5000.0, 5000.1, 10.0)] == [
        True, False, True,
    ]  # fmt: skip


def test_scans_and_statuses_are_shown_where_they_are_asked_for() -> None:
    scan = ScanEvent(
        time_s=0.0,
        index=7,
        volts=(0.5, 1.25, 9.0),
        valid=(True, True, False),
        time_sd_s=0.0,
        age_s=0.0,
        late=True,
    )
    for event in (scan, STATUS, FORCE):
        assert EventLines(str).line(event.topic, received(event)) is None
        assert EventLines(str, ("slip",)).line(event.topic, received(event)) is None
    line = EventLines(str, ("scan",)).line("scan", received(scan))
    assert line == "0.0  scan 7: 2 of 3 readings valid, 0.5 to 1.25, late"
    assert EventLines(str, ("scan",)).line("slip", received(SLIP)) is None


def test_lines_of_several_boards_name_them() -> None:
    lines = EventLines(str)
    shown = [lines.line("contact", received(CONTACT, board)) for board in ("TS1", "TS1", "TS2", "TS1")]
    assert shown == [f"0.0  {board}contact none -> loading" for board in ("", "", "TS2  ", "TS1  ")]


@pytest.mark.parametrize("kind", EVENT_TYPES.values(), ids=EVENT_TYPES)
@given(data=st.data())
@settings(deadline=None, max_examples=40)
def test_any_values_are_one_line_without_control_characters(kind: type[Event], data: st.DataObject) -> None:
    event = data.draw(instances(kind))
    sent = to_map(event, seq=0, board=data.draw(st.text()), unix_offset_s=0.0)
    sent |= {key: 0.0 for key in ("timestamp", "onset", "detected", "answered") if key in sent}
    try:
        checked = checked_map(event.topic, sent)
    except ContractError:  # lists that differ in length: no such message is shown
        return
    line = EventLines(str, EVENT_TYPES).line(event.topic, checked)
    assert line is not None
    assert line.isprintable()


@pytest.mark.parametrize(
    ("sd", "shown"),
    [
        (0.0012, "1.2346 ± 0.0012"),
        (0.0041, "1.235 ± 0.004"),
        (2.0, "1 ± 2"),
        (14.0, "1 ± 14"),
        (0.0, "1.2345678900"),
    ],
)
def test_numbers_have_the_digits_of_their_standard_deviation(sd: float, shown: str) -> None:
    assert with_sd(1.23456789, sd).startswith(shown)
