"""What the demo saw, and whether it is right: truth beside estimate, each with what is allowed."""

import math
import time
from dataclasses import dataclass, field
from typing import Any

from tactiled.events.types import Event, SlipEvent, TextureEvent

# About a tenth of the published errors at their largest (Wang 2019, table 2: period 9.2 %, angle 7.4 %).
MAX_PERIOD_ERROR = 0.01
MAX_ANGLE_ERROR_DEG = 0.3
MAX_ONSET_ERROR_S = 0.05  # from the instants at which a tenth and nine tenths of the contact slip
MAX_DIRECTION_ERROR_DEG = 5.0
MAX_ANSWER_S = 3.0  # from the slide's begin to a texture
REFINED_S = 3.0  # then the demo goes on for so long: its picture shows how the answer settles

HEAD = ["quantity", "truth", "estimate", "error", "allowed", ""]


@dataclass
class Seen:
    """What the subscriber received and what the emulator knows, on the host's monotonic clock."""

    scene: dict[str, Any] = field(default_factory=dict)
    slips: dict[int, dict[str, Any]] = field(default_factory=dict)
    time_s: list[float] = field(default_factory=list)
    volts: list[list[float]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    channel_offset_s: list[float] | None = None

    @property
    def slides(self) -> list[dict[str, Any]]:
        """True slips in which the skin moved on; a lift slips too, but goes nowhere."""
        return [s for s in self.slips.values() if s["gross_s"] and s["direction_deg"] is not None]

    @property
    def textures(self) -> list[TextureEvent]:
        """Answers."""
        return [e for e in self.events if isinstance(e, TextureEvent) and e.status == "ok"]

    @property
    def done(self) -> bool:
        """The grooves were named, and again as the answer was refined; or the scene is over."""
        if not self.scene:
            return False
        said = self.textures
        refined = bool(said) and said[-1].time_s >= said[0].time_s + REFINED_S
        return refined or time.monotonic() > self.scene["t0_s"] + self.scene["duration_s"] + 1.0


class _Rows:
    """A table of verdicts that grows."""

    def __init__(self) -> None:
        self.rows: list[list[str]] = []
        self.all_good = True

    def add(
        self, what: str, truth: float, estimate: float, allowed: float, unit: str, error: float | None = None
    ) -> None:
        error = estimate - truth if error is None else error
        good = abs(error) <= allowed
        self.all_good &= good
        shown = f"{error:+.3g} {unit}" if math.isfinite(error) else "none"
        form = ".3f" if unit else "g"
        said = f"{estimate:{form}} {unit}" if math.isfinite(estimate) else "none"
        verdict = "good" if good else "WRONG"
        self.rows.append([what, f"{truth:{form}} {unit}", said, shown, f"{allowed:.3g} {unit}", verdict])


def compare(seen: Seen) -> tuple[list[list[str]], bool]:
    """Rows of truth against estimate, and whether all is right."""
    t0_s = seen.scene["t0_s"]
    onsets = [e for e in seen.events if isinstance(e, SlipEvent) and e.state == "onset"]
    out = _Rows()
    for number, slip in enumerate(seen.slides, 1):
        name = f"slip {number}, {slip['surface']['kind']}"
        for kind in ("incipient", "gross"):
            true_s = slip[f"{kind}_s"]
            near = [e for e in onsets if e.kind == kind and abs(e.onset_s - true_s) < 1.0]
            said_s = near[0].onset_s if near else math.inf
            out.add(f"{name}: {kind} at", true_s - t0_s, said_s - t0_s, MAX_ONSET_ERROR_S, "s")
        direction_deg = near[0].direction_deg if near else math.inf
        error = _turn_deg(direction_deg - slip["direction_deg"])
        allowed = MAX_DIRECTION_ERROR_DEG
        out.add(f"{name}: direction", slip["direction_deg"], direction_deg, allowed, "deg", error)
        if slip["surface"]["kind"] == "grooves":
            _compare_grooves(out, name, slip, seen.textures)
    gross = [e for e in onsets if e.kind == "gross"]
    out.add("slides said", len(seen.slides), len(gross), 0, "")
    return out.rows, out.all_good


def _compare_grooves(out: _Rows, name: str, slip: dict[str, Any], textures: list[TextureEvent]) -> None:
    surface = slip["surface"]
    answer_s, period_mm, angle_deg = math.inf, math.inf, math.inf
    if textures:
        first = textures[0]
        answer_s, period_mm, angle_deg = first.time_s, first.period_mm, first.angle_deg
    out.add(f"{name}: answer after", 0.0, answer_s - slip["gross_s"], MAX_ANSWER_S, "s")
    period = surface["period_mm"]
    out.add(f"{name}: period", period, period_mm, MAX_PERIOD_ERROR * period, "mm")
    out.add(f"{name}: angle", surface["angle_deg"], angle_deg, MAX_ANGLE_ERROR_DEG, "deg")


def _turn_deg(angle_deg: float) -> float:
    """Difference of two directions, within -180..180; infinity stays."""
    return (angle_deg + 180) % 360 - 180 if math.isfinite(angle_deg) else angle_deg
