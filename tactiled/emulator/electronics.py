"""Force to counts: conductive rubber, voltage divider, noise, ADC. One function a stage, all in SI units.

The numbers put a hold of 20 N on the 3x3 array (0.56 N on each read-out area) at about 1.2 V, within the
1.0 to 1.5 V of the paper's plots and above the 0.5 V that it calls clear enough.
"""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.tomlfile import Params

FloatArray = NDArray[np.float64]


class ElectronicsParams(Params):
    """Rubber and read-out; the defaults are the 2019 array's."""

    # |dR/df| = rubber / (f - dead zone)^2 is above 500 kOhm/N below 0.7 N (Wang 2019) from 236e3 up.
    rubber_ohm_n: float = Field(default=250e3, gt=0, description="resistance times force above dead zone")
    dead_zone_n: float = Field(default=0.0125, ge=0, description="force on one area before it conducts")
    creep_per_n: float = Field(
        default=0.001, ge=0, le=0.1, description="relative gain per newton of total load that creeps in"
    )
    creep_time_s: float = Field(default=20.0, gt=0, description="time constant of the creep")
    divider_ohm: float = Field(default=270e3, gt=0, description="E12 resistor to ground, below the rubber")
    supply_v: float = Field(default=3.3, gt=0, description="over rubber and divider; may exceed the ADC")
    shear_v_per_n: float = Field(default=0.47, gt=0, description="of shear channels, around mid-scale")
    noise_v: float = Field(default=0.3e-3, ge=0, le=1, description="white, rms, each sample")
    dead_channels: list[int] = Field(default=[], description="open circuits: they read 0 V and noise")


def creep_gain(params: ElectronicsParams, relaxed_load_n: FloatArray) -> FloatArray:
    """Gain by which the rubber's sensitivity creeps up under load (first-order, 2 % at 20 N)."""
    return 1.0 + params.creep_per_n * relaxed_load_n


def conductance_s(params: ElectronicsParams, force_n: FloatArray) -> FloatArray:
    """Conductance of a read-out area, siemens.

    Percolation in the rubber makes it about proportional to the force above a dead zone:
    ``R = k / (f - f0)``, so sensitivity falls with force as in Wang 2019.
    """
    return np.asarray(np.maximum(force_n - params.dead_zone_n, 0.0) / params.rubber_ohm_n)


def divider_v(params: ElectronicsParams, conductance: FloatArray) -> FloatArray:
    """Volts over the divider's lower resistor: ``U R / (R + 1/G)``, which saturates by itself."""
    ratio = conductance * params.divider_ohm
    return np.asarray(params.supply_v * ratio / (1.0 + ratio))


def shear_v(params: ElectronicsParams, force_n: FloatArray, reference_v: float) -> FloatArray:
    """Volts of a shear channel: signed, around half of the ADC's range."""
    return np.asarray(reference_v / 2 + params.shear_v_per_n * force_n)


def adc_counts(volts: FloatArray, bits: int, reference_v: float) -> NDArray[np.int64]:
    """Counts of an ideal ADC with ``reference / 2**bits`` volts a count; clips at both ends."""
    counts = np.floor(volts * (2**bits / reference_v) + 0.5)
    return np.asarray(np.clip(counts, 0, 2**bits - 1), dtype=np.int64)
