"""Boards that a host starts with fixed bytes and that never answer."""

import pytest

from tactiled.array import load_array
from tactiled.daemon.board.link import BoardLink
from tactiled.daemon.board.session import SessionParams
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.scene.named import named_scene
from tactiled.events.types import Event, ScanEvent
from tactiled.pipeline import Pipeline
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Command
from tactiled.wire.layout import load_layout

TSF = load_layout("tsf-85")


class Cable:
    """A link and an emulated board, in simulated time."""

    def __init__(self) -> None:
        self.taken: list[ScanTruth] = []
        self.events: list[Event] = []
        self.sent: list[tuple[float, str]] = []
        self.link = BoardLink(Pipeline(TSF, load_array("tsf-85")), SessionParams(), TSF.file.baud)
        self.board = EmulatedPort(named_scene("rest"), TSF, power_up_s=100.0, on_scan=self.taken.append)
        self.now_s = 101.0
        self.board.advance(self.now_s)

    def send(self, commands: list[Command]) -> None:
        for command in commands:
            self.sent.append((self.now_s, command.name))
            self.board.receive(Encoder(TSF).encode(command), self.now_s)

    def run(self, duration_s: float, *, is_deaf: bool = False) -> None:
        """Advance in steps of 10 ms; a deaf host loses what the board sends."""
        for _ in range(round(duration_s / 0.01)):
            self.now_s += 0.01
            for arrival in self.board.advance(self.now_s):
                if not is_deaf:
                    self.send(self.link.received(arrival.data, self.now_s, self.events.append))
            self.send(self.link.watch(self.now_s))


def test_the_board_is_started_once_and_stopped_at_the_end() -> None:
    cable = Cable()
    cable.run(0.5)
    assert cable.taken == []  # it waits for the host
    cable.send(cable.link.opened(cable.now_s))
    cable.run(4.0)
    assert [name for _, name in cable.sent] == ["start"]  # not again while the rate is measured
    assert cable.link.session.state == "running"
    assert 61.0 < cable.link.session.rate_hz < 64.0
    assert sum(isinstance(event, ScanEvent) for event in cable.events) > 100
    cable.send(cable.link.session.stop(cable.now_s))
    n_taken = len(cable.taken)
    cable.run(0.5)
    assert len(cable.taken) == n_taken


def test_a_silent_board_is_started_again() -> None:
    cable = Cable()
    cable.send(cable.link.opened(cable.now_s))
    cable.run(3.0)
    cable.board.inflict("reboot", cable.now_s)
    n_sent = len(cable.sent)
    cable.run(1.0)
    again = [name for _, name in cable.sent[n_sent:]]
    assert set(again) == {"start"}
    assert len(again) <= 2  # the first one may come while the board boots
    assert cable.link.session.state == "running"


def test_a_start_that_is_lost_is_repeated() -> None:
    cable = Cable()
    cable.link.opened(cable.now_s)  # these bytes never reach the board
    cable.run(3.0)
    sent_s, name = cable.sent[0]
    assert name == "start"
    assert sent_s == pytest.approx(101.2, abs=0.02)
    assert cable.link.session.state == "running"
