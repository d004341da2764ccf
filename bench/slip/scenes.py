"""Scenes of ``./run bench slip``: played once without noise, then read as often as wanted with noise."""

import itertools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bench.slip.truth import GRID_S, Course, TrueInstants, first_gross, loads_at
from tactiled.array import load_array
from tactiled.emulator.board.electronics import adc_counts
from tactiled.emulator.board.noise import ScanNoise
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.scene import families
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families import Family, slipping
from tactiled.emulator.scene.phases import LoadPhase, PressPhase
from tactiled.emulator.scene.truth import Truth
from tactiled.samples.block import ScanBlock, regular_block

FloatArray = NDArray[np.float64]
Announced = Literal["inhibit", "load-change"]

RATE_HZ = 100.0
ADC_BITS, ADC_REFERENCE_V = 12, 3.0  # of the 2019 circuit: facts of `EmulatedBoardParams`
LSB_V = ADC_REFERENCE_V / 2**ADC_BITS
CHANNEL_STEP_S = 200e-6  # multiplexer step of the emulated board
SCAN_SPAN_S = (
    35 * CHANNEL_STEP_S
)  # a scan has its last channel so long after it began: no one knows it before
# Added to the first hold: level 6 of the wavelet bank sees 3.2 s, and must have left the press behind.
LEAD_S = 3.0
SPEEDS_MM_S = (0.25, 1.0, 5.0, 20.0)
NOISES_V = (0.3e-3, 1e-3, 3e-3, 10e-3)
_MOTOR_STARTS_S = 0.5  # from standing to its speed
_PIECE_SCANS = 64  # played at once: well within what a contact model keeps


@dataclass(frozen=True)
class Announcement:
    """What a controller could say of its own motion, ahead of it."""

    kind: Announced
    start_s: float
    duration_s: float


@dataclass(frozen=True, eq=False)
class Played:
    """A scene as the sensor answers it without noise.

    Attributes
    ----------
    family : str
    seed : int
    volts : (n, channels) float64
        At the ADC, noise-free, each channel at its own instant of the scan.
    held_s : float
        The press is over: what comes before is loading.
    slip : TrueInstants or None
        None where nothing ever slips as a whole.
    slipping : tuple of (start_s, end_s)
        All times that a tenth or more of the contact came to slip, gross or not, from the shear's beginning.
    announcements : tuple of Announcement
    """

    family: str
    seed: int
    volts: FloatArray
    held_s: float
    slip: TrueInstants | None
    slipping: tuple[tuple[float, float], ...]
    announcements: tuple[Announcement, ...]

    @property
    def duration_s(self) -> float:
        """Length of the scene."""
        return len(self.volts) / RATE_HZ

    def counts(self, noise_v: float, draw: int) -> NDArray[np.int64]:
        """As the ADC reads it; `draw` numbers independent noises."""
        noise = ScanNoise(1_000_000 * draw + self.seed, self.volts.shape[1])
        noisy = self.volts + noise_v * noise.normal(0, len(self.volts))
        return adc_counts(noisy, ADC_BITS, ADC_REFERENCE_V)

    def read(self, noise_v: float, draw: int) -> ScanBlock:
        """As a detector gets it."""
        return block_of(self.counts(noise_v, draw))


def block_of(counts: NDArray[np.int64]) -> ScanBlock:
    """Scans from time 0; a reading at the end of the ADC's range is saturated."""
    offsets: FloatArray = CHANNEL_STEP_S * np.arange(counts.shape[1], dtype=np.float64)
    valid = counts < 2**ADC_BITS - 1
    return regular_block(counts * LSB_V, RATE_HZ, channel_offset_s=offsets, valid=valid)


def read_sd_v(noise_v: float) -> float:
    """Sigma of a reading: noise and rounding (uniform over one step; W. R. Bennett, BSTJ 27, 1948)."""
    return float(np.hypot(noise_v, LSB_V / np.sqrt(12)))


def play(name: str, family: Family, seed: int) -> Played:
    """A scene of a family, its hold lengthened by `LEAD_S`, on the 2019 array."""
    scene = _held_longer(family(seed), LEAD_S)
    array = load_array(scene.array)
    sensor = Sensor(scene, array, adc_bits=ADC_BITS, adc_reference_v=ADC_REFERENCE_V)
    n = int(scene.duration_s * RATE_HZ) - 1
    time_s = np.arange(n)[:, None] / RATE_HZ + CHANNEL_STEP_S * np.arange(array.n_channels)
    truth = Truth(scene, 0.0, sensor.contact, array)
    grid_s = np.arange(0.0, scene.duration_s, GRID_S)
    # Volts and truth by turns: who asks for more than the newest seconds has the scene played anew.
    volts, loads_n = [], []
    bounds = [*range(0, n - _PIECE_SCANS, _PIECE_SCANS), n]
    for start, end in itertools.pairwise(bounds):
        volts.append(sensor.volts(time_s[start:end]))
        until_s = time_s[end, 0] if end < n else np.inf
        loads_n.append(loads_at(truth, grid_s[(grid_s >= time_s[start, 0]) & (grid_s < until_s)]))
    load = Course(grid_s, *np.concatenate(loads_n, axis=1))
    return Played(
        family=name,
        seed=seed,
        volts=np.concatenate(volts),
        held_s=scene.phases[0].duration_s,
        slip=first_gross(truth, load),
        slipping=tuple((load.shear_s(e), e.end_s) for e in truth.episodes),
        announcements=announcements(scene),
    )


def at_speed(speed_mm_s: float) -> Family:
    """`slipping.steady_slide` at a given speed."""

    def steady(seed: int) -> Scene:
        document = slipping.steady_slide(seed).model_dump()
        document["phases"][-1] |= {"speed_mm_s": speed_mm_s}
        return Scene.model_validate(document)

    return steady


def speed_name(speed_mm_s: float) -> str:
    """Of the family of steady slides at a speed."""
    return f"{speed_mm_s:g} mm/s"


def slipping_families() -> dict[str, Family]:
    """The physical families, steady slides at each of `SPEEDS_MM_S`, and the families held out."""
    return tuned_families() | families.HELD_OUT_SLIPPING


def tuned_families() -> dict[str, Family]:
    """Those that detectors were tuned on, by other seeds than are reported."""
    speeds = {speed_name(speed): at_speed(speed) for speed in SPEEDS_MM_S}
    return {name: f for name, f in families.SLIPPING.items() if name != "steady-slide"} | speeds


def _held_longer(scene: Scene, more_s: float) -> Scene:
    document = scene.model_dump()
    document["phases"][1]["duration_s"] += more_s  # every family begins with a press and a hold
    for extra in document["disturbances"]:
        extra["start_s"] += more_s
    return Scene.model_validate(document)


def announcements(scene: Scene) -> tuple[Announcement, ...]:
    """The gripper's and the arm's own doing: grip, load and starts and stops. Nobody announces the rest."""
    said, start_s = [], 0.0
    for phase in scene.phases:
        if isinstance(phase, PressPhase | LoadPhase):
            said.append(Announcement("load-change", start_s, phase.duration_s))
        start_s += phase.duration_s
    if scene.name.startswith("arm-acceleration"):
        said += [Announcement("inhibit", d.start_s, d.duration_s) for d in scene.disturbances]
    if scene.name.startswith("motor-hum"):  # the gripper knows when its motor begins to run
        said.append(Announcement("inhibit", scene.disturbances[0].start_s, _MOTOR_STARTS_S))
    return tuple(said)
