"""Magnetometer skins drawn at random: fields of magnets in a soft layer that is pressed and sheared."""

from dataclasses import dataclass

import numpy as np

from tactiled.array import Array, FloatArray

_ADC_UT = 0.15  # resolution of a common chip


@dataclass(frozen=True, eq=False)
class MagnetSkin:
    """One drawn skin with three field components at each taxel."""

    array: Array  # three channels a taxel
    linear: FloatArray  # (channels, taxels, 3): field for each newton, uT
    bend: FloatArray  # (channels, taxels): change of the field by the square of the taxel's load, uT/N2
    limit: float  # field at which a channel has bent to three quarters
    # creep_s, creep: time constant, and part of the field that comes with that delay
    creep_s: float
    creep: float
    temperature_per_k: float  # relative change of the field of the magnets
    noise: float  # uT
    stiffness: FloatArray  # (taxels,)

    def readings(
        self,
        loads_n: FloatArray,
        rate_hz: float,
        rng: np.random.Generator,
        temperature_k: FloatArray | float = 0.0,
    ) -> FloatArray:
        """Return the readings (n, channels) for forces (n, taxels, 3), at a temperature over the first."""
        field = np.einsum("ctk,ntk->nc", self.linear, loads_n)
        field += loads_n[:, :, 2] ** 2 @ self.bend.T
        field = self.limit * np.tanh(field / self.limit)
        follow = -np.expm1(-1.0 / (rate_hz * self.creep_s))
        state = np.zeros(field.shape[1])
        for row in field:
            state += follow * (row - state)
            row += self.creep * state
        field *= 1 + self.temperature_per_k * np.broadcast_to(temperature_k, len(field))[:, np.newaxis]
        field += self.noise * rng.standard_normal(field.shape)
        return np.asarray(np.round(field / _ADC_UT) * _ADC_UT)


def draw_magnets(array: Array, rng: np.random.Generator) -> MagnetSkin:
    """Draw a skin: signs and scales of channels differ from print to print."""
    taxels, channels = array.n_taxels, array.n_channels
    near = np.hypot(np.subtract.outer(array.x_mm, array.x_mm), np.subtract.outer(array.y_mm, array.y_mm))
    reach_mm = rng.uniform(4.0, 9.0)
    kernel = np.exp(-((near / reach_mm) ** 2))[array.channel_taxel]
    return MagnetSkin(
        array=array,
        linear=rng.normal(0, 60.0, (channels, taxels, 3)) * kernel[:, :, np.newaxis],
        bend=rng.normal(0, 1.5, (channels, taxels)) * kernel,
        limit=float(rng.uniform(1500.0, 4000.0)),
        creep_s=float(rng.uniform(1.0, 20.0)),
        creep=float(rng.uniform(0.0, 0.03)),
        temperature_per_k=float(rng.uniform(-0.003, -0.001)),  # of bonded magnets
        noise=float(rng.uniform(0.5, 2.0)),
        stiffness=rng.lognormal(0, 0.15, taxels),
    )
