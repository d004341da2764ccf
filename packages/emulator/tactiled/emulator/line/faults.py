"""Faults between the board and the host, and their counts.

Faults of bytes (flip, drop, cut, duplicate) have a probability each; faults in time (stall, burst, reboot,
unplug, overrun) are Poisson processes; any of them can also be set for an instant. All are drawn from one
seed in the order of frames and of time, so that chunking changes nothing.
"""

import heapq
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from tactiled.tomlfile import Params

FaultKind = Literal["flip", "drop", "cut", "duplicate", "burst", "stall", "overrun", "reboot", "unplug"]
_TIMED: tuple[FaultKind, ...] = ("burst", "stall", "overrun", "reboot", "unplug")


class FaultAt(Params):
    """One fault at one instant; a fault of a frame changes the next frame sent."""

    kind: FaultKind
    at_s: float = Field(ge=0, description="seconds after the emulator's power-up")


class FaultParams(Params):
    """Faults of the line and of the board; by default there are none."""

    flip_per_byte: float = Field(default=0.0, ge=0, le=1, description="one bit of a byte is inverted")
    drop_per_byte: float = Field(default=0.0, ge=0, le=1, description="a byte is lost")
    cut_per_frame: float = Field(default=0.0, ge=0, le=1, description="a frame ends early")
    duplicate_per_frame: float = Field(default=0.0, ge=0, le=1, description="a frame is sent twice")
    burst_per_s: float = Field(default=0.0, ge=0, le=100, description="noise replaces the next bytes")
    burst_bytes: int = Field(default=40, ge=1)
    stall_per_s: float = Field(default=0.0, ge=0, le=100, description="nothing arrives, then all at once")
    stall_s: float = Field(default=0.5, gt=0)
    overrun_per_s: float = Field(default=0.0, ge=0, le=100, description="the board misses a scan instant")
    reboot_per_s: float = Field(default=0.0, ge=0, le=10, description="the board resets")
    unplug_per_s: float = Field(default=0.0, ge=0, le=10, description="the port vanishes, the board runs on")
    unplug_s: float = Field(default=1.0, gt=0)
    bunch_s: float = Field(
        default=0.0, ge=0, le=1, description="adapter hands over at multiples of this: FTDI's timer is 0.016"
    )
    adapter_ppm: float = Field(default=0.0, ge=-10000, le=10000, description="drift of the adapter's timer")
    at: list[FaultAt] = []


@dataclass
class FaultCounts:
    """Counts of the faults that happened.

    ``frames_in`` and ``bytes_in`` were sent on the line, each copy of a duplicate included, before damage;
    ``bytes_in == bytes_cut + bytes_dropped + bytes_pulled_out + bytes that arrive``. ``overruns`` are scan
    instants that the board missed.
    """

    frames_in: int = 0
    frames_duplicated: int = 0
    frames_cut: int = 0
    frames_damaged: int = 0
    frames_unplugged: int = 0
    bytes_in: int = 0
    bytes_flipped: int = 0
    bytes_dropped: int = 0
    bytes_cut: int = 0
    bytes_noise: int = 0
    bytes_pulled_out: int = 0
    bursts: int = 0
    stalls: int = 0
    overruns: int = 0
    reboots: int = 0
    unplugs: int = 0


class FaultPlan:
    """Instants of the faults in time, in order; `power_up_s` is the one that ``at_s`` counts from."""

    def __init__(self, params: FaultParams, seed: int, power_up_s: float) -> None:
        self._rates = {kind: float(getattr(params, f"{kind}_per_s")) for kind in _TIMED}
        # One generator for each kind, so that one fault more in a run does not change the others.
        self._rngs = {kind: np.random.default_rng([seed, 2, k]) for k, kind in enumerate(_TIMED)}
        self._heap: list[tuple[float, FaultKind, bool]] = [
            (power_up_s + fault.at_s, fault.kind, False) for fault in params.at
        ]
        heapq.heapify(self._heap)
        for kind in _TIMED:
            self._draw(kind, power_up_s)

    def next_s(self) -> float:
        """Instant of the next fault; infinity where there is none."""
        return self._heap[0][0] if self._heap else float("inf")

    def pop(self) -> FaultKind:
        """Take the next fault, and draw the one after it."""
        at_s, kind, is_drawn = heapq.heappop(self._heap)
        if is_drawn:
            self._draw(kind, at_s)
        return kind

    def _draw(self, kind: FaultKind, after_s: float) -> None:
        if rate := self._rates[kind]:
            wait_s = float(self._rngs[kind].exponential(1.0 / rate))
            heapq.heappush(self._heap, (after_s + wait_s, kind, True))
