"""Sensors drawn at random: rubber, electronics and creep of an array of taxels with side electrodes.

Nothing here is shared with the model that is calibrated. Ranges are centred on the constants of
`tactiled.emulator.board.electronics`, whose sources are stated there; widths are those of single parts.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tactiled.array import Array, FloatArray

Law = Literal["percolation", "softening", "stiffening"]
_LAWS: tuple[Law, ...] = ("percolation", "softening", "stiffening")
_ADC_BITS, _ADC_V = 12, 3.0
_TYPICAL_N = 2.2  # load of a taxel of nine under 20 N


@dataclass(frozen=True, eq=False)
class RigSensor:
    """One drawn sensor."""

    array: Array
    # Conductance as a function of the force above the dead zone: a power, or falling or growing slope
    law: Law
    bend: float  # exponent of "percolation"; relative change of slope at 1 N of the others
    dead_n: FloatArray  # (channels,): force on an electrode below which it does not conduct
    gain: FloatArray  # (channels,): of the conductance
    share: FloatArray  # (channels,): part of the taxel's load that an electrode reads
    # imbalance, imbalance_slope: force on an electrode for each newton of shear towards it, and its relative
    # growth with load
    imbalance: float
    imbalance_slope: float
    turn_deg: FloatArray  # (taxels,): by which the electrodes of a taxel are turned
    load_crosstalk: float  # part of the neighbours' mean force that a taxel reads
    # volts_crosstalk, neighbour_crosstalk: part of a channel's volts that comes from its taxel's mean, and
    # from the neighbours' mean
    volts_crosstalk: float
    neighbour_crosstalk: float
    # creep_s, creep: (2,): time constants, and gain for each newton on the taxel
    creep_s: FloatArray
    creep: FloatArray
    creep_adds: bool  # creep adds a delayed force instead of changing the gain
    hysteresis: float  # gain while unloading, at no load
    stiffness: FloatArray  # (taxels,): relative stiffness, by which taxels share a load
    divider: float  # divider resistor times conductance at 1 N
    supply_v: float
    noise_v: float
    temperature_per_k: float  # relative change of conductance

    def readings(
        self,
        loads_n: FloatArray,
        rate_hz: float,
        rng: np.random.Generator,
        temperature_k: FloatArray | float = 0.0,
    ) -> FloatArray:
        """Return the readings (n, channels) of a board, in volts, with noise and rounded by its converter.

        `loads_n` (n, taxels, 3) are the object's forces (x, y, normal); temperature is above the beginning's.
        """
        volts = self._volts(loads_n, rate_hz, np.broadcast_to(temperature_k, len(loads_n)))
        volts = volts + self.noise_v * rng.standard_normal(volts.shape)
        lsb = _ADC_V / 2**_ADC_BITS
        return np.asarray(np.clip(np.round(volts / lsb), 0, 2**_ADC_BITS - 1) * lsb)

    def _volts(self, loads_n: FloatArray, rate_hz: float, temperature_k: FloatArray) -> FloatArray:
        array = self.array
        near = _neighbours(array)
        loads = loads_n + self.load_crosstalk * (near @ loads_n - loads_n)
        normal = np.maximum(loads[:, :, 2], 0.0)
        taxel = array.channel_taxel
        azimuth = np.deg2rad(array.azimuth_deg + self.turn_deg[taxel])
        # Friction on the skin pulls the bump along: the electrode that lies on its side is pressed more.
        towards = loads[:, taxel, 0] * np.cos(azimuth) + loads[:, taxel, 1] * np.sin(azimuth)
        lever = self.imbalance * (1 + self.imbalance_slope * (normal / _TYPICAL_N - 1))
        force = np.maximum(self.share * normal[:, taxel] + lever[:, taxel] * towards, 0.0)
        relaxed = _relaxed(normal, self.creep_s, rate_hz)
        crept = np.tensordot(self.creep, relaxed, axes=1)
        if self.creep_adds:
            force = force + self.share * (crept * normal.clip(0, _TYPICAL_N))[:, taxel]
            gain = np.ones_like(normal)
        else:
            gain = 1.0 + crept
        gain = gain * (1.0 + self.hysteresis * (1.0 - normal / np.maximum(_peaks(normal), 1e-9)))
        gain = gain * np.maximum(1.0 + self.temperature_per_k * temperature_k, 0.1)[:, np.newaxis]
        above = np.maximum(force - self.dead_n, 0.0)
        if self.law == "percolation":
            conductance = above**self.bend
        else:
            conductance = (
                above / (1 + self.bend * above) if self.bend > 0 else above * (1 - self.bend * above)
            )
        ratio = self.divider * self.gain * gain[:, taxel] * conductance
        volts = self.supply_v * ratio / (1 + ratio)
        mean = np.equal.outer(taxel, taxel) / np.bincount(taxel)[taxel]
        own = volts @ mean
        beside = own @ near[taxel][:, taxel].T / np.bincount(taxel)[taxel]
        return np.asarray(
            volts + self.volts_crosstalk * (own - volts) + self.neighbour_crosstalk * (beside - own)
        )


def draw_sensor(array: Array, rng: np.random.Generator, noise_v: float = 1e-3) -> RigSensor:
    """Draw a sensor for an array of taxels with side electrodes."""
    channels, taxels = array.n_channels, array.n_taxels
    law = _LAWS[int(rng.integers(len(_LAWS)))]
    bend = {
        "percolation": rng.uniform(0.8, 1.25),
        "softening": rng.uniform(0.02, 0.2),
        "stiffening": -rng.uniform(0.02, 0.2),
    }[law]
    per_taxel = np.bincount(array.channel_taxel)[array.channel_taxel]
    return RigSensor(
        array=array,
        law=law,
        bend=float(bend),
        dead_n=rng.uniform(0.0, 0.03) * rng.lognormal(0, 0.2, channels),
        gain=rng.lognormal(0, 0.15, channels),
        share=(1 + rng.normal(0, 0.08, channels)) / per_taxel,
        imbalance=float(rng.uniform(0.2, 0.4)),
        imbalance_slope=float(rng.uniform(-0.15, 0.15)),
        turn_deg=rng.normal(0, 2.0, taxels),
        load_crosstalk=float(rng.uniform(0, 0.08)),
        volts_crosstalk=float(rng.uniform(0, 0.03)),
        neighbour_crosstalk=float(rng.uniform(0, 0.02)),
        creep_s=np.array([rng.uniform(0.5, 3.0), rng.uniform(8.0, 40.0)]),
        creep=rng.uniform(0.002, 0.007, 2),  # 0.4 to 1.5 % each under the typical load
        creep_adds=bool(rng.random() < 0.5),
        hysteresis=float(rng.uniform(0, 0.02)),
        stiffness=rng.lognormal(0, 0.15, taxels),
        divider=float(rng.uniform(0.7, 1.5)),
        supply_v=float(rng.uniform(3.0, 3.6)),
        noise_v=noise_v,
        temperature_per_k=float(rng.uniform(-0.005, -0.001)),
    )


def _neighbours(array: Array) -> FloatArray:
    """Matrix (taxels, taxels) that takes the mean of the taxels beside each one."""
    distance = np.hypot(np.subtract.outer(array.x_mm, array.x_mm), np.subtract.outer(array.y_mm, array.y_mm))
    np.fill_diagonal(distance, np.inf)
    near = (distance < 1.3 * distance.min()).astype(np.float64)
    return np.asarray(near / np.maximum(near.sum(axis=1, keepdims=True), 1.0))


def _relaxed(values: FloatArray, time_s: FloatArray, rate_hz: float) -> FloatArray:
    """Low-passed copies (times, n, taxels) of values (n, taxels)."""
    follow = -np.expm1(-1.0 / (rate_hz * time_s))[:, np.newaxis]
    state = np.zeros((len(time_s), values.shape[1]))
    out = np.empty((len(values), *state.shape))
    for k, row in enumerate(values):
        out[k] = state
        state += follow * (row - state)
    return np.asarray(out.transpose(1, 0, 2))


def _peaks(load: FloatArray) -> FloatArray:
    """Largest load (n, taxels) of each taxel since it was last free."""
    out = np.empty_like(load)
    peak = np.zeros(load.shape[1])
    for k, row in enumerate(load):
        peak = np.where(row <= 0.0, 0.0, np.maximum(peak, row))
        out[k] = peak
    return out
