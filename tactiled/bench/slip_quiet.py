"""False alarms of ``tactiled bench slip``: hours of what is no slip, with and without being told of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactiled.array import load_array
from tactiled.bench.slip_faults import FAULTS, Stream
from tactiled.bench.slip_rivals import Knobs, rivals
from tactiled.bench.slip_scenes import NOISES_V, RATE_HZ, Announcement, Played, play
from tactiled.bench.slip_score import tally
from tactiled.detect.base import Detector
from tactiled.detect.bridge import Bridge
from tactiled.detect.suite import DetectParams
from tactiled.detect.tuning import TunedSuite
from tactiled.emulator.families import QUIET
from tactiled.events.types import Event
from tactiled.samples.block import Gap, ScanBlock

QUIET_NOISES_V = (0.3e-3, 3e-3)
HELD = "persistent-contact"  # what line faults are done to


@dataclass(frozen=True)
class Alarms:
    """One family at one noise, for one detector.

    Attributes
    ----------
    hours : float
        Of board time.
    false, gross, on_press, partial : int
        As in `slip_score.Tally`.
    told_false : int
        False alarms that are left when the daemon is told of what the controller itself does.
    """

    hours: float
    false: int
    gross: int
    on_press: int
    partial: int
    told_false: int

    def __add__(self, other: "Alarms") -> "Alarms":
        return Alarms(
            self.hours + other.hours,
            self.false + other.false,
            self.gross + other.gross,
            self.on_press + other.on_press,
            self.partial + other.partial,
            self.told_false + other.told_false,
        )


Counted = dict[tuple[str, float, str], Alarms]  # by family, noise and detector


def count(family: str, seed: int, draws: int, knobs: Knobs, names: Sequence[str]) -> Counted:
    """A scene without gross slip, read `draws` times at each of `QUIET_NOISES_V`.

    A hold, at every noise of the slips, and once with each line fault.
    """
    played = play(family, QUIET[family], seed)
    if played.slip is not None:
        return {}
    array, known, found = load_array("wang2019-3x3"), rivals(knobs), Counted()
    for noise_v in NOISES_V if family == HELD else QUIET_NOISES_V:
        for draw in range(draws):
            counts = played.counts(noise_v, draw)
            streams: dict[str, Stream] = {family: [played.read(noise_v, draw)]}
            if family == HELD and draw == 0 and noise_v in QUIET_NOISES_V:
                rng = np.random.default_rng([seed, draw, 11])
                streams |= {name: fault(counts, rng) for name, fault in FAULTS.items()}
            for stream_name, stream in streams.items():
                for name in names:
                    alarms = _alarms(known[name].build(array, noise_v), stream, played)
                    key = (stream_name, noise_v, name)
                    found[key] = found[key] + alarms if key in found else alarms
    return found


def _alarms(detector: Detector, stream: Stream, played: Played) -> Alarms:
    untold, told = run(detector, stream, played.announcements)
    hours = sum(len(item) for item in stream if isinstance(item, ScanBlock)) / RATE_HZ / 3600
    return Alarms(hours, *tally(untold, played), tally(told, played).false)


class _Alone(Bridge):
    """A slip detector as a suite: without texture, speed is nothing to it.

    Attributes
    ----------
    said : list of Event
        Before anybody judged them.
    """

    def __init__(self, detector: Detector) -> None:
        super().__init__(detector)
        self.said: list[Event] = []

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        events = super().process(item)
        self.said += events
        return events

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Takes no notice."""


def run(
    detector: Detector, stream: Stream, announcements: Sequence[Announcement]
) -> tuple[list[Event], list[Event]]:
    """Events of a stream, short gaps bridged as in a pipeline.

    Returns
    -------
    (untold, told)
        As the detector says them; and as the daemon does that is told of each announcement as it begins.
    """
    alone = _Alone(detector)
    suite = TunedSuite(load_array("wang2019-3x3"), DetectParams(), lambda *_: alone)
    tell = {"inhibit": suite.inhibit, "load-change": suite.expect_load_change}
    told: list[Event] = []
    coming = sorted(announcements, key=lambda a: a.start_s)
    for item in stream:
        rest = item
        while coming and isinstance(rest, ScanBlock):
            ahead = int(coming[0].start_s * RATE_HZ) - int(rest.index[0])
            if ahead >= len(rest):
                break
            if ahead > 0:
                told += suite.process(rest[:ahead])
                rest = rest[ahead:]
            said = coming.pop(0)
            tell[said.kind](said.start_s, said.duration_s)
        told += suite.process(rest)
    return alone.said, told
