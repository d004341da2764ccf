"""``./run bench settings``: what a controller asks of slip events, for every setting of both detectors.

Random worlds (`bench.grip.worlds`) and the emulator's families (`bench.slip.scenes`) are asked the same
questions (`score`). Everything is measured on seeds on which nothing was set.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from bench.grip.bench import REPORTED_FROM, draw_reported
from bench.report import BENCH_WORKERS, NONE, BenchOptions, BenchReport, grouped, ratio, seeds_in_words, table
from bench.settings.cases import RANDOM, SCENE_NOISES_V, SCENES, from_scene, from_world
from bench.settings.replay import (
    GROSS_PS,
    INCIPIENT_PS,
    N_BINS,
    CaseEvents,
    Reliability,
    all_thresholds,
    gross_curve_at,
    incipient_curve_at,
    run_settings,
)
from bench.settings.score import (
    AHEAD_S,
    LEADS_TO_S,
    SLOW_S,
    Told,
    directions,
    ended_while_it_slides,
    falling,
    false_onsets_per_hour,
    gross_told,
    latency_s,
    onsets_that_lead,
    rests_called_gross,
    slow_told_ahead,
    told_early,
    usual,
)
from bench.slip.bench import REPORT_SEED
from tactiled.detect.grip import slip_detector
from tactiled.detect.grip.thresholds import SlipThresholds
from tactiled.detect.slip.detector import SETTINGS
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

POSTERIOR_SETTINGS: Mapping[str, SlipThresholds] = {
    f"grip-{name}": at for name, at in slip_detector.SETTINGS.items()
}
"""Settings of the contact model."""

N_WORLDS, N_QUICK_WORLDS = 120, 48
N_SCENES, N_QUICK_SCENES = 3, 1  # seeds of each family
_BATCH = 12
_CLEAR = 0.8  # utilisation below which a contact that holds is far from gross slip


@dataclass(frozen=True)
class SettingsFound:
    """Slip events of all cases."""

    events: Sequence[CaseEvents]

    def groups(self) -> dict[str, list[CaseEvents]]:
        """Cases by kind of world and noise."""
        return grouped(self.events, lambda one: one.case.group)


def told_by_posterior(events: Sequence[CaseEvents], at: SlipThresholds) -> list[Told]:
    """Slip events of the contact model at some thresholds."""
    return [Told(one.case, one.posterior[at]) for one in events]


def told_by_coherent(events: Sequence[CaseEvents], setting: str) -> list[Told]:
    """Slip events of a setting of the detector of docs/slip.md."""
    return [Told(one.case, one.coherent[setting]) for one in events]


def bench_settings(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Rows of both detectors at each setting, and curves over the probabilities of the contact model.

    Quick: 48 random worlds instead of 120, one seed of each family instead of three.
    """
    n_worlds = N_QUICK_WORLDS if options.quick else N_WORLDS
    n_scenes = N_QUICK_SCENES if options.quick else N_SCENES
    seeds = range(REPORTED_FROM, REPORTED_FROM + n_worlds)
    batches = [seeds[start : start + _BATCH] for start in range(0, n_worlds, _BATCH)]
    scenes = list(itertools.product(SCENES, range(REPORT_SEED, REPORT_SEED + n_scenes)))
    progress.begin(len(batches) + len(scenes))
    events: list[CaseEvents] = []
    with executor(BENCH_WORKERS, options.dask) as pool:
        for some in pool.map(_read_worlds, batches):
            events += some
            progress.advance("random worlds")
        for some in pool.map(_read_scene, *zip(*scenes, strict=True)):
            events += some
            progress.advance("families")
    found = SettingsFound(events)

    def draw(path: Path) -> None:
        from bench.settings.picture import draw_settings  # matplotlib is an extra

        draw_settings(path, found)

    return BenchReport(list(_sections(found, n_worlds, n_scenes)), draw=draw)


def _read_worlds(seeds: range) -> list[CaseEvents]:
    thresholds = all_thresholds(list(POSTERIOR_SETTINGS.values()))
    return [run_settings(from_world(world), thresholds) for world in draw_reported(seeds)]


def _read_scene(name: str, seed: int) -> list[CaseEvents]:
    thresholds = all_thresholds(list(POSTERIOR_SETTINGS.values()))
    played = SCENES[name](seed)
    return [run_settings(from_scene(played, noise_v), thresholds) for noise_v in SCENE_NOISES_V]


Question = Callable[[Sequence[Told]], str]


def _direction(kind: str, told: Sequence[Told]) -> str:
    found = directions(usual(told), kind)
    if not len(found.error_deg):
        return NONE
    median = f"{np.median(np.abs(found.error_deg)):.1f} deg"
    return f"{median}, {ratio(found.inside)} inside, {found.n_reversed} reversed"


def _early(told: Sequence[Told]) -> str:
    used = told_early(usual(told))
    n = sum(one.case.slips for one in usual(told))
    return f"{len(used)} of {n}" + (f" (utilisation {np.median(used):.2f})" if used else "")


