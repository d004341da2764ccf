"""Tables of ``./run bench slip``."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from bench.report import NONE, grouped, ratio, table
from bench.slip.cost import PLAIN, DetectorCost
from bench.slip.detectors import ComparedDetector
from bench.slip.growth import Exceedances
from bench.slip.quiet import EXTERNAL, GROUPS, HOLD, QUIET_NOISES_V, QuietReading, alarm_rate
from bench.slip.resting import LOAD_DETECTORS, LOAD_NOISES_V, LOADS, RestingLoad
from bench.slip.scenes import NOISES_V, STEADY_SLIDES
from bench.slip.score import SlipScore, coverage, median, quantile
from bench.slip.slips import ORACLE, SLOW_S, SlipReading, bound_per_hour, growth_quantile
from tactiled.array import FloatArray
from tactiled.emulator.scene.families import HELD_OUT_QUIET

FAMILY_NOISE_V = 1e-3  # of the table by family: between the board's own 0.3 mV and a noisy cable's 3 mV
MEDIAN_X, P95_X = 1.5, 2.5  # aims, as multiples of the oracle's latency
_N_WORST = 5

Slips = Sequence[SlipReading]


def at_noise(slips: Iterable[SlipReading], noise_v: float) -> list[SlipReading]:
    """Readings at one noise."""
    return [slip for slip in slips if slip.noise_v == noise_v]


def latencies_s(slips: Iterable[SlipReading], name: str) -> FloatArray:
    """Latency (slips,) of a detector's first events, or of the oracle's."""
    return np.array([slip.latency_s(name) for slip in slips])


def scores_of(slips: Iterable[SlipReading], name: str) -> list[SlipScore]:
    """Scores of one detector."""
    return [slip.scores[name] for slip in slips]


def _mv(noise_v: float) -> str:
    return f"{1e3 * noise_v:g} mV"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms" if np.isfinite(seconds) else NONE


def _percent(part: float) -> str:
    return f"{100 * part:.0f} %" if np.isfinite(part) else NONE


def _median_and_p95(latency_s: FloatArray) -> str:
    missed = int(np.isnan(latency_s).sum())
    words = f"{_ms(median(latency_s))} / {_ms(quantile(latency_s, 0.95))}"
    return f"{words}, {missed} missed" if missed else words


def bound_table(slips: Slips, quiet: Sequence[Exceedances]) -> str:
    """Growth to which a detector must respond at the latencies of the aims, and its false alarms."""

    def row(noise_v: float) -> dict[str, str]:
        mine = at_noise(slips, noise_v)
        oracle_s = latencies_s(mine, ORACLE)
        by_s, all_by_s = MEDIAN_X * median(oracle_s), P95_X * quantile(oracle_s, 0.95)
        growths = [growth_quantile(mine, by_s, part) for part in (0.5, 0.9)]
        alarms = [bound_per_hour(mine, quiet, by_s, part) for part in (0.5, 0.9)]
        return {
            "noise": _mv(noise_v),
            f"{MEDIAN_X:g} x oracle's median": _ms(by_s),
            "growth by then: 50 % of slips / 90 %": " / ".join(f"{growth:.4f}" for growth in growths),
            "false alarms an hour": " / ".join(f"{per_hour:.0f}" for per_hour in alarms),
            f"{P95_X:g} x oracle's p95": _ms(all_by_s),
            "growth: 95 % of slips": f"{growth_quantile(mine, all_by_s, 0.95):.4f}",
            "alarms an hour": f"{bound_per_hour(mine, quiet, all_by_s, 0.95):.0f}",
        }

    return table(map(row, NOISES_V))


def latency_table(slips: Slips, names: Sequence[str]) -> str:
    """Latencies, misses and false alarms by noise and detector."""

    def row(noise_v: float, name: str) -> dict[str, str]:
        mine = at_noise(slips, noise_v)
        latency_s, oracle_s = latencies_s(mine, name), latencies_s(mine, ORACLE)

        def over_oracle(part: float) -> str:
            latency, bound = quantile(latency_s, part), quantile(oracle_s, part)
            return f"{latency / bound:.1f}" if np.isfinite(latency) and bound > 0 else NONE

        return {
            "noise": _mv(noise_v),
            "detector": name,
            "median": _ms(median(latency_s)),
            "p95": _ms(quantile(latency_s, 0.95)),
            "missed": ratio(np.isnan(latency_s)),
            "oracle x": over_oracle(0.5),
            "p95 x": over_oracle(0.95),
        } | _event_cells(mine, name)

    return table(row(noise_v, name) for noise_v in NOISES_V for name in (ORACLE, *names))


def _event_cells(slips: Slips, name: str) -> dict[str, str]:
    heads = ("before gross", "incipient", "gross, off by", "early", "on the press")
    if name == ORACLE:
        return dict.fromkeys(heads, NONE)
    scores = scores_of(slips, name)
    slow = [slip.scores[name].lead_s > 0 for slip in slips if slip.to_gross_s >= SLOW_S]
    incipient_s = np.array([one.incipient_latency_s for one in scores])
    incipient_s = incipient_s[np.isfinite(incipient_s)]
    spread = f"{_ms(_median_size(incipient_s, signed=True))} / {_ms(quantile(incipient_s, 0.95))}"
    cells = (
        f"{100 * np.mean(slow):.0f} %" if slow else NONE,
        f"{spread} ({len(incipient_s)})" if len(incipient_s) else NONE,
        _ms(median(np.abs([one.gross_latency_s for one in scores]))),
        f"{sum(one.n_early for one in scores)}",
        f"{sum(one.n_on_press for one in scores)}",
    )
    return dict(zip(heads, cells, strict=True))


def _median_size(values: FloatArray, *, signed: bool = False) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known if signed else np.abs(known))) if len(known) else np.nan


def speed_table(slips: Slips, names: Sequence[str]) -> str:
    """Median and p95 of steady slides by speed and noise."""

    def row(speed: str, noise_v: float) -> dict[str, str]:
        mine = [slip for slip in at_noise(slips, noise_v) if slip.family == speed]
        cells = {name: _median_and_p95(latencies_s(mine, name)) for name in (ORACLE, *names)}
        return {"speed": speed, "noise": _mv(noise_v)} | cells

    return table(row(speed, noise_v) for speed in STEADY_SLIDES for noise_v in NOISES_V)


def family_table(slips: Slips, names: Sequence[str]) -> str:
    """Median and p95 by family at `FAMILY_NOISE_V`."""

    def row(family: str, mine: Slips) -> dict[str, str]:
        return {
            "family": f"{family}, held out" if mine[0].is_held_out else family,
            "slips": f"{len(mine)}",
            "shear to gross": _ms(float(np.median([slip.to_gross_s for slip in mine]))),
        } | {name: _median_and_p95(latencies_s(mine, name)) for name in (ORACLE, *names)}

    families = grouped(at_noise(slips, FAMILY_NOISE_V), lambda slip: slip.family)
    return table(row(family, mine) for family, mine in families.items())


def worst_table(slips: Slips, names: Sequence[str], n_worst: int = _N_WORST) -> str:
    """Slips with the largest latencies, missed ones first, by detector."""

    def late_s(slip: SlipReading, name: str) -> float:
        return float(np.nan_to_num(slip.latency_s(name), nan=np.inf))

    def row(slip: SlipReading, name: str) -> dict[str, str]:
        latency_s = slip.latency_s(name)
        return {
            "detector": name,
            "family": slip.family,
            "seed": f"{slip.seed}",
            "noise": _mv(slip.noise_v),
            "latency": _ms(latency_s) if np.isfinite(latency_s) else "missed",
            ORACLE: _ms(slip.latency_s(ORACLE)),
        }

    return table(
        row(slip, name)
        for name in names
        for slip in sorted(slips, key=lambda slip: -late_s(slip, name))[:n_worst]
    )


def stated(scores: Iterable[SlipScore], quantity: str) -> tuple[FloatArray, FloatArray]:
    """Errors and stated sigmas of a quantity: ``direction``, ``onset`` or ``gross_onset``."""
    unit = "deg" if quantity == "direction" else "s"
    pairs = [
        (getattr(one, f"{quantity}_error_{unit}"), getattr(one, f"{quantity}_sd_{unit}")) for one in scores
    ]
    error, sd = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    return error, sd


def estimate_table(slips: Slips, names: Sequence[str]) -> str:
    """Errors of direction and instants, and the coverage of the stated sigmas."""

    def row(name: str, noise_v: float) -> dict[str, str]:
        scores = scores_of(at_noise(slips, noise_v), name)
        error = {quantity: stated(scores, quantity) for quantity in ("direction", "onset", "gross_onset")}
        within = {quantity: _percent(coverage(*pair)) for quantity, pair in error.items()}
        size_deg = np.abs(error["direction"][0])
        size_deg = size_deg[np.isfinite(size_deg)]
        return {
            "detector": name,
            "noise": _mv(noise_v),
            "direction error, median": f"{np.median(size_deg):.1f} deg" if len(size_deg) else NONE,
            "p95": f"{np.quantile(size_deg, 0.95):.1f} deg" if len(size_deg) else NONE,
            "direction within 1 sigma": within["direction"],
            "onset error, median": _ms(_median_size(error["onset"][0])),
            "onset within 1 sigma": within["onset"],
            "gross instant error, median": _ms(_median_size(error["gross_onset"][0])),
            "gross instant within 1 sigma": within["gross_onset"],
        }

    return table(row(name, noise_v) for name in names for noise_v in NOISES_V)


def hourly_table(readings: Sequence[QuietReading], names: Sequence[str]) -> str:
    """False alarms an hour by noise, group of families and announcement."""
    cases = {
        "unannounced": (False, True),
        "announced": (True, True),
        "announced, external disturbances excluded": (True, False),
    }

    def row(noise_v: float, group: str, case: str) -> dict[str, str]:
        is_announced, with_external = cases[case]
        mine = [one for one in readings if one.noise_v == noise_v and GROUPS[group](one.family)]
        rates = {
            name: alarm_rate(
                [one for one in mine if one.detector == name],
                is_announced=is_announced,
                with_external=with_external,
            )
            for name in names
        }
        cells = {name: str(rate) for name, rate in rates.items() if not np.isnan(rate.per_hour)}
        return {"noise": _mv(noise_v), "scenes": group, "motion": case} | cells if cells else {}

    rows = [row(noise_v, group, case) for noise_v in QUIET_NOISES_V for group in GROUPS for case in cases]
    return table(filter(None, rows))


def quiet_table(readings: Sequence[QuietReading], names: Sequence[str]) -> str:
    """False alarms a minute by noise and family."""

    def cell(mine: Sequence[QuietReading]) -> str:
        minutes = 60 * sum(one.hours for one in mine)
        false, announced = sum(one.n_false for one in mine), sum(one.n_announced_false for one in mine)
        gross, partial = sum(one.n_gross for one in mine), sum(one.n_partial for one in mine)
        words = f"{false / minutes:.3f}"
        words += f"; announced {announced / minutes:.3f}" if announced < false else ""
        words += f", {gross} gross" if 0 < gross < false else ""
        return words + (f" (+{partial} correct)" if partial else "")

    def row(noise_v: float, family: str) -> dict[str, str]:
        by_detector = {name: by_key[noise_v, family, name] for name in names}
        words = f"{family} (external)" if family in EXTERNAL else family
        words += ", held out" if family in HELD_OUT_QUIET else ""
        minutes = 60 * max(sum(one.hours for one in mine) for mine in by_detector.values())
        cells = {name: cell(mine) for name, mine in by_detector.items()}
        return {"noise": _mv(noise_v), "family": words, "read": f"{minutes:.0f} min"} | cells

    by_key = grouped(readings, lambda one: (one.noise_v, one.family, one.detector))
    families = dict.fromkeys(one.family for one in readings)
    return table(row(noise_v, family) for noise_v in QUIET_NOISES_V for family in families)


def hold_table(readings: Sequence[QuietReading], detectors: Mapping[str, ComparedDetector]) -> str:
    """False alarms in holds against the rate that each detector is set to."""
    holds = grouped((one for one in readings if one.family == HOLD), lambda one: (one.detector, one.noise_v))

    def cell(name: str, noise_v: float) -> str:
        mine = holds[name, noise_v]
        on_press = sum(one.n_on_press for one in mine)
        alarms = sum(one.n_false for one in mine) - on_press
        allowed = detectors[name].per_hour(noise_v) * sum(one.hours for one in mine)
        return f"{alarms} of {allowed:.3g}" + (f", {on_press} on the press" if on_press else "")

    return table(
        {"detector": name} | {_mv(noise_v): cell(name, noise_v) for noise_v in NOISES_V} for name in detectors
    )


def resting_table(loads: Sequence[RestingLoad], slips: Slips) -> str:
    """Reports of gross slip by load, noise and detector; below them, those of slips."""
    columns = {
        f"{_mv(noise_v)}, {name}": (noise_v, name) for noise_v in LOAD_NOISES_V for name in LOAD_DETECTORS
    }

    def row(words: str, cases: Callable[[float, str], Iterable[bool]]) -> dict[str, str]:
        return {"load": words} | {head: ratio(cases(*column)) for head, column in columns.items()}

    def is_gross(load: str) -> Callable[[float, str], Iterable[bool]]:
        return lambda noise_v, name: [
            one.is_gross for one in loads if (one.load, one.noise_v, one.detector) == (load, noise_v, name)
        ]

    def of_slips(
        test: Callable[[SlipScore], bool], is_held_out: bool
    ) -> Callable[[float, str], Iterable[bool]]:
        return lambda noise_v, name: [
            test(slip.scores[name]) for slip in at_noise(slips, noise_v) if slip.is_held_out == is_held_out
        ]

    rows = [row(load, is_gross(load)) for load in LOADS]
    for words, is_held_out in (("slips", False), ("slips, held out", True)):
        rows.append(row(words, of_slips(lambda one: bool(np.isfinite(one.gross_latency_s)), is_held_out)))
        rows.append(
            row(f"{words}: ended early, not gross", of_slips(lambda one: one.is_ended_early, is_held_out))
        )
    return table(rows)


def cost_table(costs: Mapping[str, DetectorCost]) -> str:
    """Time a scan live, and scans a second in blocks."""
    return table(
        {
            "detector": name,
            "a scan, live": f"{cost.live_us:.0f} us",
            "scans a second in blocks": f"{cost.scans_per_s:,.0f}",
            "plain over this, live": f"{costs[PLAIN].live_us / cost.live_us:.1f}",
        }
        for name, cost in costs.items()
    )
