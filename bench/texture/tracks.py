"""Slides that the online estimator follows: all of their answers, and grooves that change under the skin.

Beside them, single windows of arrays whose channels stray in phase from the wave, by channel and by taxel.

Gratings, motions and noise are drawn, as those of the grid are; odd seeds are given the speed. A slide is
seen as it would be live, and each of its answers is one of the windows that are counted.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bench.texture.signal import (
    RATE_HZ,
    Grating,
    Wave,
    bound,
    draw_grating,
    readings,
    scan_times_s,
    wave_volts,
)
from bench.texture.trials import (
    ARRAY,
    DIRECTION_SD_DEG,
    MEMORIES,
    MIN_PERIODS,
    Trial,
    compare,
    joint,
    noise_name,
    online_answers,
    slip_at,
    turns_off,
)
from tactiled.array import FloatArray
from tactiled.detect.grooves.params import JointParams
from tactiled.events.types import TextureEvent

SLIDE_S = 12.6
CHANGES = {"period 10 % longer": (1.1, 0.0), "angle 10 degrees more": (1.0, 10.0)}
CHANGE_S = 6.0  # since the slide began
NOTICED_S = 1.6  # after the change, at the latest
# Changes of longer periods move the phases over the array by less than 0.3 radians, and are not noticed.
CHANGE_PERIODS_MM = (0.6, 4.0)
_CHANGE_PERIODS = 6.0  # in the time before: three blocks of a period and a half, and a hop or two
CHANGE_SNR_DB = 20.0
_COMPARED_S = (2.0, 5.0, 8.0, 12.0)  # ends of the windows that are set over the bound, since the slide began
_GAINS = (0.7, 1.3)
_PARAMS = JointParams(settle_s=0.0)
_LONGEST_S = _PARAMS.criteria.max_window_s


class TrackKind(NamedTuple):
    """Noise of a slide, and rms of a channel's phase from its kind's."""

    snr_db: float
    memory: float = 0.0
    stray_rad: float = 0.0

    @property
    def name(self) -> str:
        """Words for a table."""
        if self.stray_rad:
            return f"phase offsets of {self.stray_rad:g} rad, {self.snr_db:g} dB"
        return f"{noise_name(self.memory) if self.memory else 'white noise'}, {self.snr_db:g} dB"


WHITE = tuple(TrackKind(snr_db) for snr_db in (0.0, 10.0, 20.0, 30.0, 40.0))
COLOURED = tuple(TrackKind(15.0, memory) for memory in MEMORIES)
STRAYS = tuple(TrackKind(20.0, 0.0, stray_rad) for stray_rad in (0.05, 0.1, 0.15, 0.2, 0.3))


def track_trials(kind: TrackKind, seed: int) -> list[Trial]:
    """Answers and refusals of a slide over one grating.

    Those of `_COMPARED_S` have their bound, where the noise is white and phases do not stray.
    """
    numbers = (kind.snr_db + 100, 100 * kind.memory, 100 * kind.stray_rad)
    rng = np.random.default_rng([seed, *(round(number) for number in numbers)])
    grating = draw_grating(ARRAY, rng, _COMPARED_S[0], kind.snr_db, MIN_PERIODS)
    time_s = scan_times_s(SLIDE_S)
    grating = replace(grating, time_s=time_s)
    gain = rng.uniform(*_GAINS, (ARRAY.n_channels, 1))
    strays = kind.stray_rad * rng.standard_normal(ARRAY.n_channels)
    grating = _strayed(grating, gain, strays if kind.stray_rad else None)
    is_known = seed % 2 == 1
    trials = []
    for event in _answers(grating, readings(grating, rng, kind.memory), is_known=is_known):
        end_s = round(event.time_s + 1 / RATE_HZ, 3)
        used_s = time_s[(time_s >= end_s - _LONGEST_S - 1e-9) & (time_s < end_s - 1e-9)]
        least = None
        if event.status == "ok" and kind in WHITE and end_s in _COMPARED_S:
            least = bound(grating.wave, grating.sensed, used_s, is_speed_known=is_known)
        fields = {"name": kind.name, "seed": seed, "is_speed_known": is_known, "window_s": end_s}
        fields |= {"snr_db": kind.snr_db, "periods": grating.periods * len(used_s) / len(time_s)}
        trials.append(compare(event, grating.wave, least, **fields))
    return trials


def change_trials(name: str, seed: int) -> list[Trial]:
    """Slide whose grooves change; `after_s` is the time until the old answer no longer stands.

    There is no trial where there is no answer to lose.
    """
    longer, more_deg = CHANGES[name]
    rng = np.random.default_rng(seed)
    grating = draw_grating(ARRAY, rng, CHANGE_S, CHANGE_SNR_DB, _CHANGE_PERIODS)
    while grating.wave.period_mm > CHANGE_PERIODS_MM[1]:
        grating = draw_grating(ARRAY, rng, CHANGE_S, CHANGE_SNR_DB, _CHANGE_PERIODS)
    time_s = scan_times_s(SLIDE_S)
    grating, old = replace(grating, time_s=time_s), grating.wave
    new = replace(old, period_mm=old.period_mm * longer, angle_deg=old.angle_deg + more_deg)
    volts = readings(grating, rng)
    later = time_s >= CHANGE_S
    for wave, sign in ((old, -1), (new, 1)):
        volts[later] += sign * wave_volts(wave, grating.sensed, time_s[later])
    events = _answers(grating, volts, is_known=seed % 2 == 1)
    before = [e for e in events if e.time_s < CHANGE_S]
    if not before or before[-1].status != "ok":
        return []
    after = [e for e in events if e.time_s >= CHANGE_S]
    lost = [e for e in after if e.status != "ok" or _is_nearer(e, new, old)]
    after_s = lost[0].answered_s - CHANGE_S if lost else np.inf
    fields = {"name": name, "seed": seed, "is_speed_known": seed % 2 == 1, "window_s": SLIDE_S}
    return [compare(after[-1], new, after_s=after_s, **fields)]


def _is_nearer(event: TextureEvent, new: Wave, old: Wave) -> bool:
    off = [turns_off(wave, event.period_mm, event.angle_deg) for wave in (new, old)]
    return off[0] < off[1]


class Strays(NamedTuple):
    """Standard deviations, in radians, of the strays of channels and of taxels."""

    channel_rad: float
    taxel_rad: float

    @property
    def name(self) -> str:
        """Words for a table."""
        return f"channels {self.channel_rad:g}, taxels {self.taxel_rad:g} rad"


STRAYED_S, STRAYED_SNR_DB = 3.0, 20.0
STRAY_KINDS = (
    *(Strays(rad, 0.0) for rad in (0.0, 0.05, 0.1, 0.13, 0.15, 0.2, 0.3)),
    *(Strays(0.0, rad) for rad in (0.05, 0.1)),
    Strays(0.1, 0.1),
)


def stray_trial(kind: Strays, seed: int, is_known: bool) -> Trial:
    """Fit one window of an array."""
    rng = np.random.default_rng([seed, is_known, *(round(1000 * rad) for rad in kind)])
    stray_rad = kind.channel_rad * rng.standard_normal(ARRAY.n_channels)
    stray_rad += kind.taxel_rad * rng.standard_normal(ARRAY.n_taxels)[ARRAY.channel_taxel]
    gain = rng.uniform(*_GAINS, (ARRAY.n_channels, 1))
    grating = draw_grating(ARRAY, rng, STRAYED_S, STRAYED_SNR_DB, MIN_PERIODS)
    answer = joint(grating, readings(_strayed(grating, gain, stray_rad), rng), is_known, DIRECTION_SD_DEG)
    fields = {"name": kind.name, "seed": seed, "is_speed_known": is_known, "window_s": STRAYED_S}
    return compare(answer, grating.wave, periods=grating.periods, **fields)


def _strayed(grating: Grating, gain: FloatArray, stray_rad: FloatArray | None) -> Grating:
    """Let the channels differ in gain (channels, 1), and stray in phase (channels,) from their kind."""
    sensed = grating.sensed
    own = replace(sensed, amplitude_volts=gain * sensed.amplitude_volts)
    if stray_rad is not None:
        phase_rad = sensed.phase_rad[sensed.kind] + stray_rad[:, None]
        own = replace(own, kind=np.arange(len(sensed.kind)), phase_rad=phase_rad)
    return replace(grating, sensed=own)


def _answers(grating: Grating, volts: FloatArray, *, is_known: bool) -> list[TextureEvent]:
    wave = grating.wave
    # The direction is configured: that of a slip is less sure, and would leave a known speed nothing to tie.
    params = _PARAMS.model_copy(update={"direction_deg": wave.direction_deg})
    given = [(0, wave.speed_mm_s)] if is_known else []
    slip = slip_at(0.0, wave.direction_deg)
    return list(online_answers(params, volts, grating.sensed.offset_s, slip, given_mm_s=given))
