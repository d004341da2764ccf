"""``tactiled calibrate --guide``: record scans of a running daemon, and say which way to press next.

How well a fit will know a sensitivity depends on which loads occurred, not on what the force sensor reads.
The guide keeps the information of a linear map of the readings, and asks for the motion whose sensitivity
would be known least.
"""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tactiled.array import Array, FloatArray
from tactiled.client.subscriber import Subscription
from tactiled.errors import ConfigError, DataError
from tactiled.scan_log import LiveScans, start_zero

GOOD, TAXEL_GOOD = 0.05, 0.15
"""Relative standard deviations of a sensitivity, and of one taxel's, at which no more is asked for."""
_PRIOR = 0.5  # relative standard deviation of a sensitivity before any press
_ERROR = 0.003  # of the largest response: what a fit leaves over a second (docs/force.md)
_LEAST_NOISES = 20.0  # a response below so many standard deviations of the noise is none
_QUIET_SCANS = 20  # of the beginning, whose spread is the noise
_LOOK_S = 1.0  # between two looks at what is lacking
_LEAST_S = 15.0  # even if all is well before: creep takes seconds to show


@dataclass(frozen=True)
class Advice:
    """Next motion, and how well each sensitivity would be known now."""

    motion: str  # empty where nothing is lacking
    sd: dict[str, float]  # relative standard deviations: "normal", "shear x", "shear y", "taxel 0", ...


class Guide:
    """Information about the sensitivities of an array, updated with each second of scans.

    `DataError` where the array has no channel whose kind is known to respond to pressure or shear.
    """

    def __init__(self, array: Array) -> None:
        self._array = array
        normal, (shear_x, shear_y) = array.normal_weights(), array.shear_weights()
        patterns = {
            name: rows.sum(axis=0)
            for name, rows in (("normal", normal), ("shear x", shear_x), ("shear y", shear_y))
        }
        if array.n_taxels > 1:
            patterns |= {f"taxel {taxel}": row for taxel, row in enumerate(normal)}
        patterns = {name: row / np.linalg.norm(row) for name, row in patterns.items() if row.any()}
        if not patterns:
            raise DataError(f"array {array.name} has no channels of a known kind: nothing can be asked for")
        self._names, self._patterns = list(patterns), np.array(list(patterns.values()))
        self._information = np.zeros((array.n_channels, array.n_channels))
        self._largest = np.zeros(len(patterns))
        self._smallest = np.zeros(len(patterns))
        self._zero: FloatArray | None = None
        self._noise = 0.0

    def add(self, readings: FloatArray) -> None:
        """Take the scans (n, channels) of about a second; NaN where missing."""
        if self._zero is None:
            first = readings[:_QUIET_SCANS]
            self._zero = start_zero(np.zeros(len(first)), first, self._array)
            change = np.diff(np.nan_to_num(first - self._zero), axis=0)
            self._noise = float(np.median(change.std(axis=0)) / np.sqrt(2)) if len(change) > 1 else 0.0
        relative = np.nan_to_num(readings - self._zero)
        # Neighbouring scans are nearly the same: a second counts as one look at each of its directions.
        self._information += relative.T @ relative / max(len(relative), 1)
        responses = relative @ self._patterns.T
        self._largest = np.maximum(self._largest, responses.max(axis=0))
        self._smallest = np.minimum(self._smallest, responses.min(axis=0))

    def advice(self) -> Advice:
        """Return the motion to add next."""
        span = np.maximum(self._largest, -self._smallest)
        least = _LEAST_NOISES * max(self._noise, 1e-6 * (self._array.high - self._array.low))
        error = max(_ERROR * float(span.max()), least / _LEAST_NOISES)
        precision = self._information / error**2 + np.eye(len(self._information)) / _PRIOR**2
        variances = np.einsum("pi,ip->p", self._patterns, cho_solve(cho_factor(precision), self._patterns.T))
        sds = np.where(span < least, _PRIOR, np.sqrt(np.maximum(variances, 0.0)))
        is_taxel = np.array([name.startswith("taxel") for name in self._names])
        over = sds / np.where(is_taxel, TAXEL_GOOD, GOOD)
        sd = dict(zip(self._names, sds.tolist(), strict=True))
        lacking = over > 1.0
        if not lacking.any():
            return Advice("", sd)
        # A taxel that was left out makes every sum uncertain, so it comes before sums that did occur.
        never, taxels = lacking & ~is_taxel & (span < least), lacking & is_taxel
        asked = next(some for some in (never, taxels, lacking) if some.any())
        return Advice(self._motion(int(np.argmax(np.where(asked, over, 0.0)))), sd)

    def _motion(self, pattern: int) -> str:
        """Words for the person who presses."""
        name = self._names[pattern]
        if name == "normal":
            return "press hard, and let go, at several places"
        if name.startswith("shear"):
            # The response is to motion of the skin, which is opposite to the force.
            sign = "-" if -self._smallest[pattern] > self._largest[pattern] else "+"
            return f"press, and push sideways along {sign}{name[-1]} and back"
        taxel = int(name.split()[1])
        place = ""
        if self._array.has_places:
            place = f" at x = {self._array.x_mm[taxel]:g} mm, y = {self._array.y_mm[taxel]:g} mm"
        return f"press with a finger tip on taxel {taxel}{place}"


