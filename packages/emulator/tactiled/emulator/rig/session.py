"""Files of an emulated calibration, and of another motion to try the result on."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.emulator.rig.magnets import MagnetSkin, draw_magnets
from tactiled.emulator.rig.motion import Loads, Motion, play
from tactiled.emulator.rig.reference import ReferenceSensor, draw_reference, write_reference
from tactiled.emulator.rig.sensor import RigSensor, draw_sensor

RATE_HZ = 100.0
TEST_S = 60.0


@dataclass(frozen=True, eq=False)
class RigRun:
    """One motion with what both sensors read."""

    loads: Loads
    readings: FloatArray  # (n, channels)
    reference_s: FloatArray  # (m,): in the reference's clock
    reference: FloatArray  # (m, 6)


DrawnSensor = RigSensor | MagnetSkin


@dataclass(frozen=True, eq=False)
class Rig:
    """A drawn sensor on a drawn force sensor."""

    array: Array
    sensor: DrawnSensor
    reference: ReferenceSensor

    def run(self, motion: Motion, seconds: float, rng: np.random.Generator) -> RigRun:
        """Play a motion."""
        loads = play(motion, self.array, self.sensor.stiffness, seconds, rng, RATE_HZ)
        readings = self.sensor.readings(loads.taxels_n, RATE_HZ, rng)
        return RigRun(loads, readings, *self.reference.measure(loads, self.array, rng))


def draw_rig(array: Array, seed: int) -> tuple[Rig, np.random.Generator]:
    """Draw a rig; the generator goes on to draw motions.

    Arrays without side electrodes get a skin whose channels respond to everything, as those of magnets do.
    """
    rng = np.random.default_rng([15, seed])
    sensor: DrawnSensor
    if set(array.channel_kind) == {"side"}:
        sensor = draw_sensor(array, rng)
    else:
        sensor = draw_magnets(array, rng)
    return Rig(array, sensor, draw_reference(rng)), rng


def write_rig(folder: Path, array: Array, seed: int, seconds: float) -> list[Path]:
    """Write log and reference of presses, and of another motion, into a folder; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    rig, rng = draw_rig(array, seed)
    written = []
    motions: tuple[tuple[Motion, float, str], ...] = (("walk", seconds, ""), ("hold", TEST_S, "test-"))
    for motion, length_s, prefix in motions:
        run = rig.run(motion, length_s, rng)
        log = folder / ("test.npz" if prefix else "log.npz")
        np.savez_compressed(log, time_s=run.loads.time_s, volts=run.readings)
        record = folder / f"{prefix}reference.csv"
        write_reference(record, run.reference_s, run.reference)
        written += [log, record]
    return written
