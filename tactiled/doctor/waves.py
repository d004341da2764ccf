"""Which gratings an array can tell apart for the joint fit, before any board is plugged in.

Two plane waves look alike to an array where their phases differ by the same at every taxel, whole turns
aside. That depends on the difference dk of their wave vectors alone::

    rival(dk) = rms over taxels of the phase dk . r, wrapped to +-half a turn about its circular mean

Close to dk = 0 that is the beam, within which one estimate spreads. The least value outside of it is what
phases have to be true to. Waves of period D or more differ by 4 pi / D at most. Where the motion is known,
frequency ties dk to the motion's normal, and fewer waves compete.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.detect.texture_joint import JointParams
from tactiled.doctor.finding import Finding

FloatArray = NDArray[np.float64]
_ALIKE_RAD = 0.03  # three sigma of a channel's phase after a second of ripple 20 dB above noise
_STEPS_OF_BEAM = 12  # grid points across the beam
_SHOWN_MM = (0.5, 1.0, 2.0, 5.0)


def closest_rivals_rad(
    array: Array, periods_mm: tuple[float, ...], across_deg: float | None = None
) -> dict[float, float]:
    """How far the phases of any two waves of at least a period differ: rms over taxels, radians.

    Parameters
    ----------
    array : Array
    periods_mm : tuple of float
    across_deg : float, optional
        The motion is known and along this direction; left out: nothing is known of it.
    """
    places = np.stack([array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()])
    finest_mm = min(periods_mm)
    step = 2 * np.pi / max(float(np.ptp(places, axis=1).max()), finest_mm) / _STEPS_OF_BEAM
    sizes = np.arange(1, round(4 * np.pi / finest_mm / step) + 1) * step
    turns_deg = np.arange(0.0, 180.0, 1.0) if across_deg is None else np.array([across_deg + 90.0])
    closest = dict.fromkeys(periods_mm, np.inf)
    for angle in np.deg2rad(turns_deg):
        apart = _apart_rad(np.outer(sizes, np.cos(angle) * places[0] + np.sin(angle) * places[1]))
        for period_mm in periods_mm:
            least = _outside_of_beam(apart[sizes <= 4 * np.pi / period_mm + step / 2])
            closest[period_mm] = min(closest[period_mm], least)
    return closest


def _apart_rad(phase: FloatArray) -> FloatArray:
    """Rms of phases about their circular mean: (n, taxels) to (n,)."""
    mean = np.angle(np.exp(1j * phase).sum(axis=1))[:, None]
    return np.asarray(np.sqrt((np.angle(np.exp(1j * (phase - mean))) ** 2).mean(axis=1)))


def _outside_of_beam(apart: FloatArray) -> float:
    """Least difference along one direction behind the first hill; 0 where no taxels differ along it."""
    if apart.max(initial=0.0) < 1e-9:
        return 0.0
    falls = np.flatnonzero(np.diff(apart) < 0)
    return float(apart[falls[0] :].min()) if len(falls) else float(apart[-1])


def check_waves(array: Array, params: JointParams, rate_hz: float, speed_mm_s: float) -> list[Finding]:
    """What the array resolves at this rate; a speed of 0 is not known."""
    return [_gratings(array, params), _sampled(params, rate_hz, speed_mm_s)]


def _gratings(array: Array, params: JointParams) -> Finding:
    name = "groove period and angle"
    periods_mm = tuple(sorted({params.min_period_mm, *_SHOWN_MM}))
    known = closest_rivals_rad(array, periods_mm, params.direction_deg or 0.0)
    unknown = closest_rivals_rad(array, periods_mm)
    if not max(known.values()):
        return Finding(name, "warn", f"{array.name} has no two taxels side by side: no angle of grooves")
    shown = ", ".join(f"{known[mm]:.2f} ({unknown[mm]:.2f}) rad from {mm:g} mm on" for mm in _SHOWN_MM)
    words = f"{array.name}: phases of two gratings differ by {shown}, where speed is known (not known)"
    if (known if params.speed_mm_s else unknown)[params.min_period_mm] >= _ALIKE_RAD:
        return Finding(name, "ok", words)
    return Finding(
        name, "warn", f"{words}; less than {_ALIKE_RAD:g} rad is often \"ambiguous\"",
        f"raise detect.texture.min_period_mm ({params.min_period_mm:g}) to what can occur, tell the speed, "
        "or wear an array with unequal gaps (wang2019-3x3)",
    )  # fmt: skip


def _sampled(params: JointParams, rate_hz: float, speed_mm_s: float) -> Finding:
    name, top_hz = "groove frequency", rate_hz / 2
    if speed_mm_s <= 0:
        words = (
            f"ripples are seen below {top_hz:g} Hz, half the scan rate: periods above speed / {top_hz:g} Hz"
        )
        return Finding(name, "ok", words)
    finest_mm = speed_mm_s / top_hz
    words = f"at {speed_mm_s:g} mm/s periods above {finest_mm:.3f} mm are below half the scan rate"
    if finest_mm <= params.min_period_mm:
        return Finding(name, "ok", words)
    return Finding(name, "warn", words, "slide slower, or scan faster (session.rate_hz)")
