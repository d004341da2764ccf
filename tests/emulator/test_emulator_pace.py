"""A host that is too slow for its scene: the emulated board misses scan instants, flags them, and goes on."""

import itertools
import os
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.pace import BEHIND_S, HICCUP_S, RECOVERED_S, REPORT_PERIOD_S, OverrunPolicy, SceneClock
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.scene.description import load_scene
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Command, Scan
from tactiled.wire.layout import load_layout

V1 = load_layout("board-v1")
OVERRUN = V1.flag("overrun")
START = Encoder(V1).encode(Command("start", 1))
# Nine taxels under a held object with full contact mechanics: some ten seconds of processor for one of scene.
HEAVY = """\
name = "heavy"
contact = "compliance"
held_object = { mass_kg = 0.2, grip_rate_n_s = 100.0 }
[[phases]]
kind = "press"
duration_s = 60.0
force_n = 10.0
"""


def too_slow_by(part: float, duration_s: float) -> tuple[list[float], list[float]]:
    """Delays of the scans sent and instants of overruns; 10 ms of scene take `part` times as long."""
    pace, now_s, due_s, late_s, overruns_s = OverrunPolicy(), 0.0, 0.0, [], []
    while now_s < duration_s:
        now_s = max(now_s, due_s) + part * 0.01
        late_s.append(now_s - due_s)
        due_s += 0.01
        if pace.is_behind(due_s, now_s):
            overruns_s.append(now_s)
            due_s = now_s + 0.01
    return late_s, overruns_s


