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
from tactiled.tomlfile import Params

# Part of a taxel's load on the read-out area under an edge at rest: finite elements, coarse mesh, 1.667 N
# (fem-coarse-flat-0.6.json).
PART_OF_LOAD = 0.05619 / (5 / 3)
_SHEAR_V_PER_N = 0.47  # of shear channels, around mid-scale; as published for side electrodes
_TEMPERATURE_PER_K = -0.003  # of the conductance: silicone-carbon composites lose 0.1 to 1 % a kelvin


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
    # Current spreads in the rubber between a side electrode and the common one, so an electrode also reads
    # forces beside its area. Used with physical contact models; prescribed signals include it.
    spread_x: float = Field(default=0.535, ge=0, le=1, description="R1, R3: part of the taxel's mean read")
    spread_y: float = Field(default=0.54, ge=0, le=1, description="R2, R4: part of the taxel's mean read")
    noise_v: float = Field(default=0.3e-3, ge=0, le=1, description="white, rms, each sample")


def creep_gain(params: ElectronicsParams, relaxed_load_n: FloatArray) -> FloatArray:
    """Gain of the rubber's sensitivity by creep under load (first order, 2 % at 20 N)."""
    return 1.0 + params.creep_per_n * relaxed_load_n


def quarter_n(area_n: FloatArray) -> FloatArray:
    """Convert force on a read-out area to the quarter of the taxel's load that causes it at rest.

    The electronics' constants are for a quarter of the load, whatever the size of the area; physical contact
    models give the force on the area itself.
    """
    return np.asarray(area_n * 0.25 / PART_OF_LOAD)


def spread_n(
    params: ElectronicsParams, force_n: FloatArray, taxel: NDArray[np.int64], azimuth_deg: FloatArray
) -> FloatArray:
    """Forces (n, s) that s side channels read: each its own area's, mixed with the mean of its taxel."""
    along_x = np.cos(np.deg2rad(azimuth_deg)) ** 2
    spread = params.spread_x * along_x + params.spread_y * (1 - along_x)
    among = np.equal.outer(taxel, taxel).astype(np.float64)
    return np.asarray((1 - spread) * force_n + spread * (force_n @ (among / among.sum(axis=0))))


def temperature_gain(temperature_k: FloatArray) -> FloatArray:
    """Gain of conductance at a temperature (K) above that of calibration; at least a tenth."""
    return np.maximum(1.0 + _TEMPERATURE_PER_K * temperature_k, 0.1)


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


def shear_v(force_n: FloatArray, reference_v: float) -> FloatArray:
    """Volts of a shear channel: signed force around half of the ADC's range."""
    return np.asarray(reference_v / 2 + _SHEAR_V_PER_N * force_n)


def adc_counts(volts: FloatArray, bits: int, reference_v: float) -> NDArray[np.int64]:
    """Counts of an ideal ADC with ``reference / 2**bits`` volts a count; clips at both ends."""
    counts = np.floor(volts * (2**bits / reference_v) + 0.5)
    return np.asarray(np.clip(counts, 0, 2**bits - 1), dtype=np.int64)
