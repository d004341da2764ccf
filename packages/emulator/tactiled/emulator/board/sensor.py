"""Conversion of a scene to the counts that the board's ADC reads, through array and electronics."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.emulator.board import electronics
from tactiled.emulator.board.noise import ScanNoise
from tactiled.emulator.scene.contact import make_contact
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.physical import PhysicalContact


class Sensor:
    """Counts of every channel at given instants of scene time.

    With `span`, the readings of no and of all counts in the unit of the array, the sensor converts counts
    itself; an array in newtons then reads the force on the skin, without rubber and divider. `ConfigError`
    for a contact model that cannot play the scene.
    """

    def __init__(
        self,
        scene: Scene,
        array: Array,
        *,
        adc_bits: int,
        adc_reference_v: float,
        span: tuple[float, float] | None = None,
    ) -> None:
        self._params = scene.electronics
        self._motion = SceneMotion(scene)
        self.contact = make_contact(self._motion, array)
        self.reacts = scene.held_object is not None
        self._noise = ScanNoise(scene.seed, array.n_channels)
        self._bits, self._reference_v = adc_bits, adc_reference_v
        self._span = span
        self._reads_force = span is not None and array.unit == "N"
        self._force_sign = np.where(np.char.startswith(array.channel_kind, "shear"), 1.0, array.sign)
        kinds = np.array(array.channel_kind)
        self._is_side = kinds == "side"
        self._side_taxel = array.channel_taxel[self._is_side]
        self._side_azimuth_deg = array.azimuth_deg[self._is_side]
        self._is_shear = (kinds == "shear_x") | (kinds == "shear_y")
        self._is_inverted = (array.sign < 0) & ~self._is_shear  # wired to the supply, not to ground

    def volts(self, time_s: FloatArray) -> FloatArray:
        """Volts at the ADC before noise; ``time_s`` and result are (n, channels)."""
        params = self._params
        force_n, relaxed_n = self.contact.forces(time_s)
        if isinstance(self.contact, PhysicalContact) and self._is_side.any():
            quarter_n = electronics.quarter_n(force_n[:, self._is_side])
            force_n = force_n.copy()
            force_n[:, self._is_side] = electronics.spread_n(
                params, quarter_n, self._side_taxel, self._side_azimuth_deg
            )
        crept = force_n * electronics.creep_gain(params, relaxed_n)
        conductance = electronics.conductance_s(params, crept)
        conductance *= electronics.temperature_gain(self._motion.temperature_k(time_s))
        volts = electronics.divider_v(params, conductance)
        volts = np.where(self._is_inverted, self._reference_v - volts, volts)
        return np.where(self._is_shear, electronics.shear_v(crept, self._reference_v), volts)

    def counts(self, first: int, time_s: FloatArray) -> NDArray[np.int64] | FloatArray:
        """Counts of scans ``first``, ``first + 1``, ... sampled at `time_s` (n, channels)."""
        noise = self._params.noise_v * self._noise.normal(first, len(time_s))
        if self._span is not None and self._reads_force:
            low, high = self._span
            force_n = self.contact.forces(time_s)[0] * self._force_sign
            noisy_n = force_n + noise * ((high - low) / self._reference_v)
            return np.asarray(np.clip(noisy_n, low, high).round(4), dtype=np.float64)  # 0.1 mN, to be printed
        counts = electronics.adc_counts(self.volts(time_s) + noise, self._bits, self._reference_v)
        if self._span is None:
            return counts
        low, high = self._span
        return np.asarray(low + counts * ((high - low) / 2**self._bits), dtype=np.float64)
