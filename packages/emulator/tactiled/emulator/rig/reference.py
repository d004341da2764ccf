"""Force sensor of the rig: its own clock, rate, noise, offset and axes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tactiled.array import Array, FloatArray
from tactiled.emulator.rig.motion import Loads

COLUMNS = ("fx_n", "fy_n", "fz_n", "tx_nmm", "ty_nmm", "tz_nmm")


@dataclass(frozen=True, eq=False)
class ReferenceSensor:
    """Six-axis force sensor under the array."""

    rate_hz: float
    late_s: float  # its clock reads so much more than that of the log at the same instant
    drift_ppm: float  # its clock runs so much faster
    noise: FloatArray  # (6,): standard deviations: N, and N mm
    offset: FloatArray  # (6,): readings without a load
    turn_rad: FloatArray  # (3,): small rotation of its axes
    shift_mm: FloatArray  # (2,): place of its origin in the array frame

    @property
    def rotation(self) -> FloatArray:
        """Matrix (3, 3) from the array's axes to the sensor's."""
        return np.asarray(Rotation.from_rotvec(self.turn_rad).as_matrix())

    def seen(self, wrench: FloatArray) -> FloatArray:
        """Return the wrench (n, 6) about the sensor's origin in its axes, without noise and offset."""
        force, moment = wrench[:, :3], wrench[:, 3:]
        arm = np.array([self.shift_mm[0], self.shift_mm[1], 0.0])
        moment = moment - np.cross(np.broadcast_to(arm, force.shape), force)
        turn = self.rotation
        return np.concatenate([force @ turn.T, moment @ turn.T], axis=1)

    def measure(self, loads: Loads, array: Array, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Return times in its own clock (m,) and readings (m, 6)."""
        wrench = self.seen(loads.wrench(array))
        n = int((loads.time_s[-1] - loads.time_s[0]) * self.rate_hz)
        true_s = loads.time_s[0] + (np.arange(n) + rng.uniform()) / self.rate_hz
        values = np.stack([np.interp(true_s, loads.time_s, column) for column in wrench.T], axis=1)
        values = values + self.offset + self.noise * rng.standard_normal(values.shape)
        return true_s * (1 + 1e-6 * self.drift_ppm) + self.late_s, values


def draw_reference(rng: np.random.Generator) -> ReferenceSensor:
    """Draw a force sensor: within 3 s and 100 ppm of the log's clock, axes within some degrees."""
    return ReferenceSensor(
        rate_hz=float(rng.choice([100.0, 250.0, 500.0])),
        late_s=float(rng.uniform(-3, 3)),
        drift_ppm=float(rng.uniform(-100, 100)),
        noise=np.array([0.01, 0.01, 0.02, 0.2, 0.2, 0.1]),
        offset=rng.normal(0, [0.3, 0.3, 0.5, 2.0, 2.0, 1.0]),
        turn_rad=np.deg2rad(rng.normal(0, 2.0, 3)),
        shift_mm=rng.normal(0, 0.3, 2),
    )


def write_reference(path: Path, time_s: FloatArray, values: FloatArray) -> None:
    """Write a CSV with the time and the readings."""
    header = ",".join(("time_s", *COLUMNS))
    np.savetxt(path, np.column_stack([time_s, values]), "%.6f", ",", header=header, comments="")
