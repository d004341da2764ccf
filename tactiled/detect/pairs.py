"""What pairs of opposed channels say together: R1 against R3, R2 against R4, over the taxels in contact."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray

# Weights are multiples of 2^-20, so that sums of weighted readings (whole steps within 2^23, some hundreds of
# channels) stay below 2^53 and exact. It costs a millionth of a response.
_WEIGHT_SCALE = 2.0**20


def whole_weights(weights: FloatArray) -> FloatArray:
    """Weights rounded to the grid on which sums of readings are exact."""
    return np.asarray(np.rint(weights * _WEIGHT_SCALE) / _WEIGHT_SCALE)


class PairResponse:
    """Opposed and common movement of an array's channels.

    Parameters
    ----------
    array : Array
    """

    def __init__(self, array: Array) -> None:
        self._weights = whole_weights(array.shear_weights())  # (2, taxels, channels)
        self._sizes = np.abs(self._weights).sum(axis=2)  # (2, taxels)
        self._common = array.normal_weights()  # (taxels, channels)
        # A taxel with one resistor of a pair missing would take pressure for shear.
        self._needs = (self._weights != 0).any(axis=0).astype(np.float64)

    def whole_taxels(self, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Taxels (taxels,) of which every shear channel is usable (channels,)."""
        complete: NDArray[np.bool_] = (self._needs @ ~usable) == 0
        return complete

    def motion_weights(self, taxels: NDArray[np.bool_]) -> FloatArray:
        """Weights (2, channels) of the summed response (x, y) of some taxels."""
        return np.asarray(self._weights[:, taxels].sum(axis=1))

    def opposed_and_common(self, volts: FloatArray, taxels: NDArray[np.bool_]) -> tuple[float, float]:
        """Size of the opposed and of the common part, both as the mean over the channels that have a share.

        Parameters
        ----------
        volts : (channels,) float64
            One coefficient or reading of each channel.
        taxels : (taxels,) bool
            Those that count.
        """
        responses = (self._weights @ volts)[:, taxels].sum(axis=1)
        opposed = responses / np.maximum(self._sizes[:, taxels].sum(axis=1), 1e-12)
        common = (self._common @ volts)[taxels].sum() / max(int(taxels.sum()), 1)
        return float(np.hypot(*opposed)), abs(float(common))
