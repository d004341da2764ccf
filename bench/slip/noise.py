"""False alarms in white noise: thresholds for a wanted rate, from hours of simulated holds.

Hours of computing would be needed to count one alarm an hour for every statistic. The tail is extrapolated
instead: the logarithm of the rate is a straight line in the squared threshold (Rice's formula for the
crossings of a Gaussian process, BSTJ 24, 1945; the maximum of several has the same slope). The line is fitted
to the largest maxima; down to `NoiseTail.counted_per_hour` it is a measurement.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.slip.oracle import Oracle
from bench.slip.rules import HOLD_OFF_S, traces
from bench.slip.scenes import ADC_BITS, ADC_REFERENCE_V, ARRAY, RATE_HZ, block_of
from tactiled.array import FloatArray
from tactiled.emulator.board.electronics import adc_counts

PIECE_S = 600.0  # computed at once: bounds memory
_FITTED = 300  # largest maxima that the line is fitted to: the slope is then good to about 6 %
_HOLD_V = 1.2  # reading of a channel in a hold of 20 N: noise does not reach either end of the ADC
_NOISE_V = 1e-3  # more than the rounding of the ADC; in units of sigma the tail is the same for all noises


@dataclass(frozen=True)
class NoiseTail:
    """``log(rate) = intercept - slope * threshold^2``, rate in false alarms an hour.

    Attributes
    ----------
    counted_per_hour : float
        Lowest rate that was counted; below it the line is extrapolated.
    """

    intercept: float
    slope: float
    counted_per_hour: float

    def threshold(self, per_hour: float) -> float:
        """Threshold for a rate, in units of sigma."""
        return float(np.sqrt(max((self.intercept - np.log(per_hour)) / self.slope, 0.0)))

    def per_hour(self, threshold: FloatArray) -> FloatArray:
        """Rates (n,) at thresholds (n,)."""
        return np.asarray(np.exp(self.intercept - self.slope * threshold**2))


def fit_tail(maxima: FloatArray, hours: float) -> NoiseTail:
    """Fit the line to maxima of stretches of time that are nearly independent."""
    largest = np.sort(maxima)[::-1][:_FITTED]
    rate = np.arange(1, len(largest) + 1) / hours
    # Each rate is a count of k: its logarithm has variance 1/k (Poisson).
    slope, intercept = np.polyfit(largest**2, np.log(rate), 1, w=np.sqrt(np.arange(1, len(largest) + 1)))
    return NoiseTail(float(intercept), float(-slope), 1.0 / hours)


def maxima(trace: FloatArray) -> FloatArray:
    """Largest value of every `HOLD_OFF_S` of a trace."""
    step = round(HOLD_OFF_S * RATE_HZ)
    whole = trace[: len(trace) // step * step]
    return np.asarray(whole.reshape(-1, step).max(axis=1))


RuleMaxima = dict[tuple[str, int], FloatArray]


def n_pieces(hours: float) -> int:
    """Number of pieces of `PIECE_S`."""
    return max(1, round(hours * 3600 / PIECE_S))


def rule_maxima(piece: int, seed: int) -> RuleMaxima:
    """`maxima` of every rule at every level in one piece of a hold."""
    shape = (round(PIECE_S * RATE_HZ), ARRAY.n_channels)
    noise = np.random.default_rng([seed, piece]).standard_normal(shape)
    counts = adc_counts(_HOLD_V + _NOISE_V * noise, ADC_BITS, ADC_REFERENCE_V)
    return {key: maxima(trace) for key, trace in traces(ARRAY, block_of(counts), _NOISE_V).items()}


def rule_tails(pieces: Sequence[RuleMaxima]) -> dict[tuple[str, int], NoiseTail]:
    """Tails of every rule at every level."""
    return {key: _fit_pieces([piece[key] for piece in pieces]) for key in pieces[0]}


def oracle_tail(oracles: Sequence[Oracle], hours: float, seed: int) -> NoiseTail:
    """Tail of all oracles together: it hardly depends on the shape."""
    pieces = []
    n = round(hours * 3600 * RATE_HZ / len(oracles))
    for number, oracle in enumerate(oracles):
        noise = np.random.default_rng([seed, number, 7]).standard_normal((n, oracle.n_combinations))
        pieces.append(maxima(oracle.noise_trace(noise)))
    return _fit_pieces(pieces)


def _fit_pieces(pieces: Sequence[FloatArray]) -> NoiseTail:
    every = np.concatenate(pieces)
    return fit_tail(every, len(every) * HOLD_OFF_S / 3600)
