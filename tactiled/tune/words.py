"""Report of a study as text, as TOML for the configuration, and as a map for JSON."""

from typing import Any

import numpy as np

from tactiled.detect.grip.slip_detector import GRIP_SETTINGS
from tactiled.detect.slip.alarm_rate import rate_at
from tactiled.tune.hold import Recording
from tactiled.tune.study import (
    NOISE_PER_HOUR,
    ONSETS,
    SHEARS,
    WEAK_SHEAR,
    AlarmCount,
    Latency,
    Setting,
    Study,
)
from tactiled.tune.tail import AlarmTail, rate_interval


def in_words(found: Study) -> str:
    """Format the report as text, one paragraph per subject."""
    parts = [_recordings(found), _noise(found), _settings(found), _tails(found), _proposal(found)]
    parts.append(_by_probability(found))
    return "\n\n".join(parts)


def as_toml(found: Study) -> str:
    """Format the proposed parameters for tactiled.toml."""
    params = found.proposed.params
    return (
        "[detect.slip]\n"
        f"false_alarms_per_hour = {params.false_alarms_per_hour:g}\n"
        f"least_shear = {params.shear:g}\n"
    )


def as_map(found: Study) -> dict[str, Any]:
    """Map of all results for JSON; unknown values and missed detections are null."""
    names = found.quiet.array.channel_name
    low, high = rate_interval(_proposed_alarms(found), _motion_hours(found))
    return {
        "array": found.quiet.array.name,
        "false_alarms_per_hour": found.wanted_per_hour,
        "quiet": _recording_map(found.quiet, found.hold_s),
        "motion": _recording_map(found.motion, found.motion_s),
        "noise_sd_v": dict(zip(names, _numbers(found.noise_sd_v.tolist()), strict=True)),
        "noise_ladder": {
            "false_alarms_per_hour": list(NOISE_PER_HOUR),
            "alarms": list(found.noise_alarms),
            "restless": found.restless,
        },
        "shear_ladder": {
            "least_shear": list(SHEARS),
            "alarms": list(found.shear_alarms),
            "silent_from": found.silent_shear,
            "tail": _tail_map(found.shear_tail),
        },
        "settings": {name: _setting_map(setting) for name, setting in found.settings.items()},
        "by_probability": {
            name: {
                "incipient_p": GRIP_SETTINGS[name].incipient_p,
                "gross_p": GRIP_SETTINGS[name].gross_p,
                "alarms_motion": vars(alarms),
            }
            for name, alarms in found.by_probability.items()
        },
        "proposed": {
            "false_alarms_per_hour": found.proposed.params.false_alarms_per_hour,
            "least_shear": found.proposed.params.shear,
            "least_shear_by_tail": dict(zip(("value", "low", "high"), found.least_shear, strict=True)),
            "proven_per_hour": {"low": low, "high": high},
            "extrapolated": _is_extrapolated(found),
            "out_of_reach": found.out_of_reach,
        },
    }


def _recordings(found: Study) -> str:
    lines = []
    judged = (("quiet hold", found.quiet, found.hold_s), ("motion", found.motion, found.motion_s))
    for what, recording, contact_s in judged:
        lines.append(
            f"{what}: {contact_s:.1f} s of contact in {recording.seconds:.1f} s ({recording.name}); "
            f"{recording.lost} scans lost, {recording.late} late"
        )
    if found.restless:
        lines.append(
            f"the hold was not quiet: {found.noise_alarms[-1]} alarms even at the strictest threshold; "
            "support the hand, hold still and run again"
        )
    return "\n".join(lines)


def _noise(found: Study) -> str:
    sd_v, names = found.noise_sd_v, found.quiet.array.channel_name
    known = np.isfinite(sd_v)
    if not known.any():
        return "noise: no channel is valid"
    worst = int(np.nanargmax(sd_v))
    words = (
        f"noise of a channel: median {np.nanmedian(sd_v) * 1e3:.2f} mV rms, largest "
        f"{sd_v[worst] * 1e3:.2f} mV ({names[worst]}, channel {worst})"
    )
    never = [names[c] for c in np.flatnonzero(~known)]
    return words + (f"; never valid: {', '.join(never)}" if never else "")


def _settings(found: Study) -> str:
    hours = _motion_hours(found)
    alarms = [["setting", "least_shear", "false alarms in the motion", "per hour, 95 %"]]
    latency = [["first event (ms)", *(f"{kind}, {where}" for kind in ONSETS for where in ("hold", "motion"))]]
    for name, setting in found.settings.items():
        between = _between(*rate_interval(setting.motion.count, hours))
        alarms.append([name, f"{setting.params.shear:.3g}", _alarms(setting.motion), between])
        cells = [
            _latency(setting.latency.get((where, kind))) for kind in ONSETS for where in ("quiet", "motion")
        ]
        latency.append([name, *cells])
    kinds = ", ".join(f"{name}: within {onset.rise_s:g} s" for name, onset in ONSETS.items())
    return (
        f"{_table(alarms)}\n\n{_table(latency)}\n"
        f"Median latency and its 95 % interval for slips injected into your recordings: shear grows to "
        f"{WEAK_SHEAR:g} of the pressure along Mindlin's curve ({kinds}). Real slips are detected later."
    )


