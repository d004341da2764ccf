"""Frames and history of the page server."""

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
from frames import rows
from messages import CONTACT, SLIP, STATUS

from tactiled.array import load_array
from tactiled.board_geometry import geometry_of
from tactiled.client import Lost, Message, Recovered, Restarted
from tactiled.events.codec import to_map
from tactiled.events.types import Event, ForceEvent, InfoEvent, ScanEvent
from tactiled.resources import shipped_names
from tactiled.web.feed import HISTORY_S, Feed

NOW_S = 1000.0
INFO = InfoEvent(
    time_s=0.0, board_serial="TS1", firmware_version="1", protocol="board-v1", protocol_version=1,
    array_id="mine", channels=1, taxels=1, x_mm=(0.0,), y_mm=(0.0,), channel_names=("t0.a",), rate_hz=100.0,
    volts_per_count=1.0, channel_offset_s=(0.0,), tactiled_version="0", zero=(0.0,),
)  # fmt: skip
SCAN = ScanEvent(time_s=0.0, index=0, volts=(1.0,), valid=(True,), time_sd_s=0.0, age_s=0.0, late=False)
FORCE = ForceEvent(
    time_s=0.0, fx_n=0.0, fy_n=0.0, fz_n=1.0, fx_sd_n=0.1, fy_sd_n=0.1, fz_sd_n=0.1, x_mm=0.0, y_mm=0.0,
    calibration="finger-7", valid=True,
)  # fmt: skip
SAMPLES: dict[str, Event] = {event.topic: event for event in (SLIP, CONTACT, STATUS, SCAN, INFO, FORCE)}


def message(topic: str, seq: int, at_s: float = NOW_S, **fields: Any) -> Message:
    event = replace(SAMPLES[topic], time_s=at_s)
    data = {**to_map(event, seq=seq, board="TS1", unix_offset_s=0.0, run=1), **fields}
    return Message(topic, "TS1", seq, at_s, data, 0.0, 0.0, 0.0)


def test_events_and_live_messages_are_in_two_frames_and_in_one() -> None:
    feed = Feed()
    for item in (message("scan", 0), message("slip", 0), Recovered(message("slip", 1)), message("status", 0)):
        feed.take(0, item)
    frames = feed.frames(NOW_S, 5.0)
    assert [(row[1], row[3]) for row in rows(frames.kept)] == [("slip", False), ("slip", True)]
    assert [row[1] for row in rows(frames.live)] == ["status", "scan"]
    assert rows(frames.both) == rows(frames.kept) + rows(frames.live)
    assert feed.frames(NOW_S, 5.0) == (None, None, None)


def test_after_the_clock_is_set_back_the_history_begins_anew() -> None:
    feed = Feed()
    for at_s in (NOW_S, NOW_S - 3600.0):
        for n in range(100):
            feed.take(0, message("scan", n, at_s + 0.1 * n))
        feed.frames(at_s + 10.0, 0.0)
        instants = [row[2]["timestamp"] for row in rows(feed.history(at_s + 10.0, 0.0)) if row[1] == "scan"]
        assert instants[0] == pytest.approx(at_s)
        assert len(instants) > 50


def test_a_frame_has_every_scan_and_the_newest_of_other_live_messages() -> None:
    feed = Feed()
    for n in range(3):
        feed.take(0, message("scan", n, volts=[0.1], valid=[True]))
        feed.take(0, message("status", n))
    feed.take(1, message("status", 9))
    found = [(row[0], row[1], row[2]["seq"]) for row in rows(feed.frames(NOW_S, 0.0).live)]
    assert found == [(0, "status", 2), (1, "status", 9), (0, "scan", 0), (0, "scan", 1), (0, "scan", 2)]


def test_losses_and_restarts_are_notices() -> None:
    feed = Feed()
    feed.take(2, Lost("slip", "TS1", 3))
    feed.take(2, Restarted("TS1"))
    assert [(row[0], row[2]["kind"]) for row in rows(feed.frames(NOW_S, 0.0).kept)] == [
        (2, "lost"),
        (2, "restart"),
    ]


