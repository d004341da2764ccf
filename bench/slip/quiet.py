"""False alarms of ``./run bench slip``: hours of what is no slip, with and without being told of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.slip.faults import FAULTS, Stream
from bench.slip.limit import Exceeded, exceeded
from bench.slip.rivals import Knobs, at_noise
from bench.slip.scenes import NOISES_V, RATE_HZ, Announcement, Played, play
from bench.slip.score import tally
from tactiled.array import load_array
from tactiled.detect.base import Detector
from tactiled.detect.signal.bridge import GapBridge
from tactiled.detect.suite import DetectParams
from tactiled.detect.tuning import TunedSuite
from tactiled.emulator.scene.families import HELD_OUT_QUIET, QUIET, Family
from tactiled.events.types import Event
from tactiled.samples.block import Gap, ScanBlock

QUIET_NOISES_V = (0.3e-3, 3e-3)
HELD = "persistent-contact"  # what line faults are done to
# Pulled by somebody else, or at every step: no controller can tell of it beforehand.
OUTSIDE = ("cable-tug", "walking", "hand-over")


@dataclass(frozen=True)
class Alarms:
    """One family at one noise, for one detector.

    Attributes
    ----------
    hours : float
        Of board time.
    apart_hours : float
        The same without what differs from other readings by its noise alone.
    false, gross, on_press, partial : int
        As in `slip_score.Tally`.
    told_false : int
        False alarms that are left when the daemon is told of what the controller itself does.
    """

    hours: float
    apart_hours: float
    false: int
    gross: int
    on_press: int
    partial: int
    told_false: int

    def __add__(self, other: "Alarms") -> "Alarms":
        return Alarms(
            self.hours + other.hours,
            self.apart_hours + other.apart_hours,
            self.false + other.false,
            self.gross + other.gross,
            self.on_press + other.on_press,
            self.partial + other.partial,
            self.told_false + other.told_false,
        )

    def again(self, other: "Alarms") -> "Alarms":
        """The same scenes, read at another noise."""
        return replace(self + other, apart_hours=max(self.apart_hours, other.apart_hours))


Counted = dict[tuple[str, float, str], Alarms]  # by family, noise and detector


@dataclass(frozen=True)
class Quiet:
    """What scenes without slip showed.

    Attributes
    ----------
    counted : Counted
    exceeded : dict of str to Exceeded
        By family.
    motions : dict of str to int
        Scenes that were played, by family; each is read several times, with another noise.
    """

    counted: Counted = field(default_factory=Counted)
    exceeded: dict[str, Exceeded] = field(default_factory=dict)
    motions: dict[str, int] = field(default_factory=dict)

    def add(self, other: "Quiet") -> None:
        """Take in what other scenes showed."""
        for key, alarms in other.counted.items():
            self.counted[key] = self.counted[key] + alarms if key in self.counted else alarms
        for name, one in other.exceeded.items():
            self.exceeded[name] = self.exceeded[name] + one if name in self.exceeded else one
        for name, n in other.motions.items():
            self.motions[name] = self.motions.get(name, 0) + n


def quiet_families() -> dict[str, Family]:
    """Those that detectors were tuned on, and those held out."""
    return QUIET | HELD_OUT_QUIET


def count(family: str, seed: int, readings: int, knobs: Knobs, names: Sequence[str]) -> Quiet:
    """A scene without gross slip, read with so many noises at each of `QUIET_NOISES_V`.

    By settings every time, by other detectors once: theirs are many. A hold is read at every noise of the
    slips, and once with each line fault.
    """
    played = play(family, quiet_families()[family], seed)
    if played.slip is not None:
        return Quiet()
    array, found = load_array("wang2019-3x3"), Quiet()
    found.exceeded[family], found.motions[family] = exceeded(array, played), 1
    for noise_v in NOISES_V if family == HELD else QUIET_NOISES_V:
        known = {name: rival for name, rival in at_noise(knobs, noise_v).items() if name in names}
        for draw in range(readings):
            streams: dict[str, Stream] = {family: [played.read(noise_v, draw)]}
            if family == HELD and draw == 0 and noise_v in QUIET_NOISES_V:
                streams |= _faulty(played, noise_v)
                found.exceeded.update(dict.fromkeys(FAULTS, found.exceeded[family]))
            for stream_name, stream in streams.items():
                for name, rival in known.items():
                    if draw == 0 or rival.is_setting:
                        is_apart = draw == 0 or family == HELD  # nothing moves there: noise is all there is
                        alarms = _alarms(rival.build(array, noise_v), stream, played, is_apart=is_apart)
                        found.add(Quiet({(stream_name, noise_v, name): alarms}))
    return found


def _faulty(played: Played, noise_v: float) -> dict[str, Stream]:
    rng = np.random.default_rng([played.seed, 0, 11])
    return {name: fault(played.counts(noise_v, 0), rng) for name, fault in FAULTS.items()}


def _alarms(detector: Detector, stream: Stream, played: Played, *, is_apart: bool) -> Alarms:
    untold, told = run(detector, stream, played.announcements)
    hours = sum(len(item) for item in stream if isinstance(item, ScanBlock)) / RATE_HZ / 3600
    said = tally(untold, played)
    return Alarms(hours, hours if is_apart else 0.0, *said, tally(told, played).false)


class _Alone(GapBridge):
    """A slip detector as a suite without a texture estimator.

    Attributes
    ----------
    said : list of Event
        Before anybody judged them.
    """

    def __init__(self, detector: Detector) -> None:
        super().__init__(detector)
        self.texture = None
        self.said: list[Event] = []

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        events = super().process(item)
        self.said += events
        return events


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
