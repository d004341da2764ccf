"""False alarms of ``tactiled bench slip``: hours of what is no slip, with and without being told of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from tactiled.array import load_array
from tactiled.bench.slip_faults import FAULTS, Stream
from tactiled.bench.slip_rivals import Knobs, rivals
from tactiled.bench.slip_scenes import NOISES_V, RATE_HZ, Announced, Announcement, Played, play
from tactiled.bench.slip_score import tally
from tactiled.detect.base import Detector
from tactiled.detect.bridge import Bridge
from tactiled.emulator.families import QUIET
from tactiled.events.types import Event
from tactiled.samples.block import Gap, ScanBlock

QUIET_NOISES_V = (0.3e-3, 3e-3)
HELD = "persistent-contact"  # what line faults are done to


@runtime_checkable
class Announces(Protocol):
    """A detector that can be told of motion that is not slip."""

    def announce(self, kind: Announced, from_index: int, duration_s: float) -> None:
        """From a scan on, for so long."""
        ...


@dataclass(frozen=True)
class Alarms:
    """One family at one noise, for one detector.

    Attributes
    ----------
    hours : float
        Of board time.
    false, gross, on_press, partial : int
        As in `slip_score.Tally`.
    announced_false : int or None
        False alarms when told of what the controller itself did; None where the detector cannot be told.
    """

    hours: float
    false: int
    gross: int
    on_press: int
    partial: int
    announced_false: int | None

    def __add__(self, other: "Alarms") -> "Alarms":
        told = (self.announced_false, other.announced_false)
        return Alarms(
            self.hours + other.hours,
            self.false + other.false,
            self.gross + other.gross,
            self.on_press + other.on_press,
            self.partial + other.partial,
            None if told[0] is None or told[1] is None else told[0] + told[1],
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
    untold, told = tally(run(detector, stream, ()), played), None
    if isinstance(detector, Announces):
        told = untold.false
        if played.announcements:
            detector.reset()
            told = tally(run(detector, stream, played.announcements), played).false
    hours = sum(len(item) for item in stream if isinstance(item, ScanBlock)) / RATE_HZ / 3600
    return Alarms(hours, *untold, told)


def run(detector: Detector, stream: Stream, announcements: Sequence[Announcement]) -> list[Event]:
    """Events of a stream, short gaps bridged as in a pipeline, each announcement made as it begins."""
    bridged = Bridge(detector)
    events: list[Event] = []
    coming = sorted(announcements, key=lambda a: a.start_s)
    for item in stream:
        if isinstance(item, Gap):
            events += bridged.process(item)
            continue
        rest = item
        while coming and isinstance(detector, Announces):
            index = int(coming[0].start_s * RATE_HZ)
            ahead = index - int(rest.index[0])
            if ahead >= len(rest):
                break
            if ahead > 0:
                events += bridged.process(rest[:ahead])
                rest = rest[ahead:]
            detector.announce(coming[0].kind, index, coming[0].duration_s)
            coming.pop(0)
        events += bridged.process(rest)
    return events
