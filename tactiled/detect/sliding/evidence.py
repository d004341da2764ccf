"""Evidence of sliding in one window of readings, against what the sensor does at rest.

A surface that moves under the skin loads each taxel on its own. A hand that trembles, a motor that hums, a
tap and a change of grip act on a rigid body: on the load and on its two tilts, which are three patterns over
the channels. Without the three strongest patterns of a window, a channel at rest is left with its own noise.

1. Spectra of the window: a cubic trend removed, under a Hann window, over the noise of each channel.
2. Roughness: the largest mean of three neighbouring bins of what the three strongest patterns leave, over the
   same at rest. Where rest was seen out of contact alone, it must exceed white noise at the level of the
   window's quietest quarter of bins, too. What happens in one quarter of the window, such as a tap, does not
   count. Before rest was seen, roughness says nothing: noise at rest has a spectrum of its own.
3. Ripple: the strongest line that travels, whose phases differ between channels. A ridge passes the taxels
   one after the other, so that the phases of its ripple fill the circle. A hum of the gripper or a tremor of
   the hand shakes the load and tilts it: phasors in phase, and phasors of both signs in quadrature to these.
   Then either the phases have a mean, or twice the phases have. Places of the taxels are not needed. Ridges
   as far apart as twice the array, or as the taxels, are not told from a hum.
4. Log odds of sliding: both over what windows at rest reach, bounded, so that no single window decides.
"""

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray

_TREND_ORDER = 3  # choice
LEAST_CYCLES = 3  # derived: a cubic trend leaves humps of fewer in the window
_PATTERNS = 3  # derived: load, and tilt in two directions
_CHANNELS_OF_PATTERN = 3  # prior: at least, for each pattern that is left out
_FEW = 4  # derived: channels, of which hum and roughness cannot be told apart
_SMOOTH = np.ones(3) / 3  # choice
_QUIET_PART = 0.25  # prior: of the bins, which show the noise
# tuned: set on seeds 0 to 7 of the worlds of `sensors` in research/README.md (16 taxels, 35.6 Hz). Largest of
# some ten independent groups of bins, in standard deviations of their logarithm, with a margin for noise that
# is not quite even.
_AT_REST, _AT_REST_SDS = 0.4, 3.5
_SLOPE = 4.0  # tuned: on the same seeds; log odds for each unit of log power beyond
_LINE_AT_REST = 0.7  # tuned: twice the most at rest on the same seeds, in logarithms
_ONCE = 0.6  # derived: of the excess: a slide through the window has a quarter in each
_MOST_ROUGH, _MOST_LINE = 1.5, 1.4  # tuned: on the same seeds; less than sliding needs

# derived: mean phasor over mean size of phasors, of the phases or of twice the phases: 0 for phases that fill
# the circle, at least 0.45 for a hum in any proportion of load and tilt on a row of taxels.
_MOST_ALIKE = 0.4
_LOBE = 2  # derived: bins to either side that a Hann window spreads a line over
_HARMONICS = (2, 3)  # choice
# derived: phases of fewer that are noise fill the circle by chance, or have a mean by chance
_LEAST_CHANNELS = 6


def travelling_line(z: NDArray[np.complex128], first_cycles: int) -> float:
    """Measure how far the strongest line of a window stands out, if it travels.

    Parameters
    ----------
    z : (bins, channels) complex128
        Spectra under a Hann window, each channel over its own standard deviation.
    first_cycles : int
        Periods in the window of the first bin.

    Returns
    -------
    float
        Logarithm of the power of the strongest bin over that of any other, except its lobe and harmonics; 0
        where it does not travel.
    """
    if z.shape[1] < _LEAST_CHANNELS:
        return 0.0
    power = (np.abs(z) ** 2).sum(axis=1)
    cycles = np.arange(len(z)) + first_cycles
    peak = int(np.argmax(power))
    size = np.abs(z[peak])
    doubled = z[peak] ** 2 / np.maximum(size, 1e-30)
    if max(abs(z[peak].sum()), abs(doubled.sum())) > _MOST_ALIKE * float(size.sum()):
        return 0.0
    others = np.abs(cycles - cycles[peak]) > _LOBE
    for harmonic in _HARMONICS:  # their lobes are of uneven ridges, and wider
        others &= np.abs(cycles - harmonic * cycles[peak]) > harmonic + 1
    if not others.any():
        return 0.0
    return float(np.log(max(power[peak], 1e-30) / max(float(power[others].max()), 1e-30)))


