"""Recordings of emulated boards, as the daemon would make them."""

from pathlib import Path

from tactiled.emulator.scene.description import Scene
from tactiled.emulator.simulate import Simulation
from tactiled.events.types import Event
from tactiled.pipeline import Pipeline
from tactiled.recording.contents import Header, Read, load_board
from tactiled.recording.writer import RecordingWriter

_SOURCE = load_board("board-v1", "wang2019-3x3")


def record_scene(path: Path, scene: Scene, duration_s: float) -> None:
    """Record an emulated board that plays a scene, and its events."""
    pipeline = Pipeline(_SOURCE.layout, _SOURCE.array)
    with RecordingWriter(path, Header(_SOURCE)) as writer:
        for arrival_s, data in Simulation(scene, _SOURCE.layout, duration_s=duration_s):
            writer.read(Read(arrival_s, 0.0, data))
            for output in pipeline.receive_data(data, arrival_s):
                if isinstance(output, Event):
                    writer.event(output, "TS0001", 0.0, "pipeline")
