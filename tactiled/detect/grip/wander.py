"""Evidence for sliding from the changes of the taxels' shares that holding does not make.

Friction differs from place to place of a surface, so that the shear of each taxel that slides wanders on its
own, also where the total shear is silent. In a contact that holds, the shares change only with load and
shear. The changes are Haar details, the mean of the last `HALF` looks less the mean of those before, of the
coif1 approximation. A coif1 detail of the same scale comes 100 ms later and does not see a steady drift.

`compiled_grip.c` does the same with the same bits. Sums over looks, taxels and patterns therefore run over an
axis before that of the hypotheses or are accumulated, so that numpy adds one term after the other.
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.constants import Wander
from tactiled.detect.grip.elementary import cbrt, log, sum_in_order

HALF = 4  # looks of 20 ms: a surface of 0.1 to 1 mm structure passes at 1 to 10 mm/s
_LEAK = 0.05  # part of a common movement that unequal gains leave in the rest; gains differ by 5 to 15 %
_LEAST, _MOST = -1.2, 4.0  # log odds: silence repeats itself, and noise has tails; priors
_N_PATTERNS = 8
_SAME = 1e-6  # part of a pattern that others do not have, below which it is their sum: rounding leaves 1e-15
_LEAST_NORM = 1e-9  # of a pattern of forces over the total load
_LEAST_VARIANCE, _LEAST_SQUARE = 1e-14, 1e-3  # without noise and change


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
        self._measured = np.zeros((2 * HALF, 2 * len(x)))
        self._predicted = np.zeros((2 * HALF, 2 * len(x), n_hypotheses))
        self._n = 0
        self._haar = np.repeat([-1.0, 1.0], HALF) / HALF

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
        n_hypotheses, n_taxels = predicted.shape[1:]
        odds = np.zeros(n_hypotheses)
        self._n += 1
        can_tell = self._n >= 2 * HALF and 2 * n_taxels > _N_PATTERNS
        stiffness = cbrt(load)
        self._measured[:-1] = self._measured[1:]
        self._measured[-1] = shear.ravel()
        self._predicted[:-1] = self._predicted[1:]
        self._predicted[-1] = predicted.swapaxes(1, 2).reshape(2 * n_taxels, -1)
        if not can_tell:
            return odds
        # Patterns of the shear before the change: a pattern with the change in it would explain it away.
        before = (self._measured[:HALF].sum(axis=0) / HALF).reshape(2, -1)
        basis = _orthonormal(self._patterns(before, load, stiffness))
        change = (self._haar[:, np.newaxis] * self._measured).sum(axis=0)
        expected = (self._haar[:, np.newaxis, np.newaxis] * self._predicted).sum(axis=0)
        common = _project(basis, change)
        rest = change[:, np.newaxis] - expected  # (2 taxels, hypotheses)
        along = (basis[:, :, np.newaxis] * rest).sum(axis=1)
        rest -= (along[:, np.newaxis] * basis[:, :, np.newaxis]).sum(axis=0)
        explained = _LEAK * _LEAK * (sum_in_order(common**2) / len(common))
        variance = 2 * (noise_sd * noise_sd) / HALF + explained + _LEAST_VARIANCE
        square = (rest**2).sum(axis=0) / (2 * n_taxels - len(basis)) / variance
        return np.asarray(np.clip(Wander.SLOPE * log(square + _LEAST_SQUARE) + Wander.OFFSET, _LEAST, _MOST))

    def _patterns(self, shear: FloatArray, load: FloatArray, stiffness: FloatArray) -> FloatArray:
        """Return the patterns (patterns, 2 taxels) of shifts and turns of a contact that holds."""
        none = np.zeros(len(load))
        rows = [
            (load, none),
            (stiffness, none),
            (none, load),
            (none, stiffness),
            (-self._y * stiffness, self._x * stiffness),
            (-self._y * load, self._x * load),
            (shear[0], shear[1]),
            (-shear[1], shear[0]),
        ]
        return np.array([np.concatenate(row) for row in rows])


def _orthonormal(patterns: FloatArray) -> FloatArray:
    """Return an orthonormal basis (rank, n) of patterns (k, n), by Gram and Schmidt.

    Each projection is done twice, because the first one leaves rounding of nearly equal patterns.
    """
    basis = np.zeros((0, patterns.shape[1]))
    for pattern in patterns:
        rest = pattern / max(_norm(pattern), _LEAST_NORM)
        for _ in range(2):
            rest = rest - _project(basis, rest)
        if (size := _norm(rest)) > _SAME:
            basis = np.concatenate([basis, rest[np.newaxis] / size])
    return basis


def _project(basis: FloatArray, values: FloatArray) -> FloatArray:
    """Return the part of the values (n,) that lies in a basis (k, n)."""
    along = np.add.accumulate(basis * values, axis=1)[:, -1:]
    return np.asarray((along * basis).sum(axis=0))


def _norm(values: FloatArray) -> float:
    return float(np.sqrt(sum_in_order(values**2)))


def wander_numbers() -> FloatArray:
    """Return the constants of `ShareWander` in the order of `struct wander_numbers`."""
    least = _LEAST_NORM, _SAME, _LEAK, _LEAST_VARIANCE, _LEAST_SQUARE
    return np.array([*least, Wander.SLOPE, Wander.OFFSET, _LEAST, _MOST])