def _by_probability(found: Study) -> str:
    hours = _motion_hours(found)
    rows = [["detect.setting", "incipient p", "gross p", "reports in the motion", "per hour, 95 %"]]
    for name, alarms in found.by_probability.items():
        params = GRIP_SETTINGS[name]
        between = _between(*rate_interval(alarms.count, hours))
        rows.append([name, f"{params.incipient_p:g}", f"{params.gross_p:g}", _alarms(alarms), between])
    return (
        f"{_table(rows)}\n"
        "Slips reported by the contact model in the same motion (docs/grip.md). While an object stays in the "
        "hand, a tenth of the contact area may well slip: only what is reported as gross is false."
    )


def _table(rows: list[list[str]]) -> str:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
    return "\n".join(lines)


def _tails(found: Study) -> str:
    asked = ", ".join(
        f"{n} at {rate:g} per hour" for rate, n in zip(NOISE_PER_HOUR, found.noise_alarms, strict=True)
    )
    expected = NOISE_PER_HOUR[0] * found.hold_s / 3600
    steps = [f"{n} at {s:g}" for s, n in zip(SHEARS, found.shear_alarms, strict=True) if n]
    return (
        f"alarms in the hold by allowed rate: {asked} (up to {expected:.0f} are expected at the first)\n"
        f"alarms in the motion by least_shear: {', '.join(steps) or 'none at any value'}"
    )


def _proposal(found: Study) -> str:
    seconds, wanted = found.motion_s, found.wanted_per_hour
    alarms = _proposed_alarms(found)
    _, high = rate_interval(alarms, _motion_hours(found))
    there = rate_at(found.proposed.params.shear)
    lines = [
        f"proposed for {wanted:g} false alarms per hour: least_shear {found.proposed.params.shear:g}, "
        f"false_alarms_per_hour {found.proposed.params.false_alarms_per_hour:g}",
        f"an emulated hand that announces no motion causes {_rate(there)} per hour there (docs/slip.md)",
    ]
    proof = "3 / T, the rule of three" if alarms == 0 else "Poisson"
    lines.append(
        f"measured: {alarms} alarms in {seconds:.0f} s of motion, so at most {_rate(high)} per hour at 95 % "
        f"({proof})"
    )
    if high > wanted:
        hours = rate_interval(0, 1.0)[1] / wanted
        lines.append(
            f"this does not prove {wanted:g} per hour; {hours:.3g} h of such motion without an alarm would"
        )
    if found.shear_tail is not None and _is_extrapolated(found):
        value, low, top = found.least_shear
        lines.append(
            f"extrapolated from {found.shear_tail.count} alarms above {found.shear_tail.start:g} with an "
            f"exponential tail: least_shear {value:.2f}, 95 % interval {low:.2f} to {top:.2f}"
        )
    elif found.shear_tail is None:
        lines.append(
            "no alarm at any threshold in this motion, so nothing can be extrapolated; move as in hard work"
        )
    if found.out_of_reach:
        lines.append(
            f"out of reach: {wanted:g} per hour would need more shear than the {WEAK_SHEAR:g} of a weak "
            "slip, so the proposed values do not reach it; announce such motion (tactiled command inhibit, "
            "expect-load-change) and tune on the rest"
        )
    return "\n".join(lines)


def _motion_hours(found: Study) -> float:
    return found.motion_s / 3600


def _proposed_alarms(found: Study) -> int:
    return found.proposed.motion.count


def _is_extrapolated(found: Study) -> bool:
    """Return True if the wanted rate is below what this duration of motion could show."""
    return found.shear_tail is not None and found.wanted_per_hour < rate_interval(0, _motion_hours(found))[1]


def _alarms(alarms: AlarmCount) -> str:
    return f"{alarms.count}" + (f", {alarms.gross} gross" if alarms.gross else "")


def _between(low: float, high: float) -> str:
    return f"{_rate(low)} to {_rate(high)}"


def _rate(per_hour: float) -> str:
    return f"{per_hour:.0f}" if per_hour >= 10 else f"{per_hour:.2g}"


def _latency(latency: Latency | None) -> str:
    if latency is None:
        return "-"
    missed = f", {latency.missed} of {latency.tried} missed" if latency.missed else ""
    if latency.missed == latency.tried:
        return "never"
    return f"{_ms(latency.median_s)} ({_ms(latency.low_s)} to {_ms(latency.high_s)}){missed}"


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.0f}" if np.isfinite(seconds) else "never"


def _recording_map(recording: Recording, contact_s: float) -> dict[str, Any]:
    return {
        "name": recording.name,
        "seconds": recording.seconds,
        "contact_s": contact_s,
        "lost": recording.lost,
        "late": recording.late,
    }


def _setting_map(setting: Setting) -> dict[str, Any]:
    latency = [
        {
            "in": where,
            "slip": name,
            "shear": ONSETS[name].shear,
            "rise_s": ONSETS[name].rise_s,
            **dict(
                zip(
                    ("median_s", "low_s", "high_s"),
                    _numbers([entry.median_s, entry.low_s, entry.high_s]),
                    strict=True,
                )
            ),
            "tried": entry.tried,
            "missed": entry.missed,
        }
        for (where, name), entry in setting.latency.items()
    ]
    return {
        "least_shear": setting.params.shear,
        "false_alarms_per_hour": setting.params.false_alarms_per_hour,
        "alarms_quiet": vars(setting.quiet),
        "alarms_motion": vars(setting.motion),
        "latency": latency,
    }


def _tail_map(tail: AlarmTail | None) -> dict[str, Any] | None:
    return None if tail is None else {"start": tail.start, "count": tail.count, "scale": tail.scale}


def _numbers(values: list[float]) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values]
