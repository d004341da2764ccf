"""False alarms in white noise: thresholds for a wanted rate, from hours of simulated holds.

One rate an hour cannot be counted in minutes of computing for every rule, so the tail is followed: the
logarithm of the rate is a straight line in the squared threshold (Rice's formula for the crossings of a
Gaussian process, BSTJ 24, 1945; of the maximum of several, the slope is the same). The line is fitted to the
largest maxima that were seen; `Tail.seen_to_per_hour` says down to which rate that is measurement.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.slip.oracle import Oracle
from bench.slip.rules import HOLD_OFF_S, traces
from bench.slip.scenes import ADC_BITS, LSB_V, RATE_HZ, block_of
from tactiled.array import load_array
from tactiled.emulator.board.electronics import adc_counts

FloatArray = NDArray[np.float64]

PIECE_S = 600.0  # played at once: bounds memory
_FITTED = 300  # largest maxima that the line is fitted to: the slope is then good to about 6 %
_HOLD_V = 1.2  # reading of a channel in a hold of 20 N: noise does not reach either end of the ADC
NOISE_V = 1e-3  # above the rounding of the ADC; in units of sigma the tail is the same for all


@dataclass(frozen=True)
class Tail:
    """``log(rate) = intercept - slope * threshold^2``, rate in false alarms an hour.

    Attributes
    ----------
    seen_to_per_hour : float
        Lowest rate that was measured; below it the line is continued.
    """

    intercept: float
    slope: float
    seen_to_per_hour: float

    def threshold(self, per_hour: float) -> float:
        """For a wanted rate, in units of sigma."""
        return float(np.sqrt(max((self.intercept - np.log(per_hour)) / self.slope, 0.0)))

    def per_hour(self, threshold: FloatArray) -> FloatArray:
        """Rates at thresholds (n,)."""
        return np.asarray(np.exp(self.intercept - self.slope * threshold**2))


def fit_tail(maxima: FloatArray, hours: float) -> Tail:
    """Tail from maxima of stretches of time that are as good as independent."""
    largest = np.sort(maxima)[::-1][:_FITTED]
    rate = np.arange(1, len(largest) + 1) / hours
    # Each rate is a count of k: its logarithm has variance 1/k (Poisson).
    slope, intercept = np.polyfit(largest**2, np.log(rate), 1, w=np.sqrt(np.arange(1, len(largest) + 1)))
    return Tail(float(intercept), float(-slope), 1.0 / hours)


def maxima(trace: FloatArray) -> FloatArray:
    """Largest value of every `HOLD_OFF_S` of a trace."""
    step = round(HOLD_OFF_S * RATE_HZ)
    whole = trace[: len(trace) // step * step]
    return np.asarray(whole.reshape(-1, step).max(axis=1))


Maxima = dict[tuple[str, int], FloatArray]


def rule_pieces(hours: float) -> int:
    """Pieces of `PIECE_S` in so many hours."""
    return max(1, round(hours * 3600 / PIECE_S))


def rule_maxima(piece: int, seed: int, array: str = "wang2019-3x3") -> Maxima:
    """`maxima` of every rule at every level in one piece of a hold."""
    worn = load_array(array)
    noise = np.random.default_rng([seed, piece]).standard_normal((round(PIECE_S * RATE_HZ), worn.n_channels))
    counts = adc_counts(_HOLD_V + NOISE_V * noise, ADC_BITS, LSB_V * 2**ADC_BITS)
    return {key: maxima(trace) for key, trace in traces(worn, block_of(counts), NOISE_V).items()}


def rule_tails(pieces: Sequence[Maxima]) -> dict[tuple[str, int], Tail]:
    """Tails of every rule at every level."""
    return {key: _fitted([piece[key] for piece in pieces]) for key in pieces[0]}


def oracle_tail(oracles: Sequence[Oracle], hours: float, seed: int) -> Tail:
    """One tail for all oracles: shapes differ, what noise alone makes of them hardly does."""
    found = []
    share = round(hours * 3600 * RATE_HZ / len(oracles))
    for number, oracle in enumerate(oracles):
        noise = np.random.default_rng([seed, number, 7]).standard_normal((share, oracle.n_combinations))
        found.append(maxima(oracle.noise_trace(noise)))
    return _fitted(found)


def _fitted(parts: Sequence[FloatArray]) -> Tail:
    every = np.concatenate(parts)
    return fit_tail(every, len(every) * HOLD_OFF_S / 3600)
