"""Findings on an array alone: contact, slip, direction and grooves that it can measure."""

from dataclasses import replace

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.detect.grooves.ambiguity import has_baseline
from tactiled.detect.grooves.model import ALIASED, WaveMotion, channel_layout
from tactiled.detect.grooves.params import JointParams
from tactiled.doctor.finding import Finding
from tactiled.events.types import UNKNOWN_SD_DEG

_FEW_CHANNELS = 4  # fewer tell no sliding: a hum and a rough surface are alike (detect/sliding/tracker.py)
_SAME_GAP = 0.02  # relative; less moves the phases of the finest grooves by less than those of a skin deviate


def abilities(array: Array, params: JointParams, rate_hz: float, speed_mm_s: float) -> list[Finding]:
    """Describe what an array can measure at a scan rate; a speed of 0 means unknown."""
    return [
        _contact(array),
        _slip(array),
        _direction(array),
        *check_waves(array, params, rate_hz, speed_mm_s),
    ]


def _contact(array: Array) -> Finding:
    n_pressed = int(array.normal_weights().any(axis=1).sum())
    if n_pressed == 0:
        return Finding("contact", "warn", "not measured: no channel of kind normal or side")
    words = f"from the pressure of {n_pressed} of {array.n_taxels} taxels"
    if array.contact is not None:
        return Finding("contact", "ok", f"{words}, above {array.contact.above:g} {array.unit}")
    return Finding("contact", "ok", f"{words}, above the noise of each ([contact] states other limits)")


def _slip(array: Array) -> Finding:
    if array.measures_ratio:
        return Finding("slip", "ok", "found from shear and pressure")
    if array.has_shear:
        what = "field" if array.is_field else "shear"
        words = f"found where {what} grows more than in the hold before; there is no load to compare it with"
    elif array.normal_weights().any() and array.n_channels >= _FEW_CHANNELS:
        words = "found where load moves between taxels, or roughness or a ripple passes; no shear channels"
    else:
        words = f"not reported: no shear channels, and fewer than {_FEW_CHANNELS} pressure channels"
    return Finding("slip", "warn", words)


def _direction(array: Array) -> Finding:
    if array.measures_ratio:
        return Finding("direction", "ok", "that of a slip is found from shear")
    lacking = "shear channels, but no load" if array.has_shear else "no shear channels"
    return Finding("direction", "warn", f"not measured: {lacking}; for a log, state it with --direction")


def check_waves(array: Array, params: JointParams, rate_hz: float, speed_mm_s: float) -> list[Finding]:
    """Check whether taxels give an angle, and which speeds fit; a speed of 0 means unknown."""
    return [_angle(array, params, speed_mm_s), _speeds(params, rate_hz, speed_mm_s)]


def _angle(array: Array, params: JointParams, speed_mm_s: float) -> Finding:
    name = "grooves"
    has_direction = params.direction_deg is not None or array.has_shear  # slip events give it
    direction_sd_deg = 0.0 if has_direction else UNKNOWN_SD_DEG
    motion = WaveMotion(speed_mm_s, 0.0, params.direction_deg or 0.0, direction_sd_deg)
    if not has_baseline(channel_layout(array), motion):
        how = (
            f"the period along the motion is {speed_mm_s:g} mm/s divided by the frequency of the ripple"
            if speed_mm_s > 0
            else "the frequency of the ripple is known; with a known speed, also the period along the motion"
        )
        remedy = "use an array with taxels in rows and columns"
        # A known speed does not help taxels that all lie in one row along the motion.
        if speed_mm_s == 0 and has_baseline(channel_layout(array), replace(motion, speed_mm_s=1.0)):
            remedy = "set the speed (detect.texture.speed_mm_s), or " + remedy
        return Finding(name, "warn", f"the angle is not measured (status period-only); {how}", remedy)
    words = f"period and angle, of {params.min_period_mm:g} to {params.max_period_mm:g} mm"
    # Over equal gaps, wave vectors that differ by 2 pi / gap give the same phases. None is longer than
    # 2 pi / min_period, so two of them differ by at most twice that.
    coarsest_mm = 2 * max(_equal_gap_mm(array.x_mm), _equal_gap_mm(array.y_mm))
    if params.min_period_mm > coarsest_mm:
        return Finding(name, "ok", words)
    return Finding(
        name,
        "warn",
        f"{words}; gaps between taxels are equal, so that two gratings may have the same phases (ambiguous)",
        f"set detect.texture.min_period_mm above {coarsest_mm:g} if no grating is finer, or use an array "
        "with unequal gaps (wang2019-3x3); a known speed and direction exclude some of these gratings",
    )


def _equal_gap_mm(places_mm: FloatArray) -> float:
    """Distance of three or more places at equal distances; 0 for others."""
    gaps_mm = np.diff(np.unique(places_mm.round(3)))
    is_equal = len(gaps_mm) > 1 and bool(np.ptp(gaps_mm) < _SAME_GAP * gaps_mm.mean())
    return float(gaps_mm.mean().round(3)) if is_equal else 0.0


def _speeds(params: JointParams, rate_hz: float, speed_mm_s: float) -> Finding:
    """Check the speed against the configured periods."""
    name = "sliding speed"
    window_s, low_mm, high_mm = params.criteria.max_window_s, params.min_period_mm, params.max_period_mm
    fastest_mm_s = ALIASED * rate_hz * low_mm
    slowest_mm_s = high_mm * params.min_periods / window_s
    blind = f"motion within {90 - params.max_tilt_deg:g} deg of the direction of the ridges gives no ripple"
    fast = f"{fastest_mm_s:.3g} mm/s or slower to measure periods of {low_mm:g} mm"
    slow = f"{slowest_mm_s:.2g} mm/s or faster to measure periods of {high_mm:g} mm"
    if speed_mm_s <= 0:
        return Finding(name, "ok", f"slide at {fast}, and at {slow}; {blind}")
    words = []
    if speed_mm_s > fastest_mm_s:
        finest_mm = speed_mm_s / (ALIASED * rate_hz)
        words.append(
            f"periods below {finest_mm:.3g} mm are too fine for {rate_hz:g} scans a second (aliased)"
        )
    if speed_mm_s < slowest_mm_s:
        coarsest_mm = speed_mm_s * window_s / params.min_periods
        words.append(
            f"periods above {coarsest_mm:.3g} mm are too long for a window of {window_s:g} s: slide at {slow}"
        )
    text = f"at {speed_mm_s:g} mm/s, {'; '.join([*words, blind])}"
    if speed_mm_s <= fastest_mm_s:
        return Finding(name, "ok", text)
    return Finding(name, "warn", text, f"slide at {fast}, or scan faster (session.rate_hz)")
