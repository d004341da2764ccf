"""Arrays whose channels stray in phase from the wave, by channel and by taxel, with gains of 0.7 to 1.3."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.texture.signal import draw_grating, readings
from bench.texture.trials import ARRAY, DIRECTION_SD_DEG, MIN_PERIODS, Trial, compare
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.params import WaveParams
from tactiled.detect.grooves.window import FitWindow

STRAYED_S, STRAYED_SNR_DB = 3.0, 20.0
_GAINS = (0.7, 1.3)


@dataclass(frozen=True)
class Strays:
    """Standard deviations, in radians, of the strays of channels and of taxels."""

    channel_rad: float
    taxel_rad: float

    @property
    def name(self) -> str:
        """Words for a table."""
        return f"channels {self.channel_rad:g}, taxels {self.taxel_rad:g} rad"


STRAY_KINDS = (
    *(Strays(rad, 0.0) for rad in (0.0, 0.05, 0.1, 0.13, 0.15, 0.2, 0.3)),
    *(Strays(0.0, rad) for rad in (0.05, 0.1)),
    Strays(0.1, 0.1),
)


def stray_trials(kind: Strays, seeds: Sequence[int]) -> list[Trial]:
    """Slide once for each seed, the speed known and not."""
    layout, trials = channel_layout(ARRAY), []
    for seed, is_known in [(seed, is_known) for seed in seeds for is_known in (True, False)]:
        numbers = [seed, is_known, round(1000 * kind.channel_rad), round(1000 * kind.taxel_rad)]
        rng = np.random.default_rng([int(number) for number in numbers])
        stray_rad = kind.channel_rad * rng.standard_normal(ARRAY.n_channels)
        stray_rad += kind.taxel_rad * rng.standard_normal(len(ARRAY.x_mm))[ARRAY.channel_taxel]
        gain = rng.uniform(*_GAINS, (ARRAY.n_channels, 1))
        grating = draw_grating(ARRAY, rng, STRAYED_S, STRAYED_SNR_DB, MIN_PERIODS)
        sensed, wave = grating.sensed, grating.wave
        sensed = replace(
            sensed,
            amplitude_volts=gain * sensed.amplitude_volts,
            kind=np.arange(ARRAY.n_channels),
            phase_rad=sensed.phase_rad[sensed.kind] + stray_rad[:, None],
        )
        volts = readings(replace(grating, sensed=sensed), rng)
        motion = WaveMotion(wave.speed_mm_s if is_known else 0.0, 0.0, wave.direction_deg, DIRECTION_SD_DEG)
        window = FitWindow(volts, grating.time_s, sensed.offset_s, layout, motion, WaveParams())
        fields = {"name": kind.name, "seed": seed, "is_speed_known": is_known, "window_s": STRAYED_S}
        trials.append(compare(fit_wave(window), wave, periods=grating.periods, **fields))
    return trials
