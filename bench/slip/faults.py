"""What wires and bytes do to readings that are otherwise a quiet hold: streams that must raise no slip."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bench.slip.scenes import ADC_BITS, RATE_HZ, block_of
from tactiled.samples.block import Gap, ScanBlock

Counts = NDArray[np.int64]
Stream = list[ScanBlock | Gap]
Fault = Callable[[Counts, np.random.Generator], Stream]

_EVERY_S = 5.0  # mean time between faults
_TOP = 2**ADC_BITS - 1


def emi_spikes(counts: Counts, rng: np.random.Generator) -> Stream:
    """A spark beside the cable: some neighbouring channels of one scan jump, either way, by up to a volt."""
    struck, channels = counts.copy(), counts.shape[1]
    for scan in _instants(len(counts), rng):
        first, n = rng.integers(channels), rng.integers(1, 7)
        jump = rng.choice([-1, 1]) * rng.uniform(0.02, 0.35) * _TOP
        struck[scan, (first + np.arange(n)) % channels] += round(jump)
    return [block_of(np.clip(struck, 0, _TOP))]


def stuck_bits(counts: Counts, rng: np.random.Generator) -> Stream:
    """A bit of one channel reads 1 for a second or so."""
    struck = counts.copy()
    for scan in _instants(len(counts), rng):
        while_stuck = slice(scan, scan + int(rng.uniform(0.1, 2.0) * RATE_HZ))
        struck[while_stuck, rng.integers(counts.shape[1])] |= 1 << int(rng.integers(ADC_BITS))
    return [block_of(struck)]


def gaps(counts: Counts, rng: np.random.Generator) -> Stream:
    """Scans are lost: one, or up to half a second."""
    return _cut(counts, rng, lambda: Gap(int(np.exp(rng.uniform(0, np.log(50)))), "missing", 0))


def restarts(counts: Counts, rng: np.random.Generator) -> Stream:
    """The board reboots and counts anew: nobody knows how long it was away; here half a second."""
    return _cut(counts, rng, lambda: Gap(0, "restart", 0))


FAULTS: dict[str, Fault] = {
    "emi-spikes": emi_spikes,
    "stuck-bits": stuck_bits,
    "gaps": gaps,
    "restarts": restarts,
}


def _instants(n: int, rng: np.random.Generator) -> list[int]:
    """Scans at which something happens: a Poisson process, not in the first five seconds."""
    length_s = n / RATE_HZ - _EVERY_S
    times_s = _EVERY_S + rng.uniform(0, length_s, rng.poisson(length_s / _EVERY_S))
    return sorted((times_s * RATE_HZ).astype(int).tolist())


def _cut(counts: Counts, rng: np.random.Generator, cause: Callable[[], Gap]) -> Stream:
    whole, stream, start = block_of(counts), Stream(), 0
    for scan in _instants(len(counts), rng):
        gap = cause()
        if scan <= start:
            continue
        begin = scan + (gap.n_missing or round(0.5 * RATE_HZ))
        stream += [whole[start:scan], Gap(gap.n_missing, gap.cause, begin)]
        start = begin
    return [*stream, whole[start:]] if start < len(counts) else stream[:-1]
