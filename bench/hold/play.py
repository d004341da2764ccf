"""Grasp controllers in simulated time: held objects, a detector and a controller for each, and the record."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bench.hold.batch import ALL_SLIDES, ARRAY, RATE_HZ, HeldBatch
from tactiled.array import FloatArray
from tactiled.client.subscriber import STALE_AFTER_S
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families.holding import LIFTED_S, START_N
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.events.codec import to_map
from tactiled.samples.block import regular_block

MOST_N = 40.0  # of a gripper
RESTART_S, DOWN_S = LIFTED_S + 0.1, 1.0
"""Scene time at which the daemon ends, with the object hanging freely, and time until another one reads."""
_BEFORE_S = 0.1
_TIGHTER = 1.05


class Controller(Protocol):
    """Grasp controller: a `grip` message and the present force to a command."""

    def take(self, message: Mapping[str, Any], present_n: float) -> float:
        """Return the force to command (N)."""
        ...

    def blind(self) -> float:
        """Return the force to command (N) while data are stale."""
        ...


def least_n(scene: Scene, time_s: FloatArray) -> FloatArray:
    """Return the grip that just bears the load at instants (n,) of scene time, by friction at rest."""
    state = SceneMotion(scene).at(time_s)
    friction = scene.surface.friction * scene.surface.static_ratio * state.friction_part
    return np.asarray(np.abs(state.pull_n) / friction)


@dataclass(frozen=True)
class GraspResult:
    """Outcome of one grasp."""

    event: str
    dropped: bool
    over_least: float  # mean grip over mean least grip while the object hangs freely; NaN where dropped
    slid_mm: float
    reaction_s: float  # as `reaction_s` returns it


@dataclass(frozen=True, eq=False)
class Episodes:
    """Record of played grasps, (scans, e) or (e,)."""

    scenes: Sequence[Scene]
    # grip_n, least_n (scans, e): grip, and the one that just bears the load by friction at rest
    grip_n: FloatArray
    least_n: FloatArray
    command_n: FloatArray  # (scans, e): after the scan
    slides: NDArray[np.bool_]  # (scans, e): true where all of the contact slips
    place_mm: FloatArray  # (scans, e): distance that the object has moved over the skin
    dropped: NDArray[np.bool_]  # (e,)

    def results(self) -> list[GraspResult]:
        """Return what is reported of each grasp."""
        hangs = slice(round(LIFTED_S * RATE_HZ), None)
        over_least = self.grip_n[hangs].mean(axis=0) / self.least_n[hangs].mean(axis=0)
        return [
            GraspResult(
                event=scene.description,
                dropped=bool(self.dropped[e]),
                over_least=float("nan") if self.dropped[e] else float(over_least[e]),
                slid_mm=float(self.place_mm[-1, e]),
                reaction_s=reaction_s(self.slides[:, e], self.command_n[:, e]),
            )
            for e, scene in enumerate(self.scenes)
        ]


def reaction_s(slides: NDArray[np.bool_], command_n: FloatArray) -> float:
    """Return the time from the first gross slip of a grasp to a command that is a twentieth higher.

    The command is compared with that of `_BEFORE_S` before, so that a command ahead of the slip is a time
    below zero. NaN without a gross slip, infinite without a reaction.
    """
    begins = np.flatnonzero(slides)
    if not len(begins):
        return float("nan")
    since = max(begins[0] - round(_BEFORE_S * RATE_HZ), 0)
    tighter = np.flatnonzero(command_n[since:] > _TIGHTER * command_n[since])
    return float(since + tighter[0] - begins[0]) / RATE_HZ if len(tighter) else float("inf")


def play(scenes: Sequence[Scene], controllers: Sequence[Controller], *, restarts: bool = False) -> Episodes:
    """Play grasps with a controller for each.

    A command is given one scan after the scan whose message causes it: line, detector and socket take 10 ms.
    The gripper's own delay follows.

    With `restarts`, the daemon is down from `RESTART_S` on for `DOWN_S`: there are no messages, the client
    says so after `STALE_AFTER_S`, and new detectors find the objects in the hand.
    """
    batch = HeldBatch(scenes)
    scan_s: FloatArray = np.arange(1, batch.n_scans + 1) / np.float64(RATE_HZ)
    down = range(round(RESTART_S * RATE_HZ), round((RESTART_S + DOWN_S) * RATE_HZ)) if restarts else range(0)
    stale = down[round(STALE_AFTER_S * RATE_HZ) :]
    shape = (batch.n_scans, len(scenes))
    grip_n, place_mm, command_n = (np.zeros(shape) for _ in range(3))
    slides = np.zeros(shape, dtype=np.bool_)
    command = np.full(len(scenes), START_N)
    batch.command(command)
    sent = command.copy()
    for scan in range(batch.n_scans):
        if scan in (0, down.stop):
            detectors = [build_suite(ARRAY, DetectParams(), topics=("grip",)) for _ in scenes]
        volts = batch.scan()
        grip_n[scan] = batch.grip_n
        place_mm[scan] = np.hypot(*batch.place_mm.T)
        for e in np.flatnonzero(~batch.has_fallen).tolist():
            if scan in stale:
                command[e] = controllers[e].blind()
            if scan in down:
                continue
            block = regular_block(volts[e : e + 1], RATE_HZ, start_s=scan / RATE_HZ, index=scan)
            for event in detectors[e].process(block):
                if event.topic == "grip":
                    message = to_map(event, seq=0, board="", unix_offset_s=0.0)
                    command[e] = controllers[e].take(message, float(batch.grip_n[e]))
        batch.command(sent)
        sent = command.copy()
        slides[scan] = (batch.sliding > ALL_SLIDES) & (batch.grip_n > 0)
        command_n[scan] = command
    least = np.stack([least_n(scene, scan_s) for scene in scenes], axis=1)
    return Episodes(scenes, grip_n, least, command_n, slides, place_mm, batch.has_fallen)
