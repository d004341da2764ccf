"""Evidence for sliding from the changes of the taxels' shares that holding does not make.

Friction differs from place to place of a surface, so that the shear of each taxel that slides wanders on its
own, also where the total shear is silent. In a contact that holds, the shares change only with load and
shear. The changes are Haar details, the mean of the last `HALF` looks less the mean of those before, of the
coif1 approximation. A coif1 detail of the same scale comes 100 ms later and does not see a steady drift.
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.constants import Wander

HALF = 4  # looks of 20 ms: a surface of 0.1 to 1 mm structure passes at 1 to 10 mm/s
_LEAK = 0.05  # part of a common movement that unequal gains leave in the rest; gains differ by 5 to 15 %
_LEAST, _MOST = -1.2, 4.0  # log odds: silence repeats itself, and noise has tails; priors
_N_PATTERNS = 8


class ShareWander:
    """Changes of the shares in one contact.

    Parameters
    ----------
    x, y : (taxels,) float64
        Places from their mean, over their effective radius.
    n_hypotheses : int
    """

    def __init__(self, x: FloatArray, y: FloatArray, n_hypotheses: int) -> None:
        self._x, self._y = x, y
        self._n_free = 2 * len(x) - _N_PATTERNS
        self._measured = np.zeros((2 * HALF, 2 * len(x)))
        self._predicted = np.zeros((2 * HALF, n_hypotheses, 2 * len(x)))
        self._n = 0
        sign = np.repeat([-1.0, 1.0], HALF) / HALF
        self._haar = sign

    def log_odds(
        self, shear: FloatArray, predicted: FloatArray, load: FloatArray, noise_sd: float
    ) -> FloatArray:
        """Return the log likelihood ratio of sliding over sticking, for each hypothesis.

        Parameters
        ----------
        shear : (2, taxels) float64
            Measured shear over the total load.
        predicted : (2, hypotheses, taxels) float64
            In the same unit.
        load : (taxels,) float64
            Over the total load.
        noise_sd : float
            Of one entry of `shear`.

        Returns
        -------
        (hypotheses,) float64
            0 where there are too few taxels or looks to tell.
        """
        n_hypotheses = predicted.shape[1]
        self._n += 1
        self._measured[:-1] = self._measured[1:]
        self._measured[-1] = shear.ravel()
        self._predicted[:-1] = self._predicted[1:]
        self._predicted[-1] = predicted.transpose(1, 0, 2).reshape(n_hypotheses, -1)
        if self._n < 2 * HALF or self._n_free < 1:
            return np.zeros(n_hypotheses)
        # Patterns of the shear before the change: a pattern with the change in it would explain it away.
        before = self._measured[:HALF].mean(axis=0).reshape(2, -1)
        basis = np.linalg.qr(self._patterns(before, load))[0]
        change = self._haar @ self._measured
        expected = np.tensordot(self._haar, self._predicted, axes=1)  # (hypotheses, 2 taxels)
        common = basis @ (basis.T @ change)
        rest = change - expected
        rest -= (rest @ basis) @ basis.T
        variance = 2 * noise_sd**2 / HALF + _LEAK**2 * float(np.mean(common**2)) + 1e-14
        square = (rest**2).sum(axis=1) / self._n_free / variance
        return np.asarray(np.clip(Wander.SLOPE * np.log(square + 1e-3) + Wander.OFFSET, _LEAST, _MOST))

    def _patterns(self, shear: FloatArray, load: FloatArray) -> FloatArray:
        """Return the patterns (2 taxels, patterns) of shifts and turns of a contact that holds."""
        n, stiffness, none = len(load), np.cbrt(load), np.zeros(len(load))
        columns = [
            (load, none),
            (stiffness, none),
            (none, load),
            (none, stiffness),
            (-self._y * stiffness, self._x * stiffness),
            (-self._y * load, self._x * load),
            (shear[0], shear[1]),
            (-shear[1], shear[0]),
        ]
        found = np.array([np.concatenate(column) for column in columns]).T.reshape(2 * n, -1)
        return np.asarray(found / np.maximum(np.sqrt((found**2).sum(axis=0)), 1e-9))
