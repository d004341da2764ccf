"""Picture of ``tactiled bench slip``: how much sooner a slip is said for how many false alarms."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tactiled.bench import slip_tables
from tactiled.bench.slip_latency import CURVE_PER_HOUR, Case, fastest_level
from tactiled.bench.slip_quiet import QUIET_NOISES_V, Counted
from tactiled.bench.slip_rivals import Knobs, rivals
from tactiled.bench.slip_rules import LEVELS, RULES
from tactiled.bench.slip_scenes import NOISES_V
from tactiled.bench.slip_score import median

_COLOURS = dict(zip(RULES, ("#777777", "#b38f00", "#6aa4d8", "#1f4e79"), strict=True))
_MARKS = "osD^vP*X"
_LONGEST_MS = 1000.0  # later is not a reaction


def draw_slip(path: Path, cases: Sequence[Case], counted: Counted, knobs: Knobs) -> None:
    """Write the picture.

    A panel a noise: median latency against false alarms an hour in a hold; thin lines are levels, thick ones
    each array rule's best level. Below: latency of all slips, and false alarms in all that is no slip.
    """
    names = list(rivals(knobs))
    figure = Figure(figsize=(11, 13), layout="constrained")
    rows = figure.subplots(3, 2)
    for axes, noise_v in zip(rows.flat, NOISES_V, strict=False):
        _draw_curve(axes, [case for case in cases if case.noise_v == noise_v], noise_v, knobs)
    rows[0, 0].legend(fontsize=8, loc="upper right")
    _draw_shares(rows[2, 0], cases, names)
    _draw_quiet(rows[2, 1], cases, counted, names)
    figure.suptitle("Slip: speed against false alarms")
    figure.savefig(path, dpi=110)


def _draw_curve(axes: Axes, cases: Sequence[Case], noise_v: float, knobs: Knobs) -> None:
    for rule, colour in _COLOURS.items():
        best = fastest_level(cases, rule)[noise_v]
        for level in LEVELS:
            latency_ms = [
                1e3 * median([case.rule_s[rule, level][k] for case in cases])
                for k in range(len(CURVE_PER_HOUR))
            ]
            label = f"{rule}, best level" if level == best else None
            width, alpha = (2.5, 1.0) if level == best else (0.7, 0.4)
            axes.plot(latency_ms, CURVE_PER_HOUR, color=colour, lw=width, alpha=alpha, label=label)
            if level == best and np.isfinite(latency_ms[0]):
                axes.annotate(f"{level}", (latency_ms[0], CURVE_PER_HOUR[0]), color=colour, fontsize=8)
    bound_ms = [1e3 * median([case.oracle_s[k] for case in cases]) for k in range(len(CURVE_PER_HOUR))]
    axes.plot(bound_ms, CURVE_PER_HOUR, color="black", lw=2, ls="--", label="oracle")
    for mark, (name, rival) in zip(_MARKS, rivals(knobs).items(), strict=False):
        x = 1e3 * median(slip_tables.first_s(cases, name))
        y = np.clip(rival.per_hour(noise_v), CURVE_PER_HOUR[0], CURVE_PER_HOUR[-1])
        axes.plot([x], [y], mark, color="#c0392b", mec="white", ms=9, label=name, clip_on=False)
    axes.set(xscale="log", yscale="log", xlim=(3, _LONGEST_MS), title=f"{1e3 * noise_v:g} mV of noise")
    axes.set(xlabel="median latency from the beginning of shear, ms", ylabel="false alarms an hour in a hold")
    axes.grid(alpha=0.3)


def _draw_shares(axes: Axes, cases: Sequence[Case], names: Sequence[str]) -> None:
    some = [case for case in cases if case.noise_v == slip_tables.FAMILY_NOISE_V]
    for number, name in enumerate((slip_tables.ORACLE, *names)):
        latency_ms = 1e3 * np.sort(slip_tables.first_s(some, name))  # misses last
        share = 100 * np.arange(1, len(latency_ms) + 1) / len(latency_ms)
        colour, line = ("black", "--") if name == slip_tables.ORACLE else (f"C{number - 1}", "-")
        axes.step(latency_ms, share, where="post", color=colour, ls=line, label=name)
    axes.set(xscale="log", xlim=(3, 1e4), ylim=(0, 100), xlabel="latency, ms", ylabel="slips said by then, %")
    axes.set_title(f"All slips, {1e3 * slip_tables.FAMILY_NOISE_V:g} mV")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def _draw_quiet(axes: Axes, cases: Sequence[Case], counted: Counted, names: Sequence[str]) -> None:
    noise_v = QUIET_NOISES_V[0]
    some = [case for case in cases if case.noise_v == noise_v]
    for number, (mark, name) in enumerate(zip(_MARKS, names, strict=False)):
        false, told = slip_tables.per_hour(counted, noise_v, name)
        x = 1e3 * median(slip_tables.first_s(some, name))
        colour = f"C{number}"
        axes.plot([x], [false], mark, color=colour, ms=9, clip_on=False, label=name)
        axes.plot([x], [told], mark, color=colour, ms=9, clip_on=False, mfc="none")
    axes.set(
        xscale="log", xlim=(3, _LONGEST_MS), yscale="symlog", title=f"What is no slip, {1e3 * noise_v:g} mV"
    )
    axes.set_ylim(0, 1e4)
    axes.set(xlabel="median latency, ms", ylabel="false alarms an hour (hollow: told of own motion)")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
