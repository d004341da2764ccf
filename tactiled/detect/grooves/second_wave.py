"""Test whether a line holds a second wave: crossed grooves, a knurl, or a vibration of the same frequency.

Two waves of one frequency leave no second line in the spectrum. Each channel has its own gain, so their sum
may pass as one wave whose channels differ in gain and a little in phase. But then a second wave explains most
of what the first one leaves; of gains and phases that differ at random it explains less.

Without this test, 7 of 12 windows over crossed grooves that all channels feel alike are answered wrong, with
it 4; no answer to ten other kinds of windows depends on it.

Two waves of one frequency and one motion have the same component along the motion. So pairs are searched on a
grid across it.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import FALSE_DOUBT, ChannelLayout
from tactiled.detect.grooves.search import grid_step
from tactiled.detect.grooves.window import DetrendedWindow
from tactiled.detect.worker import pause

# prior: squared overlap of two waves on the channels of one kind. Above it they cannot be resolved.
_MOST_ALIKE = 0.9
# choice: standard deviations by which the direction may deviate, and the largest deviation, where it is
# unknown.
_REACH = 2.5
_LARGEST_HEADING_ERROR_DEG = 45.0  # choice
# choice: directions tried to either side of the stated one.
_MOST_HEADINGS = 3
# tuned: power that two waves leave of what one leaves. Of gains and phases that differ at random a second
# wave takes a part, too: with offsets of 0.1 to 0.3 rad two waves left 0.60 to 0.88, with two gratings mostly
# less than 0.3 (windows of `bench texture`, on which this was set).
_MOST_LEFT = 0.58
# choice: the same where the phases suit one wave: between the 0.03 that two waves leave which turn no phases,
# because one is an alias of the other, and the 0.35 that gains leave which differ, as of a pad that is
# pressed unevenly.
_MOST_LEFT_IF_ALIKE = 0.15
# prior: part of the line's power. A second wave that explains less hardly moves the answer, and uneven pads
# look like it: on plates that obey physics two waves explain 0.001 to 0.003 more than one.
LEAST_SECOND_PART = 0.01


def has_second_wave(
    window: DetrendedWindow,
    z: NDArray[np.complex128],
    variance: FloatArray,
    k: FloatArray,
    are_alike: bool,
) -> bool:
    """True where a second wave of the same frequency explains most of what one wave (2,) leaves.

    Parameters
    ----------
    z, variance : (channels,) complex128 and float64
        Phasors of the line, and the variance of noise in the real and in the imaginary part of each.
    are_alike : bool
        The phases of a kind differ by no more than noise.
    """
    layout, n_kinds = window.layout, window.layout.is_kind.shape[1]
    if len(z) < 4 * n_kinds + 5:  # too few for the amplitudes of both waves and their directions
        return False
    wave = np.exp(1j * layout.xy_mm @ k)
    amplitude = (wave.conj() * z) @ layout.is_kind / layout.is_kind.sum(axis=0)
    left = np.abs(z - wave * (layout.is_kind @ amplitude)) ** 2
    by_one, total = float(left.sum()), float((np.abs(z) ** 2).sum())
    noise = special.chdtri(2 * (len(z) - n_kinds - 1), FALSE_DOUBT)
    if by_one < LEAST_SECOND_PART * total or float((left / variance).sum()) < noise:
        return False
    by_two = total - max(most_explained(z, layout, waves) for waves in _likely_waves(window, k))
    most_left = _MOST_LEFT_IF_ALIKE if are_alike else _MOST_LEFT
    return by_two <= most_left * by_one and by_one - by_two >= LEAST_SECOND_PART * total


def _likely_waves(window: DetrendedWindow, k: FloatArray) -> list[FloatArray]:
    """For each likely direction of the motion, a grid of waves (waves, 2) that have the frequency of k.

    The last one is common to all channels, as a vibration is.
    """
    motion, step = window.motion, grid_step(window.layout)
    n_across = int(np.ceil(2 * np.pi / window.params.min_period_mm / step))
    across = np.arange(-n_across, n_across + 1) * step
    off = across - k @ motion.across
    largest = np.tan(np.radians(min(_REACH * motion.direction_sd_deg, _LARGEST_HEADING_ERROR_DEG)))
    n_errors = min(int(np.ceil(largest * np.abs(off).max() / (2 * step))), _MOST_HEADINGS)
    grids = []
    for error in np.linspace(-largest, largest, 2 * n_errors + 1):
        along = k @ motion.heading - error * off
        waves = along[:, np.newaxis] * motion.heading + across[:, np.newaxis] * motion.across
        grids.append(np.concatenate([waves, np.zeros((1, 2))]))
    return grids


def most_explained(z: NDArray[np.complex128], layout: ChannelLayout, waves: FloatArray) -> float:
    """Largest power that two of some waves explain together, by least squares for each kind."""
    explained = np.zeros((len(waves), len(waves)))
    for mine in layout.is_kind.T.astype(bool):
        pause()
        own = np.exp(1j * (waves @ layout.xy_mm[mine].T)) / np.sqrt(mine.sum())
        seen, overlap = own.conj() @ z[mine], own.conj() @ own.T
        power, alike = np.abs(seen) ** 2, overlap.real**2 + overlap.imag**2
        crossed = (np.outer(seen.conj(), seen) * overlap).real
        both = power[:, np.newaxis] + power - 2 * crossed
        explained += np.where(alike < _MOST_ALIKE, both / np.maximum(1 - alike, 1 - _MOST_ALIKE), 0.0)
    return float(explained.max())
