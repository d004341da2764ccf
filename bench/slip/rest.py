"""Loads below what friction bears that come and rest, or swing: how often they are taken for gross slip.

A load that grows and rests, and one that grows until all slips, show the same shear: it grows and stops. On a
surface of unknown friction only the taxels' shares of it differ (`detect.slip_limit`). Who calls less of the
one gross may call less of the other, so slips that are called so stand beside them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bench.slip.latency import Case
from bench.slip.scenes import NOISES_V, play
from bench.slip.score import known_s, onsets
from tactiled.array import load_array
from tactiled.detect.slip.coherent import SETTINGS, CoherentSlip
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families import HELD_OUT_SLIPPING
from tactiled.emulator.scene.families.parts import (
    any_direction_deg,
    begin,
    disturb,
    friction_n,
    load_phase,
    made,
)
from tactiled.plain_table import table

# Of what friction bears; the last is a rest within a fifth of slipping.
BANDS = {
    "rests at 20 to 40 %": (0.2, 0.4),
    "rests at 40 to 60 %": (0.4, 0.6),
    "rests at 60 to 80 %": (0.6, 0.8),
    "rests at 80 to 90 %": (0.8, 0.9),
    "swings by 30 to 75 %": (0.3, 0.75),
    "comes in steps, to 30 to 75 %": (0.3, 0.75),  # of a kind that nothing was set on
}
_SWINGS, _COMES_IN_STEPS = "swings", "comes in steps"
_STEPS = 4
_NOISES_V = (NOISES_V[0], NOISES_V[2], NOISES_V[3])
_REST_S, _SWING_S = 1.0, 3.0


class Rest(NamedTuple):
    """Whether one load was called gross slip while it grew and rested, or swung."""

    band: str
    noise_v: float
    setting: str
    is_gross: bool


def rests(band: str, seed: int) -> list[Rest]:
    """One load, read at each noise by every setting; none where a rung lets it slip."""

    def family(seed: int) -> Scene:
        rng, scene = begin(band, seed)
        scene["held_object"] = {"mass_kg": 0.3}
        part = rng.uniform(*BANDS[band])
        if band.startswith(_SWINGS):
            scene["phases"] += [
                load_phase(rng, scene, 0.5, 0.05),
                {"kind": "hold", "duration_s": _SWING_S + _REST_S},
            ]
            starts_s = sum(phase["duration_s"] for phase in scene["phases"][:-1])
            pull_n, rate_hz = part * friction_n(scene), rng.uniform(0.5, 2.5)
            towards_deg = any_direction_deg(rng)
            disturb(
                scene,
                "pull_n",
                "sine",
                pull_n,
                starts_s,
                _SWING_S,
                frequency_hz=rate_hz,
                direction_deg=towards_deg,
            )
        elif band.startswith(_COMES_IN_STEPS):
            whole = load_phase(rng, scene, 0.0, part)
            for step in range(1, _STEPS + 1):
                grown = {
                    "duration_s": rng.uniform(0.1, 0.5),
                    "tangential_n": whole["tangential_n"] * step / _STEPS,
                }
                scene["phases"] += [whole | grown, {"kind": "hold", "duration_s": rng.uniform(0.2, 1.0)}]
        else:
            load = load_phase(rng, scene, rng.uniform(0.1, 1.0), part)
            scene["phases"] += [load, {"kind": "hold", "duration_s": _REST_S}]
        return made(scene)

    played = play("rest", family, seed)
    if played.slip is not None:
        return []
    array = load_array("wang2019-3x3")
    said = []
    for noise_v in _NOISES_V:
        for name, params in SETTINGS.items():
            events = onsets(CoherentSlip(array, params).process(played.read(noise_v, 0)))
            is_gross = any(e.kind == "gross" and known_s(e) > played.held_s for e in events)
            said.append(Rest(band, noise_v, name, is_gross))
    return said


def rest_table(found: Sequence[Rest], cases: Sequence[Case]) -> str:
    """Rows: what the load does, and slips; columns: noises and settings."""
    columns = [(noise_v, name) for noise_v in _NOISES_V for name in SETTINGS]
    rows = []
    for band in BANDS:
        cells = []
        for noise_v, name in columns:
            some = [r.is_gross for r in found if (r.band, r.noise_v, r.setting) == (band, noise_v, name)]
            cells.append(f"{sum(some)} of {len(some)}")
        rows.append([band, *cells])
    for what, is_held_out in (("slips", False), ("slips, held out", True)):
        gross, let_go = [], []
        for noise_v, name in columns:
            said = [
                case.found[f"coherent, {name}"]
                for case in cases
                if case.noise_v == noise_v and (case.family in HELD_OUT_SLIPPING) == is_held_out
            ]
            gross.append(f"{sum(np.isfinite(one.gross_s) for one in said)} of {len(said)}")
            let_go.append(f"{sum(one.let_go for one in said)} of {len(said)}")
        rows += [[what, *gross], [f"{what}: said to end, not gross", *let_go]]
    head = ["of what friction bears", *(f"{1e3 * noise_v:g} mV, {name}" for noise_v, name in columns)]
    return table(head, rows)


def tasks(seeds: Sequence[int]) -> list[tuple[str, int]]:
    """Arguments of `rests`."""
    return [(band, seed) for band in BANDS for seed in seeds]
