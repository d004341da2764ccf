"""Which way a slip goes on: a turn without a stop, seen in the shear response.

The summed pair response of a sliding contact points along the motion. When the motion turns, the response
turns with it within some tenths of a millimetre of travel: friction drags the skin round (Dahl's law in its
vector form, ``ds/dL = (d - s) / L0`` for the state s along the way L in direction d). So while a slip lasts
its response is compared with the slip's direction; grooves, load and a stop change its length, not its
direction.

A turn is more than `turn_deg` for `_HELD_S`, in which the response has settled and not shrunk. By the law it
then went from what it was to what it is along a straight chord, as ``1 - exp(-(t - t0) / tau)``: it passed
0.2 and 0.5 of the chord 0.223 and 0.693 tau after t0, which gives t0 back.

Smaller turns are not seen. At 0.1 mm/s some are taken for a stop, below it most.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.signal.pairs import PairResponse, mean_response

_HELD_S = 0.2  # a tap or a bump that shoves the skin aside is over sooner
_TRACE_S = 5.0  # at 0.1 mm/s a skin needs the half of it to turn over
_SETTLED_DEG = 3.0  # what may be left of the turn, and goes into its sigma; waiting longer makes it no truer
_SETTLED_PART = 0.2  # by which the response may grow in `_HELD_S`: a reversal that begins shrinks it by more
_KEPT_PART = 0.5  # of the largest response in the trace: a stop or a lift leaves less, and no direction
# Least part of the response that has come since the slip began, or turned last. Shear that is left of a slide
# before, under a slip said in error, is no turn.
_DRAGGED_PART = 0.1
_LARGEST_EXPONENT = 700.0  # exp overflows above 709, which fast scans reach: nothing is left of the turn then
_EARLY, _LATE = 0.2, 0.5  # parts of the chord: above the ripple of grooves, and where it is still steep


class Turn(NamedTuple):
    """A turn, seen from the newest scan.

    Attributes
    ----------
    delay_scans, delay_sd_scans : float
        How far back it began.
    along : (2,) float64
        Unit vector of the new direction.
    direction_sd_deg : float
        With what is left of the turn: an exponential that still turned by so much in `_HELD_S`.
    turned_deg : float
        Between the old direction and the new, 0 to 180.
    """

    delay_scans: float
    delay_sd_scans: float
    along: FloatArray
    direction_sd_deg: float
    turned_deg: float


class Heading:
    """Direction of a slip's response from scan to scan.

    Parameters
    ----------
    pairs : PairResponse
    taxels : (taxels,) bool
        Those whose response it is.
    rest_steps : (scans, channels) float64
        Readings of the contact without shear.
    before : (2,) float64
        Response before the slip, which is not that at rest if the contact has slid already.
    along : (2,) float64
        Unit vector of the slip's direction.
    turn_deg : float
        Least turn.
    rate_hz : float
    """

    def __init__(
        self,
        pairs: PairResponse,
        taxels: NDArray[np.bool_],
        rest_steps: FloatArray,
        before: FloatArray,
        along: FloatArray,
        turn_deg: float,
        rate_hz: float,
    ) -> None:
        self.turn_deg = turn_deg
        self._pairs, self._taxels, self._along = pairs, taxels, along
        self._weights = pairs.motion_weights(taxels)
        self._rest_steps = rest_steps.mean(axis=0)
        self._rest = mean_response(self._weights, rest_steps)
        self._begin = before - self._rest
        self._least_cos = float(np.cos(np.radians(turn_deg)))
        self._held_scans = max(3, round(_HELD_S * rate_hz))
        self._ring = np.zeros((self._held_scans * round(_TRACE_S / _HELD_S), 2))
        self._n_seen = 0
        self._n_turned = 0

    def follow(self, steps: FloatArray) -> Turn | None:
        """Take in one scan's readings (channels,), as grid steps; the turn that it completes."""
        response = self._weights @ steps - self._rest
        self._ring[self._n_seen % len(self._ring)] = response
        self._n_seen += 1
        has_turned = response @ self._along < self._least_cos * np.hypot(*response)
        self._n_turned = self._n_turned + 1 if has_turned else 0
        if self._n_turned < self._held_scans:
            return None
        trace = np.roll(self._ring, -self._n_seen, axis=0)[-min(self._n_seen, len(self._ring)) :]
        turn = self._turn(trace, steps - self._rest_steps)
        if turn is not None:
            self._begin, self._along, self._n_turned = response, turn.along, 0
        return turn

    @property
    def is_off(self) -> bool:
        """Whether the newest response is off the slip's direction, be it a turn or not."""
        return self._n_turned > 0

    def _turn(self, trace: FloatArray, moved: FloatArray) -> Turn | None:
        """The turn at the end of a trace (n, 2), oldest first, if the response has come to rest there."""
        sizes = np.hypot(*trace.T)
        held = sizes[-self._held_scans :]
        if held.min() < max(_KEPT_PART * sizes.max(), (1 - _SETTLED_PART) * held.max()):
            return None
        now = trace[-1]
        if (now - self._begin) @ now < _DRAGGED_PART * float(now @ now):
            return None
        course = trace[int(np.argmax(trace @ self._along)) :]
        chord = now - course[0]
        part = (course - course[0]) @ chord / max(float(chord @ chord), 1.0)
        early, late = _passed(part, _EARLY), _passed(part, _LATE)
        # -log(1 - q) tau after t0 the part is q.
        since_early, since_late = -np.log(1 - _EARLY), -np.log(1 - _LATE)
        tau_scans = (late - early) / (since_late - since_early)
        drift_deg = np.ptp(_between_deg(now, trace[-self._held_scans :].T))
        held = min(self._held_scans / max(tau_scans, 1.0), _LARGEST_EXPONENT)
        left_deg = float(drift_deg / np.expm1(held))
        if left_deg > _SETTLED_DEG:
            return None
        along = now / sizes[-1]
        return Turn(
            delay_scans=len(course) - 1 - (early - since_early * tau_scans),
            # Anywhere between two scans; a response that does not rise by the law begins a fifth elsewhere.
            delay_sd_scans=float(np.hypot(0.5, (late - early) / 5)),
            along=along,
            direction_sd_deg=self._pairs.direction_sd_deg(moved, self._taxels, along, left_deg),
            turned_deg=float(np.abs(_between_deg(self._along, now))),
        )


def _between_deg(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle from a vector to others (2, ...)."""
    return np.asarray(np.degrees(np.arctan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])))


def _passed(part: FloatArray, level: float) -> float:
    """Where a series rose through a level for good, between scans; 0 where it never was below."""
    below = int(np.flatnonzero(part < level)[-1]) if (part < level).any() else 0
    if below + 1 >= len(part):
        return float(below)
    return below + float((level - part[below]) / (part[below + 1] - part[below]))
