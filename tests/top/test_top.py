"""The view for terminals."""

import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import tracemalloc
from collections.abc import Mapping
from dataclasses import replace
from fcntl import ioctl
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from message_strategies import instances
from messages import CONTACT, SLIP, STATUS, anything
from pages import robot
from patience import PATIENCE_S
from verdicts import AT_S, CASES, Case

from tactiled.array import load_array
from tactiled.client import Lost, Malformed, Message, Recovered, Restarted
from tactiled.events.codec import to_map
from tactiled.events.types import EVENT_TYPES, Event, ForceEvent, InfoEvent, ScanEvent, TextureEvent
from tactiled.resources import shipped_names
from tactiled.top.boards import BoardView, BoardViews
from tactiled.top.draw import draw
from tactiled.top.verdict import verdict

NOW_S = 1000.0


def message(event: Event, seq: int = 0, board: str = "TS1") -> Message:
    data = to_map(event, seq=seq, board=board, unix_offset_s=0.0)
    return Message(event.topic, board, seq, event.time_s, data, 0.0, 0.0, 0.0)


def info(name: str, zero: tuple[float, ...] | None = None) -> Message:
    array = load_array(name)
    zero = tuple(array.zero.tolist()) if zero is None else zero
    return message(
        InfoEvent(
            time_s=NOW_S, board_serial="TS1", firmware_version="1", protocol="board-v1", protocol_version=1,
            array_id=name, channels=array.n_channels, taxels=array.n_taxels, x_mm=tuple(array.x_mm),
            y_mm=tuple(array.y_mm), channel_names=tuple(array.channel_name), rate_hz=100.0,
            volts_per_count=1.0, channel_offset_s=(0.0,) * array.n_channels, tactiled_version="0",
            zero=zero,
        )
    )  # fmt: skip


def scattered(n_taxels: int) -> Message:
    """An array that does not ship, whose taxels all have another x and another y."""
    places = tuple(np.random.default_rng(0).permutation(n_taxels).astype(float).tolist())
    event = InfoEvent(
        time_s=NOW_S, board_serial="TS1", firmware_version="1", protocol="board-v1", protocol_version=1,
        array_id="mine", channels=4 * n_taxels, taxels=n_taxels, x_mm=places, y_mm=places[::-1],
        channel_names=tuple(f"t{k // 4}.R{k % 4}" for k in range(4 * n_taxels)), rate_hz=100.0,
        volts_per_count=1.0, channel_offset_s=(0.0,) * 4 * n_taxels, tactiled_version="0",
        zero=(0.0,) * 4 * n_taxels,
    )  # fmt: skip
    return message(event)


def scan(n_channels: int, time_s: float = NOW_S) -> ScanEvent:
    volts = tuple(np.linspace(0.1, 1.0, n_channels).tolist())
    return ScanEvent(
        time_s=time_s, index=0, volts=volts, valid=(True,) * n_channels, time_sd_s=0.0, age_s=0.0, late=False
    )


def views_of(name: str = "wang2019-3x3", **status: Any) -> BoardViews:
    views = BoardViews()
    views.take(info(name))
    views.take(message(replace(STATUS, **{"time_s": NOW_S, **status})))
    views.take(message(scan(load_array(name).n_channels)))
    return views


@pytest.mark.parametrize(
    ("after_s", "status", "state"),
    [
        (0.05, {}, "FRESH"),
        (0.2, {}, "LATE"),
        (0.31, {}, "STALE"),
        (-1.5, {}, "STALE"),
        (0.05, {"state": "no-device", "valid": False}, "NO BOARD"),
        (0.05, {"state": "stalled", "valid": False}, "STALE"),
        (0.2, {"rate_hz": 10.0}, "FRESH"),
    ],
)
def test_the_lamp_follows_the_instants_in_the_messages(
    after_s: float, status: dict[str, Any], state: str
) -> None:
    board = views_of(**status).boards["TS1"]
    assert board.lamp(NOW_S + after_s).state == state


