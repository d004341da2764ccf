"""Session alone, against a simulated board, over a line that loses frames at random."""

import itertools
import math

import pytest
from boards import LAYOUT, SimBoard
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from tactiled.array import load_array
from tactiled.daemon.board.asking import MAX_TRIES
from tactiled.daemon.board.diagnosis import LineWatch
from tactiled.daemon.board.session import FOREIGN_S, Session, SessionParams
from tactiled.errors import ConfigError
from tactiled.pipeline import Pipeline
from tactiled.wire.frames import Acknowledge, Command, Frame, Hello
from tactiled.wire.layout import load_layout

ARRAY = "wang2019-3x3"
NOTHING = Pipeline(LAYOUT, load_array(ARRAY)).health()


def fits(hello: Hello) -> str | None:
    if hello.protocol_version != 1:
        return f"speaks protocol version {hello.protocol_version}"
    return None if hello.array_id == ARRAY else f"carries the array {hello.array_id}"


class Bench:
    """A session, a board and the line between them, in simulated time."""

    def __init__(self, params: SessionParams | None = None, board: SimBoard | None = None) -> None:
        self.now_s = 1000.0
        self.line = LineWatch("tactiled-board", 115200)
        self.session = Session(params or SessionParams(), LAYOUT, fits, self.line)
        self.board = board or SimBoard()
        self.down_broken = self.up_broken = False
        self.sent: list[Command] = []
        self._scan_due_s = self.now_s

    def plug(self, board: SimBoard | None = None) -> None:
        self.board = board or self.board
        self.line.reset(self.now_s)
        self.line.count(NOTHING, None, self.now_s)
        self.exchange(self.session.opened(self.now_s))

    def unplug(self) -> None:
        self.session.lost("/dev/ttyX: unplugged")

    def exchange(self, commands: list[Command]) -> None:
        """Commands to the board, its answers back, until both are silent."""
        rounds = 0
        while commands:
            rounds += 1
            assert rounds < 20, "session and board talk without end"
            self.sent += commands
            replies: list[Frame] = []
            for command in commands:
                if not self.down_broken:
                    replies += self.board.answer(command)
            commands = self.hear(replies)

    def hear(self, frames: list[Frame]) -> list[Command]:
        commands: list[Command] = []
        for frame in frames:
            if self.up_broken:
                continue
            self.line.received(b"\0", self.now_s)
            self.line.framed(self.now_s)
            if isinstance(frame, Hello):
                commands += self.session.greeted(frame, self.now_s)
            elif isinstance(frame, Acknowledge):
                commands += self.session.answered(frame, self.now_s)
            else:
                commands += self.session.scanned(self.now_s)
        return commands

    def run(self, duration_s: float) -> None:
        """Let time pass as the daemon does: from one event or deadline to the next."""
        end_s = self.now_s + duration_s
        idle = 0
        while True:
            self._scan_due_s = max(self._scan_due_s, self.now_s)
            next_s = min(self._scan_due_s, self.session.deadline_s, end_s)
            idle = idle + 1 if next_s <= self.now_s else 0
            assert idle < 20, f"deadline stands still at {self.session.deadline_s}"
            self.now_s = max(self.now_s, next_s)
            if self.now_s >= end_s:
                return
            if self.now_s >= self._scan_due_s:
                self._scan_due_s = self.now_s + 1 / self.board.rate_hz
                if self.board.streaming and self.session.state != "no-device":
                    self.exchange(self.hear([self.board.scan(0)]))
            if self.now_s >= self.session.deadline_s:
                self.exchange(self.session.tick(self.now_s))

    def state(self) -> str:
        return self.session.state

    @property
    def reason(self) -> str:
        return self.session.reason(self.now_s)


def test_from_open_to_running() -> None:
    bench = Bench()
    assert bench.state() == "no-device"
    bench.plug()
    assert bench.state() == "syncing"
    bench.run(0.1)
    assert bench.state() == "running"
    assert bench.reason == ""
    assert [c.name for c in bench.sent if c.name != "ping"] == ["identify", "start", "identify"]