@pytest.mark.parametrize("part", [1.2, 2.0, 5.0])
def test_scans_of_a_slow_host_are_sent_soon(part: float) -> None:
    late_s, overruns_s = too_slow_by(part, 20.0)
    assert overruns_s[0] <= part * (HICCUP_S / (part - 1) + 0.02)
    settled = late_s[len(late_s) // 2 :]
    assert max(settled) <= BEHIND_S + 0.01 + part * 0.01


def test_a_host_that_keeps_up_misses_nothing() -> None:
    assert too_slow_by(0.9, 20.0)[1] == []


def test_a_short_delay_is_caught_up_with_and_a_suspended_or_recovered_host_is_not_slow() -> None:
    short = OverrunPolicy()
    assert not short.is_behind(10.0, 10.0)
    assert not short.is_behind(10.01, 10.01 + 0.99 * HICCUP_S)
    away = OverrunPolicy()
    away.is_behind(10.0, 10.0)
    assert away.is_behind(10.0, 11.0)
    assert not away.is_behind(11.1, 11.1 + 0.99 * HICCUP_S)
    slow = OverrunPolicy()
    for k in range(100):  # the delay grows by 10 ms with each scan
        if slow.is_behind(10.0 + k / 100, 10.0 + k / 50):
            break
    now_s = 10.0 + k / 50
    assert slow.is_behind(now_s + 0.01, now_s + 0.01 + 1.01 * BEHIND_S)
    later_s = now_s + RECOVERED_S + 1.0
    assert not slow.is_behind(later_s, later_s + 0.99 * HICCUP_S)


def test_overruns_are_reported_at_once_and_then_at_intervals() -> None:
    pace, reported_s = OverrunPolicy(), []
    assert not pace.is_report_due(0.0)
    for k in range(1200):  # an overrun each 10 ms for 12 s
        pace.overrun(2)
        if pace.is_report_due(k / 100):
            reported_s.append(k / 100)
    assert reported_s == [0.0, REPORT_PERIOD_S, 2 * REPORT_PERIOD_S]
    assert pace.missed == 2400
    assert pace.is_report_due(20.0)
    assert not pace.is_report_due(30.0)  # nothing new


@given(holds=st.lists(st.tuples(st.floats(0.01, 1.0), st.floats(0.01, 1.0)), max_size=9))
def test_true_instants_grow_with_scene_time(holds: list[tuple[float, float]]) -> None:
    clock, scene_s, held_s, asked = SceneClock(100.0), 0.0, 0.0, [0.0]
    for played_s, stood_s in holds:
        asked.append(scene_s + played_s / 2)
        scene_s, held_s = scene_s + played_s, held_s + stood_s
        clock.hold(scene_s, 100.0 + held_s)
    asked.append(scene_s + 1.0)
    true_s = [clock.true_s(instant_s) for instant_s in asked]
    assert true_s == sorted(true_s)
    assert true_s[0] == 100.0
    assert true_s[-1] == pytest.approx(scene_s + 1.0 + 100.0 + held_s)
    assert clock.held_s == pytest.approx(held_s)


def played(scene_name: str, skips_at: dict[int, float]) -> tuple[list[Scan], list[ScanTruth], EmulatedPort]:
    """Two seconds of a board in simulated time; before step k the host is late by `skips_at[k]` seconds."""
    truths: list[ScanTruth] = []
    port = EmulatedPort(load_scene(scene_name), V1, power_up_s=0.0, on_scan=truths.append)
    port.advance(0.1)
    port.receive(START, 0.1)
    decoder, frames, now_s = Decoder(V1), [], 0.1
    for k in range(200):
        now_s += 0.01
        if late_s := skips_at.get(k):
            now_s += late_s
            port.skip_until(now_s)
        while port.next_deadline_s() <= now_s:
            for arrival in port.step(now_s):
                frames += decoder.feed(arrival.data)
    return [frame for frame in frames if isinstance(frame, Scan)], truths, port


@pytest.mark.parametrize("scene", ["prescribed", "grasp"])
def test_skipped_instants_use_up_their_numbers_and_the_next_scan_is_flagged(scene: str) -> None:
    scans, truths, port = played(scene, {50: 0.5, 120: 0.3})
    missing = {t.sequence for t in truths if not t.sent}
    assert 70 <= len(missing) <= 90
    assert port.counts.overruns_of_host == port.counts.overruns == len(missing)
    assert [t.sequence for t in truths] == list(range(len(truths)))
    assert [s.sequence for s in scans] == [t.sequence for t in truths if t.sent][: len(scans)]
    for before, scan in itertools.pairwise(scans):
        lost = scan.sequence - before.sequence - 1
        assert bool(scan.flags & OVERRUN) == (lost > 0)
        ticks_s = ((scan.ticks or 0) - (before.ticks or 0)) * 1e-6
        assert ticks_s == pytest.approx(0.01 * (lost + 1), abs=1e-4)  # the board's clock ran on


def test_a_skip_holds_a_physical_scene_and_not_a_prescribed_one() -> None:
    for scene, stands in (("grasp", True), ("prescribed", False)):
        _, truths, port = played(scene, {50: 0.5})
        missed = [t for t in truths if not t.sent]
        first, last = missed[0], missed[-1]
        if stands:
            assert last.scene_s == pytest.approx(first.scene_s, abs=1e-9)
            assert port.board.scene_start_s == pytest.approx(0.1 + 0.01 * len(missed), abs=1e-4)
        else:
            assert last.scene_s - first.scene_s == pytest.approx(last.began_s - first.began_s)
            assert port.board.scene_start_s == 0.1
        sent = [t.scene_s for t in truths if t.sent]
        assert sent == sorted(sent)


def test_a_held_scene_gives_the_same_counts_later() -> None:
    """The mechanics see no gap: only the instants at which the board reads them are later."""
    held, _, _ = played("grasp", {50: 0.5})
    through, _, _ = played("grasp", {})
    noise = 8  # counts: the noise of a scan goes by its number
    n = min(len(held), len(through))
    for one, other in zip(held[:n], through[:n], strict=True):
        assert abs(one.counts - other.counts).max() <= noise
    assert abs(held[n - 1].counts - held[0].counts).max() > 4 * noise  # and something happened


def test_a_scene_that_is_too_slow_keeps_sending_and_reports_overruns(tmp_path: Path) -> None:
    """The process as a user starts it: the board degrades to some scans a second, flagged."""
    scene, link = tmp_path / "heavy.toml", tmp_path / "board"
    scene.write_text(HEAVY)
    with (tmp_path / "err").open("w+") as err:
        process = subprocess.Popen(
            [sys.executable, "-m", "tactiled", "emulate", "--scene", str(scene), "--link", str(link)],
            stdout=subprocess.PIPE, stderr=err, text=True,
        )  # fmt: skip
        try:
            assert process.stdout is not None
            assert '"ready"' in process.stdout.readline()
            fd = os.open(link, os.O_RDWR | os.O_NOCTTY)
            decoder, frames = Decoder(V1), []
            deadline_s, started = time.monotonic() + 60.0, False
            while time.monotonic() < deadline_s:
                if select.select([fd], [], [], 1.0)[0]:
                    frames += decoder.feed(os.read(fd, 4096))
                if frames and not started:
                    os.write(fd, START)
                    started = True
                scans = [frame for frame in frames if isinstance(frame, Scan)]
                if len(scans) >= 60:
                    break
            os.close(fd)
        finally:
            process.terminate()
            out, _ = process.communicate(timeout=30)
        said = Path(err.name).read_text()
    assert len(scans) >= 60
    assert sum(bool(scan.flags & OVERRUN) for scan in scans) > 20
    assert scans[-1].sequence > 2 * len(scans)
    assert '"what": "overrun"' in out
    assert "overrun: this host is too slow for the scene" in said
    assert said.count("overrun:") <= 2 + (scans[-1].sequence / 100) / REPORT_PERIOD_S
