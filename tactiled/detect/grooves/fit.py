"""Joint maximum-likelihood fit of a plane wave to all channels in one window of scans.

The steps: find the line in the pooled spectrum (`ripple`); list every wave vector that its phases allow
(`search`); climb to the maximum from the best, with all harmonics (`solve`, `refine`); weigh the best
against the others (`ambiguity`) and against two waves of one frequency (`second_wave`); state the
covariance from the Fisher information (`estimates`). `model` defines the wave.

Each window is fitted without knowledge of earlier ones, so that another interpretation is found that has
become as likely. Between fits, `track` follows the answer.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tactiled.detect.grooves.ambiguity import (
    contradicts_motion,
    has_baseline,
    likely_gratings,
    weigh_interpretations,
)
from tactiled.detect.grooves.estimates import groove_answer, inflation
from tactiled.detect.grooves.model import ALIASED, SAME_WAVE_RAD, wave_vector
from tactiled.detect.grooves.outcome import GrooveAnswer, Refusal
from tactiled.detect.grooves.refine import RefinedWave, foreign_lines, refine
from tactiled.detect.grooves.ripple import Ripple, strongest_line
from tactiled.detect.grooves.search import common_mode_power, search_wave_vectors
from tactiled.detect.grooves.second_wave import LEAST_SECOND_PART, has_second_wave
from tactiled.detect.grooves.solve import PlaneWaves
from tactiled.detect.grooves.window import DetrendedWindow, FitWindow, detrended
from tactiled.events.types import TextureStatus

# prior: lines tried: hum and the like may be stronger than the grooves.
_MOST_LINES = 3
# prior: harmonics of one grating, none of which is a second grating.
_MOST_OWN_HARMONICS = 8


class _Found(NamedTuple):
    """Outcome of one line, and the lines that its wave explains: its phase rate and multiples of that.

    Without multiples there is no wave, or no second one is asked for.
    """

    outcome: GrooveAnswer | Refusal
    phase_rate: float = 0.0
    harmonics: Sequence[int] = ()


def fit_wave(window: FitWindow) -> GrooveAnswer | Refusal:
    """Fit the strongest wave of a window; refuse where what it leaves holds another one.

    Examples
    --------
    Grooves of 1.2 mm at 20 degrees, skin moving along +x at 2 mm/s, two seconds at 100 Hz:

    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> from tactiled.detect.grooves.model import WaveMotion, channel_layout
    >>> from tactiled.detect.grooves.params import WaveParams
    >>> layout = channel_layout(load_array("wang2019-3x3"))
    >>> rng, time_s, angle = np.random.default_rng(0), np.arange(200) / 100, np.radians(20)
    >>> x_mm = layout.x_mm + 2 * time_s[:, np.newaxis]
    >>> phase = 2 * np.pi / 1.2 * (x_mm * np.cos(angle) + layout.y_mm * np.sin(angle))
    >>> volts = 1 + 0.05 * np.cos(phase + layout.kind) + 0.005 * rng.standard_normal(phase.shape)
    >>> motion = WaveMotion(speed_mm_s=2.0, direction_deg=0.0, direction_sd_deg=0.0)
    >>> fit = fit_wave(FitWindow(volts, time_s, np.zeros(36), layout, motion, WaveParams()))
    >>> print(f"{fit.status}: {fit.period_mm:.3f} mm, {fit.angle_deg:.1f} degrees")
    ok: 1.200 mm, 20.0 degrees
    """
    prepared = detrended(window)
    if isinstance(prepared, Refusal):
        return prepared
    found = _strongest_wave(prepared)
    first = found.outcome
    if not found.harmonics:
        return first
    if isinstance(first, GrooveAnswer) and not first.uses_given_speed:
        # Evidence against the given speed from the first wave holds for the second one, too.
        prepared = prepared.without_speed
    least = LEAST_SECOND_PART * float(prepared.equations(found.phase_rate).explained.sum())
    second = _strongest_wave(prepared.without_lines(found.phase_rate, found.harmonics), least)
    if not isinstance(second.outcome, GrooveAnswer):
        return first
    # The first without the second, which was noise to it.
    left, other = prepared.without_lines(second.phase_rate, second.harmonics), second.outcome
    alone = _strongest_wave(left).outcome
    if isinstance(alone, GrooveAnswer):
        k, k_other = (wave_vector(each.period_mm, each.angle_deg) for each in (alone, other))
        # At 90 degrees, angles of one grating differ by 180: k and -k are the same grooves.
        apart = min(np.abs(k - k_other).max(), np.abs(k + k_other).max())
        if apart * prepared.layout.radius_mm <= SAME_WAVE_RAD:
            return alone  # an uneven speed makes side bands, which are the same grating at other frequencies
    return Refusal("several-gratings", first.frequency_hz, first.snr_db)


def _strongest_wave(window: DetrendedWindow, least: float = 0.0) -> _Found:
    """Fit the strongest line that is a wave and has some power; remove stronger lines that are no waves."""
    for _ in range(_MOST_LINES):
        # No line has more than the total power.
        ripples = strongest_line(window) if float(window.power.sum()) >= least else []
        if not ripples or max(float(each.equations.explained.sum()) for each in ripples) < least:
            break
        for ripple in ripples:
            if ripple.periods < window.params.min_periods:
                return _Found(Refusal("too-few-periods", window.frequency_hz(ripple.phase_rate)))
            found = _wave(ripple)
            if found is not None:
                return found
        phase_rate = next(each.phase_rate for each in ripples if each.is_peak)
        window = window.without_lines(phase_rate, [1])
    return _Found(Refusal("low-snr"))


def _wave(ripple: Ripple) -> _Found | None:
    """Fit the wave of a line, directly or as the mirror image of an undersampled ripple; or None."""
    window, motion = ripple.window, ripple.window.motion
    if not has_baseline(window.layout, motion):
        return _Found(Refusal("ambiguous", window.frequency_hz(ripple.phase_rate)))
    best, found = _best_interpretation(ripple)
    if ripple.is_peak and (best is None or (motion.has_speed and best.is_uneven)):
        image = _mirror_image(ripple, -np.inf if best is None else found.gain[0])
        if image is not None:
            return _Found(image)
    if best is not None and not contradicts_motion(best, found.k):
        return _judged(best, found)
    if motion.has_speed and has_baseline(window.layout, window.without_speed.motion):
        return _wave(replace(ripple, window=window.without_speed))
    return None


def _best_interpretation(ripple: Ripple) -> tuple[RefinedWave | None, PlaneWaves]:
    """The best wave of a line, None if that is no wave, and all that its phases allow, the best first."""
    window = ripple.window
    found = search_wave_vectors(ripple, common_mode_power(ripple))
    if not len(found.k):
        return None, found
    best = refine(window, found[0])
    if best.is_uneven:
        # Strays of channels may have made another interpretation the best.
        weights = weigh_interpretations(best, found.k).weights
        if weights.argmax() > 0:
            found = found[np.argsort(-weights, kind="stable")]
            best = refine(window, found[0])
    return best if best.is_wave else None, found


def _mirror_image(ripple: Ripple, least_gain: float) -> Refusal | None:
    """The refusal of an undersampled ripple, whose image suits the phases of a line better; or None.

    Such a ripple appears at a lower frequency, where its phases suit no wave well. Without this refusal, 29
    of 75 windows of ripples of 46 to 160 Hz at 100 scans a second and a known speed are answered, with a
    speed that is not the given one (period and angle are right).
    """
    least_power, whole_phase_rate = common_mode_power(ripple), 2 * np.pi / ripple.window.largest_step
    for fast in (whole_phase_rate - ripple.phase_rate, whole_phase_rate + ripple.phase_rate):
        found = search_wave_vectors(replace(ripple, phase_rate=fast), least_power)
        if len(found.k) and found.gain[0] > least_gain:
            image = refine(ripple.window, found[0])
            if image.is_wave:
                return Refusal("aliased", image.frequency_hz, image.snr_db)
    return None


def _judged(best: RefinedWave, found: PlaneWaves) -> _Found:
    """The answer that a wave gives, or the refusal where another one or a second one is likely."""
    window = best.window

    def refused(status: TextureStatus, *more: Any) -> Refusal:
        return Refusal(status, best.frequency_hz, best.snr_db, *more)

    if best.phase_rate * window.largest_step > 2 * np.pi * ALIASED:
        return _Found(refused("aliased"))
    scale, noise_inflation = inflation(best)
    variance = 2 * best.variance * noise_inflation / window.n
    if has_second_wave(window, best.equations.phasors(), variance, best.k, not best.is_uneven):
        return _Found(refused("several-gratings"))
    posterior = weigh_interpretations(best, found.k, noise_inflation)
    # `best` is the first; where another one is likelier by now, the two are hard to tell.
    error, most = float(1 - posterior.weights[0]), window.params.error_probability
    if posterior.weights.argmax() > 0 or error > most:
        status: TextureStatus = "uneven-channels" if posterior.error_if_alike <= most else "ambiguous"
        candidates = likely_gratings(found, posterior.weights)
        return _Found(refused(status, candidates, posterior.stray_rad), best.phase_rate, _own_harmonics(best))
    answer = groove_answer(best, posterior, scale, noise_inflation, error)
    answer = replace(answer, wave=None) if window.removed else answer
    return _Found(answer, best.phase_rate, _own_harmonics(best))


def _own_harmonics(best: RefinedWave) -> list[int]:
    """List the harmonics of a wave, including those too weak for the fit."""
    window, phase_rate = best.window, best.phase_rate
    sampled = int(np.clip(np.pi / phase_rate / window.largest_step, 1, _MOST_OWN_HARMONICS))
    equations = window.equations(phase_rate, window.clear_harmonics(phase_rate, sampled))
    foreign = foreign_lines(best.waves, equations, best.variance)
    return [
        h for h in range(1, equations.n_harmonics + 1)
        if h not in foreign or h <= best.equations.n_harmonics
    ]  # fmt: skip
