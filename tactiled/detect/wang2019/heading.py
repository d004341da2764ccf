"""Detect a change of the slip's direction without a stop, from the shear response.

The summed pair response of a sliding contact points along the motion. When the motion turns, the response
follows within some tenths of a millimetre of travel, because friction drags the skin (Dahl's law in vector
form, ``ds/dL = (d - s) / L0`` for the state s after the travel L in the direction d). While a slip lasts, its
response is therefore compared with the slip's direction. Grooves, load and a stop change the length of the
response, not its direction.

A direction change is more than `turn_deg` for `_HELD_S`, after which the response has settled and not shrunk.
By Dahl's law it then moved from its old to its new value along a straight chord, as ``1 - exp(-(t - t0) /
tau)``. It passed 0.2 and 0.5 of the chord 0.223 and 0.693 tau after t0, which yields t0.

Smaller changes are not detected. At 0.1 mm/s some are mistaken for a stop; at lower speeds most are.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.signal.opposed_pairs import PairResponse, mean_response

# prior: a tap or a bump that pushes the skin aside is over sooner.
_HELD_S = 0.2
# prior: length of the recorded response. At 0.1 mm/s a skin needs half of it to reverse.
_TRACE_S = 5.0
# choice: angle still to turn, which is part of the stated standard deviation; a longer wait gains nothing.
_SETTLED_DEG = 3.0
# prior: growth of the response allowed in `_HELD_S`: the beginning of a reversal shrinks the response by
# more.
_SETTLED_PART = 0.2
# prior: part of the largest recorded response. A stop or a lift leaves less, and no direction.
_KEPT_PART = 0.5
# prior: part of the response that must have come since the slip began or last changed direction. Shear that
# remains from an earlier slide, under a false slip, is no change of direction.
_DRAGGED_PART = 0.1
# derived: exp overflows above 709, which high scan rates reach; nothing is left to turn then.
_LARGEST_EXPONENT = 700.0
# prior: parts of the chord: above the ripple of grooves, and where the curve is still steep
_EARLY, _LATE = 0.2, 0.5


class DirectionChange(NamedTuple):
    """A change of direction, seen from the newest scan.

    Attributes
    ----------
    delay_scans, delay_sd_scans : float
        Scans since it began.
    along : (2,) float64
        Unit vector of the new direction.
    direction_sd_deg : float
        Includes the angle still to turn: an exponential at its rate of change over `_HELD_S`.
    turned_deg : float
        Angle between old and new direction, 0 to 180.
    """

    delay_scans: float
    delay_sd_scans: float
    along: FloatArray
    direction_sd_deg: float
    turned_deg: float


class HeadingTracker:
    """Track the direction of a slip's shear response from scan to scan.

    Parameters
    ----------
    taxels : (taxels,) bool
        Taxels whose response is summed.
    rest_steps : (scans, channels) float64
        Readings of the contact without shear.
    before : (2,) float64
        Response before the slip. It differs from that at rest if the contact has slid already.
    along : (2,) float64
        Unit vector of the slip's direction.
    turn_deg : float
        Smallest change of direction that is reported.
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

    def follow(self, steps: FloatArray) -> DirectionChange | None:
        """Process one scan's readings (channels,), in grid steps; return a completed direction change."""
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
    def is_off_direction(self) -> bool:
        """True while the newest response deviates from the slip's direction, turning or not."""
        return self._n_turned > 0

    def _turn(self, trace: FloatArray, moved: FloatArray) -> DirectionChange | None:
        """Direction change at the end of a trace (n, 2), oldest first, if the response has settled there."""
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
        early, late = _last_crossing(part, _EARLY), _last_crossing(part, _LATE)
        # The part reaches q at -log(1 - q) tau after t0.
        since_early, since_late = -np.log(1 - _EARLY), -np.log(1 - _LATE)
        tau_scans = (late - early) / (since_late - since_early)
        drift_deg = np.ptp(_between_deg(now, trace[-self._held_scans :].T))
        held = min(self._held_scans / max(tau_scans, 1.0), _LARGEST_EXPONENT)
        left_deg = float(drift_deg / np.expm1(held))
        if left_deg > _SETTLED_DEG:
            return None
        along = now / sizes[-1]
        return DirectionChange(
            delay_scans=len(course) - 1 - (early - since_early * tau_scans),
            # Half a scan of rounding; a response that does not follow the law begins up to a fifth elsewhere.
            delay_sd_scans=float(np.hypot(0.5, (late - early) / 5)),
            along=along,
            direction_sd_deg=self._pairs.direction_sd_deg(moved, self._taxels, along, left_deg),
            turned_deg=float(np.abs(_between_deg(self._along, now))),
        )


def _between_deg(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angles from one vector to others (2, ...)."""
    return np.asarray(np.degrees(np.arctan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])))


def _last_crossing(part: FloatArray, level: float) -> float:
    """Position, between scans, where a series finally exceeded a level; 0 where it was never below."""
    below = int(np.flatnonzero(part < level)[-1]) if (part < level).any() else 0
    if below + 1 >= len(part):
        return float(below)
    return below + float((level - part[below]) / (part[below + 1] - part[below]))
