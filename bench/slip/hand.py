"""``python -m bench.slip.hand``: false alarms of a hand that moves unannounced (`detect.slip_rate`).

Every family without slip counts as long as every other. Tune seeds only: the curve is part of the detector.
"""

import sys
from collections.abc import Callable, Iterator

from bench.pool import workers
from bench.slip.quiet import QUIET_NOISES_V
from bench.slip.scenes import play
from bench.slip.score import tally
from tactiled.array import load_array
from tactiled.detect.slip.coherent import CoherentParams, CoherentSlip
from tactiled.emulator.scene.families import QUIET

SHEARS = (0.005, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
_SEEDS = range(1001, 1025)
_LONG = ("thermal-drift", "persistent-contact")  # minutes each, and hardly an alarm: a few seeds do
_LONG_SEEDS = _SEEDS[:2]
_NOISE_PER_HOUR = 1.0  # as of `fast`: none is seen in the quarter of an hour of a family

Row = tuple[float, ...]


def one_scene(family: str, seed: int) -> tuple[str, float, Row]:
    """Hours of a scene at all noises, and false alarms at each of `SHEARS`; none where something slips."""
    played = play(family, QUIET[family], seed)
    if played.slip is not None:
        return family, 0.0, (0.0,) * len(SHEARS)
    array, counts = load_array("wang2019-3x3"), [0.0] * len(SHEARS)
    for noise_v in QUIET_NOISES_V:
        block = played.read(noise_v, draw=1)
        for k, shear in enumerate(SHEARS):
            params = CoherentParams(false_alarms_per_hour=_NOISE_PER_HOUR, least_shear=shear)
            counts[k] += tally(CoherentSlip(array, params).process(block), played).false
    return family, len(QUIET_NOISES_V) * played.duration_s / 3600, tuple(counts)


def curve(parts: Iterator[tuple[str, float, Row]]) -> Row:
    """Rates an hour at each of `SHEARS`, mean of the families; never more where more is waited for."""
    hours = dict.fromkeys(QUIET, 0.0)
    counts = {family: [0.0] * len(SHEARS) for family in QUIET}
    for family, more, found in parts:
        hours[family] += more
        counts[family] = [a + b for a, b in zip(counts[family], found, strict=True)]
    rates = [sum(counts[f][k] / hours[f] for f in QUIET) / len(QUIET) for k in range(len(SHEARS))]
    return tuple(min(rates[: k + 1]) for k in range(len(rates)))


def main(say: Callable[[str], object]) -> None:
    """Print the table for `detect.slip_rate`."""
    tasks = [(f, seed) for f in QUIET for seed in (_LONG_SEEDS if f in _LONG else _SEEDS)]
    with workers() as pool:
        rates = curve(pool.map(one_scene, *zip(*tasks, strict=True)))
    for shear, rate in zip(SHEARS, rates, strict=True):
        say(f"least_shear {shear:g}: {rate:.3g} an hour\n")


if __name__ == "__main__":
    main(sys.stdout.write)
