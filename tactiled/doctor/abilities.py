"""Findings of check-config on an array alone: contact, slip, direction and grooves that it can measure."""

from tactiled.array import Array, FloatArray
from tactiled.detect.grooves.estimator import JointParams
from tactiled.doctor.finding import Finding
from tactiled.doctor.waves import check_waves


def abilities(array: Array, rate_hz: float, speed_mm_s: float) -> list[Finding]:
    """Describe what an array can measure at a scan rate; a speed of 0 means unknown."""
    params = JointParams()
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
    if array.has_shear and has_pressure:
        return Finding("slip", "ok", "from shear, beside the pressure")
    if array.has_shear:
        return Finding(
            "slip", "warn", "not reported: shear without pressure gives no contact", "add a normal channel"
        )
    if has_pressure and array.has_places and _has_two_places(array.x_mm, array.y_mm):
        return Finding("slip", "warn", "from pressure that moves between taxels; no shear channels")
    remedy = "give the places of the taxels" if array.n_taxels > 1 and not array.has_places else ""
    return Finding("slip", "warn", "not reported: neither shear nor pressure at two known places", remedy)


def _direction(array: Array) -> Finding:
    if array.has_shear:
        return Finding("direction", "ok", "of slip, from shear")
    return Finding("direction", "warn", "not measured: no shear channels; --direction gives it for a log")


def _has_two_places(x_mm: FloatArray, y_mm: FloatArray) -> bool:
    return bool(x_mm.min() < x_mm.max() or y_mm.min() < y_mm.max())
