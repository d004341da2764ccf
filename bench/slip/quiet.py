"""False alarms of ``./run bench slip``: hours without gross slip, with and without announcements."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import special

from bench.report import grouped
from bench.slip.detectors import Tuning, detectors_at
from bench.slip.faults import FAULTS, Stream
from bench.slip.growth import Exceedances, count_exceedances
from bench.slip.scenes import ALL_QUIET, ARRAY, NOISES_V, RATE_HZ, Announcement, PlayedScene, play
from bench.slip.score import count_alarms
from tactiled.detect.base import Detector
from tactiled.detect.signal.bridge import GapBridge
from tactiled.detect.suite import DetectParams
from tactiled.detect.tuning import TunedSuite
from tactiled.emulator.scene.families import HELD_OUT_QUIET
from tactiled.events.types import Event
from tactiled.samples.block import Gap, ScanBlock

QUIET_NOISES_V = (0.3e-3, 3e-3)
HOLD = "persistent-contact"  # line faults are added to this family
EXTERNAL = ("cable-tug", "walking", "hand-over")  # disturbances that no controller can announce
GROUPS: dict[str, Callable[[str], bool]] = {
    "tuned on": lambda family: family not in HELD_OUT_QUIET,
    "of these, line faults": lambda family: family in FAULTS,
    "held out": lambda family: family in HELD_OUT_QUIET,
}


class QuietReading(NamedTuple):
    """A scene without gross slip, read once by one detector.

    Attributes
    ----------
    family : str
        Or line fault.
    hours : float
        Of board time.
    distinct_hours : float
        The same, or 0 where the reading differs from another by its noise alone.
    n_false, n_gross, n_on_press, n_partial : int
        See `score.AlarmCounts`.
    n_announced_false : int
        False alarms that remain when the motions of gripper and arm are announced.
    """

    family: str
    seed: int
    noise_v: float
    detector: str
    hours: float
    distinct_hours: float
    n_false: int
    n_gross: int
    n_on_press: int
    n_partial: int
    n_announced_false: int


@dataclass(frozen=True)
class QuietScene:
    """Growth of shear in a scene without gross slip, and its readings; none where it slips nevertheless."""

    family: str
    exceedances: Exceedances | None
    readings: Sequence[QuietReading]


def read_quiet(tuning: Tuning, names: tuple[str, ...], n_draws: int, family: str, seed: int) -> QuietScene:
    """One scene, read with `n_draws` noises at each of `QUIET_NOISES_V` by the detectors of these names.

    Settings read every draw, other detectors the first only. A hold is read at every noise of the slips, and
    once with each line fault.
    """
    played = play(family, ALL_QUIET[family], seed)
    if played.slip is not None:
        return QuietScene(family, None, ())
    readings = []
    for noise_v in NOISES_V if family == HOLD else QUIET_NOISES_V:
        for draw in range(n_draws):
            streams: dict[str, Stream] = {family: [played.read(noise_v, draw)]}
            if family == HOLD and draw == 0 and noise_v in QUIET_NOISES_V:
                rng, counts = np.random.default_rng([seed, 0, 11]), played.counts(noise_v, 0)
                streams |= {name: fault(counts, rng) for name, fault in FAULTS.items()}
            # Nothing moves in a hold: its noise is all that can raise an alarm.
            is_distinct = draw == 0 or family == HOLD
            readings += [
                QuietReading(
                    name,
                    seed,
                    noise_v,
                    label,
                    *_alarms(detector.build(ARRAY, noise_v), stream, played, is_distinct),
                )
                for name, stream in streams.items()
                for label, detector in detectors_at(tuning, noise_v, names).items()
                if draw == 0 or detector.is_setting
            ]
    return QuietScene(family, count_exceedances(ARRAY, played), readings)


def _alarms(
    detector: Detector, stream: Stream, played: PlayedScene, is_distinct: bool
) -> tuple[float, float, int, int, int, int, int]:
    unannounced, announced = run_detector(detector, stream, played.announcements)
    hours = sum(len(item) for item in stream if isinstance(item, ScanBlock)) / RATE_HZ / 3600
    counts = count_alarms(unannounced, played)
    return hours, hours * is_distinct, *counts, count_alarms(announced, played).n_false


class _SlipSuite(GapBridge):
    """Suite of one slip detector, without a texture estimator; keeps all events before suppression."""

    def __init__(self, detector: Detector) -> None:
        super().__init__(detector)
        self.texture = None
        self.events: list[Event] = []

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        events = super().process(item)
        self.events += events
        return events


def run_detector(
    detector: Detector, stream: Stream, announcements: Sequence[Announcement]
) -> tuple[list[Event], list[Event]]:
    """Events of a stream, short gaps bridged as in a pipeline.

    Returns
    -------
    (unannounced, announced)
        As the detector reports them; and as the daemon does, when each announcement comes as its motion
        begins.
    """
    inner = _SlipSuite(detector)
    suite = TunedSuite(ARRAY, DetectParams(), lambda *_: inner)
    announce = {"inhibit": suite.inhibit, "load-change": suite.expect_load_change}
    announced: list[Event] = []
    coming = sorted(announcements, key=lambda a: a.start_s)
    for item in stream:
        rest = item
        while coming and isinstance(rest, ScanBlock):
            ahead = int(coming[0].start_s * RATE_HZ) - int(rest.index[0])
            if ahead >= len(rest):
                break
            if ahead > 0:
                announced += suite.process(rest[:ahead])
                rest = rest[ahead:]
            motion = coming.pop(0)
            announce[motion.kind](motion.start_s, motion.duration_s)
        announced += suite.process(rest)
    return inner.events, announced


def family_exceedances(scenes: Iterable[QuietScene]) -> dict[str, Exceedances]:
    """Exceedances by family; line faults have those of the hold."""
    found: dict[str, Exceedances] = {}
    for scene in scenes:
        for name in (scene.family, *(FAULTS if scene.family == HOLD else ())):
            if scene.exceedances is not None:
                found[name] = found[name] + scene.exceedances if name in found else scene.exceedances
    return found


def distinct_hours(readings: Iterable[QuietReading]) -> float:
    """Hours of distinct motion: a motion is the same at every noise."""
    at_noise = grouped(readings, lambda reading: reading.noise_v).values()
    return max(sum(reading.distinct_hours for reading in some) for some in at_noise)


class AlarmRate(NamedTuple):
    """False alarms an hour with the 95 % interval."""

    per_hour: float
    low: float
    high: float

    def __str__(self) -> str:
        mean, low, high = (f"{value:.2f}" if value < 10 else f"{value:.0f}" for value in self)
        return f"{mean} ({low}..{high})"


def alarm_rate(
    readings: Iterable[QuietReading], *, is_announced: bool = False, with_external: bool = True
) -> AlarmRate:
    """False alarms an hour of one detector, the mean of families of equal weight.

    The interval is that of Fay and Feuer (Statistics in Medicine 16, 1997, 791) for weighted sums of Poisson
    counts; for one family it is the exact one. A motion counts once, however often it is read: more readings
    do not show how other motions would do.

    Parameters
    ----------
    is_announced : bool
        The motions of gripper and arm are announced.
    with_external : bool
        Include the families that no controller can announce (`EXTERNAL`).
    """
    mine = [one for one in readings if with_external or one.family not in EXTERNAL]
    families = list(grouped(mine, lambda one: one.family).values())
    if not families:
        return AlarmRate(np.nan, np.nan, np.nan)
    per_hour = np.array(
        [
            sum(one.n_announced_false if is_announced else one.n_false for one in some)
            / sum(one.hours for one in some)
            for some in families
        ]
    )
    distinct = np.array([distinct_hours(some) for some in families])
    weight = 1 / (len(families) * distinct)
    mean, most = float(per_hour.mean()), float(weight.max())
    variance = float((weight**2 * per_hour * distinct).sum())
    low = variance / mean * special.gammaincinv(mean**2 / variance, 0.025) if mean else 0.0
    wider = variance + most**2
    high = wider / (mean + most) * special.gammaincinv((mean + most) ** 2 / wider, 0.975)
    return AlarmRate(mean, float(low), float(high))
