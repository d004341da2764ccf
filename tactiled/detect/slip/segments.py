"""Segments of scans with a constant set of taxels, and their filtered responses.

A taxel is used while all its channels have been good for the length of the filters: a missing or stuck
reading (`signal.stuck_channels`) excludes its taxel. So does noise. The mean over n taxels with independent
noise has the variance ``sum sd^2 / n^2``; one taxel with five times the noise of the others nearly doubles
the standard deviation of the mean of nine. Weights by noise would gain little more, and would distort the
response, to which all taxels contribute equally.

Each channel has its own noise floor, from the coif1 levels of all channels; so has each axis, from its own.
With the floors of the channels alone, noise that they share (a reference, a cable, a hum) would pass as
independent, and be reported as slip. The floors of the axes alone cannot show which channel is noisy, what
noise is left without it, or whether a sudden increase is noise or motion. Motion and pressure add up along an
axis; independent noise of the channels does not. Where the channels' floors have grown, and those of the axes
by no more than that explains, all floors are raised at once.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled import compiled
from tactiled.array import Array, FloatArray
from tactiled.detect.signal.quantise import READING_BITS, HeldReadings, Quantiser
from tactiled.detect.signal.rolling import RollingRows
from tactiled.detect.signal.wavelet import BankParams, SwtBank
from tactiled.detect.slip.filters import LEVELS, RampFilters
from tactiled.detect.slip.noise_floor import GROUP_SCANS, GroupedNoiseFloor, median
from tactiled.detect.slip.response import AXES, COLUMNS, LARGEST, PRESSURE, ResponseModel, motion, responses
from tactiled.detect.slip.rises import RiseTest

_RESPONSES = AXES + 1  # axes of motion, and pressure
BEFORE_SCANS = 16  # before a ramp, in which noise is looked at (`slip.evidence`)
# Interval of choosing the taxels: the noise is known after some groups, and each choice begins a segment.
_CHOOSE_SCANS = 4 * GROUP_SCANS
_NOISY, _QUIET_AGAIN = 5.0, 3.0
# Less is followed soon enough; and times what noise of channels makes of four axes: in groups of white noise
# they have 0.8 to 1.3 of it, three and more when a slip or a tap moves all taxels.
_GREW, _INCOHERENT = 2.0, 1.6
# Steps of noise that never matter: a 13th bit of full scale. The last bit of a 12-bit ADC comes and goes.
_NO_NOISE = 2.0 ** (READING_BITS - 13)
PIECE_SCANS = 256  # filtered at once, at most: bounds the memory of long blocks


@dataclass(frozen=True, eq=False)
class TaxelSetSegment:
    """Consecutive scans with the same set of taxels.

    Attributes
    ----------
    scans : slice
        Scans of the block.
    jump : (7,) float64 or None
        Difference of the response at one and the same scan from that of the segment before, where the set of
        taxels has changed.
    steps : (window - 1 + n, channels) float64
    seen : (window - 1 + n, 7) float64
        Responses of these readings.
    ramps : (n, 3, ramps) float64
    rises : (n, 4, ramps) float64
        Rise along each ramp; the last axis is the pressure.
    fits : (n, ramps) bool
        True where the ramp may count as evidence.
    any_fits : list of bool
        For each scan, True where some ramp may.
    details : (history + n, 4, levels) float64
        Wavelet details of the axes and of pressure, with those of earlier scans.
    channels : (n, levels, channels) float64
        Details of each channel.

    Arrays are good until the next segment.
    """

    scans: slice
    jump: FloatArray | None
    steps: FloatArray
    seen: FloatArray
    ramps: FloatArray
    rises: FloatArray
    fits: NDArray[np.bool_]
    any_fits: list[bool]
    details: FloatArray
    channels: FloatArray

    def newest(self, row: int, n: int) -> FloatArray:
        """Return the responses (n, 7) of the scans from a row on."""
        at = len(self.seen) - len(self.any_fits) + row
        return self.seen[at : at + n]


class _CompiledSteps(NamedTuple):
    """Compiled functions of a segmenter, bound to its arrays."""

    clean: Callable[..., int]
    respond: Callable[..., None]
    evidence: Callable[..., None]


class ResponseSegmenter:
    """Split scans into segments and compute the response of the taxels that are valid and quiet.

    Parameters
    ----------
    array : Array
    rate_hz : float
    test : RiseTest
        Finds the rises that may count as evidence.

    Attributes
    ----------
    filters : RampFilters
    taxels : (taxels,) bool
        Taxels included in the response now.
    weights : (7, channels) float64
    even : (7,) float64
        Response of an even pressure of 1.
    axes_sd : (levels, 3) float64
        Noise of the response along each axis.
    """

    def __init__(self, array: Array, rate_hz: float, test: RiseTest) -> None:
        self._response = ResponseModel(array)
        self._test = test
        self.filters = RampFilters(rate_hz)
        self._bank = SwtBank(array, BankParams(levels=LEVELS))
        self._steps_per_volt = 1 / Quantiser(array).volts_per_step
        self._floor = GroupedNoiseFloor(len(LEVELS), _RESPONSES + array.n_channels, rate_hz)
        n_before = self.filters.window - 1
        self._steps = RollingRows(n_before, (array.n_channels,), PIECE_SCANS)
        self._seen = RollingRows(n_before, (COLUMNS,), PIECE_SCANS)
        self._axes = RollingRows(n_before, (_RESPONSES,), PIECE_SCANS)
        n_filters = self.filters.n_ramps + len(LEVELS)
        self._n_details = self.filters.longest + BEFORE_SCANS  # scans whose details are kept
        self._filtered = RollingRows(self._n_details, (_RESPONSES, n_filters), PIECE_SCANS)
        self._newest_bad = np.full(array.n_taxels, -self.filters.window - 1)
        self._n_seen = 0
        self._noisy = np.zeros(array.n_taxels, dtype=np.bool_)
        self._choose(np.zeros(array.n_taxels, dtype=np.bool_))
        self._compiled = self._bind(compiled.library(), array.n_channels)

    def _bind(self, library: Any | None, n_channels: int) -> _CompiledSteps | None:
        """Bind the compiled functions to the arrays of this object."""
        if library is None:
            return None
        filters, needs = self.filters, self._response.needs
        lengths, taps = filters.backwards
        return _CompiledSteps(
            compiled.bind(
                library.tactiled_clean, n_channels, len(needs), filters.window, needs, self._newest_bad
            ),
            compiled.bind(library.tactiled_respond, n_channels, LARGEST),
            compiled.bind(
                library.tactiled_evidence, len(lengths), lengths, taps, filters.n_ramps, filters.rise_scale,
                *self._test.constants,
            ),
        )  # fmt: skip

    @property
    def axes_sd(self) -> FloatArray:
        """Noise (levels, 3) of the response along each axis."""
        return np.asarray(self._floor.sd[:, :AXES])

    def _choose(self, taxels: NDArray[np.bool_]) -> None:
        self.taxels = taxels
        self.weights = self._response.weights(taxels)
        self.even = self.weights @ self._response.pressed

    def cut(self, held: HeldReadings) -> Iterator[TaxelSetSegment]:
        """Yield the segments of a block; call `learn` for each scan of one before taking the next."""
        first = self._n_seen
        if first == 0:
            self._steps.newest(self.filters.window - 1)[:] = held.steps[0]
        clean, changes = self._clean(held.ok)
        n = len(held.steps)
        bounds = [0, n]
        if n > 1:
            bounds = sorted({*bounds, *changes, *range(-first % _CHOOSE_SCANS, n, _CHOOSE_SCANS)})
        channels = self._bank.filter_steps(held.steps) * self._steps_per_volt
        for a, b in itertools.pairwise(bounds):
            if (first + a) % _CHOOSE_SCANS == 0:
                self._find_noisy(clean[a])
            yield self._segment(slice(a, b), held.steps[a:b], clean[a] & ~self._noisy, channels[a:b])

    def _clean(self, ok: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], list[int]]:
        """Return the taxels (n, taxels) whose channels are valid over the whole filter window.

        And the scans at which they change.
        """
        first, self._n_seen = self._n_seen, self._n_seen + len(ok)
        if self._compiled is not None:
            clean = np.empty((len(ok), len(self.taxels)), dtype=np.bool_)
            ok = compiled.dense(ok, np.bool_)
            if self._compiled.clean(len(ok), first, compiled.address(ok), compiled.address(clean)):
                return clean, []  # the same in all scans
        else:
            whole = self._response.whole_taxels(ok)
            scans = np.arange(first, self._n_seen)[:, np.newaxis]
            newest_bad = np.maximum.accumulate(np.where(whole, self._newest_bad, scans), axis=0)
            self._newest_bad[:] = newest_bad[-1]
            clean = np.asarray(scans - newest_bad > self.filters.window)
        return clean, (np.flatnonzero((clean[1:] != clean[:-1]).any(axis=1)) + 1).tolist()

    def _find_noisy(self, clean: NDArray[np.bool_]) -> None:
        """Find taxels with far more noise than the median, with hysteresis."""
        noise = self._response.worst(self._floor.sd[0, _RESPONSES:])
        usual = max(median(noise[clean]) if clean.any() else 0.0, _NO_NOISE)
        self._noisy = noise > np.where(self._noisy, _QUIET_AGAIN, _NOISY) * usual

    def newest(self, n: int) -> FloatArray:
        """Return the last n readings (n, channels)."""
        return self._steps.newest(n).copy()

    def _segment(
        self, scans: slice, steps: FloatArray, taxels: NDArray[np.bool_], channels: FloatArray
    ) -> TaxelSetSegment:
        n, window = len(steps), self.filters.window
        jump = None
        if taxels.tobytes() != self.taxels.tobytes():
            jump = self._change(taxels)
        self._steps.append(n)[:] = steps
        seen, axes, filtered = self._seen.append(n), self._axes.append(n), self._filtered.append(n)
        n_ramps = self.filters.n_ramps
        if self._compiled is not None:
            rises = np.empty((n, _RESPONSES, n_ramps))
            fits, any_fit = np.empty((n, n_ramps), dtype=np.bool_), np.empty(n, dtype=np.bool_)
            at, axes_at = compiled.address, self._axes.address(n)
            self._compiled.respond(
                n, at(self.weights), self._steps.address(n), self._seen.address(n), axes_at
            )
            self._compiled.evidence(n, axes_at, self._filtered.address(n), at(rises), at(fits), at(any_fit))
            any_fits: list[bool] = any_fit.tolist()
        else:
            self._respond(self._steps.newest(n), seen, axes)
            filtered[:] = self.filters.filter(self._axes.newest(window - 1 + n))
            rises = filtered[..., :n_ramps] * self.filters.rise_scale
            fits = self._test.fits(rises, axes)
            any_fits = [bool(row.any()) for row in fits]
        return TaxelSetSegment(
            scans,
            jump,
            self._steps.newest(window - 1 + n),
            self._seen.newest(window - 1 + n),
            filtered[:, :AXES, :n_ramps],
            rises,
            fits,
            any_fits,
            self._filtered.newest(self._n_details + n)[..., n_ramps:],
            channels,
        )

    def _change(self, taxels: NDArray[np.bool_]) -> FloatArray:
        """Change the set of taxels, and return the jump (7,) of the newest response."""
        newest = self._steps.newest(1)
        before, noise = responses(self.weights, newest), self._made_of(self._floor.sd)
        self._choose(taxels)
        jump = (responses(self.weights, newest) - before)[0]
        now = self._made_of(self._floor.sd)
        known = (noise > 0) & (now > 0)
        self._floor.scale(
            np.where(known, now, 1.0) / np.where(known, noise, 1.0), columns=slice(0, _RESPONSES)
        )
        n_before = self.filters.window - 1
        kept = self._steps.newest(n_before), self._seen.newest(n_before), self._axes.newest(n_before)
        self._respond(*kept)
        return np.asarray(jump)

    def _respond(self, steps: FloatArray, seen: FloatArray, axes: FloatArray) -> None:
        """Fill in the responses (n, 7) of steps (n, channels), and their axes and pressure (n, 4)."""
        seen[:] = responses(self.weights, steps)
        axes[:, :AXES] = motion(seen)
        axes[:, AXES] = seen[:, PRESSURE]

    def _made_of(self, noise: FloatArray) -> FloatArray:
        """Return the noise (levels, 4) of axes and pressure if the noise of channels is independent."""
        weights = np.concatenate([motion(self.weights.T), self.weights[PRESSURE:].T], axis=1)
        return np.asarray(np.sqrt(noise[:, _RESPONSES:] ** 2 @ weights**2))

    @property
    def n_to_group(self) -> int:
        """Scans until the noise floor changes."""
        return self._floor.n_to_group

    def learn(self, segment: TaxelSetSegment, row: int, n: int, *, disturbed: bool) -> bool:
        """Update the noise floor by n scans of a segment; return True if a group of scans is complete."""
        at = self._n_details + row
        if not self._floor.add(segment.details[at : at + n], segment.channels[row : row + n], disturbed):
            return False
        newest = self._floor.newest
        grew = (newest / self._floor.sd)[:, _RESPONSES:]
        if median(grew[0]) > _GREW:
            made = np.maximum(self._made_of(newest)[0], 1.0)
            if np.mean((newest[0, :_RESPONSES] / made) ** 2) < _INCOHERENT**2:
                self._floor.scale(np.maximum(np.median(grew, axis=1), 1.0)[:, np.newaxis])
        return True
