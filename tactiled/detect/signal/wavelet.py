"""The coif1 stationary wavelet transform as a causal streaming filter bank.

Level j of the undecimated transform is one FIR filter: the cascade of j - 1 low-pass filters and a
high-pass filter, each dilated by the powers of two before it (Mallat, "A Wavelet Tour of Signal
Processing", 3rd ed., section 5.5, algorithme a trous; `pywt.swt`). It has 5 (2^j - 1) + 1 taps. The bank's
output at scan n is pywt's coefficient of index n - 3 (2^j - 1), provided the last 5 (2^j - 1) + 1 scans
were good readings.

Exactness. Readings are whole steps within 2^23 (see `quantise`); taps are whole multiples of 2^-24. The sum
of a filter's absolute taps is at most 9.14 (level 6), so no partial sum exceeds 9.14 * 2^47 < 2^50.2 <
2^53: the sum, in any order and any chunking, has the same bits. Rounded taps are adjusted so
that they and their first moment sum to zero exactly: a constant and a steady ramp give exactly 0, for ever.
The error from rounding is bounded by `error_volts` and is below 1 uV rms in use.
"""

import functools
from dataclasses import dataclass

import numpy as np
import pywt
from numpy.typing import NDArray
from pydantic import Field, field_validator

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.fast import Bank
from tactiled.detect.signal.quantise import HeldReadings, Quantiser
from tactiled.detect.signal.rolling import RollingRows
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

MAX_LEVEL = 6  # choice
PIECE_SCANS = 1024  # choice: most scans filtered at once: bounds the memory of long blocks
_TAP_SCALE = 2.0**24  # derived


class BankParams(Params):
    """Levels of the wavelet bank."""

    levels: tuple[int, ...] = Field(
        default=(1, 2, 3, 4, 5, 6), min_length=1, description="1 is the finest; each next sees twice the time"
    )

    @field_validator("levels")
    @classmethod
    def _known(cls, levels: tuple[int, ...]) -> tuple[int, ...]:
        if any(not 1 <= level <= MAX_LEVEL for level in levels) or list(levels) != sorted(set(levels)):
            raise ValueError(f"levels must grow within 1..{MAX_LEVEL}")
        return levels


def delay_scans(level: int) -> int:
    """Scans by which the bank's output trails the coefficient that `pywt.swt` gives the same name."""
    return 3 * ((1 << level) - 1)


def border_scans(level: int) -> int:
    """Scans at the start (or after a gap or a bad reading) whose output is not the transform yet."""
    return 5 * ((1 << level) - 1)


@functools.cache
def taps(level: int) -> FloatArray:
    """Return the filter of a level as the bank applies it, newest scan first.

    Returns
    -------
    (5 (2^level - 1) + 1,) float64
        Multiples of 2^-24; they and their first moment sum to zero.
    """
    whole = np.rint(_exact_taps(level) * _TAP_SCALE)
    # Rounding leaves a few units over; give them back one by one where rounding had moved a tap furthest.
    surplus = int(whole.sum())
    moved = (whole - _exact_taps(level) * _TAP_SCALE) * np.sign(surplus)
    whole[np.argsort(-moved, kind="stable")[: abs(surplus)]] -= np.sign(surplus)
    # Correct the first moment, by pairs that leave the sum unchanged.
    while moment := int(whole @ np.arange(len(whole))):
        reach = min(abs(moment), len(whole) - 1)
        whole[0] += np.sign(moment)
        whole[reach] -= np.sign(moment)
    filtered: FloatArray = whole / _TAP_SCALE
    filtered.flags.writeable = False
    return filtered


@functools.cache
def _exact_taps(level: int) -> FloatArray:
    coif1 = pywt.Wavelet("coif1")
    cascade = np.ones(1)
    for j in range(level - 1):
        cascade = np.convolve(cascade, _dilated(coif1.dec_lo, 2**j))
    return np.convolve(cascade, _dilated(coif1.dec_hi, 2 ** (level - 1)))


def _dilated(filter_taps: list[float], step: int) -> FloatArray:
    spread = np.zeros((len(filter_taps) - 1) * step + 1)
    spread[::step] = filter_taps
    return spread


def kink_response(level: int) -> FloatArray:
    """Coefficient in the scans after a kink of one volt per scan; entry 0 is the scan of the kink itself."""
    response: FloatArray = np.concatenate([[0.0], np.cumsum(np.cumsum(taps(level)))[:-1]])
    return response


