"""Table 2 of the paper on scenes that obey physics: the paper, its procedure here, and the joint fit.

Each plate of the experiment protocol is played by the `periodic` rung through firmware, line, decoder and
clock fit. The joint fit sees the very windows of the procedure (10 s each, from 1 s after the slip was
detected), and windows of 2 s of the same slide, 0.8 to 2.2 periods; both are told the speed, as the procedure
must be. Online it follows the slip detector, and answers when its preset lets it.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from bench.paper.bench import PUBLISHED
from bench.paper.play import NONE, Run, play, spread
from bench.texture.answers import joint_fit
from bench.texture.bound import FloatArray
from bench.texture.online import answers
from bench.texture.signal import RATE_HZ
from tactiled.array import Array, load_array
from tactiled.detect.grooves.estimator import PRESETS, JointParams, Preset
from tactiled.detect.wang2019.grooves import SlidingMotion
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.scene.description import paper_scenes
from tactiled.events.types import SlipEvent, TextureEvent
from tactiled.plain_table import table

Plate = tuple[float, float]
PLATES: tuple[Plate, ...] = tuple(PUBLISHED)
WINDOWS_S = (10.0, 2.0)
SPEED_MM_S = 1.0  # of the protocol
SETTLE_S = 1.0  # as the procedure has it
_LONGEST_S = 12.0  # after the onset, in which an answer must come


@dataclass(frozen=True)
class Answered:
    """What one way of estimating said of one plate.

    Attributes
    ----------
    windows : int
        Full windows that there were.
    said : list of (period_mm, angle_deg)
        One for each window that was answered.
    """

    plate: Plate
    method: str
    windows: int
    said: list[tuple[float, float]]

    def with_more(self, other: "Answered") -> "Answered":
        """The windows of both."""
        return replace(self, windows=self.windows + other.windows, said=[*self.said, *other.said])

    def errors(self) -> tuple[float, float]:
        """Root mean square of period (mm) and angle (degrees); NaN where nothing was said."""
        if not self.said:
            return float("nan"), float("nan")
        off = np.array(self.said) - np.array(self.plate, dtype=np.float64)
        period_mm, angle_deg = np.sqrt((off**2).mean(axis=0))
        return float(period_mm), float(angle_deg)


@dataclass(frozen=True)
class First:
    """The first answer of the online estimator on one slide; infinitely late where there was none.

    Attributes
    ----------
    after_s : float
        From the true onset of slip to the scan that completed the answer.
    """

    plate: Plate
    preset: Preset
    seed: int
    after_s: float = float("inf")
    period_mm: float = float("nan")
    angle_deg: float = float("nan")


def run_table2(
    advance: Callable[[float], None], pool: Executor, *, n_seeds: int, plates: Sequence[Plate] = PLATES
) -> tuple[list[Answered], list[First]]:
    """Every plate with seeds 0 to n_seeds - 1."""
    slides = [(plate, seed) for plate in plates for seed in range(n_seeds)]
    found: dict[tuple[Plate, str], Answered] = {}
    firsts: list[First] = []
    for (plate, _), (answered, first) in zip(slides, pool.map(_played, slides), strict=True):
        for one in answered:
            so_far = found.setdefault((plate, one.method), Answered(plate, one.method, 0, []))
            found[plate, one.method] = so_far.with_more(one)
        firsts += first
        advance(1 / len(slides))
    return list(found.values()), firsts


def _played(slide: tuple[Plate, int]) -> tuple[list[Answered], list[First]]:
    """One slide over a plate, in whichever process."""
    plate, seed = slide
    scene = paper_scenes()[f"experiment-d{plate[0]:.2f}-a{plate[1]}"].with_changes(contact="periodic")
    run = play(scene, seed)
    textures = [e for e in run.events if isinstance(e, TextureEvent) and e.status != "no-slip"]
    agreed = [(e.period_mm, e.angle_deg) for e in textures if e.status == "ok"]
    found = [Answered(plate, "procedure", len(textures), agreed)]
    for window_s in WINDOWS_S:
        windows = _joint(run, window_s)
        said = [answer for answer in windows if answer is not None]
        found.append(Answered(plate, f"joint, {window_s:g} s", len(windows), said))
    return found, [first_answer(run, First(plate, preset, seed)) for preset in PRESETS]


def true_onset(run: Run) -> SlipEvent:
    """The onset that the slip detector meant by the true one: it may cry before, on the press."""
    return min(run.slips("onset"), key=lambda onset: abs(onset.onset_s - run.truth.slips[0].onset_s))


def _joint(run: Run, window_s: float) -> list[tuple[float, float] | None]:
    """Period and angle of window after window of a slide; None where the fit refuses."""
    onset, end_s = true_onset(run), run.truth.slips[0].end_s
    begin = int(np.searchsorted(run.time_s, onset.detected_s + SETTLE_S))
    end = int(np.searchsorted(run.time_s, end_s))
    array = load_array("wang2019-3x3")
    n = round(window_s * RATE_HZ)
    motion = SlidingMotion(SPEED_MM_S, 0.0, onset.direction_deg, onset.direction_sd_deg)
    said: list[tuple[float, float] | None] = []
    for first in range(begin, end - n + 1, n):
        fit = joint_fit(array, run.volts[first : first + n], RATE_HZ, offsets_s(array), motion)
        said.append((fit.period_mm, fit.angle_deg) if fit.status == "ok" else None)
    return said


def first_answer(run: Run, first: First) -> First:
    """The same, answered."""
    slip, array = run.truth.slips[0], load_array("wang2019-3x3")
    until = int(np.searchsorted(run.time_s, slip.onset_s + _LONGEST_S))
    said = answers(
        array,
        JointParams(preset=first.preset, speed_mm_s=SPEED_MM_S),
        run.volts[:until],
        offsets_s(array),
        true_onset(run),
        start_s=float(run.time_s[0]),
    )
    ok = next((event for event in said if event.status == "ok"), None)
    if ok is None:
        return first
    return replace(first, after_s=ok.time_s - slip.onset_s, period_mm=ok.period_mm, angle_deg=ok.angle_deg)


def offsets_s(array: Array) -> FloatArray:
    return EmulatedBoardParams().channel_step_s * np.arange(array.n_channels, dtype=np.float64)


def table2(found: Sequence[Answered]) -> str:
    """Five columns: period and angle, mean and standard deviation over windows (answered of all)."""
    head = ["D, angle", "paper, simulation", "paper, experiment", *dict.fromkeys(a.method for a in found)]
    rows = []
    for plate in dict.fromkeys(a.plate for a in found):
        published = PUBLISHED[plate]
        cells = [" mm, ".join(published[kind][1:]) + " deg" for kind in ("simulation", "experiment")]
        rows.append([_name(plate), *cells, *(_said(a) for a in found if a.plate == plate)])
    return table(head, rows)


def errors2(found: Sequence[Answered]) -> str:
    """Errors (rms) of the three, and by how much the joint fit's are smaller than the procedure's."""
    methods = list(dict.fromkeys(a.method for a in found))
    head = ["D, angle", *(f"{method}: D, angle" for method in methods)]
    head += [f"smaller at {method.removeprefix('joint, ')}" for method in methods[1:]]
    rows = []
    for plate in dict.fromkeys(a.plate for a in found):
        errors = [a.errors() for a in found if a.plate == plate]
        cells = [f"{1e3 * period:.2f} um, {angle:.3f} deg" for period, angle in errors]
        base = errors[0]
        cells += [f"{base[0] / period:.0f}, {base[1] / angle:.0f} times" for period, angle in errors[1:]]
        rows.append([_name(plate), *(NONE if "nan" in cell else cell for cell in cells)])
    return table(head, rows)


def first_table(firsts: Sequence[First]) -> str:
    """When the first answers came, median and latest, and their errors (rms)."""
    presets = list(dict.fromkeys(f.preset for f in firsts))
    rows = []
    for plate in dict.fromkeys(f.plate for f in firsts):
        cells = [_name(plate)]
        for preset in presets:
            mine = [f for f in firsts if (f.plate, f.preset) == (plate, preset)]
            ok = [(f.period_mm, f.angle_deg) for f in mine if np.isfinite(f.after_s)]
            period_mm, angle_deg = Answered(plate, preset, len(mine), ok).errors()
            after_s = np.array([f.after_s for f in mine if np.isfinite(f.after_s)])
            when = f"{np.median(after_s):.1f} s, {after_s.max():.1f} s: " if ok else f"{NONE} "
            error = f"{1e3 * period_mm:.2f} um, {angle_deg:.3f} deg " if ok else ""
            cells.append(f"{when}{error}({len(ok)}/{len(mine)})")
        rows.append(cells)
    return table(["D, angle", *(f"{preset}: D, angle" for preset in presets)], rows)


def _name(plate: Plate) -> str:
    return f"{plate[0]:.2f} mm, {plate[1]} deg"


def _said(answered: Answered) -> str:
    if not answered.said:
        return f"{NONE} (0/{answered.windows})"
    said = np.array(answered.said)
    share = f"{len(said)}/{answered.windows}"
    return f"{spread(said[:, 0], 4)} mm, {spread(said[:, 1], 3)} deg ({share})"