def test_what_no_message_can_hold_costs_only_itself() -> None:
    feed = Feed()
    for item in (
        message("scan", 0, volts=[math.nan]),
        message("scan", 1, volts=[b"x"]),
        *(message("info", 0, channels=channels) for channels in ("x", [1], math.inf)),
        message("scan", 2),
    ):
        feed.take(0, item)
    frames = feed.frames(NOW_S, 0.0)
    assert frames.kept is None
    assert [row[2]["seq"] for row in rows(frames.live)] == [2]
    assert feed.unreadable == 5


def test_the_history_has_the_newest_state_once_and_scans_thinned() -> None:
    feed = Feed()
    for n in range(200):
        feed.take(0, message("scan", n, NOW_S + 0.01 * n))
    feed.take(0, message("contact", 0, state="loading"))
    feed.take(0, message("contact", 1, state="holding"))
    feed.take(0, message("status", 7))
    feed.frames(NOW_S + 2.0, 0.0)
    found = rows(feed.history(NOW_S + 2.0, 0.0))
    assert len([row for row in found if row[1] == "scan"]) in (19, 20, 21)
    assert [row[2]["state"] for row in found if row[1] == "contact"] == ["loading", "holding"]
    assert found[-1][1] == "status"


@pytest.mark.parametrize("is_sent", [True, False])
def test_a_browser_gets_each_state_once(is_sent: bool) -> None:
    """It joins before or after the frame with the newest states, and gets the frames that follow."""
    feed, found = Feed(), list[Any]()
    for topic in ("status", "contact", "info"):
        feed.take(0, message(topic, 0))
    if is_sent:
        feed.frames(NOW_S, 0.0)
    found += rows(feed.history(NOW_S, 0.0))
    frames = feed.frames(NOW_S, 0.0)
    found += rows(frames.kept) + rows(frames.live)
    assert sorted(row[1] for row in found) == ["contact", "geometry", "info", "status"]


def test_a_late_frame_has_the_newest_force_and_the_history_one_of_each_tenth_of_a_second() -> None:
    feed = Feed()
    for n in range(100):
        feed.take(0, message("force", n, NOW_S + 0.01 * n))
    assert [row[2]["seq"] for row in rows(feed.frames(NOW_S + 1.0, 0.0).live)] == [99]
    kept_s = [row[2]["timestamp"] for row in rows(feed.history(NOW_S + 1.0, 0.0))]
    assert len(kept_s) in (9, 10, 11)
    assert max(after - before for before, after in itertools.pairwise(kept_s)) < 0.15


def test_the_history_forgets_what_is_older_than_the_timeline() -> None:
    feed = Feed()
    feed.take(0, message("contact", 0, state="holding"))
    feed.take(0, message("slip", 0))
    feed.frames(NOW_S, 0.0)
    found = rows(feed.history(NOW_S + HISTORY_S + 1.0, 0.0))
    assert [row[1] for row in found] == ["contact"]  # the newest contact still holds, the slip is over


def test_the_history_is_bounded() -> None:
    feed = Feed()
    for n in range(10_000):
        feed.take(0, message("slip", n))
    feed.frames(NOW_S, 0.0)
    assert 1000 < len(rows(feed.history(NOW_S, 0.0))) <= 4000


def test_a_browser_that_comes_at_any_turn_gets_scans_in_order_and_events_once() -> None:
    """Ten scans in each frame; the history is taken between two of them."""
    for joined in range(1, 6):
        feed, found = Feed(), list[Any]()
        for turn in range(8):
            for n in range(10 * turn, 10 * turn + 10):
                feed.take(0, message("scan", n, NOW_S + 0.01 * n))
                if n % 10 == 7:
                    feed.take(0, message("slip", n, NOW_S + 0.01 * n))
            frames = feed.frames(NOW_S, 0.0)
            if turn == joined:
                found += rows(feed.history(NOW_S, 0.0))
            elif turn > joined:
                found += rows(frames.kept) + rows(frames.live)
        scans = [row[2]["seq"] for row in found if row[1] == "scan"]
        assert scans == sorted(set(scans))
        assert set(range(10 * joined + 10, 70)) <= set(scans)
        assert [row[2]["seq"] for row in found if row[1] == "slip"] == list(range(7, 80, 10))


