"""Period and inclination of grooves from the voltages of one column (Wang, Chen, Mei 2019, eqs 3 to 6).

A taxel at (x, y) sees the phase ``2 pi ((x + travel_x) cos a + (y + travel_y) sin a) / D``. With motion of
speed v along the direction theta its frequency is ``f = v |cos(theta - a)| / D``. A taxel that is l further
along the column sees each ridge earlier by ``t = l sin a / (v cos(theta - a))``. With ``rho = v t / l``::

    tan a = rho cos(theta) / (1 - rho sin(theta))         D = v |cos(theta - a)| / f

Equations of the paper, which are these for motion along +x (theta = 0); its alpha is our angle a, its MAF
our f::

    D = v / f                                             grooves perpendicular to the motion
    alpha = atan(v t1 / l1)                               where the delay is unambiguous
    alpha = atan(v (t1 - t2) / (l1 - l2))                 with unequal gaps l1 = 3.5 mm, l2 = 3.8 mm
    D = v cos(alpha) / f

A delay is known modulo the period of the ripple only, and each period that may be added is another answer.
The ``t1 - t2`` over ``l1 - l2`` of the paper has the shortest baseline, so its answers are the furthest
apart; where the gaps are equal, there is none: "ambiguous". An answer must be no more inclined than
65 degrees and no finer than 0.3 mm (`GrooveLimits`), and every other answer must miss these limits by at
least three of its standard deviations; otherwise the result is "ambiguous".

For motion along x, answers are ``D / (l cos a)`` apart in ``tan a``, so that one answer lies within +-A at
any angle as long as ``D > l / cos A``. The shipped array has l = 0.3 mm. With A = 65 degrees that is 0.71 mm,
which leaves the standard deviations room on the finest plate of the paper, 0.9 mm; 75 degrees would need
1.16 mm and more.

Accuracy: the frequency is one bin of the spectrum, and delays are whole scans. The stated standard deviations
are those of the two grids (uniform errors of one step, ``step / sqrt(12)``), of the leakage of a frequency
between two bins, and of white noise, propagated through the equations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.events.types import Candidate, TextureStatus
from tactiled.wang2019.spectrum import Spectrum, spectrum

_MAX_CANDIDATES = 8  # choice: answers that an event lists
# choice: within 30 degrees of the column, delays along it say little about the angle.
_MIN_COS_COLUMN = 0.5
# choice: an answer that is less than this outside the limits counts as one more, even where it is unlikely.
_COUNTED_SIGMAS = 3.0
# derived: a sine between two bins, d of a bin from the nearest bin k, leaks its mirror image at -f into that
# bin: d / 2k of it, at a phase that differs between taxels. Over d in +-1/2 and all phases that is 0.102 / k
# radians rms. The largest possible error, all three taxels against each other, is four times the standard
# deviation from it.
_IMAGE_RAD = 0.102
# derived: gaps that differ by less are equal: array files have two decimals.
_EQUAL_MM = 1e-6


_Input = FloatArray | float


@dataclass(frozen=True)
class GrooveLimits:
    """Window and limits of the flow chart; the defaults are those of the paper and its plates."""

    window_s: float = 10.0  # duration of the data of one estimate
    low_pass_hz: float = 20.0  # upper end of the band in which ripples are looked for
    agreement_mm: float = 0.01  # largest difference of the periods from maximum and minimum
    max_angle_deg: float = 65.0  # largest inclination considered
    # shortest period considered: a third of the finest plate in the paper; a skin 0.8 mm thick hardly
    # responds to anything finer
    min_period_mm: float = 0.3


@dataclass(frozen=True)
class SlidingMotion:
    """Known motion of the skin over the surface, with standard deviations."""

    speed_mm_s: float
    speed_sd_mm_s: float
    direction_deg: float
    direction_sd_deg: float


@dataclass(frozen=True)
class GrooveEstimate:
    """Result for one window; zeros where `status` is not "ok"."""

    status: TextureStatus
    frequency_hz: float = 0.0
    snr_db: float = 0.0
    period_mm: float = 0.0
    period_sd_mm: float = 0.0
    angle_deg: float = 0.0
    angle_sd_deg: float = 0.0
    candidates: tuple[Candidate, ...] = ()


class _Measured(NamedTuple):
    """Delay over the difference of two gaps, modulo the period, and frequency of the ripple."""

    delay_s: float
    delay_sd_s: float
    gap_mm: float
    frequency_hz: float
    frequency_sd_hz: float


def estimate(
    volts: FloatArray,
    rate_hz: float,
    volts_per_step: float,
    places_mm: FloatArray,
    offsets_s: FloatArray,
    motion: SlidingMotion,
    limits: GrooveLimits,
) -> GrooveEstimate:
    """Estimate period and inclination from one window, as the flow chart does.

    `volts` (n, taxels), of a resolution `volts_per_step`, are those of three taxels of one column, at y of
    `places_mm` in ascending order, which are sampled `offsets_s` after the beginning of a scan.

    Examples
    --------
    Grooves of 1.2 mm inclined by 15 degrees, sliding along +x at 1 mm/s, 10 s at 100 Hz:

    >>> import numpy as np
    >>> rng, y_mm, angle = np.random.default_rng(0), np.array([0.0, 3.5, 7.3]), np.radians(15)
    >>> x_mm = 1.0 * np.arange(1000)[:, np.newaxis] / 100
    >>> phase = 2 * np.pi / 1.2 * (x_mm * np.cos(angle) + y_mm * np.sin(angle))
    >>> volts = 1 + 0.05 * np.cos(phase) + 0.005 * rng.standard_normal((1000, 3))
    >>> motion = SlidingMotion(1.0, 0.0, 0.0, 0.0)
    >>> found = estimate(volts, 100.0, 1e-6, y_mm, np.zeros(3), motion, GrooveLimits())
    >>> print(f"{found.status}: {found.period_mm:.2f} mm, {found.angle_deg:.1f} degrees")
    ok: 1.21 mm, 14.0 degrees
    """
    # Flow chart: low-pass; frequency of largest amplitude.
    seen = spectrum(volts, rate_hz, volts_per_step, limits.low_pass_hz)
    found = GrooveEstimate(seen.status, seen.peak_hz, seen.snr_db)
    if seen.status != "ok":
        return found
    if abs(np.cos(np.radians(motion.direction_deg))) < _MIN_COS_COLUMN or motion.direction_sd_deg > 45:
        return replace(found, status="ambiguous")  # the sign of the angle follows from that of the motion
    # Flow chart: pure sines at that frequency; cross-correlation of neighbours, its maximum and its minimum.
    gaps_mm = np.diff(places_mm)
    if len(gaps_mm) != 2 or abs(gaps_mm[0] - gaps_mm[1]) < _EQUAL_MM:
        return replace(found, status="ambiguous")  # nothing to divide by
    period_s = 1.0 / seen.peak_hz
    # Ours: a taxel that is sampled later seems to lead by the skew.
    skews_s = np.diff(offsets_s)
    leads_s = _leads_scans(seen, len(volts)) / rate_hz - skews_s
    phase_sd = np.hypot(np.sqrt(1 / (len(volts) * 10 ** (seen.snr_db / 10))), _IMAGE_RAD / seen.peak)
    phase_sd_s = float(phase_sd) * period_s / (2 * np.pi)
    # Flow chart: delays t1 - t2 over l1 - l2.
    delays_s = _wrap_delays(leads_s[:, 0] - leads_s[:, 1], period_s)
    measured = _Measured(
        delay_s=float(delays_s.mean()),
        delay_sd_s=float(np.hypot(np.sqrt(2 / 12) / rate_hz, np.sqrt(6) * phase_sd_s)),  # 2 p1 - p0 - p2
        gap_mm=float(gaps_mm[0] - gaps_mm[1]),
        frequency_hz=seen.peak_hz,
        frequency_sd_hz=rate_hz / len(volts) / np.sqrt(12),
    )
    # Ours: refuse where more than one period may have been added to the delay.
    readings = _possible_readings(measured, motion, limits)
    if len(readings) != 1 or not readings[0].is_within(limits, 0.0):
        return replace(found, status="ambiguous", candidates=_candidates(readings[:_MAX_CANDIDATES]))
    (reading,) = readings
    angles_deg, periods_mm = _angle_and_period(
        delays_s + reading.turns * period_s,
        measured.gap_mm,
        seen.peak_hz,
        motion.speed_mm_s,
        motion.direction_deg,
    )
    # Flow chart: two values of D, which must agree within 0.01 mm; the result is their mean.
    if abs(periods_mm[0] - periods_mm[1]) > limits.agreement_mm:
        both = [
            reading._replace(angle_deg=angle_deg, period_mm=period_mm)
            for angle_deg, period_mm in zip(angles_deg.tolist(), periods_mm.tolist(), strict=True)
        ]
        return replace(found, status="ambiguous", candidates=_candidates(both))
    return replace(
        found,
        period_mm=float(periods_mm.mean()),
        period_sd_mm=reading.period_sd_mm,
        angle_deg=float(angles_deg.mean()),
        angle_sd_deg=reading.angle_sd_deg,
    )


def _leads_scans(seen: Spectrum, n: int) -> FloatArray:
    """Number of scans by which each taxel sees a ridge before its neighbour.

    The band-pass leaves one bin, a pure sine of a whole number of periods, so the correlation of two of them
    is circular. Within half a period it has one maximum and one minimum, half a period apart. Both are told,
    (2, taxels - 1).
    """
    half_period = n / seen.peak / 2
    lags = np.arange(-int(half_period), int(half_period) + 1)
    leads = np.empty((2, seen.phasors.shape[1] - 1))
    for k in range(leads.shape[1]):
        product = np.zeros(len(seen.phasors), dtype=np.complex128)
        product[seen.peak] = seen.phasors[seen.peak, k] * np.conj(seen.phasors[seen.peak, k + 1])
        correlation = np.fft.irfft(product, n)[lags]  # sum over i of this taxel (i + lag) times the next (i)
        leads[0, k] = lags[np.argmax(correlation)]
        at_minimum = lags[np.argmin(correlation)]
        leads[1, k] = at_minimum - half_period if at_minimum > 0 else at_minimum + half_period
    return leads


def _wrap_delays(delays_s: FloatArray, period_s: float) -> FloatArray:
    """Wrap delays into half a period to either side of zero; the second next to the first."""
    first = delays_s[0] - period_s * np.round(delays_s[0] / period_s)
    apart = delays_s - delays_s[0]
    return np.asarray(first + apart - period_s * np.round(apart / period_s))


def _angle_and_period(
    delay_s: FloatArray, gap_mm: float, frequency_hz: _Input, speed_mm_s: _Input, direction_deg: _Input
) -> tuple[FloatArray, FloatArray]:
    """Angles (degrees, within -90..90) and periods (mm) by the equations of the module's docstring."""
    theta = np.radians(direction_deg)
    rho = speed_mm_s * delay_s / gap_mm
    angle = np.arctan2(rho * np.cos(theta), 1 - rho * np.sin(theta))
    angle -= np.pi * np.round(angle / np.pi)  # a groove normal has no sign
    return np.degrees(angle), np.asarray(speed_mm_s * np.abs(np.cos(theta - angle)) / frequency_hz)


