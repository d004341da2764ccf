"""Range of groove periods that the joint fit resolves, from array, scan rate and speed; needs no board.

The tilt is the angle between groove normal and motion. At speed v, grooves of period D give ripples of
frequency ``f = v cos(tilt) / D``. Fine grooves are aliased where f is too high for the scan rate; of coarse
grooves a window holds too few periods. In between, a grating is ambiguous where another one within the
limits has nearly the same phases (`rivals`). Beyond `max_tilt_deg` the skin slides along the grooves, which
then give no ripples.
"""

from dataclasses import dataclass, replace

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.detect.grooves.model import ALIASED
from tactiled.detect.grooves.params import JointParams

# Phases of the channels of a real skin deviate from a plane wave by 0.05 rad or more. Two waves whose phases
# differ by d (rms over N channels) then have a log-likelihood ratio of N d^2 / (2 0.05^2); 7 gives one wrong
# decision in a thousand.
_PHASE_SD_RAD, _LOG_RATIO = 0.05, 7.0
# Standard deviation of a direction that slip events give: theirs, and the part of friction across grooves.
_SLIP_SD_DEG = 3.4
_MOST_SIGMAS = 3.0  # largest disagreement between frequency and wave vector
TILTS_DEG = (0.0, 30.0, 60.0, 75.0)
_N_PERIODS = 60  # examined, geometrically spaced from the finest to the coarsest

_STEP_TURNS = 0.25  # over the array, from one dk to the next: fine enough to meet every set of integers
_RESULTANT = 0.9  # mean length of the phase vectors on that grid above which a fit is tried
_SAME_PER_MM = 1e-6  # radians per millimetre: a smaller dk is zero


