"""Worlds of the emulator: scenes are played, with readings and truth at each scan."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from bench.hold.batch import ADC_BITS, ADC_V, ALL_SLIDES, ARRAY, RATE_HZ
from bench.worlds.sensors import runs
from bench.worlds.world import World, onsets, tenths_s
from tactiled.array import FloatArray
from tactiled.emulator.board.electronics import adc_counts
from tactiled.emulator.board.noise import ScanNoise
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families.holding import START_N
from tactiled.emulator.scene.truth import Truth
from tactiled.samples.block import regular_block

_CHANNEL_STEP_S = 250e-6
_PIECE_SCANS = 64  # played at once: well within what a contact model keeps
TOUCHING_N = 0.03 * START_N
_MOVES_MM_S = 0.05  # a slower base creeps: a fifth of the slowest slide that is drawn
_GROSS_SCANS, _STICK_SCANS = 2, 4  # as in `sensors`: shorter slides and rests do not count
_TOLD, _TOLD_N = 0.2, 1.0  # utilisation and load from which readings tell their ratio to the forces
_SMOOTH_SCANS = 21
# Quantile of utilisation from which readings say what they are at the limit: they are not linear.
_NEAREST = 0.8


@dataclass(frozen=True, eq=False)
class Played:
    """States of a scene after each scan, and its readings."""

    volts: FloatArray  # (n, channels)
    load_n: FloatArray  # (n,)
    shear_n: FloatArray  # (n, 2): friction on the skin, against its motion
    friction: FloatArray  # (n,): coefficient that the contact bears at the speed of its base
    slides: NDArray[np.bool_]  # (n,): all of the contact slides


def play(scene: Scene) -> Played:
    """Play a scene without line and clock, with its noise; channels are read one after the other."""
    sensor = Sensor(scene, ARRAY, adc_bits=ADC_BITS, adc_reference_v=ADC_V)
    truth = Truth(scene, 0.0, sensor.contact)
    n = int(scene.duration_s * RATE_HZ) - 1
    time_s = np.arange(n)[:, np.newaxis] / RATE_HZ + _CHANNEL_STEP_S * np.arange(ARRAY.n_channels)
    volts, load, shear, shares, speed = [], [], [], [], []
    for first in range(0, n, _PIECE_SCANS):  # what is older than the newest seconds would be played anew
        some = time_s[first : first + _PIECE_SCANS]
        volts.append(sensor.volts(some))
        state = truth.state(some[:, 0])
        load.append(state.normal_n.sum(axis=1))
        shear.append(state.tangential_n.sum(axis=1))
        shares.append(state.slipping_share)
        speed.append(truth.speed_mm_s(some[:, 0]))
    clean, load_n = np.concatenate(volts), np.concatenate(load)
    noise = scene.electronics.noise_v * ScanNoise(scene.seed, clean.shape[1]).normal(0, n)
    speed_mm_s, surface = np.concatenate(speed), scene.surface
    # As in the contact model `lumped`: a slide that begins fast has no static peak.
    fall = np.exp(-(np.minimum(speed_mm_s / surface.stribeck_mm_s, 30.0) ** 2))
    return Played(
        volts=adc_counts(clean + noise, ADC_BITS, ADC_V) * (ADC_V / 2**ADC_BITS),
        load_n=load_n,
        shear_n=np.concatenate(shear),
        friction=surface.friction * (1.0 + (surface.static_ratio - 1.0) * fall),
        slides=(np.concatenate(shares) > ALL_SLIDES) & (speed_mm_s > _MOVES_MM_S) & (load_n > TOUCHING_N),
    )


def world_of(generator: str, hand: str, scene: Scene, played: Played) -> World:
    """Make a world of a scene that was played."""
    gross = runs(runs(played.slides, _GROSS_SCANS), _STICK_SCANS, of=False)
    touching = played.load_n > TOUCHING_N
    load = np.maximum(played.load_n, TOUCHING_N)
    ratio = np.hypot(*played.shear_n.T) / load
    borne = np.where(gross & played.slides, ratio, played.friction)  # friction falls with the speed
    used = np.where(touching, np.where(gross & played.slides, 1.0, np.minimum(ratio / borne, 1.0)), 0.0)
    shown = _reading_ratio(played, ratio, used)
    near = used >= np.quantile(used[touching], _NEAREST)
    begins = onsets(gross)
    surface = scene.surface
    return World(
        generator=generator,
        hand=hand,
        seed=scene.seed,
        rate_hz=RATE_HZ,
        array=ARRAY,
        block=regular_block(played.volts, RATE_HZ),
        utilisation=used,
        gross=gross,
        gross_s=[float(scan) / RATE_HZ for scan in begins],
        tenth_s=tenths_s(used, begins, 1 / RATE_HZ),
        direction_deg=np.degrees(np.arctan2(-played.shear_n[:, 1], -played.shear_n[:, 0])),
        friction=np.where(touching, shown * borne, np.nan),
        static_friction=float(np.median(shown[near])) * surface.friction * surface.static_ratio,
        load=played.load_n,
        touching=touching,
        acceleration_m_s2=np.full(len(gross), np.nan),
    )


def _reading_ratio(played: Played, ratio: FloatArray, used: FloatArray) -> FloatArray:
    """Ratio of readings over that of forces (n,), where they tell it, and between."""
    shear = np.hypot(*(ARRAY.shear_weights() @ played.volts.T).sum(axis=1))
    load = (ARRAY.normal_weights() @ played.volts.T).sum(axis=0)
    tells = np.flatnonzero((used > _TOLD) & (played.load_n > _TOLD_N))
    if not len(tells):
        return np.full(len(ratio), ARRAY.shear_per_friction)
    told = median_filter(shear[tells] / load[tells] / ratio[tells], _SMOOTH_SCANS, mode="nearest")
    return np.interp(np.arange(len(ratio)), tells, told)
