"""Controller of a grasp: as little force as is safe, from `grip` messages alone.

Pure: a message and the force that the gripper exerts go in, the force to command comes out. Times are those
of the messages, so that it serves with asyncio as without.

Assumptions; check them for your hand:

- The gripper takes a force in newtons, tells the force that it exerts now, and follows within 50 ms.
- The fingers press for 0.6 s before they lift: in this time the sensor's zero in shear is measured.
- The object's weight is carried by the sensorised finger and an equal one opposite.
- Load readings are about proportional to the force. They may be in any unit.

A controller is for one grasp with one board: make a new one for the next grasp.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple, get_args

from tactiled.events.types import GripState

# Set on emulated grasps (`./run bench hold`, seeds from 500); docs/hold.md has what they give on others.
PRESS_S = 0.6  # from touch: the grip is kept, so that the shear that pressing alone makes can be told
TARGET = 0.9  # utilisation (95 % quantile) at which an object is held
_SURELY = 0.87  # of the median of friction, that the bound is at most
_FORGET_PER_S = 0.01  # rate at which the friction bound is lost: surfaces get wet
_RENEW_PER_S, _GREW = 0.3, 1.02  # the same while shear has grown so within _REST_S, which is new evidence
_LEAD_S = 0.08  # growing shear is extrapolated so far: sensing, a gripper's delay and its travel
_LEAD_MOST = 0.5  # of the shear, that is added so at most: jerks end
_GROWTH_S = 0.03  # over which the growth of shear is measured
_GROWS = 0.08  # of the shear, by which it is extrapolated where it clearly grows
_LEAST = 0.05  # of the load: less shear is no object in the air
# Signs of slip in shear, load and force: an object that sticks keeps its shear, whatever the grip does.
_DROP, _DROP_PER_S = 0.03, 1.0  # shear falls by so much, and so fast: sliding friction is less
_FLAT_PER_S = 1.0  # and then falls more slowly: an even fall, however fast, never meets both
_FLAT_S = 0.009  # over this time: a scan at 100 Hz, several of faster boards
_DROP_S, _PEAK = 0.035, 0.93  # within this time, from so much of its largest value
_TIGHTENED = 0.5  # of the growth of the load, by which readings of shear may fall on their own
_REST_S = 0.6  # of messages that are kept
_FOLLOWS, _FOLLOW_S = 0.6, 0.2  # of a change of force in this time, that shear follows only while it slides
_FOLLOWS_ON = 0.25  # the same after a drop of the shear: friction may fall on
_CHANGED = 0.03  # of the force: least such change, tighter within _WATCH_S of a drop, eased at other times
_WATCH_S, _PLATEAU_S, _PLATEAU = 0.3, 0.15, 1.03  # eased: shear was not above its least before by more
_WEAKER = 0.7  # of the friction bound, that is left of it after a slip at least
_DENIED = 0.4  # of the friction bound of a message: less is not believed of a slip that its state denies
_RECOVER_PER_S = 0.05  # rate at which the ratio of the last slip is forgotten
GRASP_AGAIN, _GRASP_MOST = 1.4, 1.7  # times the present force while all slides; times that before the slip
_CALM_S, _CALM_AFTER_SLIP_S = 0.1, 0.3  # without growth of shear or slip, before the grip is eased
_CALM_AFTER_STALE_S = 1.0  # from the first message on, after stale data
_EASE_PER_S = 4.0  # rate at which the grip in excess is eased
_STEADY, _STEADY_S = 0.03, 0.1  # a grip that has changed by less than this part for this time is steady
_UNSTEADY = 1.2  # newtons over readings of a changing grip, over those of a steady one, at most
GONE_S = 0.2  # without contact after a valid `none`: the object has left the hand
_STATES = frozenset(get_args(GripState))
_MOST = 1e50  # numbers beyond, and loads below its inverse, are no readings: quotients stay finite
BLIND = 1.3  # times the grip that was wanted last, while tactile data are stale


class _Seen(NamedTuple):
    """Time, shear and load of a message, and the gripper's force."""

    at_s: float
    shear: float
    load: float
    force_n: float


