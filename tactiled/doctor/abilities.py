"""Findings on an array alone: contact, slip, direction and grooves that it can measure."""

from tactiled.array import Array
from tactiled.detect.grooves.params import JointParams
from tactiled.doctor.finding import Finding
from tactiled.doctor.groove_findings import check_waves

_FEW_CHANNELS = 4  # fewer tell no sliding: a hum and a rough surface are alike (detect/sliding/evidence.py)


def abilities(array: Array, params: JointParams, rate_hz: float, speed_mm_s: float) -> list[Finding]:
    """Describe what an array can measure at a scan rate; a speed of 0 means unknown."""
    grooves, speeds = check_waves(array, params, rate_hz, speed_mm_s)
    if grooves.verdict == "warn" and not grooves.values:  # no angle
        how = (
            f"the period across the motion is {speed_mm_s:g} mm/s over the frequency of the ripple"
            if speed_mm_s > 0
            else "frequency of the ripple; with a known speed, the period across the motion"
        )
        grooves = Finding("grooves", "warn", f"no angle (period-only): {how}", grooves.remedy)
    return [_contact(array), _slip(array), _direction(array), grooves, speeds]


def _contact(array: Array) -> Finding:
    n_pressed = int(array.normal_weights().any(axis=1).sum())
    if n_pressed == 0:
        return Finding("contact", "warn", "not measured: no channel of kind normal or side")
    words = f"from the pressure of {n_pressed} of {array.n_taxels} taxels"
    if array.contact is not None:
        return Finding("contact", "ok", f"{words}, above {array.contact.above:g} {array.unit}")
    return Finding("contact", "ok", f"{words}, above the noise of each; [contact] sets limits of your own")


def _slip(array: Array) -> Finding:
    has_pressure = bool(array.normal_weights().any())
    if array.measures_ratio:
        return Finding("slip", "ok", "from shear, beside the pressure")
    if array.has_shear:
        what = "field" if array.is_field else "shear"
        return Finding(
            "slip", "warn", f"from {what} that grows beyond its own hold; without a load to compare"
        )
    if not has_pressure or array.n_channels < _FEW_CHANNELS:
        words = f"not reported: no shear, and fewer than {_FEW_CHANNELS} pressure channels"
        return Finding("slip", "warn", words)
    return Finding("slip", "warn", "slip, from load that moves, roughness and ripple; no shear channels")


def _direction(array: Array) -> Finding:
    if array.measures_ratio:
        return Finding("direction", "ok", "of slip, from shear")
    lacking = "shear without a load" if array.has_shear else "no shear channels"
    return Finding("direction", "warn", f"not measured: {lacking}; --direction gives it for a log")
