"""The sentence above all numbers: what the contact does and what to do, then how surely.

`verdict.js` of the page has the same sentences, because it also says them at each instant of a recording
that somebody scrubs; tests/helpers/verdicts.py is the table of both.
"""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

from tactiled.events.words import way
from tactiled.top.boards import BoardView

_NEAR = 0.7  # utilisation that `needed_load` of the grip messages aims at: above it, tighten
_LIKELY = 0.5
Level = Literal["free", "good", "near", "partial", "gross"]


class Verdict(NamedTuple):
    """Sentence on the contact and what to do, its level, which colours it, and how sure that is."""

    level: Level
    sentence: str
    sure: str


def verdict(board: BoardView, now_unix_s: float) -> Verdict:
    """Judge the contact at an instant, from the newest messages of a board that is FRESH or LATE."""
    slip, grip = board.slip, board.current("grip")
    status = board.newest.get("status", {})
    state = str(
        board.newest["contact"]["state"] if "contact" in board.newest else status.get("contact", "none")
    )
    if slip is not None:
        state = "sliding" if slip["kind"] == "gross" else "shearing"
    sure = _sure(grip, state, slip)
    if state in ("sliding", "shearing"):
        words = "Slipping" if state == "sliding" else "Beginning to slip"
        if slip is not None:
            towards = way(slip["direction_deg"], slip["direction_sd_deg"])
            words += f"{towards and f' towards {towards}'} for {_duration(now_unix_s - slip['onset'])}"
            if slip["suppressed"]:
                return Verdict("good", f"{words}, as announced ({slip['suppressed']})", sure)
            if not slip["valid"] and not (grip and grip["valid"]):
                return Verdict("near", f"{words}: do not act on it", "The readings were late or incomplete.")
        return Verdict("gross" if state == "sliding" else "partial", f"{words}: tighten", sure)
    if state == "none":
        return Verdict("free", "Nothing touches the skin", sure)
    if state == "unknown":
        unseen = "The beginning of this contact was not seen."
        return Verdict("near", "Touching, may hold or slip: lift once", sure or unseen)
    if grip and grip["valid"] and (grip["utilisation"] > _NEAR or grip["p_gross_100ms"] > _LIKELY):
        return Verdict("near", "Holding near the friction limit: tighten", sure)
    return Verdict("good", "Being pressed" if state == "loading" else "Holding", sure)


def _sure(grip: Mapping[str, Any] | None, state: str, slip: Mapping[str, Any] | None) -> str:
    """Say how surely, in one line of at most 60 characters."""
    if state == "none":
        return ""
    if grip is None or grip["state"] == "none":
        return "" if slip is None else f"{_percent(slip['confidence'])} sure"
    if grip["state"] == "unknown":
        return ""
    if state == "sliding":  # a slip comes ahead of the margins of its scan
        is_newer = slip is not None and grip["timestamp"] < slip["detected"]
        share = slip["confidence"] if slip is not None and is_newer else grip["p_sliding"]
        return f"{_percent(share)} sure that all of the contact slides"
    if state == "shearing" and slip is not None:
        return f"{_percent(slip['confidence'])} sure that a part of the contact slips"
    if grip["p_gross_100ms"] > _LIKELY:
        return f"{_percent(grip['p_gross_100ms'])} sure that it slips within 0.1 s"
    return f"{_percent(grip['utilisation'])} of the friction limit in use"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _duration(duration_s: float) -> str:
    s = max(0.0, duration_s)
    return f"{s:.1f} s" if s < 10 else f"{s:.0f} s" if s < 100 else f"{s / 60:.0f} min"