class Spectra(NamedTuple):
    """Spectra of a window."""

    z: NDArray[np.complex128]  # (bins, channels)
    noise: FloatArray  # (channels,): power of each channel's noise in a bin, at the quietest quarter of bins
    readings: FloatArray  # (n, channels): without their trend


def spectra(readings: FloatArray, rounding_power: FloatArray) -> Spectra:
    """Compute spectra of readings (n, channels); `rounding_power` (channels,) is the least noise of each."""
    n = len(readings)
    hann, trend = _bases(n)
    centred = readings - readings.mean(axis=0)
    centred = centred - trend @ (trend.T @ centred)
    z = np.fft.rfft(hann * centred, axis=0)[LEAST_CYCLES : n // 2]
    power = np.sort(np.abs(z) ** 2, axis=0)[int(_QUIET_PART * len(z))]
    least = rounding_power * float((hann**2).sum())
    return Spectra(z, np.maximum(power, np.maximum(least, 1e-12)), centred)


def own_power(found: Spectra, noise: FloatArray) -> FloatArray:
    """Power (bins,) over the noise that the strongest patterns of a window leave, mean over channels."""
    z = found.z / np.sqrt(noise) @ _own_patterns(found, noise)
    return np.asarray((np.abs(z) ** 2).mean(axis=1))


def _own_patterns(found: Spectra, noise: FloatArray) -> FloatArray:
    """Patterns (channels, channels - left out), over the noise, except the strongest."""
    z = found.z / np.sqrt(noise)
    parts = np.concatenate([z.real, z.imag])
    _, patterns = np.linalg.eigh(parts.T @ parts)
    return np.asarray(patterns[:, : z.shape[1] - n_patterns(z.shape[1])])


def happens_once(found: Spectra) -> bool:
    """Return True where most of what exceeds the noise is in one quarter of the window, as of a tap."""
    n = len(found.readings)
    own = found.readings / np.sqrt(found.noise) @ _own_patterns(found, found.noise)
    power = (own**2).mean(axis=1)[: n // 4 * 4].reshape(4, -1).mean(axis=1)
    # A quarter of exponentially distributed power is below 0.29 of its mean; a Hann window has 3/8 of n.
    noise = 1 / (-np.log(1 - _QUIET_PART) * 0.375 * n)
    excess = np.maximum(power - noise, 0.0)
    return bool(excess.max() > _ONCE * excess.sum())


def n_patterns(channels: int) -> int:
    """Number of patterns that are left out."""
    return min(_PATTERNS, channels // _CHANNELS_OF_PATTERN)


def log_odds(found: Spectra, own: FloatArray, at_rest: FloatArray | None) -> float:
    """Log odds of sliding in a window.

    Parameters
    ----------
    own : (bins,) float64
        See `own_power`.
    at_rest : (bins,) float64 or None
        The same, and in the same noise, at rest.
    """
    bins, channels = found.z.shape
    n_free = channels - n_patterns(channels)
    if channels < _FEW:
        return -_MOST_ROUGH
    sd = float(1 / np.sqrt(2 * n_free))
    if at_rest is None:
        level = np.sort(own)[int(_QUIET_PART * bins)]
        ratio = np.convolve(own, _SMOOTH, "valid") / max(float(level), 1e-12)
    else:
        ratio = np.convolve(own, _SMOOTH, "valid") / np.convolve(at_rest, _SMOOTH, "valid").clip(1e-12)
    growth = float(np.log(max(float(ratio.max()), 1e-12)))
    rough = float(np.clip(_SLOPE * (growth - _AT_REST - _AT_REST_SDS * sd), -_MOST_ROUGH, _MOST_ROUGH))
    if rough > 0 and happens_once(found):
        rough = 0.0
    ripple = ripple_odds(found)
    return rough if ripple <= 0 else max(rough, 0.0) + ripple


def ripple_odds(found: Spectra) -> float:
    """Log odds of sliding that the ripple of a window gives; 0 where no line travels."""
    size = np.maximum(found.readings.std(axis=0), np.sqrt(found.noise / len(found.z)))
    line = travelling_line(found.z / size, LEAST_CYCLES) - _LINE_AT_REST
    return float(np.clip(_SLOPE * line, 0.0, _MOST_LINE))


@functools.lru_cache(maxsize=8)
def _bases(n: int) -> tuple[FloatArray, FloatArray]:
    """Hann window (n, 1) and trend (n, 4) of a window of n scans."""
    steps = np.linspace(-1.0, 1.0, n)
    trend = np.linalg.qr(np.polynomial.legendre.legvander(steps, _TREND_ORDER))[0]
    return np.hanning(n)[:, np.newaxis], np.asarray(trend)