def rivals(
    array: Array, finest_mm: float, alike_rad: float, across_deg: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Find all dk between allowed waves whose phases differ by at most `alike_rad`, from the geometry alone.

    Two plane waves cannot be distinguished where their phase difference is the same at every taxel, up to
    whole turns n. The phase difference at place r is ``dk . r``, where dk is the difference of the wave
    vectors. For each set of integers n, linear least squares gives the dk whose ``dk . r`` is nearest to
    ``2 pi n`` plus a constant. Where the motion is known, the frequency fixes the component of k along it,
    and dk is across it.

    Parameters
    ----------
    finest_mm : float
        Finest allowed period; wave vectors differ by at most ``4 pi / finest_mm``.
    alike_rad : float
        Largest phase difference, rms over taxels.
    across_deg : float, optional
        Direction across a known motion; left out, the motion is unknown.

    Returns
    -------
    per_mm : (n, 2) float64
        Differences dk in radians per millimetre, shortest first; each stands for its negative, too.
    apart_rad : (n,) float64
        Phase difference, rms over taxels.
    """
    places = np.stack([array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()], axis=1)
    reach = 4 * np.pi / finest_mm
    across = np.radians(0.0 if across_deg is None else across_deg)
    axes = np.array([[np.cos(across), np.sin(across)], [-np.sin(across), np.cos(across)]])
    axes = axes[: 2 if across_deg is None else 1]
    seen = places @ axes.T
    steps = 2 * np.pi * _STEP_TURNS / np.maximum(np.ptp(seen, axis=0), finest_mm)
    lines = [np.arange(-np.ceil(reach / step), np.ceil(reach / step) + 1) * step for step in steps]
    lines[0] = lines[0][lines[0] >= 0]  # one of dk and -dk
    tried = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(axes))
    phase = tried @ seen.T
    total = np.exp(1j * phase).mean(axis=1)
    near = np.abs(total) > _RESULTANT
    turns = np.round((phase[near] - np.angle(total[near])[:, None]) / (2 * np.pi))
    turns -= turns[:, :1]
    turns = np.unique(turns[turns.any(axis=1)], axis=0)  # equal integers mean the same wave
    basis = np.column_stack([seen, np.ones(len(seen))])
    solved = 2 * np.pi * turns @ np.linalg.pinv(basis).T
    apart = np.sqrt(((2 * np.pi * turns - solved @ basis.T) ** 2).mean(axis=1))
    per_mm = solved[:, : len(axes)] @ axes
    size = np.hypot(per_mm[:, 0], per_mm[:, 1])
    kept = np.flatnonzero((apart <= alike_rad) & (size <= reach) & (size > _SAME_PER_MM))
    kept = kept[np.argsort(size[kept], kind="stable")]
    return per_mm[kept], apart[kept]


@dataclass(frozen=True)
class Range:
    """Periods that are resolved at a tilt; none where `to_mm` is not above `from_mm`."""

    tilt_deg: float  # between groove normal and motion, either way
    from_mm: float
    to_mm: float
    # Period and angle of two gratings that cannot be distinguished, the first at this tilt; empty without any
    alike: tuple[tuple[float, float], ...] = ()

    @property
    def is_empty(self) -> bool:
        """True where no period at all is resolved."""
        return self.to_mm <= self.from_mm


def ranges(array: Array, params: JointParams, rate_hz: float, speed_mm_s: float) -> list[Range]:
    """Compute the resolved periods at each of `TILTS_DEG`; a speed of 0 means unknown and bounds nothing."""
    motion = _KnownMotion(array, params, speed_mm_s)
    found = []
    for tilt_deg in (tilt for tilt in TILTS_DEG if tilt <= params.max_tilt_deg):
        first_mm, last_mm = params.min_period_mm, params.max_period_mm
        if speed_mm_s > 0:
            across_mm_s = speed_mm_s * float(np.cos(np.radians(tilt_deg)))
            first_mm = max(first_mm, across_mm_s / (ALIASED * rate_hz))
            last_mm = min(last_mm, across_mm_s * params.criteria.max_window_s / params.min_periods)
        found.append(motion.longest_resolved(Range(tilt_deg, first_mm, last_mm)))
    return found


def has_direction(array: Array, params: JointParams) -> bool:
    """Return True where the direction of motion is configured or slip events give it."""
    return params.direction_deg is not None or array.has_shear


class _KnownMotion:
    """An array and the known part of its motion: direction and speed, each with its uncertainty."""

    def __init__(self, array: Array, params: JointParams, speed_mm_s: float) -> None:
        self.direction_deg = direction_deg = params.direction_deg or 0.0
        self.params = params
        self.has_direction = has_direction(array, params)
        self.heading = np.array([np.cos(np.radians(direction_deg)), np.sin(np.radians(direction_deg))])
        self.is_tied = speed_mm_s > 0 and self.has_direction
        self.direction_sd = 0.0 if params.direction_deg is not None else float(np.radians(_SLIP_SD_DEG))
        self.speed_sd = params.speed_sd_mm_s / speed_mm_s if speed_mm_s > 0 else 0.0
        alike_rad = _PHASE_SD_RAD * float(np.sqrt(2 * _LOG_RATIO / array.n_channels))
        lists = []
        if self.is_tied:
            lists.append(rivals(array, params.min_period_mm, alike_rad, direction_deg + 90.0))
        if not self.is_tied or self.direction_sd or self.speed_sd:
            lists.append(rivals(array, params.min_period_mm, alike_rad))
        self.per_mm = np.concatenate([sign * per_mm for per_mm, _ in lists for sign in (1, -1)])
        self.apart_rad = np.concatenate([np.tile(apart_rad, 2) for _, apart_rad in lists])

    def longest_resolved(self, limits: Range) -> Range:
        """Return the longest run of unambiguous periods within limits."""
        if limits.is_empty:
            return limits
        periods_mm = np.geomspace(limits.from_mm, limits.to_mm, _N_PERIODS)
        alike: list[tuple[tuple[float, float], ...]] = [
            next((pair for sign in (1, -1) if (pair := self._alike(mm, sign * limits.tilt_deg))), ())
            for mm in periods_mm
        ]
        is_resolved = np.array([not pair for pair in alike])
        if is_resolved.all():
            return limits
        edges = np.flatnonzero(np.diff(np.concatenate([[0], is_resolved, [0]])))
        first, end = max(edges.reshape(-1, 2).tolist(), key=lambda run: run[1] - run[0], default=(0, 0))
        example = next(pair for pair in reversed(alike[: first or None]) if pair) if first else ()
        example = example or next(pair for pair in alike[end:] if pair)
        last = max(end - 1, first)
        return replace(limits, from_mm=float(periods_mm[first]), to_mm=float(periods_mm[last]), alike=example)

    def _alike(self, period_mm: float, tilt_deg: float) -> tuple[tuple[float, float], ...]:
        """Find the allowed grating that is hardest to tell from this one: (this, other), or () if none."""
        angle = np.radians(self.direction_deg + tilt_deg)
        k = 2 * np.pi / period_mm * np.array([np.cos(angle), np.sin(angle)])
        others = k + self.per_mm
        size = np.hypot(others[:, 0], others[:, 1])
        params = self.params
        allowed = (size >= 2 * np.pi / params.max_period_mm) & (size <= 2 * np.pi / params.min_period_mm)
        along = others @ self.heading
        if self.has_direction:
            allowed &= along >= size * np.cos(np.radians(params.max_tilt_deg))
        if self.is_tied:
            off = np.abs(self.per_mm @ self.heading)
            slack = np.hypot(along * self.speed_sd, size * self.direction_sd)
            allowed &= off <= _MOST_SIGMAS * slack + 1e-6 * size
        if not allowed.any():
            return ()
        other = others[int(np.argmin(np.where(allowed, self.apart_rad, np.inf)))]
        return (period_mm, _within_90(self.direction_deg + tilt_deg)), _reading(other)


def _reading(k: FloatArray) -> tuple[float, float]:
    return float(2 * np.pi / np.hypot(*k)), _within_90(float(np.degrees(np.arctan2(k[1], k[0]))))


def _within_90(angle_deg: float) -> float:
    """Wrap an angle to [-90, 90): a groove normal has no sign."""
    return float((angle_deg + 90) % 180 - 90)
