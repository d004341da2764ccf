"""A scene from volts to events in simulated time: firmware, line, decoder, clock fit, detectors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import load_array
from tactiled.detect.suite import DetectParams, Wang2019Params
from tactiled.detect.wang2019.texture import TextureParams
from tactiled.emulator.scene.description import GroovedPlate, Scene, SlidePhase
from tactiled.emulator.scene.truth import Truth
from tactiled.emulator.simulate import Simulation
from tactiled.events.types import Event, ScanEvent, SlipEvent
from tactiled.pipeline import Pipeline, PipelineParams
from tactiled.wire.layout import load_layout

FloatArray = NDArray[np.float64]
NONE = "-"


@dataclass(frozen=True)
class Run:
    """One protocol played once."""

    volts: FloatArray
    time_s: FloatArray
    events: list[Event]
    truth: Truth

    def slips(self, state: str) -> list[SlipEvent]:
        """Onsets, or ends."""
        return [e for e in self.events if isinstance(e, SlipEvent) and e.state == state]


def play(scene: Scene, seed: int) -> Run:
    """Run a scene from volts to events, with its own noise and taxels, and the plate put down anywhere."""
    if isinstance(scene.surface, GroovedPlate):
        offset_mm = float(np.random.default_rng(seed).uniform(0, scene.surface.period_mm))
        scene = scene.with_surface(**scene.surface.model_dump() | {"offset_mm": offset_mm})
    slides = [phase for phase in scene.phases if isinstance(phase, SlidePhase)]
    texture = TextureParams(speed_mm_s=slides[0].speed_mm_s)
    detect = DetectParams(setting="wang2019", wang2019=Wang2019Params(texture=texture))
    params = PipelineParams(detect=detect)
    layout = load_layout("board-v1")
    pipeline = Pipeline(layout, load_array(scene.array), params)
    simulation = Simulation(scene.with_changes(seed=seed + 1), layout)
    volts, times, events = [], [], []
    for arrival_s, data in simulation:
        for output in pipeline.receive_data(data, arrival_s):
            if isinstance(output, ScanEvent):
                volts.append(output.volts)
                times.append(output.time_s)
            elif isinstance(output, Event):
                events.append(output)
    return Run(np.array(volts), np.array(times), events, simulation.truth)


def spread(values: FloatArray | list[float], digits: int) -> str:
    """Mean and standard deviation for a table."""
    if not len(values):
        return NONE
    return f"{np.mean(values):.{digits}f} ± {np.std(values):.{digits}f}"