def _is_usable(grip: Mapping[str, Any]) -> bool:
    """Return True where each field that is used has a possible value; friction is of a contact alone."""
    try:
        is_typed = (
            isinstance(grip["valid"], bool) and isinstance(grip["late"], bool) and grip["state"] in _STATES
        )
        numbers = (grip[name] for name in ("timestamp", "shear_x", "shear_y", "load"))
        if not is_typed or not all(abs(number) < _MOST for number in numbers):
            return False
        if grip["state"] == "none":
            return True
        return all(1 / _MOST < grip[name] < _MOST for name in ("friction_low", "friction"))
    except (KeyError, TypeError):
        return False


class GripController:
    """Compute the force to grip with. Messages that are not as the schema says are passed over.

    So are messages of another board than that of the contact. A present force that is not above 0, or not
    finite, is no reading of a hand that holds: the force is then inferred from the load.

    Parameters
    ----------
    target : float
        Highest utilisation (95 % quantile) that is left as it is.
    start_n, least_n, most_n : float
        Grip before the object's weight is felt, and the limits of the grip.

    Raises
    ------
    ValueError
        A number is not finite, or the limits are not in order.

    Attributes
    ----------
    command_n : float
        Newest force to command.

    Examples
    --------
    >>> controller = GripController(start_n=6.0)
    >>> controller.blind()  # nothing was felt yet: the grip stays
    6.0
    """

    def __init__(
        self, target: float = TARGET, start_n: float = 6.0, least_n: float = 1.0, most_n: float = 40.0
    ) -> None:
        if not (0 < target < math.inf and 0 <= least_n <= most_n < math.inf and math.isfinite(start_n)):
            raise ValueError(
                f"target {target}, start_n {start_n}, least_n {least_n}, most_n {most_n}: "
                "wanted are finite numbers with target > 0 and 0 <= least_n <= most_n"
            )
        self._target, self._least_n, self._most_n = target, least_n, most_n
        self.command_n = self._limited(start_n)
        self._wanted_n = 0.0  # by the newest message of a contact
        self._new_object()

    def _new_object(self) -> None:
        """Begin with another object."""
        self._board = ""  # of the contact; empty until a board has said its name
        self._friction = 0.0  # shear over load that is borne with 95 %, in units of the readings
        self._slid_ratio = math.inf  # shear over load at the last slip
        self._slides = False
        # Most force in a contact whose beginning nobody saw: shear that pressing makes grows with the grip.
        self._most_unseen_n = math.inf
        self._past: deque[_Seen] = deque()
        self._touched_s = math.inf
        self._contact_s = -math.inf  # newest message of a contact
        self._left_s = math.inf  # when a valid `none` ended the contact
        self._calm_from_s = 0.0
        self._dropped_s = -math.inf
        self._before_slip_n = self.command_n
        self._level_n = self._newtons_per_reading = self._steady_from_s = 0.0

    def take(self, grip: Mapping[str, Any], present_n: float) -> float:
        """Return the force to command (N), from a `grip` message and the force exerted now."""
        if not _is_usable(grip):
            return self.command_n
        board = str(grip.get("board", ""))
        if "" not in (board, self._board) and board != self._board:
            return self.command_n
        if grip["timestamp"] < self._contact_s:
            self._shift_times(self._contact_s - grip["timestamp"])
        if grip["state"] == "none":
            # A gap in the scans ends a contact, too, and is not valid: the hand holds what it held.
            if grip["valid"]:
                self._left_s, self._wanted_n = grip["timestamp"], 0.0
            return self.command_n
        if grip["timestamp"] > self._left_s + GONE_S:
            self._new_object()
        self._left_s, self._board = math.inf, self._board or board
        self._contact_s = grip["timestamp"]
        self._touched_s = min(self._touched_s, grip["timestamp"])
        # An incipient slip makes the state partial, also of a contact whose beginning nobody saw.
        if grip["state"] not in ("unknown", "partial"):
            self._most_unseen_n = math.inf
        elif grip["state"] == "unknown" and grip["valid"] and self._most_unseen_n == math.inf:
            self._most_unseen_n = _GRASP_MOST * self.command_n
        presses = grip["timestamp"] < self._touched_s + PRESS_S
        if presses or not grip["valid"] or grip["late"] or grip["load"] < 1 / _MOST:
            return self.command_n
        try:
            present_n = float(present_n)  # also of numpy
        except (TypeError, ValueError, OverflowError):
            present_n = math.nan
        if not 1 / _MOST < present_n < _MOST:
            present_n = self._newtons_per_reading * grip["load"] or self.command_n
        # Not hypot, whose last bit differs from that of C++.
        x, y = grip["shear_x"], grip["shear_y"]
        shear = math.sqrt(x * x + y * y)
        now = _Seen(grip["timestamp"], shear, grip["load"], present_n)
        step_s = min(now.at_s - self._past[-1].at_s, 0.1) if self._past else 0.0
        dropped, ratio = self._drops(now), self._slip_ratio(grip, now)
        self._bound_friction(grip, now, ratio, step_s)
        slides = dropped or ratio > 0
        ahead = now.shear + min(_LEAD_S * self._growth(now), _LEAD_MOST * now.shear)
        wanted_n = self._wanted(grip["friction"], now, ahead)
        if slides:
            again_n = min(GRASP_AGAIN * present_n, _GRASP_MOST * self._before_slip_n)
            if grip["state"] != "gross":  # an object that sways and sticks is not gripped ever harder
                denied_n = self._newtons_per_reading * now.shear / (_DENIED * grip["friction_low"])
                again_n = min(again_n, denied_n)
            wanted_n = max(wanted_n, again_n)
        else:
            self._before_slip_n = self.command_n
        wanted_n = min(wanted_n, self._most_unseen_n)
        if not self._past:
            self._calm_from_s = now.at_s + _CALM_AFTER_STALE_S
        elif slides:
            self._calm_from_s = max(now.at_s + _CALM_AFTER_SLIP_S, self._calm_from_s)
        elif wanted_n > self.command_n or ahead > (1 + _GROWS) * now.shear or now.shear < _LEAST * now.load:
            self._calm_from_s = max(now.at_s + _CALM_S, self._calm_from_s)
        self._wanted_n = wanted_n
        if wanted_n > self.command_n:
            self.command_n = wanted_n
        elif now.at_s > self._calm_from_s:
            self.command_n -= _EASE_PER_S * step_s * (self.command_n - wanted_n)
        self.command_n = self._limited(self.command_n)
        self._past.append(now)
        while self._past[0].at_s < now.at_s - _REST_S:
            self._past.popleft()
        return self.command_n

    def blind(self) -> float:
        """Return the force to command while tactile data are stale: tighter, and not eased."""
        self.command_n = self._limited(max(self.command_n, BLIND * self._wanted_n))
        self._past.clear()
        self._left_s = math.inf  # nobody saw whether the object came back
        return self.command_n

    def _limited(self, force_n: float) -> float:
        return min(max(force_n, self._least_n), self._most_n)

    def _shift_times(self, by_s: float) -> None:
        """Follow a clock that was set back: what was measured before is as old as it was."""
        self._past.clear()
        self._contact_s -= by_s
        self._left_s -= by_s
        self._touched_s -= by_s
        self._dropped_s -= by_s
        self._steady_from_s -= by_s

    def _bound_friction(self, grip: Mapping[str, Any], now: _Seen, slip_ratio: float, step_s: float) -> None:
        """Keep the highest bound of friction; a slip lowers it, to the ratio at which the object slid."""
        grows = bool(self._past) and now.shear > _GREW * self._past[0].shear
        self._slid_ratio *= 1 + _RECOVER_PER_S * step_s
        if slip_ratio > 0 and not self._slides:
            self._slid_ratio = max(slip_ratio, _WEAKER * max(self._friction, grip["friction_low"]))
        self._slides = slip_ratio > 0
        self._friction *= 1 - (_RENEW_PER_S if grows else _FORGET_PER_S) * step_s
        self._friction = max(self._friction, grip["friction_low"])
        self._friction = min(self._friction, self._slid_ratio, _SURELY * grip["friction"])

    def _wanted(self, friction: float, now: _Seen, ahead: float) -> float:
        """Force that holds what is borne now at the target, and what is borne soon by likely friction."""
        newtons = self._newtons_per_load(now)
        likely = max(math.sqrt(self._friction * friction), self._friction)
        return newtons * max(now.shear / (self._friction * self._target), ahead / likely)

    def _newtons_per_load(self, now: _Seen) -> float:
        """Force over load reading, measured while the grip is steady: message and gripper differ in age."""
        if abs(now.force_n - self._level_n) > _STEADY * self._level_n:
            self._level_n, self._steady_from_s = now.force_n, now.at_s + _STEADY_S
        present = now.force_n / now.load
        if now.at_s >= self._steady_from_s or not self._newtons_per_reading:
            self._newtons_per_reading = present
        return min(max(present, self._newtons_per_reading), _UNSTEADY * self._newtons_per_reading)

    def _growth(self, now: _Seen) -> float:
        """Rate at which shear has grown over `_GROWTH_S`, 0 where it has not."""
        if not self._past:
            return 0.0
        then = (self._since(now.at_s - _GROWTH_S) or [self._past[-1]])[0]
        return max(now.shear - then.shear, 0.0) / max(now.at_s - then.at_s, 1e-3)  # a message may come twice

    def _since(self, at_s: float) -> list[_Seen]:
        return [seen for seen in self._past if seen.at_s >= at_s - 1e-3]

    def _drops(self, now: _Seen) -> bool:
        """Return True where the largest shear of late has just fallen at once, and falls no further."""
        recent = self._since(now.at_s - _DROP_S)
        if not recent or now.shear < _LEAST * now.load:
            return False
        peak = max(recent, key=lambda seen: seen.shear)
        is_peak = peak.shear >= _PEAK * max(seen.shear for seen in self._past)
        least_drop = max(_DROP, _DROP_PER_S * (now.at_s - peak.at_s))
        least_drop += _TIGHTENED * max(now.load / peak.load - 1, 0.0)
        before = next((seen for seen in reversed(recent) if seen.at_s <= now.at_s - _FLAT_S), recent[0])
        least = (1 - _FLAT_PER_S * (now.at_s - before.at_s)) * before.shear
        drops = is_peak and least < now.shear < (1 - least_drop) * peak.shear
        if drops:
            self._dropped_s = now.at_s
        return drops

    def _slip_ratio(self, grip: Mapping[str, Any], now: _Seen) -> float:
        """Shear over load at which the object slides, 0 where it does not."""
        if grip["state"] == "gross":
            return now.shear / now.load
        watched = now.at_s < self._dropped_s + _WATCH_S
        before = self._since(max(now.at_s - _FOLLOW_S, self._dropped_s + 2e-3))
        then = before[0] if before else now
        if min(then.shear, now.shear) < _LEAST * then.load or min(then.force_n, now.force_n) <= 0:
            return 0.0
        tightened, grown = math.log(now.force_n / then.force_n), math.log(now.shear / then.shear)
        if watched:
            follows = tightened > _CHANGED and _FOLLOWS_ON < grown / tightened < 1.1
        else:
            earlier = [seen.shear for seen in self._since(then.at_s - _PLATEAU_S) if seen.at_s < then.at_s]
            was_steady = then.shear < _PLATEAU * min(earlier, default=0.0)
            follows = was_steady and tightened < -_CHANGED and grown < _FOLLOWS * tightened
        return max(then.shear / then.load, _DENIED * grip["friction_low"]) if follows else 0.0
