"""Limits of the published groove procedure that follow from array geometry and scan rate.

No board is needed. The limits of the joint fit are in `waves`.

Phase delays between taxels are known modulo the period of the ripple. Let l be the lever: the difference of
the two gaps of a column, or its gap where all are equal. For motion along x, grooves of period D at angle a
give the same phases as grooves at angle a' with ``tan a' = tan a + k D / (l cos a)`` for any integer k. All
angles within +-A are unambiguous if::

    D > l / cos A        where A >= 45 degrees (the minimum over a of tan a + D / (l cos a) lies inside)
    D > 2 l sin A        where A < 45 degrees (it lies at the border, a = -A)

Ripples must also be sampled: ``v / D`` below half the rate (Nyquist) and below the low-pass.
"""

import numpy as np

from tactiled.array import Array
from tactiled.detect.grooves.estimator import JointParams
from tactiled.detect.wang2019.grooves import EQUAL_MM, GrooveParams
from tactiled.doctor.finding import Finding
from tactiled.doctor.groove_findings import check_waves


def lever_mm(array: Array, column: list[int]) -> tuple[float, bool]:
    """Lever of a column in mm, and True where it is the difference of two unequal gaps."""
    gaps_mm = np.diff(array.y_mm[column])
    if len(gaps_mm) > 1 and abs(gaps_mm[0] - gaps_mm[1]) > EQUAL_MM:
        return float(abs(gaps_mm[0] - gaps_mm[1])), True
    return float(gaps_mm[0]), False


def least_period_mm(lever: float, max_angle_deg: float) -> float:
    """Finest period (mm) at which all angles within +-`max_angle_deg` are unambiguous."""
    angle = np.radians(max_angle_deg)
    return float(lever / np.cos(angle) if max_angle_deg >= 45 else 2 * lever * np.sin(angle))


def widest_angle_deg(lever: float, period_mm: float) -> float:
    """Largest A such that all angles within +-A are unambiguous: the inverse of `least_period_mm`."""
    if period_mm >= np.sqrt(2) * lever:
        return float(np.degrees(np.arccos(lever / period_mm)))
    return float(np.degrees(np.arcsin(period_mm / (2 * lever))))


def check_array(
    array: Array, params: GrooveParams | JointParams, rate_hz: float, speed_mm_s: float
) -> list[Finding]:
    """Check which directions, angles and periods the array resolves; a speed of 0 means unknown."""
    shear = (
        Finding("direction", "ok", f"{array.name} measures shear: slip has a direction")
        if array.has_shear
        else Finding("direction", "warn", f"{array.name} has no shear channels: slip has no direction")
    )
    if isinstance(params, JointParams):
        return [shear, *check_waves(array, params, rate_hz, speed_mm_s)]
    return [shear, _angles(array, params), _sampling(params, rate_hz, speed_mm_s)]


def _angles(array: Array, params: GrooveParams) -> Finding:
    columns = array.columns()
    if not columns:
        return Finding(
            "groove angle",
            "warn",
            f"{array.name} has no column of two taxels: groove angle cannot be measured",
        )
    lever, unequal = lever_mm(array, columns[0])
    least_mm = least_period_mm(lever, params.max_angle_deg)
    by_period = ", ".join(
        f"{widest_angle_deg(lever, period):.0f} deg at {period:g} mm" for period in (0.5, 0.9, 1.2, 2.0, 5.0)
    )
    gaps = "gaps differ by" if unequal else "equal gaps of"
    words = (
        f"{gaps} {lever:g} mm: angles within +-{params.max_angle_deg:g} deg are unambiguous for periods of "
        f"{least_mm:.2f} mm and more (largest unambiguous angle: {by_period})"
    )
    if unequal:
        return Finding("groove angle", "ok", words)
    return Finding(
        "groove angle",
        "warn",
        words,
        "lower max_angle_deg to the largest angle that occurs, or use an array with unequal gaps "
        "(wang2019-3x3: they differ by 0.3 mm)",
    )


def _sampling(params: GrooveParams, rate_hz: float, speed_mm_s: float) -> Finding:
    top_hz = min(rate_hz / 2, params.low_pass_hz)
    limit = "half the scan rate" if rate_hz / 2 <= params.low_pass_hz else "the low-pass"
    words = f"ripples of up to {top_hz:g} Hz are measured ({limit})"
    if speed_mm_s <= 0:
        return Finding(
            "groove period",
            "ok",
            f"{words}: the finest period is speed / {top_hz:g} Hz, e.g. 0.1 mm at 2 mm/s and 20 Hz",
        )
    finest_mm = speed_mm_s / top_hz
    words = f"{words}: the finest period at {speed_mm_s:g} mm/s is {finest_mm:.2f} mm"
    if finest_mm <= params.min_period_mm:
        return Finding("groove period", "ok", words)
    return Finding(
        "groove period",
        "warn",
        f"{words}, and min_period_mm is {params.min_period_mm:g}",
        "slide slower, scan faster (session.rate_hz), raise low_pass_hz, or raise min_period_mm",
    )
