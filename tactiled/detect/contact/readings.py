"""Loads and shears of the taxels: which channels make them, and `Readings` of the front end for an array."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.contact_gate import ContactTracker
from tactiled.detect.signal.fast import Bank, Jumps, NoiseFloor, Readings, RelievedSides
from tactiled.detect.signal.quantise import Quantiser
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


def own_channels(weights: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the few channels that make each response, and their weights.

    Parameters
    ----------
    weights : (kinds, taxels, channels) float64

    Returns
    -------
    (n, kinds, taxels) int64, (n, kinds, taxels) float64
        Indices and weights; a weight is 0 where a response has fewer channels.
    """
    n_most = max(1, int(np.count_nonzero(weights, axis=2).max()))
    own = np.argsort(weights == 0, axis=2, kind="stable")[..., :n_most]
    own_weights = np.take_along_axis(weights, own, axis=2)
    return (
        np.ascontiguousarray(own.transpose(2, 0, 1), dtype=np.int64),
        np.ascontiguousarray(own_weights.transpose(2, 0, 1)),
    )


def response_weights(array: Array) -> FloatArray:
    """Return weights (3, taxels, channels) that make load, shear along x and along y of the taxels.

    Shear is the force of the object on the skin, so that it opposes the motion of the skin.
    """
    return np.concatenate([array.normal_weights()[np.newaxis], -array.shear_weights()])


def relieved_sides(array: Array) -> RelievedSides | None:
    """Return the correction of taxels with relieved sides; None where taxels have no opposed sides."""
    is_side = np.array(array.channel_kind) == "side"
    shear = -array.shear_weights()
    sides = np.concatenate([np.maximum(shear, 0.0), np.maximum(-shear, 0.0)]) * is_side
    even = sides.sum(axis=2).reshape(-1)
    if not np.all(even > 0):
        return None
    own, weights = own_channels(sides)
    return RelievedSides(own.reshape(-1), weights.reshape(-1), even)


class TaxelReadings(Readings):
    """Loads and shears of the taxels.

    Attributes
    ----------
    recent : (n, 3, taxels) float64
        Load, shear along x and along y of the newest scans.
    """

    def __init__(self, array: Array, rate_hz: float) -> None:
        weights, grid = response_weights(array), Quantiser(array)
        own, own_weights = own_channels(weights)
        self.recent = np.zeros((max(1, round(_HISTORY_S * rate_hz)), 3, array.n_taxels))
        self._most_dropped = (1 - _LEAST_KEPT) * array.n_taxels
        self._is_dropped = np.zeros(array.n_taxels, dtype=np.uint8)
        self._n_room, self._offset_s = 0, np.zeros(0)
        super().__init__(
            stuck_channels(array),
            Bank(array.n_channels, [taps(k + 1) * grid.volts_per_step for k in range(NOISE_LEVELS)]),
            Jumps(np.any(weights != 0, axis=0).reshape(-1).view(np.uint8), array.n_taxels),
            NoiseFloor(array.n_channels, NOISE_LEVELS, grid.volts_per_step, max(2.0, _NOISE_S * rate_hz)),
            relieved_sides(array),
            own.reshape(-1),
            own_weights.reshape(-1),
            rate_hz,
            grid.volts_per_step,
            max(1, round(_HOLD_S * rate_hz)),
            self._most_dropped,
            border_scans(NOISE_LEVELS),
            self.recent.reshape(-1),
            self._is_dropped,
        )

    def follow(self, gate: ContactTracker, channel_offset_s: FloatArray) -> None:
        """Take the scans of a block from where the contact gate holds them, one by one."""
        if gate.n_room != self._n_room or channel_offset_s is not self._offset_s:
            self.begin(np.asarray(gate.steps), np.asarray(gate.ok), channel_offset_s)
            self._n_room, self._offset_s = gate.n_room, channel_offset_s

    @property
    def keeps_enough(self) -> bool:
        """True where so many taxels can be read that what is said of the contact is valid."""
        return int(np.count_nonzero(self._is_dropped)) <= self._most_dropped
