"""Conversion of force to counts: rubber, voltage divider, multiplexer, ADC; one function for each, in SI.

With the default constants a hold of 20 N on the 3x3 array (0.56 N on each read-out area) reads about 1.2 V,
within the 1.0 to 1.5 V of the paper's plots and above the 0.5 V that it calls clear enough.

Published sensitivities (Wang et al., Sens. Actuators A 297 (2019) 111512): 0.471 and 0.466 V/N in shear,
0.201 V/N up to 6 N and 0.067 V/N up to 15 N. We take them per newton on ONE taxel, with the mean of its four
resistors as normal voltage, and R1 - R3 and R2 - R4 as shear voltages. They cannot be per newton on the
whole array: 20 N with friction 0.6 would change R1 - R3 by 5.6 V at an ADC of 3 V. They also do not agree
with 1.2 V at 20 N on nine taxels (it would be 0.45 V), so there are two sets of constants: the defaults, for
scenes on the whole array, and those of `config/scenes/one-taxel.toml`, whose ``[electronics]`` can be copied
into any scene.
"""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Readout
from tactiled.tomlfile import Params

# Part of a taxel's load on one read-out area at rest: finite elements, coarse mesh, 1.667 N
# (fem-coarse-flat-0.6.json).
PART_OF_LOAD = {"edge": 0.05619 / (5 / 3), "half": 0.67987 / (5 / 3)}


class ElectronicsParams(Params):
    """Rubber and read-out; the defaults are the 2019 array's."""

    # |dR/df| = rubber / (f - dead zone)^2 is above 500 kOhm/N below 0.7 N (Wang 2019) from 236e3 up.
    rubber_ohm_n: float = Field(
        default=250e3, ge=1, le=1e12, description="resistance times force above dead zone"
    )
    dead_zone_n: float = Field(
        default=0.0125, ge=0, le=1000, description="force on one area before it conducts"
    )
    creep_per_n: float = Field(
        default=0.001, ge=0, le=0.1, description="relative gain per newton of total load that creeps in"
    )
    creep_time_s: float = Field(default=20.0, ge=1e-3, le=1e6, description="time constant of the creep")
    divider_ohm: float = Field(
        default=270e3, ge=1, le=1e12, description="E12 resistor to ground, below the rubber"
    )
    supply_v: float = Field(
        default=3.3, gt=0, le=100, description="over rubber and divider; may exceed the ADC"
    )
    shear_v_per_n: float = Field(
        default=0.47, gt=0, le=1000, description="of shear channels, around mid-scale"
    )
    # Current spreads in the rubber between a side electrode and the common one, so an electrode also reads
    # forces beside its area. Used with physical contact models; prescribed signals include it.
    spread_x: float = Field(default=0.535, ge=0, le=1, description="R1, R3: part of the taxel's mean read")
    spread_y: float = Field(default=0.54, ge=0, le=1, description="R2, R4: part of the taxel's mean read")
    hysteresis: float = Field(
        default=0.0,
        ge=0,
        le=0.5,
        description="extra conductance while unloading, relative, at half the peak load",
    )
    # Silicone-carbon composites lose 0.1 to 1 % a kelvin; the paper gives none.
    temperature_per_k: float = Field(
        default=-0.003, ge=-0.02, le=0.02, description="relative change of conductance a kelvin"
    )
    unsettled: float = Field(
        default=0.0, ge=0, lt=0.5, description="part of a sample that is left from the previous channel"
    )
    crosstalk: float = Field(
        default=0.0,
        ge=0,
        lt=0.5,
        description="part of a channel's volts that comes from the mean of its taxel",
    )
    noise_v: float = Field(default=0.3e-3, ge=0, le=1, description="white, rms, each sample")
    dead_channels: list[int] = Field(default=[], description="open circuits: they read 0 V and noise")


def creep_gain(params: ElectronicsParams, relaxed_load_n: FloatArray) -> FloatArray:
    """Gain of the rubber's sensitivity by creep under load (first order, 2 % at 20 N)."""
    return 1.0 + params.creep_per_n * relaxed_load_n


