"""Picture of ``./run bench slip``: how much sooner a slip is said for how many false alarms."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bench.slip import tables as slip_tables
from bench.slip.aims import limit_curve
from bench.slip.alarms import total
from bench.slip.latency import CURVE_PER_HOUR, Case, fastest_level
from bench.slip.quiet import Counted, Quiet
from bench.slip.rivals import SWEEP_NOISE_V, Knobs, rivals, sweep
from bench.slip.rules import COHERENT, LEVELS, RULES
from bench.slip.scenes import NOISES_V
from bench.slip.score import median, quantile
from tactiled.emulator.scene.families import HELD_OUT_SLIPPING

_COLOURS = dict(zip(RULES, ("#777777", "#b38f00", "#6aa4d8", "#1f4e79"), strict=True))
_COHERENT_COLOUR = "#2e8b57"
_SETTING_COLOURS = ("#c0392b", "#e67e22", "#8e44ad", "#d4ac0d")
_MARKS = "osD^vP*X<>"
_LONGEST_MS = 1000.0  # later is not a reaction


def draw_slip(path: Path, cases: Sequence[Case], quiet: Quiet, knobs: Knobs) -> None:
    """Write the picture.

    First what users choose from: latency against false alarms an hour where nothing slips, at the board's own
    noise, with the settings, the bound and the oracle. Beside it, slips said by a latency. Below, a panel a
    noise: median latency against false alarms an hour in a hold; thin lines are levels, thick ones each
    array rule's best level.
    """
    names = list(rivals(knobs))
    figure = Figure(figsize=(13, 17), layout="constrained")
    rows = figure.subplots(3, 2, height_ratios=(1.5, 1, 1))
    _draw_choice(rows[0, 0], cases, quiet, knobs)
    _draw_shares(rows[0, 1], cases, names)
    for axes, noise_v in zip(rows[1:].flat, NOISES_V, strict=True):
        _draw_curve(axes, [case for case in cases if case.noise_v == noise_v], noise_v, knobs)
    rows[1, 0].legend(fontsize=7, loc="upper right")
    figure.suptitle("Slip: speed against false alarms")
    figure.savefig(path, dpi=110)


def _draw_choice(axes: Axes, cases: Sequence[Case], quiet: Quiet, knobs: Knobs) -> None:
    tuned = [case for case in cases if case.family not in HELD_OUT_SLIPPING]
    some = [case for case in tuned if case.noise_v == SWEEP_NOISE_V]
    counted, known = quiet.counted, rivals(knobs)

    def latency(name: str, part: float) -> float:
        return 1e3 * quantile(slip_tables.first_s(some, name), part)

    swept = [name for name in sweep() if some and name in some[0].found]
    for part, line, words in ((0.5, "-", "median"), (0.95, ":", "p95")):
        x = [latency(name, part) for name in swept]
        axes.plot(
            x, [_alarms(counted, name) for name in swept], line, color="#555555", label=f"any rate, {words}"
        )
    for part, line, words in ((0.5, "--", "median"), (0.95, ":", "p95")):
        limit = limit_curve(some, quiet.exceeded, part)
        axes.plot(
            1e3 * limit[:, 0], limit[:, 1], "k" + line, lw=1.5, label=f"bound of growing shear, {words}"
        )
    axes.axvline(latency(slip_tables.ORACLE, 0.5), color="black", lw=0.8, label="oracle, median")
    axes.axvline(latency(slip_tables.ORACLE, 0.95), color="black", lw=0.8, ls=":", label="oracle, p95")
    settings = iter(_SETTING_COLOURS)
    for mark, (name, rival) in zip(_MARKS, known.items(), strict=False):
        colour = next(settings) if rival.is_setting else "#999999"
        x = [latency(name, part) for part in (0.5, 0.95)]
        for told in (False, True) if rival.is_setting else (False,):
            y = [_alarms(counted, name, told=told)] * 2
            face = "none" if told else colour
            label = None if told else name
            axes.plot(
                x, y, mark + "-", color=colour, mfc=face, ms=9 if rival.is_setting else 6, lw=0.6, label=label
            )
    axes.set(xscale="log", xlim=(5, 1e4), yscale="symlog", ylim=(0, 2e4))
    axes.set_title(f"What to choose from, {1e3 * SWEEP_NOISE_V:g} mV, families tuned on")
    axes.set(xlabel="latency from the beginning of shear, ms: median to p95")
    axes.set(ylabel="false alarms an hour where nothing slips (hollow: told of own motion)")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)


def _alarms(counted: Counted, name: str, *, told: bool = False) -> float:
    return total(counted, name, "tuned on", [SWEEP_NOISE_V], told=told, outside=not told).per_hour


def _draw_curve(axes: Axes, cases: Sequence[Case], noise_v: float, knobs: Knobs) -> None:
    for rule, colour in _COLOURS.items():
        best = fastest_level(cases, rule)[noise_v]
        for level in LEVELS:
            latency_ms = _rule_ms(cases, (rule, level))
            label = f"{rule}, best level" if level == best else None
            width, alpha = (2.5, 1.0) if level == best else (0.7, 0.4)
            axes.plot(latency_ms, CURVE_PER_HOUR, color=colour, lw=width, alpha=alpha, label=label)
            if level == best and np.isfinite(latency_ms[0]):
                axes.annotate(f"{level}", (latency_ms[0], CURVE_PER_HOUR[0]), color=colour, fontsize=8)
    axes.plot(
        _rule_ms(cases, COHERENT),
        CURVE_PER_HOUR,
        color=_COHERENT_COLOUR,
        lw=2.5,
        label="coherent, coif1 levels",
    )
    bound_ms = [1e3 * median([case.oracle_s[k] for case in cases]) for k in range(len(CURVE_PER_HOUR))]
    axes.plot(bound_ms, CURVE_PER_HOUR, color="black", lw=2, ls="--", label="oracle")
    for mark, (name, rival) in zip(_MARKS, rivals(knobs).items(), strict=False):
        x = 1e3 * median(slip_tables.first_s(cases, name))
        y = np.clip(rival.per_hour(noise_v), CURVE_PER_HOUR[0], CURVE_PER_HOUR[-1])
        axes.plot([x], [y], mark, color="#c0392b", mec="white", ms=9, label=name, clip_on=False)
    axes.set(xscale="log", yscale="log", xlim=(3, _LONGEST_MS), title=f"{1e3 * noise_v:g} mV of noise")
    axes.set(xlabel="median latency from the beginning of shear, ms", ylabel="false alarms an hour in a hold")
    axes.grid(alpha=0.3)


def _rule_ms(cases: Sequence[Case], rule: tuple[str, int]) -> NDArray[np.float64]:
    return np.array(
        [1e3 * median([case.rule_s[rule][k] for case in cases]) for k in range(len(CURVE_PER_HOUR))]
    )


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