def test_a_board_that_streams_already_is_not_started_again() -> None:
    bench = Bench()
    bench.board.streaming = True
    bench.plug()
    bench.run(0.1)
    assert bench.state() == "running"
    assert [c.name for c in bench.sent if c.name != "ping"] == ["identify"]


@pytest.mark.parametrize("streaming", [False, True])
def test_the_configured_rate_is_set_confirmed_and_restored_after_reboot_and_replug(streaming: bool) -> None:
    bench = Bench(SessionParams(rate_hz=200.0))
    bench.board.streaming = streaming
    bench.plug()
    bench.run(0.1)
    assert (bench.state(), bench.board.rate_hz, bench.session.rate_hz) == ("running", 200.0, 200.0)
    bench.board.reboot()
    bench.exchange(bench.hear([bench.board.hello()]))
    bench.run(0.1)
    assert (bench.state(), bench.board.rate_hz) == ("running", 200.0)
    bench.unplug()
    assert bench.state() == "no-device"
    assert "unplugged" in bench.reason
    bench.board.reboot()
    bench.plug()
    bench.run(0.1)
    assert (bench.state(), bench.board.rate_hz) == ("running", 200.0)


def test_silence_is_a_stall_after_50_ms_and_the_board_is_armed_again() -> None:
    bench = Bench()
    bench.plug()
    bench.run(0.1)
    bench.up_broken = True
    last_s = bench.now_s
    while bench.state() == "running":
        bench.run(0.001)
    assert bench.now_s - last_s <= 0.0501 + 0.01
    assert bench.state() == "stalled"
    assert "50 ms" in bench.reason
    bench.board.streaming = False
    bench.up_broken = False
    bench.run(0.3)
    assert bench.state() == "running"


def test_a_slow_board_is_given_five_periods() -> None:
    bench = Bench(board=SimBoard(rate_hz=20.0))
    bench.plug()
    bench.run(1.0)
    assert bench.session.silence_s == pytest.approx(0.25)
    assert bench.state() == "running"


@pytest.mark.parametrize(
    ("board", "words"),
    [
        (SimBoard(array_id="normal-3x3"), "carries the array"),
        (SimBoard(serial="TS0002"), "board TS0002 is plugged in, board TS0001 is configured"),
    ],
)
def test_a_wrong_board_is_refused_by_name_and_a_right_one_accepted_after_it(
    board: SimBoard, words: str
) -> None:
    bench = Bench(SessionParams(board_serial="TS0001", rate_hz=50.0), board)
    bench.plug()
    bench.run(5.0)
    assert bench.state() == "fault"
    assert words in bench.reason
    assert not bench.session.accepted
    assert {c.name for c in board.commands} == {"identify"}
    assert len(board.commands) <= 2 + 5 / FOREIGN_S  # it is asked again, and not pestered
    bench.unplug()
    bench.plug(SimBoard())
    bench.run(0.2)
    assert bench.state() == "running"


def test_a_refused_command_is_logged_and_sent_again() -> None:
    bench = Bench(SessionParams(rate_hz=1000.0))
    bench.board.refuses["set_rate"] = "bad_argument"
    bench.plug()
    bench.run(3.0)
    assert bench.state() == "fault"
    assert bench.reason == "the board refused set_rate to 1000 Hz: bad_argument"
    assert "start" not in {c.name for c in bench.sent}
    assert sum(c.name == "set_rate" for c in bench.sent) <= 4
    bench.board.refuses.clear()
    bench.run(2 * FOREIGN_S)
    assert (bench.state(), bench.reason, bench.board.rate_hz) == ("running", "", 1000.0)


class Rounding(SimBoard):
    """Takes any rate, and makes another of it."""

    def answer(self, command: Command) -> list[Frame]:
        replies = super().answer(command)
        if command.name == "set_rate":
            self.rate_hz = 90.0
        return replies


