"""Loads that come and rest below what friction bears: how often they are taken for gross slip.

A load that grows and rests, and one that grows until all slips, show the same shear: it grows and stops. On a
surface of unknown friction only the taxels' shares of it differ (`detect.slip_limit`).
"""

from collections.abc import Sequence
from typing import NamedTuple

from tactiled.array import load_array
from tactiled.bench.report import table
from tactiled.bench.slip_quiet import QUIET_NOISES_V
from tactiled.bench.slip_scenes import play
from tactiled.bench.slip_score import known_s, onsets
from tactiled.detect.slip_coherent import SETTINGS, CoherentSlip
from tactiled.emulator.families.parts import begin, load_phase, made
from tactiled.emulator.scene import Scene

BANDS = ((0.2, 0.4), (0.4, 0.6), (0.6, 0.8))  # of what friction bears
_REST_S = 1.0


class Rest(NamedTuple):
    """Whether one load was called gross slip while it grew and rested."""

    band: tuple[float, float]
    noise_v: float
    setting: str
    is_gross: bool


def rests(band: tuple[float, float], seed: int) -> list[Rest]:
    """One load, read at `QUIET_NOISES_V` by every setting; none where a rung lets it slip."""

    def family(seed: int) -> Scene:
        rng, scene = begin(f"rest-{band[0]:g}", seed)
        scene["held_object"] = {"mass_kg": 0.3}
        load = load_phase(rng, scene, rng.uniform(0.1, 1.0), rng.uniform(*band))
        scene["phases"] += [load, {"kind": "hold", "duration_s": _REST_S}]
        return made(scene)

    played = play("rest", family, seed)
    if played.slip is not None:
        return []
    array = load_array("wang2019-3x3")
    said = []
    for noise_v in QUIET_NOISES_V:
        for name, params in SETTINGS.items():
            events = onsets(CoherentSlip(array, params).process(played.read(noise_v, 0)))
            is_gross = any(e.kind == "gross" and known_s(e) > played.held_s for e in events)
            said.append(Rest(band, noise_v, name, is_gross))
    return said


def rest_table(found: Sequence[Rest]) -> str:
    """Rows: how large the load is; columns: noises and settings."""
    columns = [(noise_v, name) for noise_v in QUIET_NOISES_V for name in SETTINGS]
    rows = []
    for band in BANDS:
        cells = []
        for noise_v, name in columns:
            some = [r.is_gross for r in found if (r.band, r.noise_v, r.setting) == (band, noise_v, name)]
            cells.append(f"{sum(some)} of {len(some)}")
        rows.append([f"{100 * band[0]:.0f} to {100 * band[1]:.0f} %", *cells])
    head = ["of what friction bears", *(f"{1e3 * noise_v:g} mV, {name}" for noise_v, name in columns)]
    return table(head, rows)


def tasks(seeds: Sequence[int]) -> list[tuple[tuple[float, float], int]]:
    """Arguments of `rests`."""
    return [(band, seed) for band in BANDS for seed in seeds]
