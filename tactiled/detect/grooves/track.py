"""Follow a fitted wave from window to window: one Gauss-Newton climb each, and a test for another pattern.

A fit (`fit`) spends its time on questions that one answer settles for the windows after it: which line is the
grooves', which of the wave vectors that its phases allow is the true one, whether there are two waves. The
wave itself costs a thirtieth. It is climbed to from the last answer, in a window of raw scans, with the
equations of the fit; the result is the maximum of the same likelihood, so that nothing accumulates and
standard deviations mean what they mean in a fit. What coloured noise and mismatch add to them is that of the
last fit.

Another pattern under the skin is noticed by its phasors: the window is divided into blocks, and those of the
newest must be those of the blocks before, apart from a common factor, which an uneven speed changes too.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.fit import prepare_window, with_wave
from tactiled.detect.grooves.model import ALIASED, ChannelLayout, WaveFit, WaveMotion, WaveParams
from tactiled.detect.grooves.refine import RefinedWave, refine_once, suits_channels
from tactiled.detect.grooves.spectrum import FEW_PERIODS
from tactiled.detect.grooves.window import STRAIGHT, DetrendedWindow, trend_basis

# Length of a block. Grooves that change by 10 % in period or by 10 degrees must be noticed within 1.6 s.
_BLOCK_S = 1.0
# Periods in a block. With fewer, the slope of a block takes much of a ripple.
_BLOCK_PERIODS = 1.5
# Part of the power of a block's phasors that suits no common factor. Two patterns whose phases differ by
# 0.3 radians rms over the array (`SAME_WAVE_RAD`) differ by this much.
_ANOTHER_PATTERN = 0.3**2
# Ratio of that part to its mean over earlier blocks: misplaced ridges and uneven pads change every block.
_UNLIKE_EARLIER = 4.0
# Probability that white noise passes for another pattern, for one window.
_FALSE_CHANGE = 1e-6
# Divisor in place of zero, for channels without any ripple.
_TINY = 1e-300


def track_wave(
    last: WaveFit,
    volts: FloatArray,
    time_s: FloatArray,
    channel_offset_s: FloatArray,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
    usable: NDArray[np.bool_] | None = None,
    speeds_mm_s: FloatArray | None = None,
) -> WaveFit | None:
    """The wave of `last` in another window, or None where it is not there or where it must be fitted.

    Parameters
    ----------
    last : WaveFit
        Of an overlapping window, with `wave`; it has the error probability of the answer.
    volts, time_s, channel_offset_s, layout, motion, params, usable, speeds_mm_s
        As for `fit_wave`.

    Examples
    --------
    Grooves of 1.2 mm at 20 degrees, fitted in the first three seconds and followed for a fourth:

    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> from tactiled.detect.grooves.fit import fit_wave
    >>> from tactiled.detect.grooves.model import WaveMotion, WaveParams, channel_layout
    >>> layout = channel_layout(load_array("wang2019-3x3"))
    >>> rng, time_s, angle = np.random.default_rng(0), np.arange(400) / 100, np.radians(20)
    >>> x_mm = layout.x_mm + 2 * time_s[:, np.newaxis]
    >>> phase = 2 * np.pi / 1.2 * (x_mm * np.cos(angle) + layout.y_mm * np.sin(angle))
    >>> volts = 1 + 0.05 * np.cos(phase + layout.kind) + 0.005 * rng.standard_normal(phase.shape)
    >>> rest = np.zeros(36), layout, WaveMotion(2.0, 0.0, 0.0, 0.0), WaveParams()
    >>> first = fit_wave(volts[:300], time_s[:300], *rest)
    >>> later = track_wave(first, volts, time_s, *rest)
    >>> print(f"{later.period_mm:.3f} mm, {later.angle_deg:.1f} degrees")
    1.200 mm, 20.0 degrees
    """
    if last.wave is None:
        return None
    is_long = last.frequency_hz * (time_s[-1] - time_s[0]) >= FEW_PERIODS
    trend_order = params.trend_order if is_long else STRAIGHT
    prepared = prepare_window(
        volts, time_s, channel_offset_s, layout, motion, params, usable, speeds_mm_s, trend_order
    )
    if isinstance(prepared, WaveFit):
        return None
    window, here = prepared
    tied = motion if last.uses_given_speed else motion.without_speed
    phase_rate = last.wave.frequency * window.half_travel
    is_new_kind = here.is_kind.shape[1] != len(last.wave.mismatch)
    if is_new_kind:
        return None
    k = last.wave.k[np.newaxis]
    best = refine_once(window, here, tied, k, np.array([phase_rate]), last.wave.mismatch)
    found = float(best.waves.phase_rate[0])
    highest = 2 * np.pi * ALIASED / window.largest_step
    is_in_range = np.pi * params.min_periods <= found <= highest
    if not is_in_range or not suits_channels(best, window, here, tied, phase_rate):
        return None
    rate_hz = (window.n - 1) / window.duration_s
    n_block = round(max(_BLOCK_S, _BLOCK_PERIODS * np.pi * window.duration_s / found) * rate_hz)
    if is_another_pattern(window, best, n_block):
        return WaveFit("ambiguous", window.frequency_hz(found), best.snr_db, is_new_pattern=True)
    wave = replace(last.wave, k=best.waves.k[0], frequency=found / window.half_travel, mismatch=best.mismatch)
    fit = replace(last, frequency_hz=window.frequency_hz(found), snr_db=best.snr_db, wave=wave)
    return with_wave(fit, best, window, tied)


def is_another_pattern(window: DetrendedWindow, best: RefinedWave, n_block: int) -> bool:
    """True where the phasors of the newest block are not those of the blocks before, at least two.

    Parameters
    ----------
    best : RefinedWave
        The wave of the whole window.
    n_block : int
        Scans in a block. The oldest scans, less than a block, are not looked at.
    """
    n_channels, n_earlier = len(window.volts), window.n // n_block - 1
    if n_earlier < 2 or n_channels < 2:
        return False
    z = _block_phasors(window, best, n_block) / np.sqrt(best.variance)[:, np.newaxis]
    earlier = np.linalg.svd(z[:, :-1], full_matrices=False)[0][:, 0]
    power = (z.real**2 + z.imag**2).sum(axis=0)
    part = 1 - np.abs(earlier.conj() @ z) ** 2 / np.maximum(power, _TINY)
    # In white noise, each part of a phasor has the variance 2 / n_block; `earlier` has its own.
    white = 2 / n_block * (1 + 1 / n_earlier) * special.chdtri(2 * (n_channels - 1), _FALSE_CHANGE)
    # Coloured noise makes the earlier blocks unlike, too. One of their degrees of freedom is in `earlier`.
    usual = float(part[:-1].sum()) / (n_earlier - 1)
    return bool(part[-1] > max(_ANOTHER_PATTERN, white / max(power[-1], _TINY), _UNLIKE_EARLIER * usual))


def _block_phasors(window: DetrendedWindow, best: RefinedWave, n_block: int) -> NDArray[np.complex128]:
    """Phasors of the fundamental in each block, the newest last: (channels, blocks)."""
    n_blocks = window.n // n_block
    newest = slice(window.n - n_blocks * n_block, window.n)
    harmonics = np.arange(1, best.equations.n_harmonics + 1)[:, np.newaxis, np.newaxis]
    angle = harmonics * float(best.waves.phase_rate[0]) * window.travel[:, newest]
    waves = np.concatenate([np.cos(angle), np.sin(angle)]).swapaxes(0, 1)
    waves = waves.reshape(len(waves), -1, n_blocks, n_block).swapaxes(1, 2)
    slow = np.broadcast_to(trend_basis(n_block, STRAIGHT).T, (*waves.shape[:2], 2, n_block))
    basis = np.concatenate([waves, slow], axis=2)  # (1 or channels, blocks, functions, scans)
    volts = window.volts[:, newest].reshape(-1, n_blocks, n_block, 1)
    parts = np.linalg.solve(basis @ basis.swapaxes(2, 3), basis @ volts)[..., 0]
    return np.asarray(parts[..., 0] - 1j * parts[..., best.equations.n_harmonics])
