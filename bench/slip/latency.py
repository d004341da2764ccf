"""Latencies of ``./run bench slip``: each scene played once, read at every noise by every detector."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.slip.limit import growth_by
from bench.slip.noise import Tail
from bench.slip.oracle import Oracle
from bench.slip.rivals import PER_HOUR, Knobs, at_noise
from bench.slip.rules import LEVELS, traces
from bench.slip.scenes import NOISES_V, RATE_HZ, SCAN_SPAN_S, Played, play, slipping_families
from bench.slip.score import Found, median, score_slip
from tactiled.array import load_array

FloatArray = NDArray[np.float64]

# False alarms an hour at which the curve is drawn, around the one that is compared.
CURVE_PER_HOUR = (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0)


@dataclass(frozen=True, eq=False)
class Case:
    """One scene at one noise.

    Attributes
    ----------
    found : dict of str to Found
        By name of the detector.
    oracle_s : (rates,) float64
        Latency of the oracle at `CURVE_PER_HOUR`; NaN is a miss.
    rule_s : dict of (rule, level) to (rates,) float64
        Latency of each threshold rule.
    becoming_s : float
        From `t_shear` to `t_gross`.
    growth : (latencies,) float64
        Of shear over pressure, noise-free, by `slip_limit.LATENCIES_S` after `t_shear`.
    """

    family: str
    seed: int
    noise_v: float
    found: dict[str, Found]
    oracle_s: FloatArray
    rule_s: dict[tuple[str, int], FloatArray]
    becoming_s: float
    growth: FloatArray


def measure(family: str, seed: int, knobs: Knobs, oracle: Tail, names: Sequence[str]) -> list[Case]:
    """All noises of one scene; none where it never slips as a whole.

    Parameters
    ----------
    names : sequence of str
        Detectors to run, of `at_noise`.
    """
    played = play(family, slipping_families()[family], seed)
    if played.slip is None:
        return []
    test, array, cases = Oracle(played), load_array("wang2019-3x3"), []
    growth = growth_by(array, played, played.slip.shear_s)
    for noise_v in NOISES_V:
        block = played.read(noise_v, draw=1)
        found = {
            name: score_slip(rival.build(array, noise_v).process(block), played, played.slip)
            for name, rival in (at_noise(knobs, noise_v) if names else {}).items()
            if name in names
        }
        rule_s = {
            key: _first_s(trace[test.first :], knobs.tails[key], test.first, played)
            for key, trace in traces(array, block, noise_v).items()
        }
        oracle_s = _first_s(test.trace(block, noise_v), oracle, test.first, played)
        becoming_s = played.slip.gross_s - played.slip.shear_s
        cases.append(Case(family, seed, noise_v, found, oracle_s, rule_s, becoming_s, growth))
    return cases


def fastest_level(cases: Sequence[Case], rule: str) -> dict[float, int]:
    """Level with the least median latency at `PER_HOUR`, for each noise; of equals that with fewer misses."""
    at = CURVE_PER_HOUR.index(PER_HOUR)

    def cost(noise_v: float, level: int) -> tuple[float, int]:
        seen = [case.rule_s[rule, level][at] for case in cases if case.noise_v == noise_v]
        return median(seen), int(np.isnan(seen).sum())

    return {noise: min(LEVELS, key=lambda level: cost(noise, level)) for noise in NOISES_V}


def _first_s(trace: FloatArray, tail: Tail, first: int, played: Played) -> FloatArray:
    """First crossing at each rate, since `t_shear`, until the slip is over; NaN where there is none."""
    assert played.slip is not None
    last = int(played.slip.end_s * RATE_HZ) if np.isfinite(played.slip.end_s) else len(trace) + first
    highest = np.maximum.accumulate(trace[: max(last - first, 1)])
    out = np.full(len(CURVE_PER_HOUR), np.nan)
    for k, per_hour in enumerate(CURVE_PER_HOUR):
        at = int(np.searchsorted(highest, tail.threshold(per_hour)))
        if at < len(highest):
            out[k] = (first + at) / RATE_HZ + SCAN_SPAN_S - played.slip.shear_s
    return out
