"""The slip rule where the paper did not try it: other speeds, any direction, turns, more noise."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bench.paper.play import NONE, FloatArray, Run, play, spread
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.emulator.scene.truth import TrueSlip
from tactiled.events.types import SlipEvent
from tactiled.plain_table import table
from tactiled.progress import ProgressBar

_RIGHT_S = 0.3  # an event so near a true one is said of it: three times the paper's own delay


@dataclass(frozen=True)
class Case:
    """A row: how fast, in how much noise, and whether the slide turns on its way."""

    speed_mm_s: float
    noise_v: float = 0.3e-3
    turns: bool = False

    @property
    def name(self) -> str:
        turn = ", turning" if self.turns else ""
        return f"{self.speed_mm_s:g} mm/s{turn}, {1e3 * self.noise_v:.1f} mV"

    def scene(self, seed: int) -> Scene:
        """Press, hold, slide in any direction, hold; onset and stop anywhere between scans."""
        rng = np.random.default_rng([seed, round(100 * self.speed_mm_s)])
        direction_deg, turned_deg = rng.uniform(-180, 180), rng.choice([-1, 1]) * rng.uniform(40, 180)
        slide = {"kind": "slide", "speed_mm_s": self.speed_mm_s, "direction_deg": float(direction_deg)}
        slides = [slide | {"duration_s": float(rng.uniform(4, 5))}]
        if self.turns:
            turned = {"direction_deg": float(direction_deg + turned_deg)}
            slides.append(slides[0] | turned)
        base = load_scene("flat-experiment")
        phases = [
            {"kind": "press", "duration_s": 3.0, "force_n": 20.0},
            {"kind": "hold", "duration_s": float(rng.uniform(3, 4))},
            *slides,
            {"kind": "hold", "duration_s": 4.0},
        ]
        electronics = base.electronics.model_dump() | {"noise_v": self.noise_v}
        return base.with_changes(name=self.name, phases=phases, electronics=electronics)


CASES = (
    *(Case(speed_mm_s) for speed_mm_s in (0.25, 1.0, 5.0, 20.0)),
    Case(1.0, turns=True),
    *(Case(1.0, noise_v) for noise_v in (0.5e-3, 1.0e-3)),
)
HEAD = (
    "speed, noise", "onsets said / true", "right", "onset error", "stated", "within 2 sigma",
    "direction error (rms)", "stated", "within 2 sigma", "ends right", "end error",
)  # fmt: skip


def off_protocol(progress: ProgressBar, *, seeds: int) -> str:
    """Table of every case."""
    rows = []
    for case in CASES:
        rows.append(score(case.name, [play(case.scene(seed), seed) for seed in range(seeds)]))
        progress.advance(case.name)
    return (
        "The rule off the paper's protocol: a flat plate, 20 N, any direction; right is what is within "
        f"{_RIGHT_S:g} s of the truth, and errors are of those. {seeds} runs a row (seeds 1..{seeds}).\n\n"
        + table(HEAD, rows)
    )


def score(name: str, runs: Sequence[Run]) -> list[str]:
    """Row of a case."""
    n_said = sum(len(run.slips("onset")) for run in runs)
    n_true = sum(len(run.truth.slips) for run in runs)
    onsets = [pair for run in runs for pair in _pairs(run, "onset")]
    ends = [pair for run in runs for pair in _pairs(run, "end")]
    late_s = np.array([said.onset_s - true.onset_s for said, true in onsets])
    late_sd_s = np.array([said.onset_sd_s for said, _ in onsets])
    off_deg = np.array([(said.direction_deg - (true.direction_deg or 0.0)) for said, true in onsets])
    off_deg = (off_deg + 180) % 360 - 180
    off_sd_deg = np.array([said.direction_sd_deg for said, _ in onsets])

    def covered(error: FloatArray, sd: FloatArray) -> str:
        return f"{int((np.abs(error) <= 2 * sd).sum())} of {len(error)}"

    return [
        name,
        f"{n_said} / {n_true}",
        f"{len(onsets)}",
        f"{spread(1e3 * late_s, 0)} ms" if len(onsets) else NONE,
        f"{1e3 * late_sd_s.mean():.0f} ms" if len(onsets) else NONE,
        covered(late_s, late_sd_s),
        f"{np.sqrt((off_deg**2).mean()):.1f} deg" if len(onsets) else NONE,
        f"{off_sd_deg.mean():.1f} deg" if len(onsets) else NONE,
        covered(off_deg, off_sd_deg),
        f"{len(ends)} of {n_true}",
        f"{spread([1e3 * (said.time_s - true.end_s) for said, true in ends], 0)} ms" if ends else NONE,
    ]


def _pairs(run: Run, state: str) -> Iterator[tuple[SlipEvent, TrueSlip]]:
    """Each true slip with the event nearest to its onset or end, if that is right."""
    for true in run.truth.slips:
        at_s = true.onset_s if state == "onset" else true.end_s
        said = min(run.slips(state), key=lambda event: abs(event.time_s - at_s), default=None)
        if said is not None and abs(said.time_s - at_s) <= _RIGHT_S:
            yield said, true
