"""Scenes of ``./run bench slip``: played once without noise, then read with noise as often as needed."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tactiled.array import FloatArray, load_array
from tactiled.emulator.board.electronics import adc_counts
from tactiled.emulator.board.noise import ScanNoise
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.scene import families
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families import Family, slipping
from tactiled.emulator.scene.families.parts import (
    any_direction_deg,
    begin,
    disturb,
    friction_n,
    load_phase,
    made,
)
from tactiled.emulator.scene.truth import TrueSlip, Truth
from tactiled.samples.block import ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
RATE_HZ = 100.0
ADC_BITS, ADC_REFERENCE_V = 12, 3.0  # of the 2019 circuit, as `EmulatedBoardParams`
LSB_V = ADC_REFERENCE_V / 2**ADC_BITS
CHANNEL_STEP_S = 200e-6  # multiplexer step of the emulated board
HOLD_EXTRA_S = 3.0  # added to the first hold, so that the press is over and forgotten when something happens
SPEEDS_MM_S = (0.25, 1.0, 5.0, 20.0)
NOISES_V = (0.3e-3, 3e-3)
_PIECE_SCANS = 64  # played at once: well within what a contact model keeps
GRID_S = 0.005  # step of the contact models: truth is no finer
# The load is at rest where it changes by less than this part of the grip within so many seconds.
_REST_CHANGE, _REST_S = 0.002, 0.1


@dataclass(frozen=True)
class FirstSlip:
    """First gross slip of a scene, in scene time."""

    # shear_s, incipient_s, gross_s, end_s: the tangential load begins to grow towards the slip, as the
    # emulator's truth states it, or a later rest ends (an object that hangs still and is then jerked): it has
    # grown by 0.2 % of the grip. 10 %, then 90 % of the contact slip; less than 10 % again.
    shear_s: float
    incipient_s: float
    gross_s: float
    end_s: float
    direction_deg: float | None  # None where the skin turned on the spot


def shear_begins_s(slip: TrueSlip, time_s: FloatArray, shear_n: FloatArray, normal_n: FloatArray) -> float:
    """Instant at which the tangential load began to grow towards a slip; loads (n,) come every `GRID_S`."""
    back = round(_REST_S / GRID_S)
    change_n = np.ptp(sliding_window_view(shear_n, back + 1), axis=1)
    at_rest_s = time_s[back:][change_n <= _REST_CHANGE * normal_n[back:]]
    rested_s = at_rest_s[at_rest_s <= slip.onset_s]
    return max(slip.shear_s or 0.0, float(rested_s[-1]) if len(rested_s) else 0.0)


def _first_gross_slip(truth: Truth, *loads: FloatArray) -> FirstSlip | None:
    """First gross slip of a scene; None where there is none. Loads are those of `shear_begins_s`."""
    gross = next((slip for slip in truth.slips if slip.gross_s is not None), None)
    if gross is None or gross.gross_s is None:
        return None
    shear_s = shear_begins_s(gross, *loads)
    # The contact may slip in part, hold, and slip again on its way to gross slip.
    partial = [e.onset_s for e in truth.episodes if e.end_s > shear_s and e.onset_s <= gross.onset_s]
    return FirstSlip(shear_s, max(min(partial), shear_s), gross.gross_s, gross.end_s, gross.direction_deg)


@dataclass(frozen=True, eq=False)
class PlayedScene:
    """Noise-free readings and truth of a scene."""

    seed: int
    volts: FloatArray  # (n, channels): at the ADC, noise-free, each channel at its own instant of the scan
    slip: FirstSlip | None  # None where no gross slip happens
    slipping_share: FloatArray  # (n,): share of the contact area that slips, at the begin of each scan

    @property
    def duration_s(self) -> float:
        """Length of the scene."""
        return len(self.volts) / RATE_HZ

    def read(self, noise_v: float, draw: int = 1) -> ScanBlock:
        """Scans as a detector gets them, from time 0; `draw` numbers independent noises."""
        n, channels = self.volts.shape
        noise = ScanNoise(1_000_000 * draw + self.seed, channels).normal(0, n)
        counts = adc_counts(self.volts + noise_v * noise, ADC_BITS, ADC_REFERENCE_V)
        offsets: FloatArray = CHANNEL_STEP_S * np.arange(channels, dtype=np.float64)
        valid = counts < 2**ADC_BITS - 1  # a reading at the end of the range is saturated
        return regular_block(counts * LSB_V, RATE_HZ, channel_offset_s=offsets, valid=valid)


def read_sd_v(noise_v: float) -> float:
    """Sigma of a reading: noise and rounding (uniform over one step; W. R. Bennett, BSTJ 27, 1948)."""
    return float(np.hypot(noise_v, LSB_V / np.sqrt(12)))


def play(family: Family, seed: int) -> PlayedScene:
    """Play a scene of a family on the 2019 array, its hold lengthened by `HOLD_EXTRA_S`."""
    scene = _with_longer_hold(family(seed))
    sensor = Sensor(scene, ARRAY, adc_bits=ADC_BITS, adc_reference_v=ADC_REFERENCE_V)
    n = int(scene.duration_s * RATE_HZ) - 1
    time_s = np.arange(n)[:, None] / RATE_HZ + CHANNEL_STEP_S * np.arange(ARRAY.n_channels)
    truth = Truth(scene, 0.0, sensor.contact, ARRAY)
    grid_s = np.arange(0.0, scene.duration_s, GRID_S)
    # Volts and truth in turns: a request older than the newest seconds would play the scene anew.
    volts, loads_n, shares = [], [], []
    bounds = [*range(0, n - _PIECE_SCANS, _PIECE_SCANS), n]
    for start, end in itertools.pairwise(bounds):
        volts.append(sensor.volts(time_s[start:end]))
        until_s = time_s[end, 0] if end < n else np.inf
        state = truth.state(grid_s[(grid_s >= time_s[start, 0]) & (grid_s < until_s)])
        shear_n = np.linalg.norm(state.tangential_n, axis=-1).sum(axis=1)
        loads_n.append(np.stack([shear_n, state.normal_n.sum(axis=1)]))
        shares.append(truth.state(time_s[start:end, 0]).slipping_share)
    slip = _first_gross_slip(truth, grid_s, *np.concatenate(loads_n, axis=1))
    return PlayedScene(seed, np.concatenate(volts), slip, np.concatenate(shares))


def _with_longer_hold(scene: Scene) -> Scene:
    document = scene.model_dump()
    document["phases"][1]["duration_s"] += HOLD_EXTRA_S  # every family begins with a press and a hold
    for disturbance in document["disturbances"]:
        disturbance["start_s"] += HOLD_EXTRA_S
    return Scene.model_validate(document)


def at_speed(speed_mm_s: float) -> Family:
    """`slipping.steady_slide` at a given speed."""

    def steady(seed: int) -> Scene:
        document = slipping.steady_slide(seed).model_dump()
        document["phases"][-1] |= {"speed_mm_s": speed_mm_s}
        return Scene.model_validate(document)

    return steady


STEADY_SLIDES = {f"{speed:g} mm/s": at_speed(speed) for speed in SPEEDS_MM_S}
# Detectors were set on these, by other seeds than are reported.
TUNED_SLIPPING = {name: f for name, f in families.SLIPPING.items() if name != "steady-slide"} | STEADY_SLIDES
FAMILIES = TUNED_SLIPPING | families.HELD_OUT_SLIPPING | families.QUIET | families.HELD_OUT_QUIET

_LOADED_S, _SWING_S, _STEPS = 1.0, 3.0, 4
_SWING, _IN_STEPS = "swings by 30 to 75 %", "comes in steps, to 30 to 75 %"
# Loads as parts of the friction limit.
LOADS = {
    "rests at 20 to 40 %": (0.2, 0.4),
    "rests at 40 to 60 %": (0.4, 0.6),
    "rests at 60 to 80 %": (0.6, 0.8),
    "rests at 80 to 90 %": (0.8, 0.9),
    _SWING: (0.3, 0.75),
    _IN_STEPS: (0.3, 0.75),
}


def loaded(load: str, seed: int) -> Scene:
    """Scene of a load that comes to rest, or swings, below the friction limit: no gross slip.

    The total shear of a load that comes to rest and of one that makes the contact slip is the same: it grows
    and stops. On a surface of unknown friction only the taxels' shares differ.
    """
    rng, scene = begin(load, seed)
    scene["held_object"] = {"mass_kg": 0.3}
    part = rng.uniform(*LOADS[load])
    if load == _SWING:
        scene["phases"] += [
            load_phase(rng, scene, 0.5, 0.05),
            {"kind": "hold", "duration_s": _SWING_S + _LOADED_S},
        ]
        start_s = sum(phase["duration_s"] for phase in scene["phases"][:-1])
        pull_n, rate_hz = part * friction_n(scene), rng.uniform(0.5, 2.5)
        direction_deg = any_direction_deg(rng)
        swing = {"frequency_hz": rate_hz, "direction_deg": direction_deg}
        disturb(scene, "pull_n", "sine", pull_n, start_s, _SWING_S, **swing)
    elif load == _IN_STEPS:
        whole = load_phase(rng, scene, 0.0, part)
        for step in range(1, _STEPS + 1):
            tangential_n = whole["tangential_n"] * step / _STEPS
            grown = {"duration_s": rng.uniform(0.1, 0.5), "tangential_n": tangential_n}
            scene["phases"] += [whole | grown, {"kind": "hold", "duration_s": rng.uniform(0.2, 1.0)}]
    else:
        grown = load_phase(rng, scene, rng.uniform(0.1, 1.0), part)
        scene["phases"] += [grown, {"kind": "hold", "duration_s": _LOADED_S}]
    return made(scene)


SCENES: Mapping[str, Callable[[int], PlayedScene]] = {
    name: partial(play, family)
    for name, family in (FAMILIES | {load: partial(loaded, load) for load in LOADS}).items()
}
"""Families and resting loads: seed to a played scene."""