@pytest.mark.parametrize("name", shipped_names("config/arrays"))
@pytest.mark.parametrize("size", [(80, 24), (200, 60), (40, 10), (40, 24)])
@pytest.mark.parametrize("after_s", [0.05, 9.0])
def test_every_array_fits_every_screen(name: str, size: tuple[int, int], after_s: float) -> None:
    views = views_of(name)
    views.take(message(replace(SLIP, time_s=NOW_S, detected_s=NOW_S)))
    lines = draw(views.boards["TS1"], NOW_S + after_s, *size, "keys")
    assert len(lines) == size[1]
    assert max(line.cell_len for line in lines) <= size[0]
    words = "\n".join(line.plain for line in lines)
    said = " ".join(line.plain[13:].strip() for line in lines[:3])
    assert ("Slipping towards +x +y for 17 min: tighten" in said) == (after_s < 1.0)
    if after_s < 1.0 and size[1] >= 24:
        assert "rate  100.0 Hz" in words
    assert "keys" in words


def test_a_load_that_may_be_hidden_stands_beside_the_contact() -> None:
    for below, is_shown in ((0.0, False), (450.0, True)):
        views = BoardViews()
        views.take(info("normal-4x4"))
        views.take(message(replace(STATUS, time_s=NOW_S, contact="none", hidden_below=below)))
        text = "\n".join(line.plain for line in draw(views.boards["TS1"], NOW_S + 0.05, 80, 24, ""))
        assert ("contact  none, told from 450 " in text) == is_shown


def test_the_largest_array_takes_little_memory_and_leaves_room_for_the_numbers() -> None:
    made = scattered(4096)
    views = BoardViews()
    tracemalloc.start()
    views.take(made)
    views.take(message(replace(STATUS, time_s=NOW_S)))
    views.take(message(scan(4 * 4096)))
    text = "\n".join(line.plain for line in draw(views.boards["TS1"], NOW_S + 0.05, 80, 24, ""))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 50e6
    assert "rate  100.0 Hz" in text


@pytest.mark.parametrize("case", CASES)
def test_one_sentence_says_what_the_contact_does(case: Case) -> None:
    newest: dict[str, Mapping[str, Any]] = {"scan": {"timestamp": AT_S}, **case.messages()}
    board = BoardView("TS1", newest=newest, slip=newest.get("slip"))
    assert verdict(board, AT_S) == (case.level, case.sentence, case.sure)


def test_the_sentence_stands_first_and_what_is_stale_says_so_there() -> None:
    views = views_of(contact="sliding")
    views.take(message(replace(SLIP, time_s=NOW_S, onset_s=NOW_S - 0.27, detected_s=NOW_S)))
    live, stale = (draw(views.boards["TS1"], NOW_S + after_s, 80, 24, "") for after_s in (0.05, 5.0))
    assert live[0].plain.strip() == "● FRESH     Slipping towards +x +y for 0.3 s: tighten"
    assert live[1].plain.strip() == "50 ms  100 % sure"
    assert stale[0].plain.strip() == "■ STALE     no status for 5.0 s: is tactiled running?"


def test_the_sentences_of_other_boards_stand_below_that_of_the_chosen_one() -> None:
    one, *others = (views_of(contact="holding").boards["TS1"] for _ in range(8))
    for n, other in enumerate(others):
        other.name = f"left-{n}"
    lines = draw(one, NOW_S + 0.05, 80, 24, "keys", others=others)
    assert [line.plain.split() for line in lines[3:6]] == [
        [f"left-{n}", "●", "FRESH", "Holding"] for n in range(3)
    ]
    assert (len(lines), max(line.cell_len for line in lines)) == (24, 80)


