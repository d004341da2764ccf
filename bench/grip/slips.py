"""Slip events of several detectors on the random worlds, and their scores."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.grip.worlds import INCIPIENT_USED, World
from bench.report import NONE, ratio
from tactiled.array import Array, FloatArray
from tactiled.detect.base import Detector
from tactiled.detect.grip.detector import GripParams
from tactiled.detect.grip.slip_detector import GripSlip
from tactiled.detect.slip.detector import SETTINGS, CoherentSlip
from tactiled.events.types import UNKNOWN_SD_DEG, SlipEvent

COMPARED: Mapping[str, Callable[[Array], Detector]] = {
    "contact model": lambda array: GripSlip(array, GripParams()),
    "contact model, at 0.2 / 0.2": lambda array: GripSlip(array, GripParams(incipient_p=0.2, gross_p=0.2)),
    "contact model, at 0.9 / 0.5": lambda array: GripSlip(array, GripParams(incipient_p=0.9, gross_p=0.5)),
    "balanced": lambda array: CoherentSlip(array, SETTINGS["balanced"]),
    "quiet": lambda array: CoherentSlip(array, SETTINGS["quiet"]),
}
SLOW_S = 0.2  # from a tenth of the area to all of it
_EARLY_S = 0.1  # before gross slip: what is reported earlier is counted as early
_REVERSED_DEG, _SURE_DEG = 90.0, 30.0


@dataclass(frozen=True, eq=False)
class WorldSlips:
    """Slip events of one world by detector."""

    world: World
    events: Mapping[str, Sequence[SlipEvent]]


def read_slips(world: World) -> WorldSlips:
    """Run the compared detectors over a world."""
    return WorldSlips(
        world,
        {
            name: [e for e in build(world.array).process(world.block) if isinstance(e, SlipEvent)]
            for name, build in COMPARED.items()
        },
    )


def slips_row(name: str, found: Sequence[WorldSlips]) -> dict[str, str]:
    """Scores of one detector."""
    usual = [f for f in found if f.world.hand != "falling-friction"]
    falling = [f for f in found if f.world.hand == "falling-friction"]
    error_deg, sd_deg = _directions(name, usual)
    is_within = [bool(one) for one in np.abs(error_deg) <= sd_deg]
    is_reversed = (np.abs(error_deg) > _REVERSED_DEG) & (sd_deg < _SURE_DEG)
    median = f"{np.median(np.abs(error_deg)):.1f} deg" if len(error_deg) else NONE
    return {
        "detector": name,
        "slow slips told before gross": ratio(_before_gross(name, usual)),
        "onsets an hour where nothing slips": f"{_onsets_per_hour(name, found):.0f}",
        "gross in 100 ms": ratio(gross_told(name, usual, 0.1)),
        "gross in 300 ms": ratio(gross_told(name, usual, 0.3)),
        f"more than {_EARLY_S:g} s early": ratio(told_early(name, usual)),
        "friction falls": ratio(gross_told(name, falling, 0.3)),
        "rests called gross": ratio(rests_called_gross(name, found)),
        "direction at gross slip": f"{median}, {ratio(is_within)} within one sigma, "
        f"{int(is_reversed.sum())} reversed",
    }


def gross_told(name: str, found: Sequence[WorldSlips], within_s: float) -> list[bool]:
    """Return, for each world with gross slip, True if a reported gross slip was open within a time of it."""
    out = []
    for f in found:
        if f.world.slips:
            since_s = f.world.gross_s[0] - _EARLY_S
            until_s = f.world.gross_s[0] + within_s
            told = any(since_s <= e.detected_s <= until_s for e in _onsets(f, name, "gross"))
            out.append(told or _is_gross_at(f, name, since_s))
    return out


def told_early(name: str, found: Sequence[WorldSlips]) -> list[bool]:
    """Return, for each world with gross slip, True if it was reported as gross well before it was."""
    return [_is_gross_at(f, name, f.world.gross_s[0] - _EARLY_S) for f in found if f.world.slips]


def _is_gross_at(found: WorldSlips, name: str, time_s: float) -> bool:
    before = [e for e in found.events[name] if e.detected_s < time_s]
    return bool(before) and (before[-1].state, before[-1].kind) == ("onset", "gross")


def rests_called_gross(name: str, found: Sequence[WorldSlips]) -> list[bool]:
    """Return, for each world without gross slip, True if one was reported."""
    return [bool(_onsets(f, name, "gross")) for f in found if not f.world.slips]


def _onsets(found: WorldSlips, name: str, kind: str) -> list[SlipEvent]:
    return [e for e in found.events[name] if (e.state, e.kind) == ("onset", kind)]


def _before_gross(name: str, found: Sequence[WorldSlips]) -> list[bool]:
    """Return, for each slow slip, True if a slip was open when it became gross."""
    out = []
    for f in found:
        if f.world.slips and f.world.gross_s[0] - f.world.tenth_s[0] >= SLOW_S:
            before = [e for e in f.events[name] if e.detected_s < f.world.gross_s[0]]
            out.append(bool(before) and before[-1].state == "onset")
    return out


def _onsets_per_hour(name: str, found: Sequence[WorldSlips]) -> float:
    """Return the onsets of incipient slip in an hour with less than a tenth of the area slipping."""
    n, hours = 0, 0.0
    for f in found:
        nothing = f.world.utilisation < INCIPIENT_USED
        hours += float(nothing.sum()) / f.world.rate_hz / 3600
        for event in _onsets(f, name, "incipient"):
            n += bool(nothing[round(event.detected_s * f.world.rate_hz)])
    return n / max(hours, 1e-9)


def _directions(name: str, found: Sequence[WorldSlips]) -> tuple[FloatArray, FloatArray]:
    """Return errors and standard deviations of the directions of true first gross slips, in degrees."""
    errors, sds = [], []
    for f in found:
        if not f.world.slips or f.world.hand == "twist":
            continue
        first_s = f.world.gross_s[0]
        near = [e for e in _onsets(f, name, "gross") if -_EARLY_S <= e.detected_s - first_s <= 0.3]
        if near and near[0].direction_sd_deg < UNKNOWN_SD_DEG:
            true_deg = float(f.world.direction_deg[round(first_s * f.world.rate_hz)])
            errors.append((near[0].direction_deg - true_deg + 180.0) % 360.0 - 180.0)
            sds.append(near[0].direction_sd_deg)
    return np.array(errors), np.array(sds)