def test_a_rate_that_the_board_accepts_but_does_not_keep_is_a_fault() -> None:
    bench = Bench(SessionParams(rate_hz=100.5), Rounding())
    bench.plug()
    bench.run(3.0)
    assert bench.state() == "fault"
    assert "100.5 Hz but says 90 Hz" in bench.reason
    assert len(bench.sent) < 20


@pytest.mark.parametrize(
    ("down_broken", "up_broken", "words"),
    [(True, False, "does not answer identify"), (False, True, "no bytes arrive")],
)
def test_a_broken_line_is_diagnosed(down_broken: bool, up_broken: bool, words: str) -> None:
    bench = Bench()
    bench.board.streaming = not up_broken
    bench.down_broken, bench.up_broken = down_broken, up_broken
    bench.plug()
    for _ in range(30):  # scans of a board that was never introduced: frames, but not ours
        bench.run(0.1)
        if not up_broken:
            bench.line.received(b"\0", bench.now_s)
            bench.line.framed(bench.now_s)
    assert bench.state() == "syncing"
    assert words in bench.reason


def test_bytes_without_frames_are_diagnosed() -> None:
    bench = Bench()
    bench.up_broken = True
    bench.plug()
    for _ in range(30):
        bench.run(0.1)
        bench.line.received(b"\0", bench.now_s)
        bench.line.count(NOTHING, None, bench.now_s)
    assert "no frame passes: no frame structure in it: wrong baud rate (115200 configured)" in bench.reason


def test_a_board_that_stays_busy_is_named_and_its_line_is_not_suspected() -> None:
    bench = Bench()
    bench.board.refuses["start"] = "busy"
    bench.plug()
    for _ in range(4 * MAX_TRIES):
        bench.run(0.1)
    assert bench.reason == "the board is busy and puts off start: it is asked again until it is ready"
    assert bench.state() == "syncing"
    assert {command.name for command in bench.sent[1:]} == {"start"}  # it is not asked who it is again
    bench.board.refuses.clear()
    bench.run(1.0)
    assert (bench.state(), bench.reason) == ("running", "")


class Mute(SimBoard):
    """Hears `start` and does not answer it."""

    def answer(self, command: Command) -> list[Frame]:
        return [] if command.name == "start" else super().answer(command)


def test_a_board_that_answers_hello_but_nothing_else_is_named() -> None:
    bench = Bench(board=Mute())
    bench.plug()
    for _ in range(4 * MAX_TRIES):
        bench.run(0.1)
        bench.line.received(b"\0", bench.now_s)  # its hellos
        bench.line.framed(bench.now_s)
    assert "does not answer start: is the line to it broken?" in bench.reason
    assert bench.state() == "syncing"


def pings(bench: Bench) -> list[Command]:
    return [command for command in bench.sent if command.name == "ping"]


def test_a_running_board_is_pinged_about_once_a_second_out_of_step_with_everything() -> None:
    bench = Bench()
    bench.plug()
    sent_s: list[float] = []
    for _ in range(6000):
        before = len(pings(bench))
        bench.run(0.01)
        if len(pings(bench)) > before:
            sent_s.append(bench.session._pinging.due_s)  # noqa: SLF001  the schedule itself
    waits_s = [b - a for a, b in itertools.pairwise(sent_s)]
    assert 55 <= len(sent_s) <= 65
    assert 0.45 < min(waits_s) < max(waits_s) < 1.55
    for period_s in (0.001, 0.01, 0.016, 0.1, 1.0):
        phases = sorted(at_s % period_s / period_s for at_s in sent_s)
        assert max(b - a for a, b in itertools.pairwise([0.0, *phases, 1.0])) < 0.2, period_s
    assert len({command.token for command in bench.sent}) == len(bench.sent)


def test_no_ping_goes_while_a_command_waits_for_its_answer() -> None:
    bench = Bench(SessionParams(rate_hz=50.0))
    bench.plug()
    bench.run(0.1)
    bench.down_broken = True
    bench.board.reboot()  # at a rate that is not the configured one
    bench.exchange(bench.hear([bench.board.hello()]))
    before = len(pings(bench))
    bench.run(5.0)
    assert len(pings(bench)) == before
    assert [command.name for command in bench.sent[-3:]] == ["identify"] * 3
    bench.down_broken = False
    bench.run(3.0)
    assert (bench.state(), bench.board.rate_hz) == ("running", 50.0)
    assert len(pings(bench)) > before


