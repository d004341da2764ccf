"""Tables of ``./run bench slip``."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.slip.cost import Cost
from bench.slip.latency import CURVE_PER_HOUR, Case
from bench.slip.rivals import PER_HOUR
from bench.slip.scenes import NOISES_V, SPEEDS_MM_S, speed_name
from bench.slip.score import coverage, median, quantile
from tactiled.emulator.scene.families import HELD_OUT_SLIPPING
from tactiled.plain_table import table

FloatArray = NDArray[np.float64]

ORACLE = "oracle"
FAMILY_NOISE_V = 1e-3  # of the table by family: between the board's own 0.3 mV and a noisy cable's 3 mV
# Slips that take this long to become gross are those that an event can come before.
SLOW_S = 0.05
_NONE = "-"


def first_s(cases: Iterable[Case], name: str) -> FloatArray:
    """Latency of the first event of a detector, or of the oracle, in each case."""
    if name == ORACLE:
        return np.array([case.oracle_s[CURVE_PER_HOUR.index(PER_HOUR)] for case in cases])
    return np.array([case.found[name].first_s for case in cases])


def latency_table(cases: Sequence[Case], names: Sequence[str]) -> str:
    """By noise and detector."""
    head = [
        "noise", "detector", "median", "p95", "missed", "oracle x", "p95 x", "before gross", "incipient",
        "gross, off by", "early", "on the press",
    ]  # fmt: skip
    rows = []
    for noise_v in NOISES_V:
        some = [case for case in cases if case.noise_v == noise_v]
        bound = first_s(some, ORACLE)
        for name in (ORACLE, *names):
            latency = first_s(some, name)
            rows.append(
                [
                    f"{1e3 * noise_v:g} mV",
                    name,
                    _ms(median(latency)),
                    _ms(quantile(latency, 0.95)),
                    f"{int(np.isnan(latency).sum())} of {len(latency)}",
                    _times(median(latency), median(bound)),
                    _times(quantile(latency, 0.95), quantile(bound, 0.95)),
                    *(_events(some, name) if name != ORACLE else [_NONE] * 5),
                ]
            )
    return table(head, rows)


def _events(cases: Sequence[Case], name: str) -> list[str]:
    found = [case.found[name] for case in cases]
    slow = [case.found[name].to_gross_s for case in cases if case.becoming_s >= SLOW_S]
    gross = np.array([one.gross_s for one in found])
    incipient = np.array([one.incipient_s for one in found])
    said = np.isfinite(incipient)
    return [
        f"{100 * np.mean(np.array(slow) > 0):.0f} %" if slow else _NONE,
        f"{_ms(float(np.median(incipient[said])))} / {_ms(quantile(incipient[said], 0.95))} ({said.sum()})"
        if said.any()
        else _NONE,
        _ms(median(np.abs(gross))),
        f"{sum(one.early for one in found)}",
        f"{sum(one.on_press for one in found)}",
    ]


def family_table(cases: Sequence[Case], names: Sequence[str]) -> str:
    """Median and p95 by family at `FAMILY_NOISE_V`."""
    some = [case for case in cases if case.noise_v == FAMILY_NOISE_V]
    rows = []
    for family in dict.fromkeys(case.family for case in some):
        mine = [case for case in some if case.family == family]
        becoming = _ms(float(np.median([case.becoming_s for case in mine])))
        cells = [_spread(first_s(mine, name)) for name in (ORACLE, *names)]
        name = f"{family}, held out" if family in HELD_OUT_SLIPPING else family
        rows.append([name, f"{len(mine)}", becoming, *cells])
    return table(["family", "slips", "shear to gross", ORACLE, *names], rows)


def speed_table(cases: Sequence[Case], names: Sequence[str]) -> str:
    """Median and p95 of steady slides by speed and noise."""
    rows = []
    for speed in map(speed_name, SPEEDS_MM_S):
        for noise_v in NOISES_V:
            mine = [case for case in cases if (case.family, case.noise_v) == (speed, noise_v)]
            cells = [_spread(first_s(mine, name)) for name in (ORACLE, *names)]
            rows.append([speed, f"{1e3 * noise_v:g} mV", *cells])
    return table(["speed", "noise", ORACLE, *names], rows)


def estimate_table(cases: Sequence[Case], names: Sequence[str]) -> str:
    """Direction and onset errors with the coverage of their stated sigmas; all noises."""
    head = [
        "detector", "noise", "direction error, median", "p95", "inside 1 sigma", "onset error, median size",
        "inside 1 sigma", "gross instant, median size", "inside 1 sigma",
    ]  # fmt: skip
    rows = []
    for name in names:
        for noise_v in NOISES_V:
            found = [case.found[name] for case in cases if case.noise_v == noise_v]
            turn, onset, gross = np.array(
                [
                    [
                        (one.direction_error_deg, one.direction_sd_deg),
                        (one.onset_error_s, one.onset_sd_s),
                        (one.gross_onset_error_s, one.gross_onset_sd_s),
                    ]
                    for one in found
                ]
            ).transpose(1, 2, 0)
            size = np.abs(turn[0][np.isfinite(turn[0])])
            rows.append(
                [
                    name,
                    f"{1e3 * noise_v:g} mV",
                    f"{np.median(size):.1f} deg" if len(size) else _NONE,
                    f"{np.quantile(size, 0.95):.1f} deg" if len(size) else _NONE,
                    _percent(coverage(turn[0], turn[1])),
                    _ms(_middle(onset[0])),
                    _percent(coverage(onset[0], onset[1])),
                    _ms(_middle(gross[0])),
                    _percent(coverage(gross[0], gross[1])),
                ]
            )
    return table(head, rows)


def worst_table(cases: Sequence[Case], names: Sequence[str], most: int = 5) -> str:
    """Slips said latest or not at all, by detector: where to look."""
    rows = []
    for name in names:
        by_latency = sorted(cases, key=lambda case: -_late_s(case, name))
        for case in by_latency[:most]:
            latency = case.found[name].first_s
            rows.append(
                [
                    name,
                    case.family,
                    f"{case.seed}",
                    f"{1e3 * case.noise_v:g} mV",
                    _ms(latency) if np.isfinite(latency) else "missed",
                    _ms(float(first_s([case], ORACLE)[0])),
                ]
            )
    return table(["detector", "family", "seed", "noise", "said after", ORACLE], rows)


def _late_s(case: Case, name: str) -> float:
    latency = case.found[name].first_s
    return latency if np.isfinite(latency) else np.inf


def cost_table(costs: Mapping[str, Cost]) -> str:
    """Microseconds a scan live, and scans a second in blocks."""
    plain = costs["pywt.swt, plain"]
    rows = [
        [name, f"{cost.live_us:.0f} us", f"{cost.scans_per_s:,.0f}", f"{plain.live_us / cost.live_us:.1f}"]
        for name, cost in costs.items()
    ]
    return table(["detector", "a scan, live", "scans a second in blocks", "plain over this, live"], rows)


def _middle(error: FloatArray) -> float:
    sized = np.abs(error[np.isfinite(error)])
    return float(np.median(sized)) if len(sized) else np.nan


def _spread(latency: FloatArray) -> str:
    missed = int(np.isnan(latency).sum())
    more = f", {missed} missed" if missed else ""
    return f"{_ms(median(latency))} / {_ms(quantile(latency, 0.95))}{more}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms" if np.isfinite(seconds) else _NONE


def _times(latency: float, bound: float) -> str:
    return f"{latency / bound:.1f}" if np.isfinite(latency) and bound > 0 else _NONE


def _percent(part: float) -> str:
    return f"{100 * part:.0f} %" if np.isfinite(part) else _NONE
