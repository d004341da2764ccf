"""Slips of ``./run bench slip``: each scene is played once and read at every noise by every detector."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.slip.detectors import PER_HOUR, Tuning, detectors_at
from bench.slip.growth import LATENCIES_S, Exceedances, alarms_per_hour, growth_after
from bench.slip.noise import NoiseTail
from bench.slip.oracle import Oracle
from bench.slip.rules import LEVELS, traces
from bench.slip.scenes import ALL_SLIPPING, ARRAY, NOISES_V, RATE_HZ, SCAN_SPAN_S, PlayedScene, play
from bench.slip.score import SlipScore, median, score_slip
from tactiled.array import FloatArray
from tactiled.emulator.scene.families import HELD_OUT_SLIPPING

CURVE_PER_HOUR = (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0)  # false alarms an hour at which curves are drawn
ORACLE = "oracle"
SLOW_S = 0.05  # an event can precede gross slip where the slip takes this long to become gross


@dataclass(frozen=True, eq=False)
class SlipReading:
    """One scene with a slip at one noise.

    Attributes
    ----------
    scores : dict of str to SlipScore
        By name of the detector.
    oracle_s : (rates,) float64
        Latency of the oracle at `CURVE_PER_HOUR`; NaN is a miss.
    rule_s : dict of (rule, level) to (rates,) float64
        Latency of each threshold rule.
    to_gross_s : float
        From the beginning of shear to gross slip.
    growth : (latencies,) float64
        Noise-free growth of shear over pressure by `growth.LATENCIES_S` after the beginning of shear.
    """

    family: str
    seed: int
    noise_v: float
    scores: dict[str, SlipScore]
    oracle_s: FloatArray
    rule_s: dict[tuple[str, int], FloatArray]
    to_gross_s: float
    growth: FloatArray

    @property
    def is_held_out(self) -> bool:
        """Return whether nothing was set on the family."""
        return self.family in HELD_OUT_SLIPPING

    def latency_s(self, name: str) -> float:
        """Latency of a detector's first event, or the oracle's; NaN is a miss."""
        if name == ORACLE:
            return float(self.oracle_s[CURVE_PER_HOUR.index(PER_HOUR)])
        return self.scores[name].latency_s


def read_slips(
    tuning: Tuning, oracle: NoiseTail, names: tuple[str, ...], family: str, seed: int
) -> list[SlipReading]:
    """One scene read at all noises by the detectors of these names; nothing where it has no gross slip."""
    played = play(family, ALL_SLIPPING[family], seed)
    if played.slip is None:
        return []
    test, readings = Oracle(played), []
    growth = growth_after(ARRAY, played, played.slip.shear_s)
    for noise_v in NOISES_V:
        block = played.read(noise_v, draw=1)
        scores = {
            name: score_slip(detector.build(ARRAY, noise_v).process(block), played, played.slip)
            for name, detector in detectors_at(tuning, noise_v, names).items()
        }
        rule_s = {
            key: _crossings_s(trace[test.first :], tuning.tails[key], test.first, played)
            for key, trace in traces(ARRAY, block, noise_v).items()
        }
        oracle_s = _crossings_s(test.trace(block, noise_v), oracle, test.first, played)
        to_gross_s = played.slip.gross_s - played.slip.shear_s
        readings.append(SlipReading(family, seed, noise_v, scores, oracle_s, rule_s, to_gross_s, growth))
    return readings


def fastest_level(slips: Sequence[SlipReading], rule: str) -> dict[float, int]:
    """Level with the least median latency at `PER_HOUR` for each noise; of equals that with fewer misses."""
    column = CURVE_PER_HOUR.index(PER_HOUR)

    def cost(noise_v: float, level: int) -> tuple[float, int]:
        latency_s = [slip.rule_s[rule, level][column] for slip in slips if slip.noise_v == noise_v]
        return median(latency_s), int(np.isnan(latency_s).sum())

    return {noise: min(LEVELS, key=lambda level: cost(noise, level)) for noise in NOISES_V}


def growth_quantile(slips: Sequence[SlipReading], latency_s: float, part: float) -> float:
    """Growth that this part of all slips have reached; between `LATENCIES_S`, that at the longer one."""
    row = min(int(np.searchsorted(LATENCIES_S, latency_s - 1e-9)), len(LATENCIES_S) - 1)
    return float(np.quantile([slip.growth[row] for slip in slips], 1 - part))


def bound_per_hour(
    slips: Sequence[SlipReading], quiet: Sequence[Exceedances], latency_s: float, part: float
) -> float:
    """Fewest false alarms an hour with which this part of all slips can be reported by a latency."""
    return alarms_per_hour(quiet, latency_s, growth_quantile(slips, latency_s, part))


def _crossings_s(trace: FloatArray, tail: NoiseTail, first: int, played: PlayedScene) -> FloatArray:
    """Latency of the first crossing at each of `CURVE_PER_HOUR` until the slip is over; NaN is a miss."""
    assert played.slip is not None
    last = int(played.slip.end_s * RATE_HZ) if np.isfinite(played.slip.end_s) else len(trace) + first
    highest = np.maximum.accumulate(trace[: max(last - first, 1)])
    latency_s = np.full(len(CURVE_PER_HOUR), np.nan)
    for k, per_hour in enumerate(CURVE_PER_HOUR):
        at = int(np.searchsorted(highest, tail.threshold(per_hour)))
        if at < len(highest):
            latency_s[k] = (first + at) / RATE_HZ + SCAN_SPAN_S - played.slip.shear_s
    return latency_s
