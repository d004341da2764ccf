"""Loads and shears of the taxels of an array: `Readings` of the front end, made for it."""

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.detect.contact.responses import Responses, relieved_sides
from tactiled.detect.signal.fast import Bank, Jumps, NoiseFloor, Readings
from tactiled.detect.signal.quantise import HeldReadings, Quantiser
from tactiled.detect.signal.stuck_channels import stuck_channels
from tactiled.detect.signal.wavelet import border_scans, taps

# choice: the standard deviation of the noise is read off the detail coefficients of the two finest levels of
# the stationary coif1 transform: all its filters have unit energy, so that white noise has the same standard
# deviation in each (Mallat, A Wavelet Tour of Signal Processing, 3rd ed., 5.5).
NOISE_LEVELS = 2
_NOISE_S = 1.0  # choice: averaging time of the noise
# prior: in which what interpolation between channels leaves counts as noise: the length of a jerk
_HISTORY_S = 0.06
# choice: for which the last good reading stands in; a channel that is bad for longer takes its taxel out.
_HOLD_S = 0.05
_LEAST_KEPT = 0.75  # choice: of the taxels; with fewer, the messages are not valid


class TaxelReadings(Readings):
    """Loads and shears of the taxels.

    Attributes
    ----------
    recent : (n, 3, taxels) float64
        Load, shear along x and along y of the newest scans.
    """

    def __init__(self, array: Array, rate_hz: float) -> None:
        responses, grid = Responses(array), Quantiser(array)
        self.recent = np.zeros((max(1, round(_HISTORY_S * rate_hz)), 3, array.n_taxels))
        self._most_dropped = (1 - _LEAST_KEPT) * array.n_taxels
        self._is_dropped = np.zeros(array.n_taxels, dtype=np.uint8)
        super().__init__(
            stuck_channels(array),
            Bank(array.n_channels, [taps(k + 1) * grid.volts_per_step for k in range(NOISE_LEVELS)]),
            Jumps(responses.taxel_channels.reshape(-1).view(np.uint8), array.n_taxels),
            NoiseFloor(array.n_channels, NOISE_LEVELS, grid.volts_per_step, max(2.0, _NOISE_S * rate_hz)),
            relieved_sides(array),
            responses.own.reshape(-1),
            responses.own_weights.reshape(-1),
            rate_hz,
            grid.volts_per_step,
            max(1, round(_HOLD_S * rate_hz)),
            self._most_dropped,
            border_scans(NOISE_LEVELS),
            self.recent.reshape(-1),
            self._is_dropped,
        )

    def begin_block(self, held: HeldReadings, channel_offset_s: FloatArray) -> None:
        """Take a block, whose scans are then taken one by one."""
        self.begin(held.steps.ravel(), held.ok.ravel().view(np.uint8), channel_offset_s)

    @property
    def keeps_enough(self) -> bool:
        """True where so many taxels can be read that what is said of the contact is valid."""
        return int(np.count_nonzero(self._is_dropped)) <= self._most_dropped
