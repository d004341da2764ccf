"""Faults of wires and bytes on a quiet hold: streams that must not raise a slip."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.slip.scenes import ADC_BITS, RATE_HZ, block_of
from tactiled.events.types import SlipEvent
from tactiled.samples.block import Gap, ScanBlock

Counts = NDArray[np.int64]
Stream = list[ScanBlock | Gap]
Fault = Callable[[Counts, np.random.Generator], Stream]

HOLD = "persistent-contact"  # family that faults are added to
_EVERY_S = 5.0  # mean time between faults
_TOP = 2**ADC_BITS - 1
_RESTART_S = 0.5  # absence of the board in a restart, which the gap does not state


@dataclass(frozen=True, eq=False)
class FaultEvents:
    """Slip events of one hold, by setting or name of another detector."""

    fault: str
    stream: Stream
    by_name: Mapping[str, Sequence[SlipEvent]]

    @property
    def duration_s(self) -> float:
        """Length of the scans without the gaps."""
        return sum(len(item) for item in self.stream if isinstance(item, ScanBlock)) / RATE_HZ


def no_fault(counts: Counts, _rng: np.random.Generator) -> Stream:
    """Leave the hold as it is."""
    return [block_of(counts)]


def emi_spikes(counts: Counts, rng: np.random.Generator) -> Stream:
    """Let some neighbouring channels of one scan jump, up or down, by up to a volt: a spark."""
    struck, channels = counts.copy(), counts.shape[1]
    for scan in _instants(len(counts), rng):
        first, n = rng.integers(channels), rng.integers(1, 7)
        jump = rng.choice([-1, 1]) * rng.uniform(0.02, 0.35) * _TOP
        struck[scan, (first + np.arange(n)) % channels] += round(jump)
    return [block_of(np.clip(struck, 0, _TOP))]


def stuck_bits(counts: Counts, rng: np.random.Generator) -> Stream:
    """Let a bit of one channel read 1 for 0.1 to 2 s."""
    struck = counts.copy()
    for scan in _instants(len(counts), rng):
        while_stuck = slice(scan, scan + int(rng.uniform(0.1, 2.0) * RATE_HZ))
        struck[while_stuck, rng.integers(counts.shape[1])] |= 1 << int(rng.integers(ADC_BITS))
    return [block_of(struck)]


def gaps(counts: Counts, rng: np.random.Generator) -> Stream:
    """Lose 1 to 50 scans at a time."""
    return _cut(counts, rng, lambda: Gap(int(np.exp(rng.uniform(0, np.log(50)))), "missing", 0))


def restarts(counts: Counts, rng: np.random.Generator) -> Stream:
    """Restart the board, which then counts from 0."""
    return _cut(counts, rng, lambda: Gap(0, "restart", 0))


FAULTS: dict[str, Fault] = {
    "emi-spikes": emi_spikes,
    "stuck-bits": stuck_bits,
    "gaps": gaps,
    "restarts": restarts,
}


def _instants(n: int, rng: np.random.Generator) -> list[int]:
    """Scans with a fault: a Poisson process, after the first five seconds."""
    length_s = n / RATE_HZ - _EVERY_S
    times_s = _EVERY_S + rng.uniform(0, length_s, rng.poisson(length_s / _EVERY_S))
    return sorted((times_s * RATE_HZ).astype(int).tolist())


def _cut(counts: Counts, rng: np.random.Generator, new_gap: Callable[[], Gap]) -> Stream:
    whole, stream, start = block_of(counts), Stream(), 0
    for scan in _instants(len(counts), rng):
        gap = new_gap()
        if scan <= start:
            continue
        after = scan + (gap.n_missing or round(_RESTART_S * RATE_HZ))
        stream += [whole[start:scan], Gap(gap.n_missing, gap.cause, after)]
        start = after
    return [*stream, whole[start:]] if start < len(counts) else stream[:-1]
