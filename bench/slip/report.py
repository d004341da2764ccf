"""What ``./run bench slip`` prints and writes of what it measured."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench.slip import tables as slip_tables
from bench.slip.aims import aims_table, limit_table
from bench.slip.alarms import hold_table, hourly_table, quiet_table
from bench.slip.cost import Cost
from bench.slip.latency import CURVE_PER_HOUR, Case
from bench.slip.limit import GROWTHS, LATENCIES_S
from bench.slip.noise import Tail
from bench.slip.quiet import QUIET_NOISES_V, Quiet
from bench.slip.rest import Rest, rest_table
from bench.slip.rivals import PER_HOUR, Knobs, rivals
from bench.slip.scenes import LEAD_S, NOISES_V
from tactiled.detect.slip.coherent import SETTINGS, CoherentParams
from tactiled.emulator.scene.families import HELD_OUT_QUIET, HELD_OUT_SLIPPING, QUIET


@dataclass(frozen=True)
class Measured:
    """Everything that was measured."""

    seeds: Mapping[str, Sequence[int]]
    noise_hours: float
    knobs: Knobs
    oracle: Tail
    cases: Sequence[Case]
    quiet: Quiet
    resting: Sequence[Rest]
    cost: Mapping[str, Cost]


def text_of(found: Measured) -> str:
    """Tables, the aims first."""
    known = rivals(found.knobs)
    names, settings = list(known), [name for name, rival in known.items() if rival.is_setting]
    tuned = [case for case in found.cases if case.family not in HELD_OUT_SLIPPING]
    held_out = [case for case in found.cases if case.family in HELD_OUT_SLIPPING]
    counted = found.quiet.counted
    levels = ", ".join(f"{found.knobs.window_level[noise]} at {1e3 * noise:g} mV" for noise in NOISES_V)
    motions = sum(found.quiet.motions.values())
    read = [alarms for (_, _, who), alarms in counted.items() if who == settings[0]]
    return "\n\n".join(
        [
            f"Tuned on seeds {_range(found.seeds['tune'])} and {found.noise_hours:g} h of white noise (seed "
            f"{found.seeds['noise'][0]}); reported on seeds {_range(found.seeds['slips'])} (slips) and "
            f"{_range(found.seeds['quiet'])} (no slips). The detector's constants were set on other seeds of "
            f"the families {', '.join(dict.fromkeys(case.family for case in tuned))} and {', '.join(QUIET)}; "
            f"held out, nothing set on them: {', '.join(HELD_OUT_SLIPPING | HELD_OUT_QUIET)}. Thresholds: "
            f"{PER_HOUR:g} false alarm an hour in a hold. Level of the plain window: {levels}. Every hold is "
            f"{LEAD_S:g} s longer than its family's. {motions} scenes without slip, read "
            f"for {sum(a.hours for a in read):.1f} h, with line faults, at {len(QUIET_NOISES_V)} noises (the "
            f"hold at {len(NOISES_V)}); without readings that differ by noise alone "
            f"{sum(a.apart_hours for a in read):.1f} h.",
            "Settings: " + "; ".join(_in_words(name, params) for name, params in SETTINGS.items()) + ".",
            "Aims, families tuned on.",
            aims_table(tuned, counted, "tuned on", settings),
            "Aims, families held out.",
            aims_table(held_out, counted, "held out", settings),
            "What limits them: shear over pressure that slips have grown by, or more, at the instants that "
            "the aims ask for, and how often an hour motion without slip grows by as much in that time, "
            "unannounced and without noise. Whoever looks at growing shear raises so many false alarms.",
            limit_table(tuned, found.quiet.exceeded),
            "First event after the shear began, to the end of the scan that showed it; negative where it had "
            "grown, but not yet by the 0.2 % of the grip that truth calls beginning. before gross: of "
            "slips that take 50 ms or more to become gross. incipient: median / p95 since 10 % slipped, of "
            "so many that said it. gross: median distance from 90 %. early, on the press: false alarms "
            "before the shear. Families tuned on:",
            slip_tables.latency_table(tuned, names),
            "Families held out:",
            slip_tables.latency_table(held_out, names),
            "First event of steady slides by speed and noise, median / p95.",
            slip_tables.speed_table(found.cases, names),
            f"First event by family, median / p95, at {1e3 * slip_tables.FAMILY_NOISE_V:g} mV.",
            slip_tables.family_table(found.cases, names),
            "The worst of each.",
            slip_tables.worst_table(found.cases, names),
            "Direction, onset (against the beginning of shear) and gross instant, with the share inside one "
            "stated sigma.",
            slip_tables.estimate_table(found.cases, names),
            "False alarms an hour, the mean of the families, with the 95 % interval of the counts in which a "
            "motion counts once however often it is read. announced: the daemon is told of the gripper's and "
            "arm's own motion as it begins.",
            hourly_table(counted, settings),
            "False alarms a minute by family; told: what announcing leaves; gross: so many said that all "
            "slips; right: so many said that a part slips, when it did. A false slip that does not end hides "
            "all after it. Settings are read for the whole time, the others once a scene.",
            quiet_table(counted, names),
            hold_table(counted, {name: rival.per_hour for name, rival in known.items()}),
            "Loads that grow to less than friction bears and rest there, or swing: how many are called gross "
            "slip. Their shear grows and stops as that of a slip does. Below them, how many slips are, and "
            "how many of the others are said to have ended while they go on.",
            rest_table(found.resting, found.cases),
            "Cost, 36 channels.",
            slip_tables.cost_table(found.cost),
        ]
    )


def numbers_of(found: Measured) -> dict[str, Any]:
    """Everything as JSON knows it: no NaN."""
    return {
        "seeds": {name: list(seeds) for name, seeds in found.seeds.items()},
        "noise_hours": found.noise_hours,
        "held_out": [*HELD_OUT_SLIPPING, *HELD_OUT_QUIET],
        "false_alarms_per_hour": PER_HOUR,
        "curve_per_hour": CURVE_PER_HOUR,
        "window_level": {f"{noise:g}": level for noise, level in found.knobs.window_level.items()},
        "tails": {
            f"{rule}, level {level}": asdict(tail) for (rule, level), tail in found.knobs.tails.items()
        },
        "oracle_tail": asdict(found.oracle),
        "slips": [
            {
                "family": case.family,
                "seed": case.seed,
                "noise_v": case.noise_v,
                "becoming_s": case.becoming_s,
                "growth": case.growth.tolist(),
                "oracle_s": [_number(s) for s in case.oracle_s],
                "rules_s": {f"{r}, level {n}": [_number(s) for s in v] for (r, n), v in case.rule_s.items()},
                "found": {
                    name: {field: _number(value) for field, value in asdict(one).items()}
                    for name, one in case.found.items()
                },
            }
            for case in found.cases
        ],
        "quiet": [
            {"family": family, "noise_v": noise_v, "detector": name, **asdict(alarms)}
            for (family, noise_v, name), alarms in found.quiet.counted.items()
        ],
        "motions": found.quiet.motions,
        "resting": [rest._asdict() for rest in found.resting],
        "limit": {
            "latencies_s": LATENCIES_S,
            "growths": GROWTHS.tolist(),
            "families": {
                name: {"hours": one.hours, "times": one.times.tolist()}
                for name, one in found.quiet.exceeded.items()
            },
        },
        "cost": {name: asdict(one) for name, one in found.cost.items()},
    }


def _in_words(name: str, params: CoherentParams) -> str:
    return (
        f"{name} is asked for {params.false_alarms_per_hour:g} false alarms an hour of a hand that moves "
        f"unannounced, and so waits for shear to grow by {params.shear:.2g} of the pressure and leaves noise "
        f"{params.noise_per_hour:.2g} an hour"
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _range(seeds: Sequence[int]) -> str:
    return f"{seeds[0]}..{seeds[-1]}"