def error_volts(level: int, array: Array) -> float:
    """Largest difference from the transform in exact arithmetic, for readings anywhere within full scale."""
    grid = Quantiser(array)
    tap_error = np.abs(taps(level) - _exact_taps(level)).sum()
    return float(tap_error * grid.full_scale_volts + np.abs(taps(level)).sum() * grid.volts_per_step / 2)


@dataclass(frozen=True, eq=False)
class WaveletCoefficients:
    """Wavelet coefficients of n scans.

    Attributes
    ----------
    volts : (n, levels, channels) float64
        Detail coefficients, in the order of `BankParams.levels`.
    usable : (n, levels, channels) bool
        False where the filter still sees the start, a gap or a held reading.
    """

    volts: FloatArray
    usable: NDArray[np.bool_]


class SwtBank:
    """Causal coif1 bank over all channels."""

    def __init__(self, array: Array, params: BankParams | None = None) -> None:
        self.levels = (params or BankParams()).levels
        self._quantiser = Quantiser(array)
        self._n_channels = array.n_channels
        self._borders = np.array([border_scans(level) for level in self.levels])
        self._border = int(self._borders[-1])
        scale = self._quantiser.volts_per_step  # a power of two: products with it do not round
        self._bank = Bank(array.n_channels, [taps(level) * scale for level in self.levels])
        self.reset()

    def reset(self) -> None:
        """Forget everything seen."""
        self._quantiser.reset()
        self._steps = RollingRows(self._border, (self._n_channels,), PIECE_SCANS)
        self._is_begun = False
        self._n_usable = 0  # scans whose usability was asked for
        # Before the start stand copies of the first scan, which are not readings.
        self._newest_bad = np.full(self._n_channels, -1, dtype=np.int64)

    def process(self, item: ScanBlock | Gap) -> WaveletCoefficients:
        """Return the coefficients of each scan; a gap resets the bank and has none."""
        if isinstance(item, Gap):
            self.reset()
            n_levels = len(self.levels)
            empty = np.zeros((0, n_levels, self._n_channels))
            return WaveletCoefficients(empty, empty.astype(np.bool_))
        return self.coefficients(self._quantiser.process(item))

    def coefficients(self, held: HeldReadings) -> WaveletCoefficients:
        """Return the coefficients of readings already on the grid, any number of them."""
        parts = [
            self.filter(
                HeldReadings(
                    held.steps[start : start + PIECE_SCANS], held.ok[start : start + PIECE_SCANS], held.all_ok
                )
            )
            for start in range(0, len(held.steps), PIECE_SCANS)
        ]
        if len(parts) == 1:
            return parts[0]
        return WaveletCoefficients(
            np.concatenate([part.volts for part in parts]), np.concatenate([part.usable for part in parts])
        )

    def filter(self, held: HeldReadings) -> WaveletCoefficients:
        """Return the coefficients of readings already on the grid, at most `PIECE_SCANS` of them."""
        volts = self.filter_steps(held.steps)
        return WaveletCoefficients(volts, self._usable(held.ok, all_ok=held.all_ok))

    def filter_steps(self, steps: FloatArray) -> FloatArray:
        """Return the coefficients (n, levels, channels) of readings on the grid, usable or not."""
        n = len(steps)
        self._append(steps)
        volts = np.empty((n, len(self.levels), self._n_channels))
        seen = self._steps.newest(n + self._border)
        self._bank.take(n, self._border, seen.reshape(-1), volts.reshape(-1))
        return volts

    def recent_steps(self, n: int) -> FloatArray:
        """Return the held readings (n + border, channels) behind the last `n` outputs, in grid steps.

        A view, good until the next call of `filter` or `process`.
        """
        return self._steps.newest(n + self._border)

    def _append(self, steps: FloatArray) -> None:
        if not self._is_begun:
            self._is_begun = True
            self._steps.newest(self._border)[:] = steps[0]
        self._steps.append(len(steps))[:] = steps

    def _usable(self, ok: NDArray[np.bool_], *, all_ok: bool) -> NDArray[np.bool_]:
        n = len(ok)
        scans = np.arange(self._n_usable, self._n_usable + n)[:, np.newaxis]
        self._n_usable += n
        newest_bad = self._newest_bad
        if not all_ok:
            bad = np.where(ok, self._newest_bad, scans)
            newest_bad = np.maximum.accumulate(bad, axis=0)
            self._newest_bad = newest_bad[-1].copy()
        clean_scans = scans - newest_bad
        return clean_scans[:, np.newaxis, :] > self._borders[:, np.newaxis]


def coefficients(array: Array, block: ScanBlock, params: BankParams | None = None) -> WaveletCoefficients:
    """Return the coefficients of a whole recording, for plots: one call of the streaming bank."""
    return SwtBank(array, params).process(block)