class _Reading(NamedTuple):
    """One answer, with the number of ripple periods that were added to the delay."""

    angle_deg: float
    period_mm: float
    angle_sd_deg: float
    period_sd_mm: float
    turns: int

    def is_within(self, limits: GrooveLimits, sigmas: float) -> bool:
        """True within the limits, or outside them by no more than so many standard deviations."""
        return (
            abs(self.angle_deg) <= limits.max_angle_deg + sigmas * self.angle_sd_deg
            and self.period_mm >= limits.min_period_mm - sigmas * self.period_sd_mm
        )


def _possible_readings(measured: _Measured, motion: SlidingMotion, limits: GrooveLimits) -> list[_Reading]:
    """Every answer within or near the limits for a delay known modulo the period; smallest angle first."""
    # |sin a| / D = |t| f / l is at most 1 / D. One more for the standard deviations, one for rounding.
    most = int(abs(measured.gap_mm) / limits.min_period_mm) + 2
    turns = np.arange(-most, most + 1)
    delay_s = measured.delay_s + turns / measured.frequency_hz
    sigmas = _standard_deviations(delay_s, measured, motion)
    known = measured.gap_mm, measured.frequency_hz, motion.speed_mm_s, motion.direction_deg
    columns = *_angle_and_period(delay_s, *known), *sigmas, turns
    readings = map(_Reading._make, zip(*(column.tolist() for column in columns), strict=True))
    near = [reading for reading in readings if reading.is_within(limits, _COUNTED_SIGMAS)]
    return sorted(near, key=lambda reading: abs(reading.angle_deg))


