"""Messages to controllers in simulated time: of a detector, or of the truth behind it."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from bench.hold.batch import ALL_SLIDES, RATE_HZ, HeldBatch
from tactiled.array import FloatArray
from tactiled.detect.base import Detector
from tactiled.events.codec import to_map
from tactiled.samples.block import regular_block

Message = Mapping[str, Any]
_ZERO_S = 0.6  # of a contact, in which no detector's message is valid
_LEAST_USED = 0.05  # utilisation below which readings do not tell what they would be at the limit


class Messages(Protocol):
    """Source of messages about many grasps."""

    def of(self, e: int, scan: int, volts: FloatArray) -> Sequence[Message]:
        """Return the messages of a scan of grasp `e`, whose readings are `volts` (1, channels)."""
        ...


class DetectorMessages:
    """Messages of a topic from a detector for each grasp.

    Parameters
    ----------
    topic : str
        Slip events are rare: between them, a message has the time alone.
    """

    def __init__(self, batch: HeldBatch, make_detector: Callable[[], Detector], topic: str) -> None:
        self._detectors = [make_detector() for _ in batch.scenes]
        self._topic = topic

    def of(self, e: int, scan: int, volts: FloatArray) -> Sequence[Message]:
        """Return the messages of a scan of grasp `e`, whose readings are `volts` (1, channels)."""
        block = regular_block(volts, RATE_HZ, start_s=scan / RATE_HZ, index=scan)
        events = self._detectors[e].process(block)
        messages = [to_map(x, seq=0, board="", unix_offset_s=0.0) for x in events if x.topic == self._topic]
        return messages or ([{"timestamp": scan / RATE_HZ}] if self._topic == "slip" else [])


class TrueMessages:
    """Messages of a perfect contact model: forces, friction at rest and state of the scene."""

    def __init__(self, batch: HeldBatch) -> None:
        self._batch = batch

    def of(self, e: int, scan: int, _volts: FloatArray) -> Sequence[Message]:
        """Return the message of a scan of grasp `e`."""
        batch = self._batch
        load, shear = float(batch.grip_n[e]), batch.shear_n[e].tolist()
        friction = float(batch.friction[e])
        used = float(np.hypot(*shear)) / max(friction * load, 1e-9)
        slides = float(batch.sliding[e] > ALL_SLIDES)
        state = "none" if load <= 0 else "gross" if slides else "sticking"
        return [
            {
                "timestamp": scan / RATE_HZ,
                "load": load,
                "shear_x": shear[0],
                "shear_y": shear[1],
                "state": state,
            }
            | {"valid": scan >= _ZERO_S * RATE_HZ, "late": False}
            | dict.fromkeys(("friction", "friction_low", "friction_high"), friction)
            | dict.fromkeys(("utilisation", "utilisation_low", "utilisation_high"), used)
            | dict.fromkeys(("p_gross_50ms", "p_gross_100ms", "p_gross_300ms"), slides)
        ]


class TrueFriction(DetectorMessages):
    """Messages of a detector, but friction is known: the ratio of readings at which this object slips."""

    def __init__(self, batch: HeldBatch, make_detector: Callable[[], Detector]) -> None:
        super().__init__(batch, make_detector, "grip")
        self._batch = batch
        self._friction = np.full(len(batch.scenes), np.nan)

    def of(self, e: int, scan: int, volts: FloatArray) -> Sequence[Message]:
        """Return the messages of a scan of grasp `e`, whose readings are `volts` (1, channels)."""
        batch, told = self._batch, []
        for message in super().of(e, scan, volts):
            limit_n = float(batch.friction[e] * batch.grip_n[e])
            used = float(np.hypot(*batch.shear_n[e])) / max(limit_n, 1e-9)
            ratio = float(np.hypot(message["shear_x"], message["shear_y"])) / max(message["load"], 1e-9)
            if used > _LEAST_USED:
                self._friction[e] = ratio / used
            known = float(self._friction[e])
            names = ("friction", "friction_low", "friction_high") if np.isfinite(known) else ()
            told.append({**message, **dict.fromkeys(names, known)})
        return told