class GuidedLog(NamedTuple):
    """What was recorded."""

    scans: int
    duration_s: float
    lacking: str  # motion that is still lacking; empty where every sensitivity can be known


def record_guided(
    log: Path,
    endpoint: str,
    array: str | None,
    keys: Path | None,
    most_s: float,
    report: Callable[[str], None],
    board: str = "",
) -> GuidedLog:
    """Record until every sensitivity can be known, or for `most_s`, and write the scans.

    The npz file `log` is for `tactiled calibrate LOG --reference ...`; its times are epoch seconds. `array`
    is the file of one that is not shipped. `report` gets lines for the person who presses. Without `board`,
    the first one of the daemon is taken. `DataError` or `ConfigError` where there is no daemon, no board or
    no scan, or the array is not known here.
    """
    if log.suffix != ".npz" or not log.parent.is_dir() or not os.access(log.parent, os.W_OK):
        raise ConfigError("command line", [f"{log}: name an .npz in a folder that exists and may be written"])
    with Subscription(endpoint, ("scan", "info"), board=board or None, keys=keys) as subscription:
        scans = LiveScans(subscription, endpoint, array, report)
        guide = Guide(scans.array)
        report("Start the record of the force sensor now. Let nothing touch the array for the first second.")
        said, is_good, seen = "", False, 0
        began_s = time.monotonic()
        while not is_good and time.monotonic() - began_s < most_s:
            scans.listen(_LOOK_S)
            if len(scans.readings) > seen:
                guide.add(np.array(scans.readings[seen:]))
                seen = len(scans.readings)
            advice = guide.advice()
            elapsed_s = time.monotonic() - began_s
            is_good = not advice.motion and elapsed_s >= _LEAST_S
            motion = advice.motion or "go on pressing"
            if motion != said and not is_good:
                report(f"{elapsed_s:4.0f} s  {motion} (now {100 * max(advice.sd.values()):.0f} %)")
                said = motion
    recorded = scans.log()
    try:
        np.savez_compressed(log, time_s=recorded.time_s, volts=recorded.readings)
    except OSError as error:
        raise DataError(f"{log}: cannot be written: {error.strerror}") from None
    lacking = f"; still lacking: {advice.motion}" if advice.motion else ""
    report(f"{log}: {len(recorded.time_s)} scans{lacking}. Stop the record of the force sensor.")
    duration_s = float(recorded.time_s[-1] - recorded.time_s[0])
    return GuidedLog(len(recorded.time_s), duration_s, advice.motion)
