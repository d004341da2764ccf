"""Loads and shears of the taxels, scan by scan: at one instant, and without bad channels."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled import compiled
from tactiled.array import Array, FloatArray
from tactiled.detect.contact.jumps import JumpGate, jump_numbers
from tactiled.detect.contact.observe import (
    FLOOR_LEVELS,
    NoiseFloor,
    Responses,
    floor_numbers,
    history_scans,
)
from tactiled.detect.contact.ordered_sums import sum_in_order
from tactiled.detect.contact.relief import RelievedSides, relief_numbers
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.stuck_channels import StuckChannelDetector
from tactiled.detect.signal.wavelet import BankParams, SwtBank, border_scans, taps
from tactiled.samples.block import ScanBlock

_HOLD_S = (
    0.05  # for which the last good reading stands in; a channel that is bad for longer takes its taxel out
)
_LEAST_KEPT = 0.75  # of the taxels; with fewer, the messages are not valid


class ScanReading(NamedTuple):
    """Reading of a scan.

    Attributes
    ----------
    load : float
        Mean load of the taxels.
    shear_sd, total_sd, load_sd : float
        Noise of a taxel's shear, of the total shear and of the mean load.
    is_read : bool
        All taxels that are not out can be read, and they are enough.
    is_lost : bool
        A taxel was taken out during the contact.
    is_switched : bool
        A taxel is read from other sides than in the scan before: `switched`.
    """

    load: float
    shear_sd: float
    total_sd: float
    load_sd: float
    is_read: bool
    is_lost: bool
    is_switched: bool


class TaxelReadings:
    """Loads and shears of the taxels.

    Parameters
    ----------
    array : Array
    rate_hz : float

    Attributes
    ----------
    history : (n, 3, taxels) float64
        Load, shear along x and along y of the newest scans.
    dropped, switched : (taxels,) bool
        Taxels that are out, and those that are read from other sides than in the scan before.
    """

    def __init__(self, array: Array, rate_hz: float) -> None:
        self._array, self._rate_hz = array, rate_hz
        self._n_hold = max(1, round(_HOLD_S * rate_hz))
        self._responses = Responses(array)
        self._relieved = RelievedSides(array)
        self._quantiser = Quantiser(array)
        self._stuck = StuckChannelDetector(array)
        self._jumps = JumpGate(self._responses.taxel_channels)
        self._bank = SwtBank(array, BankParams(levels=tuple(range(1, FLOOR_LEVELS + 1))))
        self._floor = NoiseFloor(array.n_channels, self._quantiser.volts_per_step)
        self._baseline = np.zeros(array.n_channels)
        self.history = np.zeros((history_scans(rate_hz), 3, array.n_taxels))
        self._remainders = np.zeros(len(self.history))
        self._previous: FloatArray | None = None  # readings (2, channels) of the scans before
        self._bad_scans = np.zeros(array.n_channels, dtype=np.int64)
        self.dropped = np.zeros(array.n_taxels, dtype=np.bool_)
        self.switched = np.zeros(array.n_taxels, dtype=np.bool_)
        self._is_after_gap = True

    def begin(self, block: ScanBlock) -> None:
        """Take a block, whose scans are then taken one by one."""
        held = self._quantiser.process(block)
        self._ok = held.ok & ~self._stuck.process(held.steps)
        self._volts = held.steps * self._quantiser.volts_per_step
        self._details = self._bank.coefficients(held)
        self._usable = np.all(self._details.usable, axis=1)
        self._together, self._remainder = self._at_one_instant(self._volts, block)

    def take(self, scan: int, *, in_contact: bool, is_pressed: bool) -> ScanReading:
        """Take a scan of the block, in a contact whose press may be over."""
        volts, together = self._volts[scan], self._together[scan]
        jumped = None
        if is_pressed:
            jumped = self._jumps.take(volts, self.history[-1, 0], self._floor.sd())
        else:  # a press moves taxels one after the other
            self._jumps.skip(volts)
        if jumped is not None:
            self._ok[scan] &= ~jumped
            together[jumped] = self._jumps.accepted[jumped]
        is_read, is_lost = self._take_out(self._ok[scan], in_contact=in_contact)
        out = self._responses.taxel_channels[self.dropped].any(axis=0)
        if (self._usable[scan] | out).all():
            self._floor.take(volts, self._details.volts[scan], self._rate_hz)
        pressed = together - self._baseline
        response = self._responses.of(pressed)
        was_relieved = self._relieved.relieved
        if in_contact:
            self._relieved.correct(response, pressed)
        self.switched = (self._relieved.relieved != was_relieved).any(axis=0)
        response[:, self.dropped] = 0.0
        self.history[:-1] = self.history[1:]
        self.history[-1] = response
        bent = self._responses.of(self._remainder[scan])[1:].ravel()
        self._remainders[:-1] = self._remainders[1:]
        self._remainders[-1] = sum_in_order(bent * bent) / len(bent)
        if self._is_after_gap:  # no window straddles a gap
            self._is_after_gap = False
            self.history[:], self._remainders[:] = response, 0.0
        self._newest = volts
        load = sum_in_order(response[0]) / response.shape[1]
        shear_sd, total_sd, load_sd = self._responses.noise(self._floor.sd())
        shear_sd = math.sqrt(shear_sd * shear_sd + self._remainders.max())
        return ScanReading(load, shear_sd, total_sd, load_sd, is_read, is_lost, bool(self.switched.any()))

    def rest(self, part: float) -> None:
        """Let the baseline follow the readings of a scan without contact, by a part of their difference."""
        self._baseline += part * (self._newest - self._baseline)

    def release(self) -> None:
        """Forget which sides of taxels the contact relieved."""
        self._relieved.reset()

    def interrupt(self) -> None:
        """Let no window reach back before a gap."""
        self._bank.reset()
        self._previous = None
        self._is_after_gap = True

    @property
    def keeps_enough(self) -> bool:
        """True where so many taxels can be read that what is said of the contact is valid."""
        return int(np.count_nonzero(self.dropped)) <= most_dropped(self._array)

    def _at_one_instant(self, readings: FloatArray, block: ScanBlock) -> tuple[FloatArray, FloatArray]:
        """Return readings (n, channels) interpolated to the beginning of their scan, and the remainders.

        A board reads its channels one after the other. While shear grows, the taxels that are read last have
        grown the most, by several times what partial slip changes of their shares. Linear interpolation
        leaves half of the second derivative times the times to both readings (Abramowitz and Stegun, 25.2.3).
        """
        seen = np.empty((len(readings) + 2, readings.shape[1]))
        seen[:2] = readings[0] if self._previous is None else self._previous
        seen[2:] = readings
        self._previous = seen[-2:].copy()
        back = np.clip(block.channel_offset_s * block.rate_hz, 0.0, 1.0)
        change = np.diff(seen, axis=0)
        together = readings - back * change[1:]
        return np.asarray(together), np.asarray(0.5 * back * (1.0 - back) * np.diff(change, axis=0))

    def _take_out(self, ok: NDArray[np.bool_], *, in_contact: bool) -> tuple[bool, bool]:
        """Take out taxels with a channel that is bad for long; return if the rest is read, and if one is new.

        A taxel stays out until the contact ends, because its zero and its share are no longer known.
        """
        self._bad_scans = np.where(ok, 0, self._bad_scans + 1)
        bad = self._responses.taxel_channels @ (self._bad_scans > self._n_hold)
        dropped = bad | self.dropped if in_contact else bad
        is_lost = in_contact and bool(np.any(dropped & ~self.dropped))
        self.dropped = dropped
        waits = self._responses.taxel_channels[~dropped] @ ~ok
        return not bool(np.any(waits)) and self.keeps_enough, is_lost


def most_dropped(array: Array) -> float:
    """Return the number of taxels that may be out."""
    return (1 - _LEAST_KEPT) * array.n_taxels


class CompiledTaxelReadings:
    """`TaxelReadings` with the same bits: `compiled_readings.c` has the state in a block."""

    def __init__(self, array: Array, rate_hz: float) -> None:
        library = compiled.library()
        assert library is not None
        numbers, arrays, sizes = _constants(array, rate_hz)
        self.history = np.zeros((history_scans(rate_hz), 3, array.n_taxels))
        self.dropped = np.zeros(array.n_taxels, dtype=np.bool_)
        self.switched = np.zeros(array.n_taxels, dtype=np.bool_)
        self._volts, self._offset_s = np.zeros((2, array.n_channels))
        self._valid = np.zeros(array.n_channels, dtype=np.bool_)
        self._block_offset_s: FloatArray | None = None
        # Arrays whose addresses are bound must live as long as this object.
        self._bound = (
            sizes,
            numbers,
            np.array([compiled.address(values) for values in arrays], dtype=np.uintp),
            *(self._volts, self._valid, self._offset_s, self.history, self.dropped, self.switched),
            arrays,
        )
        begin = compiled.bind(library.tactiled_readings, *self._bound[:-1])
        self._state = np.zeros(begin(None))
        begin(compiled.address(self._state))
        self._most_dropped = most_dropped(array)
        self._seen = self._state[: len(ScanReading._fields)]
        self._take = compiled.bind(library.tactiled_readings_take, self._state)
        self.rest = compiled.bind(library.tactiled_readings_rest, self._state)
        self.release = compiled.bind(library.tactiled_readings_release, self._state)
        self.interrupt = compiled.bind(library.tactiled_readings_interrupt, self._state)
        """As those of `TaxelReadings`."""

    def begin(self, block: ScanBlock) -> None:
        """Take a block, whose scans are then taken one by one."""
        self._block_volts, self._block_valid = block.volts, block.valid
        if block.channel_offset_s is not self._block_offset_s:
            self._block_offset_s = block.channel_offset_s
            self._offset_s[:] = block.channel_offset_s

    def take(self, scan: int, *, in_contact: bool, is_pressed: bool) -> ScanReading:
        """Take a scan of the block, in a contact whose press may be over."""
        # Copies take less time than three addresses.
        self._volts[:], self._valid[:] = self._block_volts[scan], self._block_valid[scan]
        self._take(in_contact, is_pressed)
        load, shear_sd, total_sd, load_sd, is_read, is_lost, is_switched = self._seen.tolist()
        return ScanReading(load, shear_sd, total_sd, load_sd, is_read > 0, is_lost > 0, is_switched > 0)

    @property
    def keeps_enough(self) -> bool:
        """True where so many taxels can be read that what is said of the contact is valid."""
        return int(np.count_nonzero(self.dropped)) <= self._most_dropped


def _constants(
    array: Array, rate_hz: float
) -> tuple[FloatArray, tuple[NDArray[Any], ...], NDArray[np.int64]]:
    """Return numbers, arrays and sizes, in the order of `compiled_readings.c`."""
    responses, sides, stuck = Responses(array), RelievedSides(array), StuckChannelDetector(array)
    grid = Quantiser(array)
    n_hold = max(1, round(_HOLD_S * rate_hz))
    numbers = np.concatenate(
        [
            [grid.full_scale_volts, grid.volts_per_step, rate_hz, n_hold, most_dropped(array)],
            floor_numbers(rate_hz),
            relief_numbers(),
            jump_numbers(),
            stuck.numbers(),
        ]
    )
    filters = [taps(level) * grid.volts_per_step for level in range(1, FLOOR_LEVELS + 1)]
    lengths = np.array([len(one) for one in filters], dtype=np.int64)
    arrays = (
        *(lengths, np.concatenate(filters), responses.own, responses.own_weights),
        *(sides.own, sides.weights, sides.even, responses.taxel_channels),
        *(stuck.sign, compiled.dense(stuck.sides, np.int64), stuck.judged),
    )
    n_sides = len(sides.own) if sides.is_needed else 0
    sizes = [array.n_channels, array.n_taxels, FLOOR_LEVELS, len(responses.own), n_sides]
    sizes += [history_scans(rate_hz), border_scans(FLOOR_LEVELS), stuck.sides.shape[1]]
    return numbers, arrays, np.array(sizes, dtype=np.int64)


AnyTaxelReadings = TaxelReadings | CompiledTaxelReadings


def taxel_readings(array: Array, rate_hz: float) -> AnyTaxelReadings:
    """Return the readings of an array, on the compiled path where there is one."""
    return (TaxelReadings if compiled.library() is None else CompiledTaxelReadings)(array, rate_hz)