def _candidates(readings: Sequence[_Reading]) -> tuple[Candidate, ...]:
    """Readings as equally weighted candidates."""
    return tuple(
        Candidate(period_mm=r.period_mm, angle_deg=r.angle_deg, weight=1 / len(readings)) for r in readings
    )


def _standard_deviations(
    delay_s: FloatArray, measured: _Measured, motion: SlidingMotion
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of angles (degrees) and periods (mm), from each input moved by its own."""
    given = np.array([0.0, measured.frequency_hz, motion.speed_mm_s, motion.direction_deg])
    sds = measured.delay_sd_s, measured.frequency_sd_hz, motion.speed_sd_mm_s, motion.direction_sd_deg
    ends = []
    for moved in (given + np.diag(sds), given - np.diag(sds)):  # (input that is moved, input)
        more_s, frequency_hz, speed_mm_s, direction_deg = moved.T[:, :, np.newaxis]
        # The measured phase yields the delay through the frequency, so the two change together.
        at_s = delay_s * measured.frequency_hz / frequency_hz + more_s
        known = frequency_hz, np.maximum(speed_mm_s, 0.0), direction_deg
        ends.append(_angle_and_period(at_s, measured.gap_mm, *known))
    (angle_a, period_a), (angle_b, period_b) = ends
    turn = angle_a - angle_b
    angle_sd_deg = np.sqrt((((turn - 180 * np.round(turn / 180)) / 2) ** 2).sum(axis=0))
    return np.minimum(angle_sd_deg, 90.0), np.sqrt((((period_a - period_b) / 2) ** 2).sum(axis=0))
