"""Picture of ``./run bench slip``: latency against false alarms."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.slip.detectors import SWEEP_NOISE_V, Tuning, compared_detectors, sweep
from bench.slip.growth import LATENCIES_S, Exceedances
from bench.slip.quiet import GROUPS, QuietReading, alarm_rate
from bench.slip.rules import COHERENT, LEVELS, RULES
from bench.slip.scenes import NOISES_V
from bench.slip.score import median, quantile
from bench.slip.slips import CURVE_PER_HOUR, ORACLE, SlipReading, bound_per_hour, fastest_level
from bench.slip.tables import FAMILY_NOISE_V, at_noise, latencies_s
from tactiled.array import FloatArray

_COLOURS = dict(zip(RULES, ("#777777", "#b38f00", "#6aa4d8", "#1f4e79"), strict=True))
_COHERENT_COLOUR = "#2e8b57"
_SETTING_COLOURS = ("#c0392b", "#e67e22", "#8e44ad", "#d4ac0d")
_MARKS = "osD^vP*X<>"
_LONGEST_MS = 1000.0  # later is not a reaction
_QUANTILES = ((0.5, "median"), (0.95, "p95"))

Slips = Sequence[SlipReading]


def draw_slip(
    path: Path,
    slips: Slips,
    quiet: Sequence[QuietReading],
    exceedances: Mapping[str, Exceedances],
    tuning: Tuning,
) -> None:
    """Write the picture.

    First what users choose from: latency against false alarms an hour without slip, at the board's own noise,
    of the settings, the bound and the oracle. Beside it the share of slips reported by a latency. Below, a
    panel for each noise: median latency against false alarms an hour in a hold. Thin lines are levels, thick
    lines the best level of each rule.
    """
    figure = Figure(figsize=(13, 17), layout="constrained")
    rows = figure.subplots(3, 2, height_ratios=(1.5, 1, 1))
    _draw_choice(rows[0, 0], slips, quiet, exceedances, tuning)
    _draw_shares(rows[0, 1], at_noise(slips, FAMILY_NOISE_V), (ORACLE, *compared_detectors(tuning)))
    for axes, noise_v in zip(rows[1:].flat, NOISES_V, strict=True):
        _draw_curve(axes, at_noise(slips, noise_v), noise_v, tuning)
    rows[1, 0].legend(fontsize=7, loc="upper right")
    figure.suptitle("Slip: latency against false alarms")
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
    for (part, words), line in zip(_QUANTILES, ("-", ":"), strict=True):
        x = [latency_ms(name, part) for name in swept]
        axes.plot(x, swept_rates, line, color="#555555", label=f"any rate, {words}")
        bound = [bound_per_hour(mine, families, latency_s, part) for latency_s in LATENCIES_S]
        axes.plot(1e3 * np.array(LATENCIES_S), bound, "k" + line, lw=1.5, label=f"bound of shear, {words}")
        axes.axvline(latency_ms(ORACLE, part), color="black", lw=0.8, ls=line, label=f"oracle, {words}")
    colours = iter(_SETTING_COLOURS)
    for mark, (name, detector) in zip(_MARKS, compared_detectors(tuning).items(), strict=False):
        colour, size = (next(colours), 9) if detector.is_setting else ("#999999", 6)
        x = [latency_ms(name, part) for part, _ in _QUANTILES]
        axes.plot(x, [per_hour(name)] * 2, mark + "-", color=colour, ms=size, lw=0.6, label=name)
        if detector.is_setting:
            y = [per_hour(name, is_announced=True)] * 2
            axes.plot(x, y, mark + "-", color=colour, mfc="none", ms=size, lw=0.6)
    axes.set(xscale="log", xlim=(5, 1e4), yscale="symlog", ylim=(0, 2e4))
    axes.set_title(f"What to choose from, {1e3 * SWEEP_NOISE_V:g} mV, families tuned on")
    axes.set(xlabel="latency from the beginning of shear, ms: median to p95")
    axes.set(ylabel="false alarms an hour without slip (hollow: own motion announced)")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)


def _draw_curve(axes: Axes, slips: Slips, noise_v: float, tuning: Tuning) -> None:
    def rule_ms(rule: tuple[str, int]) -> FloatArray:
        return np.array(
            [1e3 * median([slip.rule_s[rule][k] for slip in slips]) for k in range(len(CURVE_PER_HOUR))]
        )

    for rule, colour in _COLOURS.items():
        best = fastest_level(slips, rule)[noise_v]
        for level in LEVELS:
            latency_ms = rule_ms((rule, level))
            label = f"{rule}, best level" if level == best else None
            width, alpha = (2.5, 1.0) if level == best else (0.7, 0.4)
            axes.plot(latency_ms, CURVE_PER_HOUR, color=colour, lw=width, alpha=alpha, label=label)
            if level == best and np.isfinite(latency_ms[0]):
                axes.annotate(f"{level}", (latency_ms[0], CURVE_PER_HOUR[0]), color=colour, fontsize=8)
    coherent_ms = rule_ms(COHERENT)
    axes.plot(coherent_ms, CURVE_PER_HOUR, color=_COHERENT_COLOUR, lw=2.5, label="coherent, coif1 levels")
    oracle_ms = [1e3 * median([slip.oracle_s[k] for slip in slips]) for k in range(len(CURVE_PER_HOUR))]
    axes.plot(oracle_ms, CURVE_PER_HOUR, color="black", lw=2, ls="--", label=ORACLE)
    for mark, (name, detector) in zip(_MARKS, compared_detectors(tuning).items(), strict=False):
        x = 1e3 * median(latencies_s(slips, name))
        y = np.clip(detector.per_hour(noise_v), CURVE_PER_HOUR[0], CURVE_PER_HOUR[-1])
        axes.plot([x], [y], mark, color="#c0392b", mec="white", ms=9, label=name, clip_on=False)
    axes.set(xscale="log", yscale="log", xlim=(3, _LONGEST_MS), title=f"{1e3 * noise_v:g} mV of noise")
    axes.set(xlabel="median latency from the beginning of shear, ms", ylabel="false alarms an hour in a hold")
    axes.grid(alpha=0.3)


def _draw_shares(axes: Axes, slips: Slips, names: Sequence[str]) -> None:
    for number, name in enumerate(names):
        latency_ms = 1e3 * np.sort(latencies_s(slips, name))  # misses last
        share = 100 * np.arange(1, len(latency_ms) + 1) / len(latency_ms)
        colour, line = ("black", "--") if name == ORACLE else (f"C{number - 1}", "-")
        axes.step(latency_ms, share, where="post", color=colour, ls=line, label=name)
    axes.set(
        xscale="log", xlim=(3, 1e4), ylim=(0, 100), xlabel="latency, ms", ylabel="slips reported by then, %"
    )
    axes.set_title(f"All slips, {1e3 * FAMILY_NOISE_V:g} mV")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
