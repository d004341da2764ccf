"""Grooved plates on scenes that obey physics: the plates of table 2 of the paper, and plates drawn at random.

Each plate is played by the contact model `periodic` through firmware, line, decoder and clock fit. The joint
fit is given the speed, as the procedure must be, and the direction of the slip event. On the plates of the
paper it sees the very windows of the procedure (10 s each, from 1 s after the slip was detected), and windows
of 2 s of the same slide, 0.8 to 2.2 periods. Plates drawn at random are no plates that anything was tuned on:
each seed has a period and an angle of its own, one window of each length, with the speed given and not.
Online the estimator follows the slip detector, and answers when the preset "balanced" lets it.
"""

from dataclasses import dataclass

import numpy as np

from bench.report import NONE
from bench.texture.signal import RATE_HZ, Wave
from bench.texture.trials import ARRAY, Trial, compare, joint_fit, online_answers
from tactiled.array import FloatArray, load_array
from tactiled.detect.grooves.outcome import GrooveAnswer, Refusal
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.suite import DetectParams, Wang2019Params
from tactiled.detect.wang2019.texture import TextureParams
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.scene.description import Scene, paper_scenes
from tactiled.emulator.scene.phases import GroovedPlate, SlidePhase
from tactiled.emulator.scene.truth import TrueSlip
from tactiled.emulator.simulate import Simulation
from tactiled.events.types import Event, ScanEvent, SlipEvent, TextureEvent
from tactiled.pipeline import Pipeline, PipelineParams
from tactiled.wire.layout import load_layout

Plate = tuple[float, float]  # period (mm) and angle (degrees)
# Experiments of table 2 of the paper: period (mm) and angle (degrees) that were found; "-" where not given.
PUBLISHED: dict[Plate, tuple[str, str]] = {
    (0.9, 0): ("0.95", NONE),
    (1.2, 0): ("1.20 1.25", "0.48"),
    (1.5, 0): ("1.50", NONE),
    (1.2, 15): ("1.22", "13.59"),
    (1.2, 30): ("1.30", "29.90"),
    (1.2, 45): ("1.31", "45.47"),
    (1.2, 60): (NONE, "61.50"),
}
PLATES: tuple[Plate, ...] = tuple(PUBLISHED)
PERIODS_MM = (0.8, 2.5)
ANGLES_DEG = (-60.0, 60.0)
DRAWN_WINDOWS_S = (10.0, 4.0)
_PAPER_WINDOWS_S = (10.0, 2.0)
_SPEED_MM_S = 1.0  # of the protocol
_SETTLE_S = 1.0  # as the procedure has it
_LONGEST_S = 12.0  # after the onset, in which an answer must come
_HOLD_S, _SLIDE_S = 5.0, 13.0  # as long as slip detection and the longest window need


@dataclass(frozen=True)
class PlateSlide:
    """A slide over a plate, played once."""

    volts: FloatArray  # (n, channels)
    time_s: FloatArray  # (n,)
    # the onset that is nearest to the true one: there may be a false alarm on the press before
    onset: SlipEvent
    procedure: list[TextureEvent]  # answers of the published procedure
    truth: TrueSlip

    @property
    def first_scan(self) -> int:
        """Scan at which windows begin."""
        return int(np.searchsorted(self.time_s, self.onset.detected_s + _SETTLE_S))


def play(scene: Scene, seed: int) -> PlateSlide:
    """Play a scene with noise and taxels of seed + 1, and a random offset of its plate along x."""
    if isinstance(scene.surface, GroovedPlate):
        offset_mm = float(np.random.default_rng(seed).uniform(0, scene.surface.period_mm))
        scene = scene.with_surface(**scene.surface.model_dump() | {"offset_mm": offset_mm})
    slides = [phase for phase in scene.phases if isinstance(phase, SlidePhase)]
    texture = TextureParams(speed_mm_s=slides[0].speed_mm_s)
    detect = DetectParams(setting="wang2019", wang2019=Wang2019Params(texture=texture))
    layout = load_layout("board-v1")
    pipeline = Pipeline(layout, load_array(scene.array), PipelineParams(detect=detect))
    simulation = Simulation(scene.with_changes(seed=seed + 1), layout)
    volts, times, events = [], [], []
    for arrival_s, data in simulation:
        for output in pipeline.receive_data(data, arrival_s):
            if isinstance(output, ScanEvent):
                volts.append(output.volts)
                times.append(output.time_s)
            elif isinstance(output, Event):
                events.append(output)
    truth = simulation.truth.slips[0]
    onsets = [e for e in events if isinstance(e, SlipEvent) and e.state == "onset"]
    onset = min(onsets, key=lambda one: abs(one.onset_s - truth.onset_s))
    answers = [e for e in events if isinstance(e, TextureEvent) and e.status != "no-slip"]
    return PlateSlide(np.array(volts), np.array(times), onset, answers, truth)


