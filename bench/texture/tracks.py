"""Slides that the online estimator follows: all of their answers, and grooves that change under the skin.

Gratings, motions and noise are drawn, as those of the grid are; odd seeds are given the speed. A slide is
seen as it would be live, and each of its answers is one of the windows that are counted.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.texture.signal import RATE_HZ, FloatArray, Grating, Wave, bound, draw_grating, readings, wave_volts
from bench.texture.trials import ARRAY, MIN_PERIODS, Trial, compare, online_answers, slip_at, turns_off
from tactiled.detect.grooves.estimator import JointParams
from tactiled.events.types import TextureEvent

SLIDE_S = 12.0
SNRS_DB = (0.0, 10.0, 20.0, 30.0, 40.0)
STRAYS_RAD = (0.0, 0.1, 0.15, 0.2, 0.3)  # rms, of a channel's phase from its kind's
STRAY_SNR_DB = 20.0
CHANGES = {"period 10 % longer": (1.1, 0.0), "angle 10 degrees more": (1.0, 10.0)}
CHANGE_S = 6.0  # since the slide began
_CHANGE_PERIODS = 9.0  # in the time before: three blocks of a period and a half, at twice the least speed
_COMPARED_S = (2.0, 5.0, 8.0, 12.0)  # windows set over the bound: since the slide began
_GAINS = (0.7, 1.3)
_PARAMS = JointParams(settle_s=0.0)
_LONGEST_S = _PARAMS.criteria.max_window_s


def track_trials(stray_rad: float, snr_db: float, seeds: Sequence[int]) -> list[Trial]:
    """Answers and refusals of slides over one grating each; those of `_COMPARED_S` have their bound."""
    trials = []
    for seed in seeds:
        rng = np.random.default_rng([seed, round(snr_db) + 100, round(100 * stray_rad)])
        grating = draw_grating(ARRAY, rng, _COMPARED_S[0], snr_db, MIN_PERIODS)
        time_s = np.arange(round(SLIDE_S * RATE_HZ)) / RATE_HZ
        grating = _strayed(replace(grating, time_s=time_s), rng, stray_rad)
        for event in _answers(grating, readings(grating, rng), is_known=seed % 2 == 1):
            end = round(event.time_s * RATE_HZ) + 1
            used_s = time_s[max(0, end - round(_LONGEST_S * RATE_HZ)) : end]
            least = None
            if event.status == "ok" and not stray_rad and end / RATE_HZ in _COMPARED_S:
                least = bound(grating.wave, grating.sensed, used_s, is_speed_known=seed % 2 == 1)
            fields = {
                "name": f"{stray_rad:g} rad",
                "seed": seed,
                "is_speed_known": seed % 2 == 1,
                "window_s": end / RATE_HZ,
                "snr_db": snr_db,
                "periods": abs(grating.wave.frequency_hz) * len(used_s) / RATE_HZ,
            }
            trials.append(compare(event, grating.wave, least, **fields))
    return trials


def change_trials(name: str, seeds: Sequence[int]) -> list[Trial]:
    """Slides whose grooves change; `after_s` is the time until the old answer no longer stands."""
    longer, more_deg = CHANGES[name]
    trials = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        grating = draw_grating(ARRAY, rng, CHANGE_S, STRAY_SNR_DB, _CHANGE_PERIODS)
        time_s = np.arange(round(SLIDE_S * RATE_HZ)) / RATE_HZ
        grating = _strayed(replace(grating, time_s=time_s), rng, 0.0)
        old = grating.wave
        new = replace(old, period_mm=old.period_mm * longer, angle_deg=old.angle_deg + more_deg)
        volts = readings(grating, rng)
        later = time_s >= CHANGE_S
        for wave, sign in ((old, -1), (new, 1)):
            volts[later] += sign * wave_volts(wave, grating.sensed, time_s[later])
        events = _answers(grating, volts, is_known=seed % 2 == 1)
        before = [e for e in events if e.time_s < CHANGE_S]
        if not before or before[-1].status != "ok":
            continue  # there is no answer to lose
        after = [e for e in events if e.time_s >= CHANGE_S]
        lost = [e for e in after if e.status != "ok" or _is_nearer(e, new, old)]
        last = after[-1]
        fields = {"name": name, "seed": seed, "is_speed_known": seed % 2 == 1, "window_s": SLIDE_S}
        after_s = lost[0].answered_s - CHANGE_S if lost else np.inf
        trials.append(compare(last, new, after_s=after_s, **fields))
    return trials


def _is_nearer(event: TextureEvent, new: Wave, old: Wave) -> bool:
    off = [turns_off(wave, event.period_mm, event.angle_deg) for wave in (new, old)]
    return off[0] < off[1]


def _strayed(grating: Grating, rng: np.random.Generator, stray_rad: float) -> Grating:
    """Let the channels differ in gain, and stray in phase from their kind."""
    sensed = grating.sensed
    gain = rng.uniform(*_GAINS, (len(sensed.kind), 1))
    phase_rad = sensed.phase_rad[sensed.kind] + stray_rad * rng.standard_normal(gain.shape)
    if not stray_rad:
        return replace(grating, sensed=replace(sensed, amplitude_volts=gain * sensed.amplitude_volts))
    kind = np.arange(len(sensed.kind))
    return replace(
        grating,
        sensed=replace(sensed, amplitude_volts=gain * sensed.amplitude_volts, kind=kind, phase_rad=phase_rad),
    )


def _answers(grating: Grating, volts: FloatArray, *, is_known: bool) -> list[TextureEvent]:
    wave = grating.wave
    # The direction is configured: that of a slip is less sure, and would leave a known speed nothing to tie.
    params = _PARAMS.model_copy(update={"direction_deg": wave.direction_deg})
    given = [(0, wave.speed_mm_s)] if is_known else []
    slip = slip_at(0.0, wave.direction_deg)
    return list(online_answers(params, volts, grating.sensed.offset_s, slip, given_mm_s=given))