def test_unanswered_pings_delay_no_command() -> None:
    bench = Bench(SessionParams(rate_hz=50.0))
    bench.plug()
    bench.run(0.1)
    bench.board.refuses["ping"] = "busy"
    bench.run(10.0)
    assert (bench.state(), bench.reason) == ("running", "")
    bench.board.reboot()
    bench.exchange(bench.hear([bench.board.hello()]))
    bench.run(0.3)
    assert (bench.state(), bench.board.rate_hz) == ("running", 50.0)


def test_a_board_without_ping_is_pinged_once() -> None:
    bench = Bench()
    bench.board.refuses["ping"] = "unknown_command"
    bench.plug()
    bench.run(10.0)
    assert (bench.state(), len(pings(bench))) == ("running", 1)


def test_leaving_stops_the_board_and_restores_nothing() -> None:
    bench = Bench()
    bench.plug()
    bench.run(0.1)
    commands = bench.session.stop(bench.now_s)
    assert bench.session.is_stopping
    bench.exchange(commands)
    assert not bench.session.is_stopping
    assert not bench.board.streaming
    bench.run(1.0)
    assert not bench.board.streaming
    assert bench.session.deadline_s == math.inf


def test_leaving_sends_nothing_to_a_board_that_is_not_the_configured_one() -> None:
    bench = Bench(SessionParams(board_serial="another"))
    bench.plug()
    bench.run(0.5)
    assert bench.state() == "fault"
    assert bench.session.stop(bench.now_s) == []
    assert not bench.session.is_stopping


def test_the_last_stop_waits_for_its_own_answer_or_the_loss_of_the_port() -> None:
    bench = Bench()
    bench.plug()
    bench.run(0.1)
    (command,) = bench.session.stop(bench.now_s)
    bench.hear([Acknowledge(command.token - 1, "stop", "ok", ticks=0)])
    assert bench.session.is_stopping
    bench.unplug()
    assert not bench.session.is_stopping
    assert not bench.session.stop(bench.now_s)
    assert not bench.session.is_stopping


def test_the_last_stop_is_repeated_until_it_is_answered() -> None:
    bench = Bench()
    bench.plug()
    bench.run(0.1)
    bench.down_broken = True
    bench.exchange(bench.session.stop(bench.now_s))
    bench.run(0.5)
    bench.down_broken, bench.board.refuses = False, {"stop": "busy"}
    bench.run(0.5)
    assert bench.board.streaming
    assert bench.session.is_stopping
    bench.board.refuses = {}
    bench.run(0.5)
    assert not bench.board.streaming
    assert not bench.session.is_stopping
    stops = [command for command in bench.sent if command.name == "stop"]
    assert len(stops) == 6  # every 0.2 s, and the last one is answered
    tokens = [command.token for command in stops]
    assert (
        len(set(tokens[:4])) == 1
    )  # lost, or answered for the first time: the board may have carried it out
    assert len(set(tokens[3:])) == 3  # after "busy", a new one


def test_firmware_without_hello_and_commands_runs_when_scans_come() -> None:
    layout = load_layout("legacy-9")
    session = Session(SessionParams(), layout, fits, LineWatch("legacy-9", 57600))
    assert session.opened(10.0) == []
    assert (session.state, session.deadline_s) == ("syncing", math.inf)
    assert session.scanned(10.1) == []
    assert session.state == "running"
    assert session.tick(session.deadline_s) == []
    assert (session.state, session.rate_hz) == ("stalled", 50.0)
    assert session.tick(session.deadline_s if session.deadline_s < math.inf else 20.0) == []
    session.scanned(20.1)
    assert session.state == "running"


