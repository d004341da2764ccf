"""``./run bench sensors``: slides over ridges and flat surfaces, of sensors of six kinds.

Each recording goes through the detectors as `tactiled detect --sliding --speed V` runs them, with an array
file as a user writes it. Beside it stands the `baseline`, which answers in any case.
"""

import time
from dataclasses import dataclass

import numpy as np

from bench.report import (
    Aim,
    BenchOptions,
    BenchReport,
    Reading,
    aims_table,
    judge,
    never,
    ratio,
    rms,
    table,
)
from bench.sensors.baseline import strongest_line_hz
from bench.sensors.recordings import DURATION_S, FLAT, SENSORS, Recording, Sensor, Surface, make
from bench.sensors.slips import CASES, FIRST_SEED, SlipTrial, run_slips
from tactiled import tomlfile
from tactiled.array import ArrayFile, build
from tactiled.detect.signal.known_sliding import KnownSliding
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.events.types import TextureEvent
from tactiled.progress import ProgressBar
from tactiled.recording.table import to_blocks

SNRS_DB = (10.0, 0.0, -6.0, -10.0, -15.0)
_RIGHT = 0.03  # of the period: right or wrong line, whatever its sigma
_MOST_RMS = 1.5
_MOST_TILT_DEG = 35.0  # what the user says of the ridges


@dataclass(frozen=True)
class Trial:
    """Answers on one recording.

    Attributes
    ----------
    status : str
        Of the last answer; empty for none.
    is_right : bool
        The stated period is that of the ridges: along the motion for "period-only", across them for "ok".
    is_inside : bool
        The interval of the period holds the period of the ridges.
    error_sds : float
        Error of a right answer over its stated standard deviation.
    cost_s : float
        Processor time of one second of recording.
    """

    sensor: str
    surface: Surface
    snr_db: float
    status: str
    is_right: bool
    is_inside: bool
    error_sds: float
    baseline_is_right: bool
    cost_s: float


def run(sensor: Sensor, surface: Surface, snr_db: float, seed: int) -> Trial:
    """Make a recording and analyse it."""
    recording = make(sensor, surface, snr_db, seed)
    array = build(tomlfile.parse(sensor.array, ArrayFile, sensor.name))
    texture = {"speed_mm_s": recording.speed_mm_s, "max_tilt_deg": _MOST_TILT_DEG}
    params = DetectParams.model_validate({"texture": texture})
    suite = build_suite(array, params, sliding=KnownSliding(), topics=("texture",))
    blocks = to_blocks(recording.time_s, recording.readings, None, array.in_range(recording.readings))
    began_s = time.process_time()
    events = [event for item in blocks for event in suite.process(item)]
    cost_s = (time.process_time() - began_s) / DURATION_S
    answers = [e for e in events if isinstance(e, TextureEvent) and e.status in ("ok", "period-only")]
    line_hz = strongest_line_hz(recording.time_s, recording.readings)
    return _judge(sensor, surface, snr_db, recording, answers[-1] if answers else None, line_hz, cost_s)


def _judge(
    sensor: Sensor,
    surface: Surface,
    snr_db: float,
    recording: Recording,
    last: TextureEvent | None,
    line_hz: float,
    cost_s: float,
) -> Trial:
    is_right = is_inside = False
    error_sds = float("nan")
    if last is not None and recording.ripple_hz:
        along_mm = recording.speed_mm_s / recording.ripple_hz
        true_mm = along_mm if last.status == "period-only" else recording.period_mm
        error_mm = last.period_mm - true_mm
        is_right = abs(error_mm) < _RIGHT * true_mm
        error_sds = error_mm / last.period_sd_mm if is_right and last.period_sd_mm > 0 else float("nan")
        is_inside = last.status == "ok" or last.period_min_mm <= recording.period_mm <= last.period_max_mm
    return Trial(
        sensor=sensor.name,
        surface=surface,
        snr_db=snr_db,
        status="" if last is None else last.status,
        is_right=is_right,
        is_inside=is_inside,
        error_sds=error_sds,
        baseline_is_right=abs(line_hz / recording.ripple_hz - 1) < _RIGHT if recording.ripple_hz else False,
        cost_s=cost_s,
    )


