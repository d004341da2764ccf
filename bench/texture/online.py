"""The online joint estimator on signals whose slip is known: no slip detector stands between."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.texture.bound import FloatArray
from bench.texture.signal import RATE_HZ
from tactiled.array import Array
from tactiled.detect.grooves.estimator import JointParams, JointTexture
from tactiled.events.types import SlipEvent, TextureEvent
from tactiled.samples.block import regular_block

DIRECTION_SD_DEG = 1.5  # what the slip detector states


def slip_at(time_s: float, direction_deg: float, direction_sd_deg: float = 0.0) -> SlipEvent:
    """Onset of a gross slip, detected when it happened."""
    return SlipEvent(
        time_s=time_s,
        state="onset",
        kind="gross",
        onset_s=time_s,
        onset_sd_s=0.0,
        direction_deg=direction_deg,
        direction_sd_deg=direction_sd_deg,
        confidence=1.0,
        taxels=(),
        detector="truth",
        statistic=0.0,
        threshold=0.0,
        valid=True,
        detected_s=time_s,
    )


def answers(
    array: Array,
    params: JointParams,
    volts: FloatArray,
    offset_s: FloatArray,
    slip: SlipEvent,
    *,
    valid: NDArray[np.bool_] | None = None,
    given_mm_s: Sequence[tuple[int, float]] = (),
    start_s: float = 0.0,
    block_scans: int = 10,
) -> Iterator[TextureEvent]:
    """Everything said about a stretch of scans, as it is said, in blocks as they would come live.

    Parameters
    ----------
    given_mm_s : sequence of (scan, mm/s)
        Speeds told, from which scan on.
    """
    estimator = JointTexture(array, params)
    for scan, speed_mm_s in given_mm_s:
        estimator.set_speed(speed_mm_s, scan)
    block = regular_block(volts, RATE_HZ, start_s=start_s, channel_offset_s=offset_s, valid=valid)
    detected = round((slip.detected_s - start_s) * RATE_HZ)
    for first in range(0, len(block), block_scans):
        part = block[first : first + block_scans]
        slips = [slip] if first <= detected < first + len(part) else []
        yield from (e for e in estimator.process(part, slips) if isinstance(e, TextureEvent))
