"""``./run bench hostile``: every attack, with what was expected and what was seen."""

import tempfile
from importlib import import_module
from pathlib import Path

from bench.hostile.attack import Attack, Outcome
from bench.report import Aim, BenchOptions, BenchReport, aims_table, judge, ratio, table
from tactiled.progress import ProgressBar

# One module for each border; each has `ATTACKS`.
BORDERS = ("usb", "store", "disk", "page", "files", "compiled", "subscribers", "line", "config", "network")


def all_attacks() -> list[Attack]:
    """Return the attacks of all borders."""
    found: list[Attack] = []
    for border in BORDERS:
        found += import_module(f"bench.hostile.{border}").ATTACKS
    return found


def do(attack: Attack, scale: float) -> Outcome:
    """Run one attack in a new folder; an exception of the attack is an outcome, too."""
    with tempfile.TemporaryDirectory(prefix="tactiled-hostile-") as folder:
        try:
            return attack.run(Path(folder), scale)
        except Exception as error:
            return Outcome(f"{type(error).__name__}: {error}", held=False)


def bench_hostile(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Run all attacks, in their short form with ``--quick``."""
    attacks = [attack for attack in all_attacks() if not (options.quick and attack.short is None)]
    outcomes: list[Outcome] = []
    progress.begin(len(attacks))
    for attack in attacks:
        scale = attack.short if options.quick and attack.short is not None else 1.0
        outcomes.append(do(attack, scale))
        progress.advance(attack.name)
    rows = table(
        {
            "attack": attack.name,
            "tried": attack.tried,
            "expected": attack.expected,
            "seen": ("" if outcome.held else "**NOT HELD** ") + outcome.seen,
        }
        for attack, outcome in zip(attacks, outcomes, strict=True)
    )
    held = [outcome.held for outcome in outcomes]
    aim: Aim[list[bool]] = Aim("attacks held", "all", lambda found: judge(ratio(found), all(found)))
    return BenchReport([rows, aims_table([aim], {"measured": held})])
