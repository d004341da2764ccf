"""The board: states, commands, clocks and counters."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tactiled.array import load_array
from tactiled.emulator.board.firmware import BOOT_S, Board
from tactiled.emulator.board.identity import EmulatedBoardParams, identity
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.errors import ConfigError
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Frame, Hello, Scan
from tactiled.wire.layout import Layout, compile_layout, load_layout

V1 = load_layout("board-v1")
LEGACY = load_layout("legacy-9")
ORIGIN_S = 1000.0


class Echo:
    """A source whose counts say the scan, and which keeps the instants it was asked for."""

    reacts = False

    def __init__(self) -> None:
        self.asked: dict[int, NDArray[np.float64]] = {}

    def counts(self, first: int, time_s: NDArray[np.float64]) -> NDArray[np.int64]:
        self.asked |= {first + k: row for k, row in enumerate(time_s)}
        numbers = (first + np.arange(len(time_s), dtype=np.int64)) % 512
        return np.repeat(numbers[:, None], time_s.shape[1], axis=1)


class Bench:
    """A board with a decoder on its line."""

    def __init__(self, layout: Layout = V1, **params: Any) -> None:
        self.source = Echo()
        self.scans: list[ScanTruth] = []
        board = EmulatedBoardParams(**params)
        array = load_array("wang2019-3x3" if layout is V1 else "normal-3x3")
        hello = identity(board, layout, array)
        self.board = Board(layout, hello, board, self.source, power_up_s=ORIGIN_S, on_scan=self.scans.append)
        self._encoder = Encoder(layout)
        self._decoder = Decoder(layout)
        self.ready_s: list[float] = []
        self.hello_s: list[float] = []

    def until(self, after_s: float) -> list[Frame]:
        """Frames up to `after_s` seconds after power-up."""
        frames: list[Frame] = []
        for out in self.board.advance(ORIGIN_S + after_s):
            (frame,) = self._decoder.feed(out.data)
            assert not hasattr(frame, "n_bytes"), "the board sent something corrupt"
            self.ready_s.append(out.ready_s - ORIGIN_S)
            if isinstance(frame, Hello):
                self.hello_s.append(self.ready_s[-1])
            frames.append(frame)
        return frames

    def ask(self, after_s: float, name: str, token: int = 7, rate_hz: float | None = None) -> Acknowledge:
        """Answer to a command; what came before it must have been taken."""
        self.board.receive(self._encoder.encode(Command(name, token, rate_hz)), ORIGIN_S + after_s)
        answers = [f for f in self.until(after_s) if isinstance(f, Acknowledge)]
        assert len(answers) == 1
        return answers[0]


def kinds(frames: list[Frame]) -> list[str]:
    return [type(frame).__name__ for frame in frames]


def scans_of(frames: list[Frame]) -> list[Scan]:
    return [frame for frame in frames if isinstance(frame, Scan)]


def test_hello_comes_after_boot_and_then_each_second_until_start() -> None:
    bench = Bench(board_serial="XY17", rate_hz=50.0)
    bench.board.receive(Encoder(V1).encode(Command("start", 1)), ORIGIN_S + BOOT_S / 2)  # ignored
    assert bench.until(BOOT_S - 1e-6) == []
    hellos = bench.until(3.5)
    assert bench.ready_s == pytest.approx([BOOT_S + k for k in range(4)])
    hello = hellos[0]
    assert isinstance(hello, Hello)
    assert (hello.board_serial, hello.rate_hz, hello.streaming) == ("XY17", 50.0, False)
    assert (hello.array_id, hello.adc_bits, hello.adc_reference_v) == ("wang2019-3x3", 12, 3.0)
    assert hello.channel_offset_s == pytest.approx([2e-4 * c for c in range(36)])
    assert bench.ask(3.6, "start") == Acknowledge(7, "start", "ok", 3600108)  # 30 ppm fast
    assert set(kinds(bench.until(6.0))) == {"Scan"}


def test_start_stop_and_start_again() -> None:
    bench = Bench(drift_ppm=0.0)
    bench.until(0.5)
    bench.ask(1.0, "start", 1)
    first = scans_of(bench.until(1.999))
    assert [s.sequence for s in first] == list(range(99 + 1))
    assert [s.flags for s in first] == [1] + [0] * 99
    assert bench.ask(2.0, "start", 2).result == "ok"  # changes nothing
    assert not scans_of(bench.until(2.006))  # scan 100 began at 2.000 and ends 7 ms later
    assert bench.ask(2.5001, "stop", 3).result == "ok"
    taken = len(bench.scans)
    assert kinds(bench.until(5.0)) == ["Hello", "Hello"]
    assert len(bench.scans) == taken
    bench.ask(5.0, "start", 4)
    again = scans_of(bench.until(5.1))
    assert again[0].sequence == taken
    assert again[0].flags == 1
    assert again[0].ticks == 5_000_000


def test_scene_time_starts_with_the_first_start() -> None:
    bench = Bench()
    bench.ask(2.0, "start", 1)
    bench.ask(3.0, "stop", 2)
    bench.ask(4.0, "start", 3)
    bench.until(4.5)
    assert bench.board.scene_start_s == ORIGIN_S + 2.0
    assert bench.source.asked[0][0] == pytest.approx(0.0, abs=1e-9)
    began_s = [scan.began_s - ORIGIN_S - 2.0 for scan in bench.scans]
    np.testing.assert_allclose([bench.source.asked[s.index][0] for s in bench.scans], began_s, atol=1e-9)


@pytest.mark.parametrize("name", ["start", "identify", "stop"])
def test_commands_are_answered_in_both_states(name: str) -> None:
    bench = Bench()
    bench.until(0.5)
    assert bench.ask(0.6, name, 1).result == "ok"
    bench.ask(0.7, "start", 2)
    assert bench.ask(0.8, name, 3) == Acknowledge(3, name, "ok", 800024)


def test_a_ping_is_answered_after_its_time_on_the_line_with_the_tick_of_that_instant() -> None:
    bench = Bench(drift_ppm=0.0, answer_least_s=1e-4, answer_most_s=1e-3)
    bench.ask(0.7, "start", 1)
    bench.until(0.8)
    bench.ready_s.clear()
    for token in range(50):
        bench.board.receive(Encoder(V1).encode(Command("ping", token)), ORIGIN_S + 1.0 + 0.0103 * token)
    frames = bench.until(2.0)
    answers = [(at, f) for at, f in zip(bench.ready_s, frames, strict=True) if isinstance(f, Acknowledge)]
    took_s = [at - (1.0 + 0.0103 * answer.token) for at, answer in answers]
    assert [answer.token for _, answer in answers] == list(range(50))
    on_the_line_s = 7 * 10 / 115200
    assert min(took_s) >= on_the_line_s + 1e-4 - 1e-9
    assert max(took_s) <= on_the_line_s + 1e-3 + 1e-9
    assert np.std(took_s) > 1e-4
    for at, answer in answers:
        assert answer.ticks is not None
        assert 0 <= at * 1e6 - answer.ticks <= 1


def test_identify_sends_hello_again_also_while_running() -> None:
    bench = Bench()
    bench.ask(0.7, "start", 1)
    bench.until(1.0)
    for _ in range(2):
        bench.board.receive(Encoder(V1).encode(Command("identify", 5)), ORIGIN_S + 1.001)
        frames = bench.until(1.001)
        assert sorted(kinds(frames)) == ["Acknowledge", "Hello"]
        assert next(f for f in frames if isinstance(f, Hello)).streaming


def test_stop_while_idle_changes_nothing() -> None:
    bench = Bench()
    bench.until(0.5)
    for k in range(30):
        bench.ask(0.5 + 0.1 * k, "stop", k)
    bench.until(4.0)
    assert bench.hello_s == pytest.approx([0.05, 1.05, 2.05, 3.05])


def test_a_repeated_token_gets_the_same_answer_and_is_not_carried_out_again() -> None:
    bench = Bench(drift_ppm=0.0)
    bench.ask(0.5, "start", 10)
    assert bench.ask(0.904, "start", 10).result == "ok"
    # A rate set again would restart the schedule: 0.904 lies between two scan instants.
    bench.ask(1.0, "set_rate", 11, rate_hz=50.0)
    assert bench.ask(1.207, "set_rate", 11, rate_hz=50.0).result == "ok"
    assert bench.ask(1.3, "set_rate", 12, rate_hz=1e6).result == "bad_argument"
    assert bench.ask(1.4, "set_rate", 12, rate_hz=1e6).result == "bad_argument"
    bench.until(2.0)
    expected = [*np.arange(0.5, 0.999, 0.01), *np.arange(1.0, 1.999, 0.02)]
    began_s = [scan.began_s - ORIGIN_S for scan in bench.scans]
    np.testing.assert_allclose(began_s, expected[: len(began_s)], atol=1e-9)
    # Only the newest token is remembered: an older one is a new command.
    bench.ask(2.1, "stop", 13)
    bench.ask(2.2, "start", 10)
    assert bench.board.running


@pytest.mark.parametrize(
    ("rate_hz", "step_s", "result"),
    [
        (0.1, 2e-4, "ok"),
        # 85 bytes of ten bits at 115200 baud take 7.38 ms; 95 % of the line gives 128.7 Hz.
        (128.0, 2e-4, "ok"),
        (129.0, 2e-4, "bad_argument"),
        (0.0, 2e-4, "bad_argument"),
        (114.0, 250e-6, "ok"),  # 36 channels take 8.75 ms
        (115.0, 250e-6, "bad_argument"),
    ],
)
def test_rate_is_limited_by_the_line_and_by_sampling(rate_hz: float, step_s: float, result: str) -> None:
    assert Bench(channel_step_s=step_s).ask(0.5, "set_rate", 1, rate_hz).result == result


def test_a_new_rate_takes_effect_at_once_and_is_in_the_hello() -> None:
    bench = Bench(drift_ppm=0.0)
    bench.ask(0.5, "start", 1)
    bench.ask(1.0, "set_rate", 2, 20.0)
    bench.until(2.04)
    times = np.array([scan.began_s for scan in bench.scans]) - ORIGIN_S
    steps = np.diff(times)
    np.testing.assert_allclose(steps[:49], 0.01)
    np.testing.assert_allclose(steps[50:], 0.05)
    assert [s.sequence for s in bench.scans] == list(range(len(bench.scans)))
    bench.board.receive(Encoder(V1).encode(Command("identify", 3)), ORIGIN_S + 2.05)
    assert next(f for f in bench.until(2.05) if isinstance(f, Hello)).rate_hz == 20.0


def test_a_power_up_rate_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ConfigError, match="200 scans a second do not fit 115200 baud"):
        Bench(rate_hz=200.0)


@pytest.mark.parametrize(
    ("params", "finding"),
    [
        ({"channel_step_s": 1e-3}, "channel_step_s: a scan of 0.035 s is longer than a period of 0.01 s"),
        ({"rate_hz": 0.05}, "rate_hz: 0.05 scans a second are less than 0.1"),
        ({"channel_step_s": 2e-3, "rate_hz": 1.0}, "hello.channel_offset_s"),
        ({"adc_reference_v": 100.0}, "hello.adc_reference_v: 100.0 does not fit"),
        ({"board_serial": "TS\u00e9"}, "hello.board_serial: .* is not printable ASCII"),
    ],
)
def test_a_board_that_its_hello_cannot_tell_is_refused_at_once(params: dict[str, Any], finding: str) -> None:
    """Such a port once appeared, and its program ended 50 ms later."""
    with pytest.raises(ConfigError, match=finding):
        Bench(**params)


def test_an_unknown_command_is_refused_and_noise_is_ignored() -> None:
    bench = Bench()
    bench.until(0.5)
    bench.board.receive(b"\x05hello\0\xff\xff\0" + bytes(range(200)), ORIGIN_S + 0.6)
    assert bench.until(0.6) == []
    other = V1.file.model_copy(
        update={
            "messages": [
                m.model_copy(update={"id": 0x7E}) if m.name == "ping" else m for m in V1.file.messages
            ]
        }
    )
    strange = Encoder(compile_layout(other)).encode(Command("ping", 77))
    bench.board.receive(b"\0" + strange, ORIGIN_S + 0.7)
    assert bench.until(0.7) == [Acknowledge(77, "0x7e", "unknown_command", 700021)]


def test_ticks_and_sequence_wrap() -> None:
    bench = Bench(start_ticks=2**32 - 600_000, start_sequence=65530, drift_ppm=0.0)
    bench.ask(0.5, "start")
    scans = scans_of(bench.until(1.0))
    expected_ticks = (2**32 - 100_000 + 10_000 * np.arange(len(scans))) % 2**32
    assert [s.ticks for s in scans] == expected_ticks.tolist()
    assert [s.sequence for s in scans] == ((65530 + np.arange(len(scans))) % 65536).tolist()
    assert [s.index for s in bench.scans] == list(range(len(scans)))
    assert min(expected_ticks) < 10_000
    assert max(expected_ticks) > 2**32 - 20_000


@given(ppm=st.floats(-500, 500), seconds=st.floats(10, 3000))
@settings(max_examples=20, deadline=None)
def test_crystal_drifts_by_its_ppm(ppm: float, seconds: float) -> None:
    bench = Bench(drift_ppm=ppm, rate_hz=0.5)
    bench.ask(1.0, "start")
    scans = scans_of(bench.until(1.0 + seconds))
    truth = bench.scans[: len(scans)]
    for scan, true in zip(scans, truth, strict=True):
        assert scan.ticks is not None
        # Ticks count the crystal since power-up: true seconds times (1 + ppm), floored to 1 us.
        expected = (true.began_s - ORIGIN_S) * (1 + ppm * 1e-6) * 1e6
        assert abs((scan.ticks - expected + 2**31) % 2**32 - 2**31) <= 1.01
    np.testing.assert_allclose(np.diff([t.began_s for t in truth]), 2 / (1 + ppm * 1e-6), rtol=1e-9)


def test_channels_are_sampled_one_after_the_other_on_the_boards_clock() -> None:
    bench = Bench(drift_ppm=5000.0)
    bench.ask(0.5, "start")
    bench.until(1.0)
    skew = bench.source.asked[10] - bench.source.asked[10][0]
    np.testing.assert_allclose(skew, 2e-4 / 1.005 * np.arange(36), atol=1e-12)
    assert bench.ready_s[-1] - (bench.scans[-1].began_s - ORIGIN_S) == pytest.approx(35 * 2e-4 / 1.005)


def test_missed_scans_are_counted_and_flagged() -> None:
    bench = Bench(drift_ppm=0.0)
    bench.ask(0.5, "start")
    bench.until(0.7)
    bench.board.miss_scan(ORIGIN_S + 0.7)
    bench.board.miss_scan(ORIGIN_S + 0.7)
    scans = scans_of(bench.until(0.8))
    steps = np.diff([s.sequence for s in scans])
    missed = [s for s in bench.scans if not s.sent]
    assert len(missed) == 2
    assert [s.sequence for s in scans if s.flags == 2] == [missed[-1].sequence + 1]
    assert sorted(set(steps.tolist())) in ([1], [1, 3])
    assert sorted(s.sequence for s in bench.scans if s.sent)[-len(scans) :] == [s.sequence for s in scans]


def test_reboot_resets_the_board_but_not_the_scene() -> None:
    bench = Bench(boot_count=65535, start_sequence=500, start_ticks=10**6)
    first = bench.until(0.1)[0]
    assert isinstance(first, Hello)
    assert first.boot_count == 65535
    bench.ask(0.5, "start")
    bench.ask(0.6, "set_rate", 8, 50.0)
    taken = len(bench.scans)
    bench.until(0.9)
    bench.board.reboot(ORIGIN_S + 1.0)
    assert not bench.board.running
    (hello,) = bench.until(1.5)
    assert isinstance(hello, Hello)
    assert (hello.boot_count, hello.rate_hz, hello.streaming) == (0, 100.0, False)
    assert hello.ticks == 50_001
    assert bench.ask(2.0, "start").result == "ok"
    scan = scans_of(bench.until(2.1))[0]
    assert (scan.sequence, scan.ticks, scan.flags) == (0, 1_000_030, 1)
    truth = bench.scans[taken:]
    assert [s.index for s in bench.scans] == list(range(len(bench.scans)))
    assert truth[-1].boot == 0
    assert bench.board.scene_start_s == ORIGIN_S + 0.5


def test_a_layout_without_commands_runs_from_boot() -> None:
    bench = Bench(LEGACY)
    scans = scans_of(bench.until(12.0))
    assert len(scans) == 598  # 50 Hz from 50 ms on, the crystal being 30 ppm fast
    assert [s.sequence for s in scans] == (np.arange(598) % 256).tolist()
    assert scans[0].ticks == 50
    assert bench.board.scene_start_s == ORIGIN_S + BOOT_S
    bench.board.receive(b"anything", ORIGIN_S + 12.0)
    bench.board.reboot(ORIGIN_S + 12.5)
    assert scans_of(bench.until(13.0))[0].sequence == 0


@given(st.lists(st.floats(0.0005, 0.4), min_size=1, max_size=30))
@settings(max_examples=20, deadline=None)
def test_any_steps_of_time_give_the_same_frames(steps: list[float]) -> None:
    whole, stepped = Bench(), Bench()
    for bench in (whole, stepped):
        bench.ask(0.5, "start")
    at, frames = 0.5, []
    for step in steps:
        at += step
        frames += stepped.until(at)
    assert frames == whole.until(at)
    assert stepped.scans == whole.scans
    assert stepped.ready_s == whole.ready_s
