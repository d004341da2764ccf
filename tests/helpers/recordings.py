"""Recordings for tests: made of a simulated board, with all that a service would write."""

from pathlib import Path

from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.simulate import Simulation
from tactiled.events.types import Event
from tactiled.pipeline import Pipeline
from tactiled.received import Output
from tactiled.recording.contents import Header, Item, Read, load_board
from tactiled.recording.reader import read_items
from tactiled.recording.writer import RecordingWriter

SOURCE = load_board("board-v1", "wang2019-3x3")
HEADER = Header(SOURCE, sync_s=0.5)
UNIX_OFFSET_S = 1.7e9


def simulated_reads(duration_s: float, scene: str = "prescribed") -> list[Read]:
    """Return the reads of a port from an emulated board that plays a scene."""
    arrivals = Simulation(load_scene(scene), SOURCE.layout, duration_s=duration_s)
    return [Read(arrival_s, UNIX_OFFSET_S, data) for arrival_s, data in arrivals]


def write_step(writer: RecordingWriter, read: Read, outputs: list[Output]) -> None:
    """A read and what came of it, as the service records them."""
    writer.read(read)
    for output in outputs:
        if isinstance(output, Event):
            writer.event(output, "TS0001", read.unix_offset_s, "pipeline")


def record(path: Path, reads: list[Read], sync_every: int = 50) -> list[int]:
    """Record reads with their events; gives the size of the file after each sync."""
    pipeline = Pipeline(SOURCE.layout, SOURCE.array)
    sizes = []
    with RecordingWriter(path, HEADER) as writer:
        for k, read in enumerate(reads, 1):
            write_step(writer, read, pipeline.receive_data(read.data, read.arrival_s))
            if k % sync_every == 0:
                writer.sync()
                sizes.append(writer.size_bytes)
    return sizes


def items(path: Path) -> list[Item]:
    return list(read_items(path))


def noise_read(k: int) -> Read:
    """Return the k-th of some short reads."""
    return Read(k * 0.01, UNIX_OFFSET_S, bytes([k % 256]) * 5)
