"""A scene from volts to events in simulated time: firmware, line, decoder, clock fit, published detectors."""

from dataclasses import dataclass

import numpy as np

from tactiled.array import FloatArray, load_array
from tactiled.detect.suite import DetectParams, Wang2019Params
from tactiled.detect.wang2019.texture import TextureParams
from tactiled.emulator.scene.description import GroovedPlate, Scene, SlidePhase
from tactiled.emulator.scene.truth import Truth
from tactiled.emulator.simulate import Simulation
from tactiled.events.types import Event, ScanEvent, SlipEvent, TextureEvent
from tactiled.pipeline import Pipeline, PipelineParams
from tactiled.wire.layout import load_layout


@dataclass(frozen=True)
class ScenePlay:
    """A scene played once: readings (n, channels), their instants (n,), events and truth."""

    volts: FloatArray
    time_s: FloatArray
    events: list[Event]
    truth: Truth

    def slips(self, state: str) -> list[SlipEvent]:
        """Slip events of one state: "onset" or "end"."""
        return [e for e in self.events if isinstance(e, SlipEvent) and e.state == state]

    def textures(self) -> list[TextureEvent]:
        """Texture events of the full windows while sliding."""
        return [e for e in self.events if isinstance(e, TextureEvent) and e.status != "no-slip"]


def play(scene: Scene, seed: int) -> ScenePlay:
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
    return ScenePlay(np.array(volts), np.array(times), events, simulation.truth)