def test_colours_stand_for_the_same_load_whatever_is_pressed() -> None:
    array = load_array("wang2019-3x3")
    taxel_of = array.channel_taxel

    def colour(share: float) -> Any:
        views = views_of()
        volts = tuple(
            zero + share * array.high * (t == 0) for zero, t in zip(array.zero, taxel_of, strict=True)
        )
        views.take(message(replace(scan(array.n_channels, NOW_S + 0.01), volts=volts)))
        lines = draw(views.boards["TS1"], NOW_S + 0.05, 80, 24, "")
        return {str(span.style) for line in lines[3:12] for span in line.spans if "on rgb" in str(span.style)}

    assert colour(0.0) == colour(0.0002)
    assert colour(0.05) != colour(0.2)


def test_loads_are_relative_to_the_zero_that_the_daemon_has() -> None:
    array, views = load_array("xyz-counts-4x4"), BoardViews()

    def load(zero: tuple[float, ...]) -> float | None:
        views.take(info(array.name, zero))
        views.take(message(replace(scan(array.n_channels), volts=(8100.0,) * array.n_channels)))
        felt = views.boards["TS1"].felt()
        return None if felt is None else float(felt.load.sum())

    assert load(()) is None  # of the first scans, which are not in
    assert load((8000.0,) * array.n_channels) == pytest.approx(1600.0)
    assert load((8100.0,) * array.n_channels) == pytest.approx(0.0)  # after a tare


def test_stale_numbers_are_not_shown() -> None:
    board = views_of().boards["TS1"]
    fresh, stale = (
        "\n".join(line.plain for line in draw(board, NOW_S + after_s, 80, 24, "")) for after_s in (0.05, 5.0)
    )
    load = f"{board.felt().load.sum():.2f} V"  # type: ignore[union-attr]
    assert load in fresh
    assert load not in stale
    assert "STALE" in stale


def test_advice_is_wrapped_where_the_screen_is_narrow() -> None:
    reason = "no such port; there are: " + ", ".join(f"/dev/ttyUSB{n}" for n in range(8))
    status = replace(STATUS, state="no-device", valid=False, reason=reason, time_s=NOW_S)
    views = views_of()
    views.take(message(status))
    lines = [line.plain for line in draw(views.boards["TS1"], NOW_S + 0.05, 80, 24, "keys")]
    assert reason in " ".join(line[13:].strip() for line in lines)
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"calibration": "nominal", "valid": True}, "not calibrated: tactiled calibrate"),
        ({"calibration": "finger-7", "valid": False}, "not valid"),
        ({"calibration": "finger-7", "valid": True}, "12.0 ± 0.5 N, shear 5.0 N"),
        ({"calibration": "finger-7", "valid": True, "saturated": True}, ">= 12.0 ± 0.5 N, shear 5.0 N"),
    ],
)
def test_newtons_are_those_of_a_calibration(fields: dict[str, Any], words: str) -> None:
    sds: dict[str, Any] = {"fx_sd_n": 0.1, "fy_sd_n": 0.1, "fz_sd_n": 0.5}
    views = views_of()
    views.take(message(ForceEvent(time_s=NOW_S, fx_n=3.0, fy_n=4.0, fz_n=12.0, **sds, **fields)))
    text = "\n".join(line.plain for line in draw(views.boards["TS1"], NOW_S + 0.05, 100, 24, ""))
    assert f"force  {words}" in text


def test_a_slip_and_a_contact_whose_ends_were_lost_end_with_the_next_status() -> None:
    views = views_of()
    board = views.boards["TS1"]
    views.take(message(replace(CONTACT, time_s=NOW_S, state="sliding")))
    views.take(message(replace(SLIP, time_s=NOW_S + 0.1, onset_s=NOW_S, detected_s=NOW_S + 0.1)))
    views.take(message(replace(STATUS, time_s=NOW_S + 0.11, contact="none", slipping=False), 1))
    assert board.slip is not None  # the slip was published after this status, and overtook it
    views.take(message(replace(STATUS, time_s=NOW_S + 1.2, contact="sliding", slipping=True), 2))
    assert verdict(board, NOW_S + 1.2).sentence.startswith("Slipping")
    views.take(message(TextureEvent(time_s=NOW_S + 0.2, status="low-snr", answered_s=NOW_S + 0.2)))
    views.take(message(replace(STATUS, time_s=NOW_S + 1.3, contact="none", slipping=False), 3))
    assert verdict(board, NOW_S + 1.3).sentence == "Nothing touches the skin"
    assert "texture" not in board.newest


