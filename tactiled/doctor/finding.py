"""Result of a check."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

Severity = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    check: str
    verdict: Severity  # "warn": it works, and could be better; "fail": it does not work
    words: str
    remedy: str = ""  # empty where none is needed
    values: dict[str, Any] = field(default_factory=dict)  # numbers in `words`, for programs; JSON-compatible

    @property
    def line(self) -> str:
        """The finding in one line."""
        return f"{self.check}: {self.words}" + (f" -> {self.remedy}" if self.remedy else "")


def as_text(findings: Sequence[Finding]) -> str:
    """Format findings as text, with a summary line."""
    width = max(len(finding.check) for finding in findings)
    lines = []
    for finding in findings:
        lines.append(f"{finding.verdict:4}  {finding.check:{width}}  {finding.words}")
        if finding.remedy:
            lines.append(f"{'':4}  {'':{width}}  -> {finding.remedy}")
    n_fail, n_warn = (sum(f.verdict == verdict for f in findings) for verdict in ("fail", "warn"))
    return "\n".join([*lines, f"{len(findings)} checks: {n_fail} fail, {n_warn} warn"])


def as_json(findings: Sequence[Finding]) -> str:
    """Format findings as JSON lines."""
    return "\n".join(json.dumps(asdict(finding)) for finding in findings)


def split(check: str, line: str, verdict: Severity) -> Finding:
    """Make a finding from a message of the form ``fault; remedy``."""
    words, _, remedy = line.partition("; ")
    return Finding(check, verdict, words, remedy)