def bench_sensors(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Measure every sensor over ridges at each signal-to-noise ratio, and over surfaces without a period."""
    n_ridges, n_flat = (3, 2) if options.quick else (10, 10)
    n_slips = 2 if options.quick else 10
    n_worlds = sum(len(slides) + len(quiet) for _, slides, quiet in CASES)
    progress.begin(len(SENSORS) * (len(SNRS_DB) * n_ridges + len(FLAT) * n_flat) + n_worlds * n_slips)
    trials: list[Trial] = []
    for sensor in SENSORS:
        cases: list[tuple[Surface, float, int]]
        cases = [("ridges", snr_db, seed) for snr_db in SNRS_DB for seed in range(n_ridges)]
        cases += [(surface, 0.0, seed) for surface in FLAT for seed in range(n_flat)]
        for surface, snr_db, seed in cases:
            trials.append(run(sensor, surface, snr_db, seed))
            progress.advance(sensor.name)
    slips: list[SlipTrial] = []
    for skin, slides, quiet in CASES:
        for world in (*slides, *quiet):
            for seed in range(FIRST_SEED, FIRST_SEED + n_slips):
                slips.append(run_slips(skin, world, seed))
                progress.advance(f"{skin.name}, {world}")
    return BenchReport(
        [
            f"Slides of {DURATION_S:g} s over ridges, stamps that jitter by a tenth: recordings whose last "
            "answer is the right line, and in brackets wrong answers; then the strongest line of the summed "
            f"spectrum, which always answers. {n_ridges} seeds.",
            table(_ridge_row(sensor, trials) for sensor in SENSORS),
            f"Answers over surfaces without a period, {n_flat} seeds; processor time of a second.",
            table(_flat_row(sensor, trials) for sensor in SENSORS),
            aims_table(AIMS, {"measured": trials}),
            "Slips that are found without being told, in emulated worlds (`bench/sensors/worlds.py`, seeds "
            f"from {FIRST_SEED}); beside them a threshold on the rate of change. A tug or a jerk "
            "counts from the beginning of its load, whether it slips or not.",
            table(_slip_row(skin.name, world, slips) for skin, a, b in CASES for world in (*a, *b)),
            aims_table(SLIP_AIMS, {"measured": slips}),
        ],
        numbers=[*trials, *slips],
    )


def _slip_row(skin: str, world: str, trials: list[SlipTrial]) -> dict[str, str]:
    mine = [t for t in trials if (t.skin, t.world) == (skin, world)]
    slid = [t for t in mine if t.has_slide]
    row = {"sensor": skin, "world": world, "minutes": f"{sum(t.duration_s for t in mine) / 60:.1f}"}
    for name, found, n_false, delays_s in (
        ("", [t.found for t in slid], sum(t.n_false for t in mine), [t.delay_s for t in slid]),
        (
            "baseline: ",
            [t.baseline_found for t in slid],
            sum(t.baseline_false for t in mine),
            [t.baseline_delay_s for t in slid],
        ),
    ):
        known = [delay for delay in delays_s if np.isfinite(delay)]
        row[f"{name}found"] = ratio(found) if found else "-"
        row[f"{name}false onsets"] = str(n_false)
        row[f"{name}delay"] = f"{np.median(known):.2f} s" if known else "-"
    return row


def _ridge_row(sensor: Sensor, trials: list[Trial]) -> dict[str, str]:
    row = {"sensor": sensor.name}
    for snr_db in SNRS_DB:
        mine = [t for t in _ridges(trials) if t.sensor == sensor.name and t.snr_db == snr_db]
        wrong = sum(bool(t.status) and not t.is_right for t in mine)
        row[f"{snr_db:g} dB"] = f"{ratio(t.is_right for t in mine)} ({wrong})"
        row[f"baseline, {snr_db:g} dB"] = ratio(t.baseline_is_right for t in mine)
    return row


def _flat_row(sensor: Sensor, trials: list[Trial]) -> dict[str, str]:
    mine = [t for t in trials if t.sensor == sensor.name]
    flat = {str(s): ratio(bool(t.status) for t in mine if t.surface == s) for s in FLAT}
    return {"sensor": sensor.name, **flat, "cost": f"{1e3 * np.mean([t.cost_s for t in mine]):.0f} ms/s"}


def _ridges(trials: list[Trial]) -> list[Trial]:
    return [t for t in trials if t.surface == "ridges"]


def _lost(trials: list[Trial]) -> list[bool]:
    return [t.baseline_is_right and not t.is_right for t in _ridges(trials)]


def _wrong(trials: list[Trial]) -> list[bool]:
    return [bool(t.status) and not t.is_right for t in _ridges(trials)]


def _false(trials: list[Trial]) -> list[bool]:
    return [bool(t.status) for t in trials if t.surface != "ridges"]


def _outside(trials: list[Trial]) -> list[bool]:
    return [not t.is_inside for t in _ridges(trials) if t.is_right]


def _errors(trials: list[Trial]) -> Reading:
    known = [t.error_sds for t in _ridges(trials) if np.isfinite(t.error_sds)]
    return judge(f"{rms(known):.2f}", rms(known) <= _MOST_RMS, is_open=not known)


AIMS: tuple[Aim[list[Trial]], ...] = (
    never("right in the baseline, and refused or wrong here", _lost),
    never("wrong answers over ridges", _wrong),
    never("answers over surfaces without a period", _false),
    never("right answers whose interval does not hold the period", _outside),
    Aim("error of the period over its standard deviation, rms", f"at most {_MOST_RMS:g}", _errors),
)


def _slips_lost(trials: list[SlipTrial]) -> list[bool]:
    return [t.baseline_found and not t.found for t in trials if t.has_slide]


def _slips_false(trials: list[SlipTrial]) -> list[bool]:
    return [t.n_false > 0 for t in trials]


SLIP_AIMS: tuple[Aim[list[SlipTrial]], ...] = (
    never("slips that the baseline finds, and tactiled does not", _slips_lost),
    never("recordings with onsets where nothing slides", _slips_false),
)
