"""Picture of ``./run bench slip``: latency against false alarms."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.slip.detectors import SWEEP_NOISE_V, Tuning, compared_detectors, sweep
from bench.slip.growth import LATENCIES_S, Exceedances
from bench.slip.quiet import GROUPS, QuietReading, alarm_rate
from bench.slip.score import quantile
from bench.slip.slips import SlipReading, bound_per_hour
from bench.slip.tables import at_noise, latencies_s

_SETTING_COLOURS = ("#c0392b", "#e67e22", "#8e44ad", "#d4ac0d")
_QUANTILES = (0.5, 0.95)
_PUBLISHED = "paper, threshold tuned"

Slips = Sequence[SlipReading]


def draw_slip(
    path: Path,
    slips: Slips,
    quiet: Sequence[QuietReading],
    exceedances: Mapping[str, Exceedances],
    tuning: Tuning,
) -> None:
    """Write the picture: what users choose from, latency against false alarms at the board's own noise.

    A setting is a bar from its median latency to its 95 % quantile. Hollow: the hand's own motion announced.
    """
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    _draw_choice(figure.subplots(), slips, quiet, exceedances, tuning)
    figure.savefig(path, dpi=110)


def _draw_choice(
    axes: Axes,
    slips: Slips,
    quiet: Sequence[QuietReading],
    exceedances: Mapping[str, Exceedances],
    tuning: Tuning,
) -> None:
    is_tuned = GROUPS["tuned on"]
    mine = [slip for slip in at_noise(slips, SWEEP_NOISE_V) if not slip.is_held_out]
    quiet = [one for one in quiet if one.noise_v == SWEEP_NOISE_V and is_tuned(one.family)]
    families = [one for name, one in exceedances.items() if is_tuned(name)]

    def latency_ms(name: str, part: float) -> float:
        return 1e3 * quantile(latencies_s(mine, name), part)

    def per_hour(name: str, *, is_announced: bool = False) -> float:
        readings = [one for one in quiet if one.detector == name]
        return alarm_rate(readings, is_announced=is_announced, with_external=not is_announced).per_hour

    swept = [name for name in sweep() if mine and name in mine[0].scores]
    swept_rates = [per_hour(name) for name in swept]
    x = [latency_ms(name, 0.5) for name in swept]
    axes.plot(x, swept_rates, "-", color="#555555", label="this detector at any permitted rate, median")
    bound = [bound_per_hour(mine, families, latency_s, 0.5) for latency_s in LATENCIES_S]
    axes.plot(1e3 * np.array(LATENCIES_S), bound, "k--", label="best possible for growth of shear, median")
    colours = iter(_SETTING_COLOURS)
    for name, detector in compared_detectors(tuning).items():
        x = [latency_ms(name, part) for part in _QUANTILES]
        if detector.is_setting:
            colour = next(colours)
            axes.plot(x, [per_hour(name)] * 2, "o-", color=colour, ms=8, lw=2, label=name)
            announced = [per_hour(name, is_announced=True)] * 2
            axes.plot(x, announced, "o-", color=colour, mfc="none", ms=8, lw=1)
        elif name == _PUBLISHED:
            axes.plot(x, [per_hour(name)] * 2, "s", color="#999999", ms=7)
            axes.annotate(f"{name}:\nmedian", (x[0], per_hour(name)), (6, 6), textcoords="offset points")
    axes.set(xscale="log", xlim=(5, 1e4), yscale="symlog", ylim=(0, 2e4))
    axes.set_title(f"Slip: early or sure. {1e3 * SWEEP_NOISE_V:g} mV of noise, {len(mine)} slips")
    axes.set(xlabel="first event after the beginning of shear (ms): median and 95 %")
    axes.set(ylabel="false alarms an hour without slip (hollow: motion announced)")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9, loc="upper right")