def info(array_id: str, channels: int, names: list[str], taxels: int) -> dict[str, Any]:
    return {
        "array_id": array_id,
        "channels": channels,
        "channel_names": names,
        "taxels": taxels,
        "x_mm": [0.0],
        "y_mm": [0.0],
    }


def test_weights_of_every_shipped_array_give_its_load_and_shear() -> None:
    for name in shipped_names("config/arrays"):
        array = load_array(name)
        found = geometry_of(info(name, array.n_channels, list(array.channel_name), array.n_taxels))
        assert found["words"] == ""
        for rows_of, weights in (
            (found["pressure"], array.normal_weights()),
            (found["shear_x"], array.shear_weights()[0]),
            (found["shear_y"], array.shear_weights()[1]),
        ):
            assert [dict(map(tuple, pairs)) for pairs in rows_of] == [
                {int(c): float(row[c]) for c in range(array.n_channels) if row[c]} for row in weights
            ]


def test_an_unknown_array_shows_load_and_says_what_is_missing() -> None:
    found = geometry_of(info("mine", 4, ["t0.a", "t0.b", "t1.a", "odd"], 2))
    assert found["pressure"] == [[[0, 1 / 3], [1, 1 / 3], [3, 1 / 3]], [[2, 1.0]]]
    assert found["shear_x"] == [[], []]
    assert "--array" in found["words"]


def test_a_changed_board_gets_a_new_geometry_once() -> None:
    feed = Feed()
    for seq in range(3):
        feed.take(0, message("info", seq, **info("mine", 1, ["t0.a"], 1)))
    assert [row[1] for row in rows(feed.frames(NOW_S, 0.0).kept)].count("geometry") == 1
    feed.take(0, message("info", 3, **{**info("mine", 1, ["t0.a"], 1), "x_mm": [5.0]}))
    (geometry,) = [row for row in rows(feed.frames(NOW_S, 0.0).kept) if row[1] == "geometry"]
    assert geometry[2]["x_mm"] == [5.0]  # the array file was edited


def named(board: str, at_s: float) -> Message:
    made = message("status", 0, at_s, board=board)
    return replace(made, board=board)


def test_boards_that_were_taken_away_are_forgotten_while_others_go_on() -> None:
    feed = Feed()
    for n in range(20):
        feed.take(0, named(f"TS{n:04}", NOW_S + 3600.0 * n))
        feed.take(1, named("alone", NOW_S))
        feed.frames(NOW_S + 3600.0 * n, 3600.0 * n)
    feed.take(0, named("TS0020", NOW_S))  # a step of the clock is no absence
    feed.frames(NOW_S, 3600.0 * 19 + 1.0)
    known = {row[2]["board"] for row in rows(feed.history(NOW_S, 3600.0 * 19 + 1.0))}
    assert known == {"TS0019", "TS0020", "alone"}
    assert {board for _, board in feed.boards()} == known
    feed.frames(NOW_S, 1e6)
    assert {board for _, board in feed.boards()} == known  # the daemon is gone, too: what it said last stays


def test_notices_after_the_clock_was_set_back_stand_at_the_present_instant() -> None:
    feed = Feed()
    for at_s in (NOW_S + 3600.0, NOW_S):
        feed.take(0, message("status", 0, at_s))
        feed.frames(at_s, 0.0)
    feed.take(0, Recovered(message("slip", 1, NOW_S + 3590.0)))
    feed.take(0, Lost("scan", "TS1", 3))
    (notice,) = [row for row in rows(feed.frames(NOW_S, 0.0).kept) if row[1] == "notice"]
    assert notice[2]["timestamp"] == NOW_S