def test_a_rate_for_firmware_that_cannot_set_one_is_a_config_error() -> None:
    with pytest.raises(ConfigError, match=r"session\.rate_hz.*leave rate_hz out"):
        Session(SessionParams(rate_hz=10.0), load_layout("legacy-9"), fits, LineWatch("legacy-9", 57600))


class AnyHistory(RuleBasedStateMachine):
    """Whatever happened before: a good board on a good line ends running, with its settings."""

    @initialize(rate_hz=st.sampled_from([None, 50.0, 200.0]), pinned=st.booleans())
    def set_up(self, rate_hz: float | None, pinned: bool) -> None:
        self.params = SessionParams(rate_hz=rate_hz, board_serial="TS0001" if pinned else None)
        self.good = SimBoard()
        self.bench = Bench(self.params, self.good)
        self.plugged = False

    @precondition(lambda self: not self.plugged)
    @rule(kind=st.sampled_from(["good", "other array", "other version", "other serial"]))
    def plug(self, kind: str) -> None:
        board = self.good
        if kind == "other array":
            board = SimBoard(array_id="normal-3x3")
        elif kind == "other version":
            board = SimBoard()
            board.protocol_version = 2
        elif kind == "other serial":
            board = SimBoard(serial="TS0002")
        self.bench.plug(board)
        self.plugged = True

    @precondition(lambda self: self.plugged)
    @rule()
    def unplug(self) -> None:
        self.bench.unplug()
        self.plugged = False

    @rule(duration_s=st.sampled_from([0.003, 0.03, 0.06, 0.25, 1.5]))
    def wait(self, duration_s: float) -> None:
        self.bench.run(duration_s)

    @rule(down=st.booleans(), up=st.booleans())
    def damage(self, down: bool, up: bool) -> None:
        self.bench.down_broken, self.bench.up_broken = down, up

    @precondition(lambda self: self.plugged)
    @rule(tells=st.booleans())
    def reboot(self, tells: bool) -> None:
        self.bench.board.reboot()
        if tells:
            self.bench.exchange(self.bench.hear([self.bench.board.hello()]))

    @precondition(lambda self: self.plugged)
    @rule(
        name=st.sampled_from(["start", "stop", "set_rate"]), result=st.sampled_from(["busy", "wrong_state"])
    )
    def refuse(self, name: str, result: str) -> None:
        self.bench.board.refuses = {name: result}

    @precondition(lambda self: self.plugged)
    @rule()
    def stop_streaming(self) -> None:
        self.bench.board.streaming = False

    @precondition(lambda self: self.plugged)
    @rule()
    def unasked_hello(self) -> None:
        self.bench.exchange(self.bench.hear([self.bench.board.hello()]))

    @precondition(lambda self: self.plugged)
    @rule(token=st.integers(0, 3), name=st.sampled_from(["start", "stop", "identify", "0x99"]))
    def stray_answer(self, token: int, name: str) -> None:
        self.bench.exchange(self.bench.hear([Acknowledge(token, name, "ok")]))

    @invariant()
    def a_wrong_board_hears_nothing_but_identify(self) -> None:
        board = self.bench.board
        foreign = fits(board.hello()) is not None or self.params.board_serial not in (None, board.serial)
        assert not foreign or {c.name for c in board.commands} <= {"identify"}
        assert not foreign or self.bench.state() != "running"

    @invariant()
    def state_and_reason_agree(self) -> None:
        assert (self.bench.state() == "running") == (self.bench.reason == "")

    def teardown(self) -> None:
        if not hasattr(self, "bench"):
            return
        if self.plugged and self.bench.board is not self.good:
            self.unplug()
        self.bench.down_broken = self.bench.up_broken = False
        self.good.refuses = {}
        if not self.plugged:
            self.bench.plug(self.good)
        self.bench.run(4.0)
        assert (self.bench.state(), self.bench.reason) == ("running", "")
        assert self.good.streaming
        assert self.params.rate_hz in (None, self.good.rate_hz)


AnyHistory.TestCase.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)
TestAnyHistory = AnyHistory.TestCase
