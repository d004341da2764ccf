"""The published slip rule beyond the paper's protocol: other speeds, any direction, turns, more noise."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bench.paper.play import ScenePlay, play
from bench.report import NONE, ratio, rms, spread, table
from tactiled.array import FloatArray
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.emulator.scene.truth import TrueSlip
from tactiled.events.types import SlipEvent
from tactiled.progress import ProgressBar

_RIGHT_S = 0.3  # an event within this of a true slip counts as right: three times the paper's own delay


@dataclass(frozen=True)
class SlideConditions:
    """Speed and noise of a slide, and whether its direction changes."""

    speed_mm_s: float
    noise_v: float = 0.3e-3
    turns: bool = False

    @property
    def name(self) -> str:
        """Conditions in words."""
        turn = ", turning" if self.turns else ""
        return f"{self.speed_mm_s:g} mm/s{turn}, {1e3 * self.noise_v:.1f} mV"

    def scene(self, seed: int) -> Scene:
        """Press, hold, slide in any direction, hold; onset and stop anywhere between scans."""
        rng = np.random.default_rng([seed, round(100 * self.speed_mm_s)])
        direction_deg, turned_deg = rng.uniform(-180, 180), rng.choice([-1, 1]) * rng.uniform(40, 180)
        slide = {"kind": "slide", "speed_mm_s": self.speed_mm_s, "direction_deg": float(direction_deg)}
        slides = [slide | {"duration_s": float(rng.uniform(4, 5))}]
        if self.turns:
            slides.append(slides[0] | {"direction_deg": float(direction_deg + turned_deg)})
        base = load_scene("flat-experiment")
        phases = [
            {"kind": "press", "duration_s": 3.0, "force_n": 20.0},
            {"kind": "hold", "duration_s": float(rng.uniform(3, 4))},
            *slides,
            {"kind": "hold", "duration_s": 4.0},
        ]
        electronics = base.electronics.model_dump() | {"noise_v": self.noise_v}
        return base.with_changes(name=self.name, phases=phases, electronics=electronics)


CONDITIONS = (
    *(SlideConditions(speed_mm_s) for speed_mm_s in (0.25, 1.0, 5.0, 20.0)),
    SlideConditions(1.0, turns=True),
    *(SlideConditions(1.0, noise_v) for noise_v in (0.5e-3, 1.0e-3)),
)


def off_protocol(progress: ProgressBar, *, seeds: int) -> str:
    """Table of all `CONDITIONS`."""
    rows = []
    for conditions in CONDITIONS:
        rows.append(row(conditions.name, [play(conditions.scene(seed), seed) for seed in range(seeds)]))
        progress.advance(conditions.name)
    return (
        "The rule off the paper's protocol: a flat plate, 20 N, any direction; right: within "
        f"{_RIGHT_S:g} s of the truth, errors are of those. {seeds} runs a row (seeds 1..{seeds}).\n\n"
        + table(rows)
    )


def row(name: str, plays: Sequence[ScenePlay]) -> dict[str, str]:
    """Row of the table from the plays of one condition."""
    n_true = sum(len(one.truth.slips) for one in plays)
    onsets = [pair for one in plays for pair in _pairs(one, "onset")]
    ends = [pair for one in plays for pair in _pairs(one, "end")]
    late_s = np.array([event.onset_s - true.onset_s for event, true in onsets])
    late_sd_s = np.array([event.onset_sd_s for event, _ in onsets])
    off_deg = np.array([event.direction_deg - (true.direction_deg or 0.0) for event, true in onsets])
    off_deg = (off_deg + 180) % 360 - 180
    off_sd_deg = np.array([event.direction_sd_deg for event, _ in onsets])

    def covered(error: FloatArray, sd: FloatArray) -> str:
        return ratio(np.abs(error) <= 2 * sd)

    return {
        "speed, noise": name,
        "onsets detected / true": f"{sum(len(one.slips('onset')) for one in plays)} / {n_true}",
        "right": f"{len(onsets)}",
        "onset error": f"{spread(1e3 * late_s, 0)} ms" if onsets else NONE,
        "stated sigma": f"{1e3 * late_sd_s.mean():.0f} ms" if onsets else NONE,
        "onset within 2 sigma": covered(late_s, late_sd_s),
        "direction error (rms)": f"{rms(off_deg):.1f} deg" if onsets else NONE,
        "its stated sigma": f"{off_sd_deg.mean():.1f} deg" if onsets else NONE,
        "direction within 2 sigma": covered(off_deg, off_sd_deg),
        "ends right": f"{len(ends)} of {n_true}",
        "end error": f"{spread([1e3 * (end.time_s - true.end_s) for end, true in ends], 0)} ms"
        if ends
        else NONE,
    }


def _pairs(one: ScenePlay, state: str) -> Iterator[tuple[SlipEvent, TrueSlip]]:
    """Each true slip with the event nearest to its onset or end, if that is right."""
    for true in one.truth.slips:
        at_s = true.onset_s if state == "onset" else true.end_s
        nearest = min(one.slips(state), key=lambda event: abs(event.time_s - at_s), default=None)
        if nearest is not None and abs(nearest.time_s - at_s) <= _RIGHT_S:
            yield nearest, true