def of_run(run: int, event: Event, seq: int = 0) -> Message:
    made = message(event, seq)
    return replace(made, data={**made.data, "run": run})


def test_a_restart_of_the_daemon_ends_what_its_last_run_said() -> None:
    views = views_of()
    board = views.boards["TS1"]
    views.take(of_run(0, SLIP))
    views.take(of_run(0, TextureEvent(time_s=NOW_S, status="low-snr", answered_s=NOW_S)))
    assert board.slip is not None
    assert "texture" in board.newest
    views.take(of_run(1, replace(STATUS, time_s=NOW_S)))
    assert board.slip is None
    assert "texture" not in board.newest


def test_control_characters_do_not_reach_the_terminal() -> None:
    board = views_of(warning="\x1b[2J\x1b]0;title\x07\n").boards["TS1"]
    assert all(line.plain.isprintable() for line in draw(board, NOW_S + 0.05, 80, 24, ""))


def test_a_slip_is_listed_at_the_instant_that_its_words_count_from() -> None:
    """It was detected 55 ms after the onset: the line has the time of the detection."""
    views = views_of()
    views.take(message(replace(SLIP, time_s=NOW_S - 0.055, onset_s=NOW_S - 0.055, detected_s=NOW_S)))
    (listed,) = views.boards["TS1"].events
    assert listed.at_s == pytest.approx(NOW_S)
    assert "latency 55 ms" in listed.words


TOPICS = st.sampled_from(list(EVENT_TYPES)) | st.text(max_size=8)


@given(st.lists(st.tuples(TOPICS, anything(st.text()), st.booleans()), max_size=5))
@settings(deadline=None)
def test_any_foreign_map_is_a_counted_line(items: list[tuple[str, Any, bool]]) -> None:
    views = views_of()
    for topic, data, recovered in items:
        made = Message(topic, "TS1", 0, NOW_S, {"v": 1, "data": data}, 0.0, 0.0, 0.0)
        views.take(Recovered(made) if recovered else made)
    views.take(Malformed("2 frames"))
    assert views.unreadable == len(items) + 1
    lines = draw(views.boards["TS1"], NOW_S + 0.05, 80, 24, "keys", views.notice)
    assert f"{len(items) + 1} messages are not as protocols/events.md says" in lines[-2].plain
    assert all(line.plain.isprintable() for line in lines)


@pytest.mark.parametrize("kind", EVENT_TYPES.values(), ids=EVENT_TYPES)
@given(data=st.data())
@settings(deadline=None, max_examples=40)
def test_any_values_that_the_types_allow_can_be_drawn(kind: type[Event], data: st.DataObject) -> None:
    views = views_of()
    views.take(message(data.draw(instances(kind))))
    for board in views.boards.values():
        assert len(draw(board, NOW_S + 0.05, 80, 24, "keys", views.notice)) == 24


def test_losses_restarts_and_recovered_messages_are_listed() -> None:
    views = views_of(contact="none", slipping=False)
    views.take(Recovered(message(SLIP)))
    views.take(Lost("slip", "TS1", 2))
    views.take(Restarted("TS1"))
    texture = TextureEvent(time_s=NOW_S, status="low-snr", answered_s=NOW_S)
    views.take(message(texture))
    words = [event.words for event in views.boards["TS1"].events]
    assert words[:3] == ["no groove estimate: low-snr", "daemon restarted", "2 slip messages lost"]
    assert views.boards["TS1"].slip is None  # recovered: not of now