def _latency(told: Sequence[Told]) -> str:
    found = latency_s(told)
    return f"{1e3 * np.median(found):.0f} ms" if len(found) else NONE


QUESTIONS: Mapping[str, Question] = {
    f"slow slips told {1e3 * AHEAD_S:.0f} ms ahead": lambda told: ratio(slow_told_ahead(usual(told))),
    "onsets an hour where nothing slips": lambda told: f"{false_onsets_per_hour(told):.0f}",
    f"onsets that gross slip follows in {LEADS_TO_S:g} s": lambda told: ratio(onsets_that_lead(usual(told))),
    "gross told in 100 ms": lambda told: ratio(gross_told(usual(told), 0.1)),
    "gross told in 300 ms": lambda told: ratio(gross_told(usual(told), 0.3)),
    "gross told more than 100 ms early": _early,
    "gross told in 300 ms where friction falls": lambda told: ratio(gross_told(falling(told), 0.3)),
    "rests called gross": lambda told: ratio(rests_called_gross(told)),
    f"rests below {_CLEAR:.0%} of the limit called gross": lambda told: ratio(
        rests_called_gross(told, _CLEAR)
    ),
    "ended while it slides": lambda told: ratio(ended_while_it_slides(told)),
    "direction at onset": partial(_direction, "incipient"),
    "direction at gross slip": partial(_direction, "gross"),
    "first event since shear begins, median": _latency,
}


def settings_table(events: Sequence[CaseEvents]) -> str:
    """Answers to all questions, a column for each setting."""
    columns = {
        f"{name}, p {at.incipient:g} / {at.gross:g}": told_by_posterior(events, at)
        for name, at in POSTERIOR_SETTINGS.items()
    }
    columns |= {name: told_by_coherent(events, name) for name in SETTINGS}
    return table(
        {"question": question} | {name: answer(told) for name, told in columns.items()}
        for question, answer in QUESTIONS.items()
    )


def curves_table(events: Sequence[CaseEvents]) -> str:
    """Price and gain over each probability of the contact model, the settings of the other detector below."""
    return table(_curve_rows(events))


def _curve_rows(events: Sequence[CaseEvents]) -> Iterator[dict[str, str]]:
    for p in INCIPIENT_PS:
        yield _curve_row(f"incipient at p {p:g}", told_by_posterior(events, incipient_curve_at(p)))
    for p in GROSS_PS:
        yield _curve_row(f"gross at p {p:g}", told_by_posterior(events, gross_curve_at(p)))
    for name in SETTINGS:
        yield _curve_row(name, told_by_coherent(events, name))


def _curve_row(name: str, told: Sequence[Told]) -> dict[str, str]:
    return {
        "reported": name,
        "onsets an hour where nothing slips": f"{false_onsets_per_hour(told):.0f}",
        "slow slips told ahead": ratio(slow_told_ahead(usual(told))),
        "onsets that gross slip follows": ratio(onsets_that_lead(usual(told))),
        "gross told in 100 ms": ratio(gross_told(usual(told), 0.1)),
        "told early": f"{len(told_early(usual(told)))}",
        "rests called gross": ratio(rests_called_gross(told)),
    }


def reliability_of(events: Sequence[CaseEvents]) -> Reliability:
    """Reliability of the probability that a tenth of the area slips."""
    return sum((one.partial for one in events), start=Reliability())


def _reliability_table(events: Sequence[CaseEvents]) -> str:
    found = reliability_of(events)
    return table(
        {
            "said": f"{found.said_s[k] / found.time_s[k]:.2f}",
            "seen": f"{found.seen_s[k] / found.time_s[k]:.2f}",
            "time (s)": f"{found.time_s[k]:.1f}",
        }
        for k in range(N_BINS)
        if found.time_s[k] > 0
    )


def _sections(found: SettingsFound, n_worlds: int, n_scenes: int) -> Iterator[str]:
    yield (
        f"{n_worlds} random worlds ({seeds_in_words(n_worlds, REPORTED_FROM)}) and {len(SCENES)} families "
        f"({seeds_in_words(n_scenes, REPORT_SEED)}), these at {len(SCENE_NOISES_V)} noises. Slow slips take "
        f"{SLOW_S:g} s or more from a tenth of the area to all of it. Nothing slips where less than a tenth "
        "of the area does, and did so in the last 0.1 s. Ended: an end was reported while all of the contact "
        "slid, and no new slip within 0.1 s. Columns of the contact model name the probabilities at which "
        "incipient and gross slip are reported."
    )
    for group, events in found.groups().items():
        slips = sum(one.case.slips for one in events)
        yield f"{_in_words(group)}: {len(events)} cases, {slips} with gross slip."
        yield settings_table(events)
    for group, events in found.groups().items():
        yield f"{_in_words(group)}: curves over the probabilities."
        yield curves_table(events)
    yield (
        "Probability that a tenth of the area slips, against the truth, in random worlds, where shear over "
        "load grows beyond what was borne before."
    )
    yield _reliability_table(found.groups()[RANDOM])


def _in_words(group: str) -> str:
    return "Random worlds" if group == RANDOM else f"Families at {group}"