def paper_plate_trials(plate: Plate, seed: int) -> list[Trial]:
    """Windows of one slide over a plate of the paper: the procedure, the joint fit, and first answers."""
    scene = paper_scenes()[f"experiment-d{plate[0]:.2f}-a{plate[1]}"].with_changes(contact="periodic")
    slide, wave = play(scene, seed), Wave(*plate, _SPEED_MM_S)
    end = int(np.searchsorted(slide.time_s, slide.truth.end_s))
    fields = {"seed": seed, "is_speed_known": True}
    trials = [
        compare(event, wave, name="procedure", window_s=_PAPER_WINDOWS_S[0], **fields)
        for event in slide.procedure
    ]
    for window_s in _PAPER_WINDOWS_S:
        n = round(window_s * RATE_HZ)
        for first in range(slide.first_scan, end - n + 1, n):
            fit = _fit(slide, first, window_s, _SPEED_MM_S)
            trials.append(compare(fit, wave, name=f"joint, {window_s:g} s", window_s=window_s, **fields))
    return [*trials, _first_answer(slide, wave, "plates of the paper", seed)]


def drawn_plate(seed: int) -> Plate:
    """Draw period (mm) and angle (degrees) of a seed."""
    rng = np.random.default_rng(seed)
    period_mm = float(np.exp(rng.uniform(*np.log(PERIODS_MM))))
    return round(period_mm, 3), round(float(rng.uniform(*ANGLES_DEG)), 1)


def drawn_plate_trials(seed: int) -> list[Trial]:
    """Windows of one slide over the plate of a seed, and the first answer online."""
    wave = Wave(*drawn_plate(seed), _SPEED_MM_S)
    slide = play(_drawn_scene(wave), seed)
    trials = []
    for window_s in DRAWN_WINDOWS_S:
        for is_known in (True, False):
            fit = _fit(slide, slide.first_scan, window_s, _SPEED_MM_S if is_known else 0.0)
            fields = {"seed": seed, "window_s": window_s, "is_speed_known": is_known}
            trials.append(compare(fit, wave, name="drawn plate", **fields))
    return [*trials, _first_answer(slide, wave, "drawn plates", seed)]


def _drawn_scene(wave: Wave) -> Scene:
    scene = paper_scenes()["experiment-d1.20-a0"]
    scene = scene.with_surface(period_mm=wave.period_mm, angle_deg=wave.angle_deg)
    press, hold, slide = (phase.model_dump() for phase in scene.phases)
    phases = [press, hold | {"duration_s": _HOLD_S}, slide | {"duration_s": _SLIDE_S}]
    return scene.with_changes(contact="periodic", phases=phases)


_OFFSET_S = EmulatedBoardParams().channel_step_s * np.arange(ARRAY.n_channels, dtype=np.float64)


def _fit(slide: PlateSlide, first: int, window_s: float, speed_mm_s: float) -> GrooveAnswer | Refusal:
    onset, volts = slide.onset, slide.volts[first : first + round(window_s * RATE_HZ)]
    return joint_fit(volts, _OFFSET_S, speed_mm_s, onset.direction_deg, onset.direction_sd_deg)


def _first_answer(slide: PlateSlide, wave: Wave, name: str, seed: int) -> Trial:
    """First answer online, and the time from the true onset to the scan that completed it."""
    onset_s = slide.truth.onset_s
    until = int(np.searchsorted(slide.time_s, onset_s + _LONGEST_S))
    events = online_answers(
        JointParams(speed_mm_s=_SPEED_MM_S),
        slide.volts[:until],
        _OFFSET_S,
        slide.onset,
        start_s=float(slide.time_s[0]),
    )
    answer = next((event for event in events if event.status == "ok"), None)
    after_s = answer.answered_s - onset_s if answer else np.inf
    nan = float("nan")
    return compare(answer, wave, name=name, seed=seed, window_s=nan, is_speed_known=True, after_s=after_s)
