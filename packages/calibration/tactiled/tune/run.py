"""Result of ``tactiled tune`` as text, as TOML for the configuration, and as a map for JSON."""

import json
from typing import Any

import click

from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.plain_table import table
from tactiled.progress import ProgressBar, tell
from tactiled.tune.study import N_STAGES, Recording, ReportCount, Study, rate_interval, study


def judge(quiet: Recording, motion: Recording, accepted_per_hour: float, *, as_json: bool = True) -> None:
    """Evaluate two recordings; report to stderr, all numbers as one JSON line to stdout if asked."""
    with ProgressBar("count the reports of each setting", N_STAGES) as bar:
        found = study(quiet, motion, accepted_per_hour, bar.advance)
    tell(f"\n{in_words(found)}\n\nfor tactiled.toml:\n\n{as_toml(found)}")
    if as_json:
        click.echo(json.dumps(as_map(found), allow_nan=False))


def in_words(found: Study) -> str:
    """Format the report as text, one paragraph per subject."""
    return "\n\n".join([_recordings(found), _settings(found), _proposal(found)])


def as_toml(found: Study) -> str:
    """Format the proposed parameters for tactiled.toml."""
    text = f'[detect]\nsetting = "{found.proposed}"\n'
    if found.friction is not None:
        text += (
            f"\n[detect.grip]\nfriction = {found.friction.median:.3g}\n"
            f"friction_log_sd = {found.friction.log_sd:.2g}\n"
        )
    return text


def as_map(found: Study) -> dict[str, Any]:
    """Map of all results for JSON; unknown values are null."""
    recordings = {"quiet": (found.quiet, found.hold_s), "motion": (found.motion, found.motion_s)}
    return {
        "array": found.quiet.array.name,
        "accepted_per_hour": found.accepted_per_hour,
        "toml": as_toml(found),
        **{
            what: {"name": one.name, "seconds": one.seconds, "contact_s": contact_s}
            for what, (one, contact_s) in recordings.items()
        },
        "settings": {
            name: {
                "incipient_p": SETTINGS[name].incipient,
                "gross_p": SETTINGS[name].gross,
                "quiet": reports.quiet._asdict(),
                "motion": reports.motion._asdict(),
                "per_hour": _interval_map(found, reports.motion.total),
                "gross_per_hour": _interval_map(found, reports.motion.gross),
            }
            for name, reports in found.settings.items()
        },
        "proposed": {
            "setting": found.proposed,
            "is_accepted": found.is_accepted,
            "friction": None if found.friction is None else found.friction.median,
            "friction_log_sd": None if found.friction is None else found.friction.log_sd,
        },
    }


def _recordings(found: Study) -> str:
    lines = []
    judged = (("quiet hold", found.quiet, found.hold_s), ("motion", found.motion, found.motion_s))
    for what, recording, contact_s in judged:
        lines.append(f"{what}: {contact_s:.1f} s of contact in {recording.seconds:.1f} s ({recording.name})")
    if least := min(reports.quiet.total for reports in found.settings.values()):
        lines.append(
            f"the hold was not quiet: every setting reports {least} slips or more in it; support the hand, "
            "hold still and run again"
        )
    return "\n".join(lines)


def _settings(found: Study) -> str:
    rows = []
    for name, reports in found.settings.items():
        at = SETTINGS[name]
        between = "{} to {}".format(*map(_rate, found.interval(reports.motion.total)))
        counts = [_reports(reports.quiet), _reports(reports.motion)]
        rows.append([name, f"{at.incipient:g}", f"{at.gross:g}", *counts, between])
    head = ["setting", "incipient p", "gross p", "slips, hold", "in motion", "per hour, 95 %"]
    return table(head, rows) + (
        "\nNothing slipped as a whole: every report of gross slip is false. An incipient slip may be true, "
        "since a tenth of the contact area may slip in an object that stays in the hand."
    )


def _proposal(found: Study) -> str:
    n, accepted = found.settings[found.proposed].motion.total, found.accepted_per_hour
    _, high = found.interval(n)
    which = "the earliest setting" if found.is_accepted else "even the strictest setting has more"
    lines = [
        f"proposed for {accepted:g} reports per hour: {found.proposed} ({which})",
        f"measured: {n} reports in {found.motion_s:.0f} s of motion, so at most {_rate(high)} per hour at "
        f"95 % ({'3 / T, the rule of three' if n == 0 else 'Poisson'})",
    ]
    if high > accepted:
        hours = rate_interval(0, 1.0)[1] / accepted
        lines.append(
            f"this does not prove {accepted:g} per hour; {hours:.3g} h of such motion without a report would"
        )
    if not found.is_accepted:
        lines.append(
            "announce such motion (tactiled command inhibit, expect-load-change) and tune on the rest"
        )
    if not found.quiet.array.measures_ratio:
        lines.append(
            "the setting does not matter: without shear and load, all of them have the same detector"
        )
    if found.friction is None:
        lines.append("friction: these contacts tell no more about it than the prior")
    else:
        lines.append(
            f"friction of this object: {found.friction.median:.3g} (shear over load at which it slips), "
            f"standard deviation of its logarithm {found.friction.log_sd:.2g}; omit it where objects change"
        )
    return "\n".join(lines)


def _reports(count: ReportCount) -> str:
    return f"{count.total}" + (f", {count.gross} gross" if count.gross else "")


def _rate(per_hour: float) -> str:
    return f"{per_hour:.0f}" if per_hour >= 10 else f"{per_hour:.2g}"


def _interval_map(found: Study, count: int) -> dict[str, float]:
    low, high = found.interval(count)
    return {"value": count / (found.motion_s / 3600), "low": low, "high": high}
