"""``python -m bench.slip.hand``: false alarms of unannounced motion, the table in `detect.slip.alarm_rate`.

All families without slip have equal weight. The table is part of the detector, therefore it is measured on
tuning seeds only.
"""

import sys
from collections.abc import Callable, Iterable

from bench.slip.quiet import HOLD, QUIET_NOISES_V
from bench.slip.scenes import ARRAY, play
from bench.slip.score import count_alarms
from tactiled.detect.slip.detector import CoherentParams, CoherentSlip
from tactiled.emulator.scene.families import QUIET
from tactiled.jobs import executor

SHEARS = (0.005, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
_SEEDS = range(1001, 1025)
_LONG = ("thermal-drift", HOLD)  # minutes each with hardly an alarm: a few seeds suffice
_LONG_SEEDS = _SEEDS[:2]
_NOISE_PER_HOUR = 1.0  # as in setting `fast`: a family has a quarter of an hour, so none is expected

Row = tuple[float, ...]


def one_scene(family: str, seed: int) -> tuple[str, float, Row]:
    """Family, hours at all noises, false alarms at each of `SHEARS`; zeros where the scene slips."""
    played = play(family, QUIET[family], seed)
    if played.slip is not None:
        return family, 0.0, (0.0,) * len(SHEARS)
    counts = [0.0] * len(SHEARS)
    for noise_v in QUIET_NOISES_V:
        block = played.read(noise_v, draw=1)
        for k, shear in enumerate(SHEARS):
            params = CoherentParams(false_alarms_per_hour=_NOISE_PER_HOUR, least_shear=shear)
            counts[k] += count_alarms(CoherentSlip(ARRAY, params).process(block), played).n_false
    return family, len(QUIET_NOISES_V) * played.duration_s / 3600, tuple(counts)


def curve(scenes: Iterable[tuple[str, float, Row]]) -> Row:
    """Rates an hour at each of `SHEARS`, the mean of the families, made monotonic."""
    hours = dict.fromkeys(QUIET, 0.0)
    counts = {family: [0.0] * len(SHEARS) for family in QUIET}
    for family, more, found in scenes:
        hours[family] += more
        counts[family] = [a + b for a, b in zip(counts[family], found, strict=True)]
    rates = [sum(counts[f][k] / hours[f] for f in QUIET) / len(QUIET) for k in range(len(SHEARS))]
    return tuple(min(rates[: k + 1]) for k in range(len(rates)))


def main(write: Callable[[str], object]) -> None:
    """Print the table for `detect.slip.alarm_rate`."""
    scenes = [(f, seed) for f in QUIET for seed in (_LONG_SEEDS if f in _LONG else _SEEDS)]
    with executor(2) as pool:
        rates = curve(pool.map(one_scene, *zip(*scenes, strict=True)))
    for shear, rate in zip(SHEARS, rates, strict=True):
        write(f"least_shear {shear:g}: {rate:.3g} an hour\n")


if __name__ == "__main__":
    main(sys.stdout.write)
