"""Serial line and USB adapter, sans-I/O: frames in when they are ready, bytes out when they arrive.

A byte takes ten bits. A frame is sent when it is ready and the line is free, and arrives whole with its last
bit. An adapter that bunches hands over the bytes that it has, parts of frames too, at multiples of its own
timer. During a stall nothing arrives, and then everything at once.
"""

import itertools
import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.emulator.line.faults import FaultCounts, FaultKind, FaultParams

# A good decoder can restore a frame that lost only its last byte, so a cut takes more.
_LEAST_CUT = 3


class Arrival(NamedTuple):
    """Bytes that the host can read from `arrival_s` on."""

    arrival_s: float
    data: bytes


class CableModel:
    """Line and adapter in the direction from board to host."""

    def __init__(self, baud: int, params: FaultParams, seed: int, counts: FaultCounts) -> None:
        self._byte_s = 10.0 / baud
        self._params = params
        self._rng = np.random.default_rng([seed, 3])
        self._counts = counts
        self._queue: deque[Arrival] = deque()
        self._busy_until_s = -math.inf
        self._not_before_s = -math.inf
        self._armed: list[FaultKind] = []
        self._noise_left = 0

    def arm(self, kind: FaultKind) -> None:
        """Damage the next frame: flip, drop, cut, duplicate, or burst (of noise on the next bytes)."""
        if kind == "burst":
            self._noise_left = self._params.burst_bytes
            self._counts.bursts += 1
        else:
            self._armed.append(kind)

    def stall(self, until_s: float) -> None:
        """Delay bytes that have not arrived yet until `until_s` at least."""
        self._not_before_s = max(self._not_before_s, until_s)

    def send(self, ready_s: float, frame: bytes) -> None:
        """Send a frame of the board; calls are in order of `ready_s`."""
        rng, params, armed = self._rng, self._params, self._armed
        self._armed = []
        # Drawn whether needed or not, so that one fault does not change the others.
        duplicate, cut = rng.random(2).tolist()
        is_twice = duplicate < params.duplicate_per_frame or "duplicate" in armed
        self._counts.frames_duplicated += is_twice
        self._transmit(ready_s, self._damaged(frame, cut < params.cut_per_frame, armed))
        if is_twice:
            self._transmit(ready_s, self._damaged(frame, False, []))

    def next_arrival_s(self) -> float:
        return max(self._queue[0].arrival_s, self._not_before_s) if self._queue else math.inf

    def arrivals(self, now_s: float) -> list[Arrival]:
        """Take the bytes that arrived by `now_s`; those of one instant are joined."""
        out: list[Arrival] = []
        while self._queue and (arrival_s := self.next_arrival_s()) <= now_s:
            data = self._queue.popleft().data
            if out and out[-1].arrival_s == arrival_s:
                data = out.pop().data + data
            out.append(Arrival(arrival_s, data))
        return out

    def pull_out(self) -> None:
        """Lose the bytes under way, as when the adapter is pulled out."""
        self._counts.bytes_pulled_out += sum(len(item.data) for item in self._queue)
        self._queue.clear()

    def _damaged(self, frame: bytes, cut: bool, armed: list[FaultKind]) -> bytes:
        counts, params = self._counts, self._params
        counts.frames_in += 1
        counts.bytes_in += len(frame)
        data = np.frombuffer(frame, np.uint8)
        if cut or "cut" in armed:
            kept = int(self._rng.integers(0, max(1, len(data) - _LEAST_CUT + 1)))
            counts.frames_cut += 1
            counts.bytes_cut += len(data) - kept
            data = data[:kept]
        mask = np.zeros(len(data), np.uint8)
        if params.flip_per_byte or "flip" in armed:
            flipped = self._chosen(len(data), params.flip_per_byte, "flip" in armed)
            mask[flipped] = 1 << self._rng.integers(0, 8, int(flipped.sum()))
            counts.bytes_flipped += int(flipped.sum())
        noisy = min(self._noise_left, len(data))
        if noisy:
            mask[:noisy] = self._rng.integers(1, 256, noisy)  # not 0, which would change nothing
            self._noise_left -= noisy
            counts.bytes_noise += noisy
        data = data ^ mask
        if params.drop_per_byte or "drop" in armed:
            dropped = self._chosen(len(data), params.drop_per_byte, "drop" in armed)
            counts.bytes_dropped += int(dropped.sum())
            data = data[~dropped]
        sent = data.tobytes()
        counts.frames_damaged += sent != frame
        return sent

    def _chosen(self, n: int, probability: float, at_least_one: bool) -> NDArray[np.bool_]:
        """Draw the bytes of n that a fault changes: (n,)."""
        chosen = self._rng.random(n) < probability
        if at_least_one and n:
            chosen[self._rng.integers(n)] = True
        return chosen

    def _transmit(self, ready_s: float, data: bytes) -> None:
        start_s = max(ready_s, self._busy_until_s)
        self._busy_until_s = end_s = start_s + len(data) * self._byte_s
        if not self._params.bunch_s:
            if data:
                self._queue.append(Arrival(end_s, data))
            return
        timer_s = self._params.bunch_s / (1.0 + self._params.adapter_ppm * 1e-6)
        done_s = start_s + np.arange(1, len(data) + 1) * self._byte_s
        bunch = np.ceil(done_s / timer_s)
        edges = [0, *(np.flatnonzero(np.diff(bunch)) + 1).tolist(), len(data)]
        for first, last in itertools.pairwise(edges):
            if last > first:
                self._queue.append(Arrival(float(bunch[first] * timer_s), data[first:last]))
