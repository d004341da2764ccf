"""The board's clock, and evenly timed scans by it, each channel sampled at its own instant.

=============  ==========================================================
``now_s``      true time, the host's monotonic clock (simulated or real)
``board_s``    seconds since power-up by the board's crystal, not wrapped
ticks          counts of the crystal as sent on the wire, wrapping
=============  ==========================================================
"""

import math
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

_SCANS_AHEAD = 32  # computed at once: one call costs some 0.3 ms, for one scan or for 32
Readings = NDArray[np.int64] | NDArray[np.float64]
Seconds = TypeVar("Seconds", float, NDArray[np.float64])
# Rounding of a board time that is a whole number of ticks must not make the counter one tick early.
_TICK_SLACK = 1e-3


@dataclass(frozen=True)
class Crystal:
    """Linear clock that starts at `power_up_s` and is too fast by `drift_ppm`."""

    power_up_s: float
    drift_ppm: float
    tick_s: float  # nominal length of a tick
    bits: int  # width of the tick counter
    start_ticks: int = 0  # counter at power-up

    def board_s(self, now_s: Seconds) -> Seconds:
        return (now_s - self.power_up_s) * (1.0 + self.drift_ppm * 1e-6)

    def true_s(self, board_s: Seconds) -> Seconds:
        return self.power_up_s + board_s / (1.0 + self.drift_ppm * 1e-6)

    def ticks(self, board_s: float) -> int:
        """Counter at a board time, wrapped."""
        return (self.start_ticks + math.floor(board_s / self.tick_s + _TICK_SLACK)) % (1 << self.bits)


class ScanSource(Protocol):
    """Source of the ADC's readings, see `sensor.Sensor`."""

    reacts: bool  # a controller may still change coming scans, which are then not read ahead

    def counts(self, first: int, time_s: NDArray[np.float64]) -> Readings:
        """Counts (n, channels) of scans ``first``, ... sampled at scene times `time_s` (n, channels)."""
        ...


@dataclass(frozen=True, slots=True)
class ScanTruth:
    """Truth about one scan instant."""

    index: int  # scan instants before this one since the first power-up; does not wrap or restart
    # sequence, boot: sequence number and boot count as on the wire
    sequence: int
    boot: int
    began_s: float  # true instant on the host's clock
    scene_s: float  # scene time of the scan
    sent: bool  # False where the board missed the instant (overrun)


class Scanning:
    """Sample scan k at board time ``epoch_board_s + k / rate_hz``, and its channels after their offsets.

    `begin_s` and `scene_start_s` are the true instants of the first scan and of scene time 0; offsets are
    board seconds.
    """

    def __init__(
        self,
        source: ScanSource,
        crystal: Crystal,
        offset_s: NDArray[np.float64],
        *,
        rate_hz: float,
        begin_s: float,
        scene_start_s: float,
    ) -> None:
        self._source = source
        self._crystal = crystal
        self._offset_s = offset_s
        self._span_s = float(offset_s.max())
        self._rate_hz = rate_hz
        self._epoch_board_s = crystal.board_s(begin_s)
        self._scene_start_s = scene_start_s
        self._k = 0
        self._ahead: Readings = np.empty((0, len(offset_s)), dtype=np.int64)
        self._n_ahead = 1 if source.reacts else _SCANS_AHEAD

    @property
    def begin_board_s(self) -> float:
        """Board time at which the coming scan begins."""
        return self._epoch_board_s + self._k / self._rate_hz

    @property
    def end_s(self) -> float:
        """True instant at which the coming scan has all its channels."""
        return self._crystal.true_s(self.begin_board_s + self._span_s)

    @property
    def scene_s(self) -> float:
        """Instant of scene time at which the coming scan begins."""
        return self._crystal.true_s(self.begin_board_s) - self._scene_start_s

    def take(self, index: int) -> Readings:
        """Sample the coming scan, which has number `index`, and go on to the next one."""
        if not len(self._ahead):
            k = self._k + np.arange(self._n_ahead)
            begin_board_s = self._epoch_board_s + k / self._rate_hz
            sampled_s = self._crystal.true_s(begin_board_s[:, None] + self._offset_s)
            self._ahead = self._source.counts(index, sampled_s - self._scene_start_s)
        counts: Readings = self._ahead[0]
        self._ahead = self._ahead[1:]
        self._k += 1
        return counts
