"""``./run bench contact``: cost and errors of each contact model of the emulator.

Finite elements of one taxel are the reference (`score`). Beside them stand the findings of Wang 2019 and
ours (`findings`), and the published estimators on scenes that are played by contact models.
"""

import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.contact import score
from bench.contact.findings import N_STEPS, findings_table
from bench.contact.score import GROOVED, NEEDS, ModelScore, reference_ripple, score_model
from bench.paper.bench import compare
from bench.report import NONE, Aim, BenchOptions, BenchReport, Reading, aims_table, at_most, judge, table
from tactiled.emulator.scene.contact import model_name
from tactiled.emulator.scene.description import load_scene, paper_scenes
from tactiled.emulator.simulate import Simulation
from tactiled.progress import ProgressBar
from tactiled.wire.layout import load_layout
from tools.fem.reference import reference_names

Scores = dict[str, ModelScore]  # by contact model
_CORRELATED = 0.95


def bench_contact(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Measure every contact model, and compare with the published findings and estimates.

    Quick: one groove plate instead of all, one seed of the estimators instead of three.
    """
    plates = [name for name in score.GROOVES if name in reference_names("coarse")]
    plates = plates[: 1 if options.quick else None]
    progress.begin(len(score.MODELS) + N_STEPS + len(paper_scenes()))
    scores: Scores = {}
    for name in score.MODELS:
        scores[name] = score_model(name, plates)
        progress.advance(name)
    scenes = {
        name: scene.with_changes(contact="lumped" if name.startswith("flat") else "periodic")
        for name, scene in paper_scenes().items()
    }

    def draw(path: Path) -> None:
        from bench.contact.picture import draw_contact  # matplotlib is an extra

        draw_contact(path, scores, plates)

    return BenchReport(
        [
            "Contact models against finite elements (coarse mesh, flat plates). Cost: processor time of a "
            "simulated second of nine taxels; periodic and compliance over grooves.",
            table(
                {"contact model": s.name, "cost (ms/s)": f"{s.cost_ms:.1f}"} | _errors(s.flat)
                for s in scores.values()
            ),
            "load curve: largest error of the force at an indentation, from 0.1 to 3 N a taxel. left, right: "
            "largest error of the force on an area at any instant at friction 0.3, 0.6 and 0.9, relative to "
            "its force at rest. friction force: largest error at any instant, relative to its limit. gross "
            "slip: error of the travel at which nine tenths slip, relative to that travel. slipping share: "
            "mean error over the knee.",
            "The same over grooves, the onset of sliding included.",
            table(
                {"contact model": name, "plate": _in_words(plate)} | _errors(scores[name].grooved[plate])
                for name in GROOVED
                for plate in plates
            ),
            _cost_of_boards(),
            f"Groove ripple (depth 0.1 mm, friction 0.6, {score.LOAD_N:.2f} N a taxel, {score.AREA} read-out "
            "areas): amplitude of the fundamental; then amplitude and phase against the coarse mesh. "
            "Correlations are those of compliance with the coarse mesh.",
            _ripple_table(scores, plates),
            "Aims, worst case of all plates:",
            aims_table(AIMS, {"measured": scores}),
            findings_table(progress),
            "With contact models (lumped on the flat plate, periodic on grooves):",
            *compare(progress, scenes, seeds=1 if options.quick else 3),
        ],
        draw=draw,
    )


def _in_words(plate: str) -> str:
    """``1.2 mm, 30 deg`` for ``groove-1.2-30``."""
    return plate.removeprefix("groove-").replace("-", " mm, ") + " deg"


def _errors(by_need: dict[str, float]) -> dict[str, str]:
    return {words: f"{100 * by_need[need]:.1f} %" for need, words in NEEDS.items() if need in by_need}


def _ripple_table(scores: Scores, plates: Sequence[str]) -> str:
    solved, rows = scores["compliance"].ripples, []
    for plate in plates:
        coarse = reference_ripple("coarse", plate)
        medium = reference_ripple("medium", plate) if plate in reference_names("medium") else None
        for k, side in enumerate(("left", "right")):
            rows.append(
                {
                    "period, angle": _in_words(plate),
                    "side": side,
                    "coarse mesh": f"{1e3 * abs(coarse.wave_n[k]):.1f} mN",
                    "medium mesh": medium.relative_to(coarse, k) if medium else NONE,
                }
                | {name: scores[name].ripples[plate].relative_to(coarse, k) for name in GROOVED}
                | {
                    "correlation, whole run": f"{solved[plate].correlation[k]:.3f}",
                    "last wave": f"{solved[plate].sliding_correlation[k]:.3f}",
                }
            )
    return table(rows)


def _cost_of_boards() -> str:
    """Cost of the whole emulator: contact, sensor, converter, firmware, line."""
    parts = []
    for scene in (load_scene("demo"), load_scene("grasp")):
        simulation = Simulation(scene, load_layout("board-v1"))
        began = time.process_time()
        deque(simulation, maxlen=0)
        part = (time.process_time() - began) / scene.duration_s
        parts.append(f"{100 * part:.1f} % for `{scene.name}` ({model_name(scene)})")
    return f"The whole emulated board at 100 Hz, of one core: {', '.join(parts)}."


def _ratios(scores: Scores) -> NDArray[np.complex128]:
    """Fundamentals of periodic over those of compliance, from which its tables are solved."""
    solved = scores["compliance"].ripples
    return np.array([scores["periodic"].ripples[plate].wave_n / solved[plate].wave_n for plate in solved])


def _cost(name: str, limit: float, form: str) -> Aim[Scores]:
    words = f"{name}: processor time of a simulated second"
    return at_most(words, limit, " ms", lambda scores: scores[name].cost_ms, form)


def _correlated(words: str, field: str) -> Aim[Scores]:
    def measure(scores: Scores) -> Reading:
        values = np.array([getattr(ripple, field) for ripple in scores["compliance"].ripples.values()])
        above = values > _CORRELATED
        return judge(f"{values.min():.3f} ({above.sum()} of {above.size})", bool(above.all()))

    return Aim(f"compliance: correlation over grooves, {words}", f"above {_CORRELATED:g}", measure)


AIMS: tuple[Aim[Scores], ...] = (
    _cost("lumped", 5, ".1f"),
    at_most(
        "lumped: left, right on flat plates",
        5,
        " %",
        lambda scores: 100 * scores["lumped"].flat["left-right"],
        ".1f",
    ),
    _cost("periodic", 10, ".1f"),
    at_most(
        "periodic: amplitude of the ripple against compliance",
        10,
        " %",
        lambda scores: float(100 * np.abs(np.abs(_ratios(scores)) - 1).max()),
        ".1f",
    ),
    at_most(
        "periodic: phase of the ripple against compliance",
        5,
        " deg",
        lambda scores: float(np.abs(np.angle(_ratios(scores), deg=True)).max()),
        ".1f",
    ),
    _cost("compliance", 2000, ".0f"),
    at_most(
        "compliance: load curve",
        5,
        " %",
        lambda scores: 100 * scores["compliance"].flat["absolute-force"],
        ".1f",
    ),
    at_most(
        "compliance: steps in which the solver did not converge",
        0,
        "",
        lambda scores: sum(ripple.unsolved for ripple in scores["compliance"].ripples.values()),
        "d",
    ),
    _correlated("whole run", "correlation"),
    _correlated("last wave of sliding", "sliding_correlation"),
)
