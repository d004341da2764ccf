"""Amplitude spectrum of a window and its ripple: the frequency of largest amplitude (MAF in the 2019 paper).

Ripples above the low-pass are outside the procedure's range. Where the largest ripple is there, peaks below
may be its harmonics mirrored at half the scan rate: "aliased". A ripple whose own frequency is above half the
scan rate shows its mirror image only, which no spectrum can distinguish from a ripple: grooves finer than
``2 v / rate`` (1 mm at 50 mm/s and 100 Hz) may be mistaken for coarser ones.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.signal.median import median
from tactiled.events.types import TextureStatus

# derived: of the scan rate: a ripple that is faster is near its own mirror image.
_ALIASED = 0.45
# prior: with fewer, a trend or creep passes for a ripple.
_MIN_PERIODS = 3
# derived: peak power over the median of the spectrum, summed over three taxels. White noise in 500 bins
# exceeds 10 less than once in a million windows (gamma distribution of shape 3).
_MIN_PEAK_RATIO = 10.0


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Amplitude spectrum of a window, mean and trend removed."""

    frequency_hz: FloatArray  # (bins,)
    amplitude_volts: FloatArray  # (bins, taxels)
    phasors: NDArray[np.complex128]  # (bins, taxels): Fourier transform
    peak: int  # bin of the ripple; 0 where there is none
    status: TextureStatus  # "ok", or the reason why there is no ripple
    snr_db: float  # power of the ripple over that of white noise of the median bin's density

    @property
    def peak_hz(self) -> float:
        """Frequency of the ripple; 0 where there is none."""
        return float(self.frequency_hz[self.peak])


def spectrum(volts: FloatArray, rate_hz: float, volts_per_step: float, low_pass_hz: float) -> Spectrum:
    """Spectrum of a window and its peak: the bin with the largest power, summed over the taxels.

    `volts` (n, taxels) are finite. Their resolution `volts_per_step` is the noise floor of a noiseless
    signal. A largest ripple above `low_pass_hz`, the end of the band, is "aliased".
    """
    n, n_taxels = volts.shape
    time = np.arange(n) - (n - 1) / 2
    level = volts.mean(axis=0)
    trend = time @ (volts - level) / (float(time @ time) or 1.0)  # one scan has no trend
    phasors = np.fft.rfft(volts - level - np.outer(time, trend), axis=0)
    frequency_hz = np.arange(len(phasors)) * (rate_hz / n)
    power = (np.abs(phasors) ** 2).sum(axis=1)
    in_band = frequency_hz <= min(low_pass_hz, _ALIASED * rate_hz)
    # The median of a gamma distribution of shape m is near 1 - 1 / (3 m) of its mean (Wilson-Hilferty).
    noise_power = n * volts_per_step**2 / 12 * n_taxels
    if in_band.sum() > 1:
        noise_power = max(noise_power, float(median(power[1:][in_band[1:]])) / (1 - 1 / (3 * n_taxels)))
    clear = power > _MIN_PEAK_RATIO * noise_power
    peak = 1 + int(np.argmax(power[1:][in_band[1:]])) if in_band.sum() > 1 else 0
    # The last bin in the band may be the flank of a ripple above the band.
    if not clear[peak] or (peak + 1 < len(power) and power[peak + 1] > power[peak]):
        peak = 0
    status: TextureStatus = "ok"
    # Without the slowest bins: next to creep, a ripple above the band would pass for a slow one of too few
    # periods.
    top = int(np.argmax(power[_MIN_PERIODS:])) + _MIN_PERIODS if len(power) > _MIN_PERIODS else 0
    if clear[top] and not in_band[top]:
        status, peak = "aliased", top
    elif not peak:
        status = "low-snr"
    elif peak < _MIN_PERIODS:
        status = "too-few-periods"
    signal_power = 2 * float(power[peak]) / n**2 if peak else 0.0  # sum of amplitude^2 / 2
    snr_db = 10 * float(np.log10(max(signal_power * n / noise_power, 1e-10))) if peak else 0.0
    return Spectrum(frequency_hz, 2 * np.abs(phasors) / n, phasors, peak, status, snr_db)