def quarter_n(area_n: FloatArray, readout: Readout) -> FloatArray:
    """Convert force on a read-out area to the quarter of the taxel's load that causes it at rest.

    The electronics' constants are for a quarter of the load, whatever the size of the area; physical contact
    models give the force on the area itself.
    """
    return np.asarray(area_n * 0.25 / PART_OF_LOAD[readout])


def spread_n(
    params: ElectronicsParams, force_n: FloatArray, taxel: NDArray[np.int64], azimuth_deg: FloatArray
) -> FloatArray:
    """Forces that side electrodes read: each its own area's, mixed with the mean of its taxel.

    Parameters
    ----------
    force_n : (n, s) float64
        On the area of each side channel.
    taxel, azimuth_deg : (s,)
        Of each side channel.
    """
    along_x = np.cos(np.deg2rad(azimuth_deg)) ** 2
    spread = params.spread_x * along_x + params.spread_y * (1 - along_x)
    return np.asarray((1 - spread) * force_n + spread * (force_n @ _means(taxel)))


def _means(taxel: NDArray[np.int64]) -> FloatArray:
    """Matrix (s, s) that replaces each of s channels by the mean of its taxel."""
    among = np.equal.outer(taxel, taxel).astype(np.float64)
    return np.asarray(among / among.sum(axis=0))


def hysteresis_gain(params: ElectronicsParams, load_n: FloatArray, peak_n: FloatArray) -> FloatArray:
    """Gain of conductance by hysteresis, with the largest load `peak_n` since contact.

    It is 1 while the load grows. The difference of the unloading from the loading curve is a parabola, 0 at
    the peak and at zero load.
    """
    part = np.clip(load_n / np.maximum(peak_n, 1e-9), 0.0, 1.0)
    return np.asarray(1.0 + params.hysteresis * 2.0 * (1.0 - part))


def temperature_gain(params: ElectronicsParams, temperature_k: FloatArray) -> FloatArray:
    """Gain of conductance at a temperature (K) above that of calibration; at least a tenth."""
    return np.maximum(1.0 + params.temperature_per_k * temperature_k, 0.1)


def sampled_v(params: ElectronicsParams, volts: FloatArray, taxel: NDArray[np.int64]) -> FloatArray:
    """Volts after the multiplexer: crosstalk within a taxel, then the residue of the previous channel.

    Parameters
    ----------
    volts : (n, channels) float64
    taxel : (channels,) int64
        Of each channel. Before the first comes the last of the same scan, which differs little from that of
        the scan before.
    """
    if params.crosstalk:
        volts = volts + params.crosstalk * (volts @ _means(taxel) - volts)
    if params.unsettled:
        volts = volts + params.unsettled * (np.roll(volts, 1, axis=1) - volts)
    return volts


def conductance_s(params: ElectronicsParams, force_n: FloatArray) -> FloatArray:
    """Conductance of a read-out area, siemens.

    By percolation in the rubber it is about proportional to the force above a dead zone, ``R = k / (f -
    f0)``, so that sensitivity falls with force as in Wang 2019.
    """
    return np.asarray(np.maximum(force_n - params.dead_zone_n, 0.0) / params.rubber_ohm_n)


def divider_v(params: ElectronicsParams, conductance: FloatArray) -> FloatArray:
    """Volts over the divider's lower resistor: ``U R / (R + 1/G)``."""
    ratio = conductance * params.divider_ohm
    return np.asarray(params.supply_v * ratio / (1.0 + ratio))


def shear_v(params: ElectronicsParams, force_n: FloatArray, reference_v: float) -> FloatArray:
    """Volts of a shear channel: signed force around half of the ADC's range."""
    return np.asarray(reference_v / 2 + params.shear_v_per_n * force_n)


def adc_counts(volts: FloatArray, bits: int, reference_v: float) -> NDArray[np.int64]:
    """Counts of an ideal ADC with ``reference / 2**bits`` volts a count; clips at both ends."""
    counts = np.floor(volts * (2**bits / reference_v) + 0.5)
    return np.asarray(np.clip(counts, 0, 2**bits - 1), dtype=np.int64)
