"""Comparison of the demo's estimates with the ground truth, and the load of the host.

The expected slips come from the ground truth of the scene; a slip that was not reported appears as missing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

from tactiled.emulator.scene.phases import GroovedPlate
from tactiled.emulator.scene.truth import TrueSlip, Truth
from tactiled.events.types import Event, GripEvent, SlipEvent, TextureEvent

# About a tenth of the published errors at their largest (Wang 2019, table 2: period 9.2 %, angle 7.4 %).
MAX_PERIOD_ERROR = 0.01
MAX_ANGLE_ERROR_DEG = 0.3
# From the instants at which a tenth and nine tenths of the contact slip; more where the event says that its
# instant is less certain, up to so many of its standard deviations.
MAX_ONSET_ERROR_S, ONSET_SDS = 0.05, 3.0
MAX_DIRECTION_ERROR_DEG = 5.0
# While all of the contact slides, from this long after the beginning of that: utilisation is 1, and grip
# messages say gross. Sliding shows by friction that differs from place to place, over half a millimetre.
SLIDES_AFTER_S = 0.7
MAX_USED_ERROR = 0.1
MAX_UNTOLD_SHARE = 0.01
MAX_ANSWER_S = 3.0  # from the slide's begin to a texture
REFINED_S = 3.0  # then the demo goes on for so long: its picture shows how the answer settles
# An onset nearer than this to a true one is an estimate of it; the slips of a scene are seconds apart.
_SAME_SLIP_S = 1.0
# Share of scans that came too late to be acted on. On an idle host there are none.
MAX_LATE_SHARE = 0.05
# Groove fits that were not ready in time. Where estimates are good all the same, more do not matter.
MAX_LATE_FITS = 5
# Share of scans that never came. Single ones are bridged; with one in twenty, answers are given up as stale.
MAX_LOST_SHARE = 0.05

GROOVE_ROWS = (": answer after", ": period", ": angle")
HEAD = ["quantity", "truth", "estimate", "error", "allowed", ""]


@dataclass
class Host:
    """Measures of how well this host kept up with the board."""

    # scans, late, lost: scans received; of these, those that the daemon called late; and those that never
    # came
    scans: int = 0
    late: int = 0
    lost: int = 0
    oldest_s: float = 0.0  # largest age of a scan when the daemon had handled it
    fits_late: int = 0  # groove fits that were not ready in time

    def __str__(self) -> str:
        return (
            f"{self.scans} scans, {self.late} of them late (the latest {self.oldest_s:.2f} s old), "
            f"{self.lost} lost, {self.fits_late} groove fits late"
        )

    def too_slow(self, *, is_wrong: bool = True) -> str:
        """Describe why this host is too slow; empty when it kept up.

        Late fits are a reason where an estimate is wrong or missing (`is_wrong`).
        """
        shown = []
        if self.late > MAX_LATE_SHARE * self.scans:
            shown.append(f"{self.late} of {self.scans} scans were late, the latest {self.oldest_s:.2f} s old")
        if is_wrong and self.fits_late > MAX_LATE_FITS:
            shown.append(f"{self.fits_late} groove fits were not ready in time")
        if self.lost > MAX_LOST_SHARE * self.scans:
            shown.append(f"{self.lost} scans were lost on the way")
        return "; ".join(shown)


@dataclass
class DemoComparison:
    """Table of truth and estimate, and the list of errors; empty if all is right."""

    rows: list[list[str]] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    @property
    def is_groove_wrong(self) -> bool:
        """A groove estimate is wrong or missing, for which late fits may be the reason."""
        return any(row in words for words in self.wrong for row in GROOVE_ROWS)

    def add(
        self, what: str, truth: float, estimate: float, allowed: float, unit: str, error: float | None = None
    ) -> None:
        """Compare one quantity; an infinite estimate means none."""
        error = estimate - truth if error is None else error
        good = abs(error) <= allowed
        shown = f"{error:+.3g} {unit}" if math.isfinite(error) else "none"
        form = ".3f" if unit else "g"
        reported = f"{estimate:{form}} {unit}" if math.isfinite(estimate) else "none"
        verdict = "good" if good else "WRONG"
        self.rows.append([what, f"{truth:{form}} {unit}", reported, shown, f"{allowed:.3g} {unit}", verdict])
        if not good:
            self.wrong.append(f"{what}: {reported.strip() if math.isfinite(estimate) else 'not reported'}")


def true_slides(truth: Truth) -> list[TrueSlip]:
    """Slips with a direction of motion; slips during a lift have none and are not expected events."""
    return [slip for slip in truth.slips if slip.direction_deg is not None]


def true_releases(truth: Truth) -> list[TrueSlip]:
    """Slips during a lift, in which the remaining shear is released: they may be reported, or not."""
    return [slip for slip in truth.slips if slip.direction_deg is None]


def finds_end_s(slides: Sequence[TrueSlip], duration_s: float) -> float:
    """Scene time by which every estimate must have been reported."""
    last_s = max((slide.gross_s or slide.onset_s for slide in slides), default=duration_s)
    return min(last_s + MAX_ANSWER_S + REFINED_S, duration_s)


def name_of(number: int, slide: TrueSlip) -> str:
    """Name of a slide in the table; numbers begin at 1."""
    return f"slip {number}, {slide.surface.kind}"


def compare(
    slides: Sequence[TrueSlip], events: Sequence[Event], t0_s: float, releases: Sequence[TrueSlip] = ()
) -> DemoComparison:
    """Compare the events, on the host's clock, with the expected slips, in scene time.

    `t0_s` is scene time 0 on the host's clock; `releases` may be reported and need not be.
    """
    out = DemoComparison()
    onsets = [e for e in events if isinstance(e, SlipEvent) and e.state == "onset"]
    textures = [e for e in events if isinstance(e, TextureEvent) and e.status == "ok"]
    n_gross = sum(
        e.kind == "gross" and not any(r.onset_s <= e.detected_s - t0_s <= r.end_s for r in releases)
        for e in onsets
    )
    for number, slide in enumerate(slides, 1):
        name = name_of(number, slide)
        found = None
        for kind, true_s in (("incipient", slide.incipient_s), ("gross", slide.gross_s)):
            if true_s is None:  # a scene of prescribed signals has no partial slip
                continue
            found = _nearest(onsets, kind, t0_s + true_s)
            if found is not None:
                onsets.remove(found)
            found_s = math.inf if found is None else found.onset_s - t0_s
            certain_s = 0.0 if found is None else ONSET_SDS * found.onset_sd_s
            out.add(f"{name}: {kind} at", true_s, found_s, max(MAX_ONSET_ERROR_S, certain_s), "s")
        found_deg = math.inf if found is None else found.direction_deg
        true_deg = slide.direction_deg or 0.0
        error = _turn_deg(found_deg - true_deg)
        out.add(f"{name}: direction", true_deg, found_deg, MAX_DIRECTION_ERROR_DEG, "deg", error)
        _compare_grips(out, name, slide, [e for e in events if isinstance(e, GripEvent)], t0_s)
        if isinstance(slide.surface, GroovedPlate):
            own = [e for e in textures if slide.onset_s <= e.time_s - t0_s <= slide.end_s + 1.0]
            textures = [e for e in textures if e not in own]
            _compare_grooves(out, name, slide, slide.surface, own, t0_s)
    out.add("slides reported", len(slides), n_gross, 0, "")
    out.add("textures where there are no grooves", 0, len(textures), 0, "")
    if not slides:
        out.wrong.append("the scene plays no slide: there is nothing to find")
    return out


def _nearest(onsets: Sequence[SlipEvent], kind: str, true_s: float) -> SlipEvent | None:
    near = [e for e in onsets if e.kind == kind and abs(e.onset_s - true_s) < _SAME_SLIP_S]
    return min(near, key=lambda e: abs(e.onset_s - true_s), default=None)


def _compare_grips(
    out: DemoComparison, name: str, slide: TrueSlip, grips: Sequence[GripEvent], t0_s: float
) -> None:
    if slide.gross_s is None:
        return
    from_s, until_s = t0_s + slide.gross_s + SLIDES_AFTER_S, t0_s + slide.end_s
    while_sliding = [grip for grip in grips if from_s <= grip.time_s < until_s]
    used = told = math.inf
    if while_sliding:
        used = median(grip.utilisation for grip in while_sliding)
        told = sum(grip.state == "gross" for grip in while_sliding) / len(while_sliding)
    out.add(f"{name}: utilisation", 1.0, used, MAX_USED_ERROR, "")
    out.add(f"{name}: part reported as gross", 1.0, told, MAX_UNTOLD_SHARE, "")


def _compare_grooves(
    out: DemoComparison,
    name: str,
    slide: TrueSlip,
    grooves: GroovedPlate,
    answers: Sequence[TextureEvent],
    t0_s: float,
) -> None:
    answer_s, period_mm, angle_deg = math.inf, math.inf, math.inf
    if answers:
        first = answers[0]
        answer_s, period_mm, angle_deg = first.answered_s - t0_s, first.period_mm, first.angle_deg
    begin_s = slide.gross_s or slide.onset_s
    out.add(f"{name}: answer after", 0.0, answer_s - begin_s, MAX_ANSWER_S, "s")
    period = grooves.period_mm
    out.add(f"{name}: period", period, period_mm, MAX_PERIOD_ERROR * period, "mm")
    out.add(f"{name}: angle", grooves.angle_deg, angle_deg, MAX_ANGLE_ERROR_DEG, "deg")


def _turn_deg(angle_deg: float) -> float:
    """Difference of two directions, within -180..180; infinity stays."""
    return (angle_deg + 180) % 360 - 180 if math.isfinite(angle_deg) else angle_deg