def test_a_recovered_slip_that_goes_on_is_shown() -> None:
    views = views_of(contact="sliding", slipping=True)
    board = views.boards["TS1"]
    views.take(message(replace(CONTACT, time_s=NOW_S - 0.5, state="holding")))
    slip = replace(SLIP, time_s=NOW_S - 0.1, onset_s=NOW_S - 0.1, detected_s=NOW_S - 0.05)
    views.take(Recovered(message(slip)))
    views.take(Recovered(message(replace(CONTACT, time_s=NOW_S - 0.1, state="sliding"), 1)))
    assert verdict(board, NOW_S).sentence.startswith("Slipping")
    assert board.newest["contact"]["state"] == "sliding"
    views.take(message(replace(slip, time_s=NOW_S + 0.2, state="end"), 2))
    views.take(Recovered(message(replace(slip, time_s=NOW_S + 0.1), 1)))
    assert board.slip is None  # an older one than what is known


@given(st.lists(st.sampled_from([(36, 9), (9, 9), (9, 3), (4, 1)]), min_size=1, max_size=4))
@settings(deadline=None)
def test_an_array_file_that_was_edited_is_drawn_as_it_is_now(arrays: list[tuple[int, int]]) -> None:
    """Its name is the same; `top` goes on while the daemon is started anew."""
    views = BoardViews()
    for run, (channels, taxels) in enumerate(arrays):
        places = [float(k) for k in range(taxels)]
        described = {
            "channels": channels, "taxels": taxels, "x_mm": places, "y_mm": places,
            "channel_names": [f"t{k % taxels}.c" for k in range(channels)], "zero": [0.0] * channels,
            "channel_offset_s": [0.0] * channels,
        }  # fmt: skip
        sent = scattered(1)
        views.take(replace(sent, data={**sent.data, **described, "run": run}))
        views.take(of_run(run, replace(STATUS, time_s=NOW_S)))
        views.take(of_run(run, scan(channels)))
        board = views.boards["TS1"]
        felt = board.felt()
        assert felt is not None
        assert len(felt.load) == taxels
        assert len(draw(board, NOW_S + 0.05, 80, 24, "")) == 24


def test_a_daemon_without_a_board_is_the_same_panel_until_it_has_one() -> None:
    views = BoardViews()
    views.take(message(STATUS, board=""))
    views.take(message(STATUS, 1, board="TS1"))
    views.take(message(STATUS, 2, board=""))
    assert list(views.boards) == ["TS1"]


def test_names_of_a_foreign_publisher_do_not_fill_the_memory() -> None:
    views = BoardViews()
    for k in range(2000):
        views.take(Lost("slip", f"B{k}", 1))
    assert list(views.boards) == [f"B{k}" for k in range(1000, 2000)]


def test_without_a_terminal_it_fails_in_one_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tactiled", "top", f"ipc://{tmp_path}/none.ipc"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.system
def test_on_a_terminal_of_80x24_with_keys(tmp_path: Path) -> None:
    with robot(tmp_path) as live:
        live.run()
        live.plug()
        command = [sys.executable, "-m", "tactiled", "top", live.endpoint]
        master, slave = pty.openpty()
        ioctl(slave, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
        before = termios.tcgetattr(slave)
        with subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave) as child:
            try:
                seen = b""

                def until(words: bytes) -> None:
                    nonlocal seen
                    while words not in seen:
                        readable, _, _ = select.select([master], [], [], PATIENCE_S)
                        assert readable, seen
                        seen += os.read(master, 65536)

                until(b"FRESH")
                os.write(master, b"m")
                until(b"mark: done")
                until(b"mark by tactiled top")
                os.write(master, b"q")
                assert child.wait(PATIENCE_S) == 0
            finally:
                if child.poll() is None:
                    child.send_signal(signal.SIGKILL)
        assert termios.tcgetattr(slave)[3] == before[3]  # echo is on again
        os.close(master)
        os.close(slave)
        assert b"\x1b[2J" in seen
        assert seen.count(b"\x1b[2J") == 1  # cleared once: no flicker
