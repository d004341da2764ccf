"""Evaluation of the slip detector on two recordings: false alarms, noise, proposed parameters, latency.

Nothing slips in either, so each alarm is false. Two parameters control the rate of alarms:

* `false_alarms_per_hour` sets the threshold against noise where `least_shear` is given. The quiet hold is run
  with several rates; no more alarms should come than were asked for.
* `least_shear` is the smallest shear reported as slip. The motion is run with increasing values; the result
  replaces the curve in `detect.slip.alarm_rate`, which was measured on the emulator.

The proposal extrapolates the counts of alarms to the wanted rate, and is at least what raised no alarm in
hold and motion. Where that exceeds the shear of a weak slip, no threshold separates this motion from slip:
then the proposal is what raised no alarm, or the strictest named setting, and the wanted rate is marked out
of reach.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.detector import GripParams
from tactiled.detect.grip.slip_detector import GRIP_SETTINGS
from tactiled.detect.grip.thresholds import SlipsByThreshold, SlipThresholds
from tactiled.detect.signal.bridge import GapBridge
from tactiled.detect.slip.detector import SETTINGS, CoherentParams, CoherentSlip
from tactiled.events.types import Event, SlipEvent
from tactiled.tune.hold import Recording, check_motion, noise_sd_v, quiet_part
from tactiled.tune.onset import InjectedOnset, latencies
from tactiled.tune.tail import AlarmTail, fit_tail, median_interval, silent_from

# Short recordings hold few alarms: only rates far above useful ones can be observed.
NOISE_PER_HOUR = (3600.0, 900.0, 225.0, 56.0, 14.0)
# From the value of the fastest setting to beyond the friction limit of any dry skin.
SHEARS = tuple(float(s) for s in np.round(np.geomspace(0.02, 1.0, 18), 3))
# Friction limit at friction coefficient 0.3 on the 2019 array: the weakest slip of a dry skin.
WEAK_SHEAR = 0.57
ONSETS: Mapping[str, InjectedOnset] = {
    "sudden": InjectedOnset(WEAK_SHEAR, 0.1),
    "slow": InjectedOnset(WEAK_SHEAR, 1.0),
}
# Progress steps: two series of alarm counts, the named settings, the proposed one, the contact model, and the
# last step's end.
N_STAGES = 2 + len(SETTINGS) + 1 + 1 + 1

Report = Callable[[str], None]
_Map = Callable[..., Iterable[Any]]  # `map`, or that of an executor


@dataclass(frozen=True)
class AlarmCount:
    """False alarms of a setting in a recording; `gross` counts those reported as gross slip."""

    count: int
    gross: int


@dataclass(frozen=True)
class Latency:
    """Latency from an injected onset to the end of the detecting scan; inf where missed.

    Attributes
    ----------
    median_s, low_s, high_s : float
        Median and its 95 % interval.
    tried, missed : int
    """

    median_s: float
    low_s: float
    high_s: float
    tried: int
    missed: int


@dataclass(frozen=True)
class Setting:
    """Results of one set of parameters on the recordings.

    Attributes
    ----------
    latency : mapping of (recording, onset) to Latency
        ``"quiet"`` or ``"motion"``, and a name of `ONSETS`; absent where no onset could be injected.
    """

    params: CoherentParams
    quiet: AlarmCount
    motion: AlarmCount
    latency: Mapping[tuple[str, str], Latency]


@dataclass(frozen=True, eq=False)
class Study:
    """Results of `study`.

    Attributes
    ----------
    wanted_per_hour : float
    quiet, motion : Recording
    hold_s, motion_s : float
        Evaluated time: the longest contact without its first second; all contact.
    noise_sd_v : (channels,) float64
    noise_alarms, shear_alarms : tuple of int
        Number of alarms at each of `NOISE_PER_HOUR` and `SHEARS`.
    noise_tail, shear_tail : AlarmTail or None
        None where there was no alarm.
    restless : bool
        The hold raises alarms even at the strictest threshold: something moved.
    least_shear : tuple of float
        Extrapolated value for the wanted rate and its 95 % interval; all equal where there was no alarm.
    silent_shear : float or None
        Smallest value from which on hold and motion raised no alarm.
    out_of_reach : bool
        The wanted rate needs more shear than a weak slip has.
    settings : mapping of str to Setting
        Results of the named settings and of "proposed".
    by_probability : mapping of str to AlarmCount
        Slips that the settings of the contact model report in the motion. A tenth of the contact area may
        well slip in an object that stays in the hand: only those reported as gross are false.
    """

    wanted_per_hour: float
    quiet: Recording
    motion: Recording
    hold_s: float
    motion_s: float
    noise_sd_v: FloatArray
    noise_alarms: tuple[int, ...]
    noise_tail: AlarmTail | None
    restless: bool
    shear_alarms: tuple[int, ...]
    shear_tail: AlarmTail | None
    least_shear: tuple[float, float, float]
    silent_shear: float | None
    out_of_reach: bool
    settings: Mapping[str, Setting]
    by_probability: Mapping[str, AlarmCount]

    @property
    def proposed(self) -> Setting:
        """Results of the proposed parameters."""
        return self.settings["proposed"]


def study(
    quiet: Recording,
    motion: Recording,
    wanted_per_hour: float,
    report: Report,
    workers: Executor | None = None,
) -> Study:
    """Evaluate two recordings in which nothing slips.

    Parameters
    ----------
    quiet, motion : Recording
        Recordings of the same array.
    wanted_per_hour : float
        Acceptable rate of false alarms.
    report : callable
        Called with progress messages.
    workers : Executor, optional
        Evaluates several settings at once; the result is the same without.

    Raises
    ------
    DataError
        There is too little contact in one of them.
    """
    each: _Map = map if workers is None else workers.map
    hold, motion_s = quiet_part(quiet), motion.touching_s()
    check_motion(motion)
    report("counting alarms in the hold")
    lowest = SHEARS[0]
    noise_alarms = _counts_by_setting(
        hold,
        [CoherentParams(false_alarms_per_hour=rate, least_shear=lowest) for rate in NOISE_PER_HOUR],
        each,
    )
    restless = noise_alarms[-1] > 0
    strictness = [-float(np.log(rate)) for rate in NOISE_PER_HOUR]
    noise_tail = fit_tail(strictness, noise_alarms, hold.seconds / 3600)
    per_hour = wanted_per_hour
    if noise_tail is not None and not restless:
        per_hour = min(wanted_per_hour, float(f"{np.exp(-noise_tail.needed(wanted_per_hour)[0]):.2g}"))

    report("counting alarms in the motion")
    shears = [CoherentParams(false_alarms_per_hour=per_hour, least_shear=shear) for shear in SHEARS]
    shear_alarms = _counts_by_setting(motion, shears, each)
    shear_tail = fit_tail(SHEARS, shear_alarms, motion_s / 3600)
    in_hold = _counts_by_setting(hold, shears, each) if restless else (0,) * len(SHEARS)
    silent = silent_from(SHEARS, [a + b for a, b in zip(shear_alarms, in_hold, strict=True)])
    needed = (lowest, lowest, lowest) if shear_tail is None else shear_tail.needed(wanted_per_hour)
    least, out_of_reach = _least_shear(needed[0], silent)
    proposed = CoherentParams(false_alarms_per_hour=per_hour, least_shear=least)

    settings = {}
    named = {**SETTINGS, "proposed": proposed}
    report(f"injecting onsets: {next(iter(named))}")
    for name, found in zip(
        named, each(partial(_evaluate, quiet=hold, motion=motion), named.values()), strict=True
    ):
        settings[name] = found
        if len(settings) < len(named):
            report(f"injecting onsets: {list(named)[len(settings)]}")
    report("running the contact model")
    (by_probability,) = each(reports_by_probability, [motion])
    return Study(
        wanted_per_hour=wanted_per_hour,
        quiet=quiet,
        motion=motion,
        hold_s=hold.seconds,
        motion_s=motion_s,
        noise_sd_v=noise_sd_v(hold),
        noise_alarms=noise_alarms,
        noise_tail=noise_tail,
        restless=restless,
        shear_alarms=shear_alarms,
        shear_tail=shear_tail,
        least_shear=needed,
        silent_shear=silent,
        out_of_reach=out_of_reach,
        settings=settings,
        by_probability=by_probability,
    )


def _least_shear(needed: float, silent: float | None) -> tuple[float, bool]:
    """Proposed `least_shear`, and True if the wanted rate is out of reach."""
    silent = np.inf if silent is None else silent
    least = max(needed, silent)
    out_of_reach = least >= WEAK_SHEAR
    if out_of_reach:
        quietest = max(params.shear for params in SETTINGS.values())
        least = silent if silent < WEAK_SHEAR else quietest
    return float(np.ceil(1000 * least) / 1000), out_of_reach


def _counts_by_setting(
    recording: Recording, settings: Sequence[CoherentParams], each: _Map
) -> tuple[int, ...]:
    return tuple(found.count for found in each(partial(false_alarms, recording), settings))


def false_alarms(recording: Recording, params: CoherentParams) -> AlarmCount:
    """Count slips reported in a recording without slip; short gaps are bridged as in the pipeline."""
    detector = GapBridge(CoherentSlip(recording.array, params))
    return _count(event for item in recording.items for event in detector.process(item))


def reports_by_probability(recording: Recording) -> dict[str, AlarmCount]:
    """Count the slips that each setting of the contact model reports in a recording."""
    settings = {
        name: SlipThresholds(params.incipient_p, params.gross_p) for name, params in GRIP_SETTINGS.items()
    }
    slips = SlipsByThreshold(recording.array, GripParams(), settings.values())
    bridged = GapBridge(slips)
    for item in recording.items:
        bridged.process(item)
    return {name: _count(slips.found[at]) for name, at in settings.items()}


def _count(events: Iterable[Event]) -> AlarmCount:
    """Count the slips that begin; one that becomes gross is one slip."""
    onsets = [e for e in events if isinstance(e, SlipEvent) and e.state == "onset" and e.valid]
    gross = sum(event.kind == "gross" for event in onsets)
    return AlarmCount(len(onsets) - gross, gross)


def _evaluate(params: CoherentParams, quiet: Recording, motion: Recording) -> Setting:
    latency = {}
    for where, recording in (("quiet", quiet), ("motion", motion)):
        for name, onset in ONSETS.items():
            found = latencies(recording, params, onset)
            if found:
                missed = int(np.isinf(found).sum())
                latency[where, name] = Latency(*median_interval(found), len(found), missed)
    return Setting(params, false_alarms(quiet, params), false_alarms(motion, params), latency)
