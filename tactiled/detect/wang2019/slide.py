"""A slip that is going on, and how one sees that it has ended: see `slip_wavelet` for the rule."""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.signal.pairs import mean_response
from tactiled.detect.wang2019.heading import Heading
from tactiled.detect.wang2019.kink import KinkFit
from tactiled.events.types import SlipEvent

TURN_DETECTOR = "wang2019-turn"


class Look(NamedTuple):
    """What the rule looks at in one scan."""

    time_s: float
    time_sd_s: float
    late: bool
    coefficients: FloatArray  # (channels,)
    analysed: NDArray[np.bool_]  # (channels,): usable, on a taxel in contact
    crossing: NDArray[np.bool_]  # (channels,)
    steps: FloatArray  # (taps, channels): the held readings behind the coefficients
    channel_offset_s: FloatArray  # (channels,): how long after `time_s` each channel was sampled


class MotionResponse:
    """Summed response of the pairs along the direction of a slip, above what it was before.

    Parameters
    ----------
    weights : (axes, channels) float64
        Readings to the response of each axis; whole, so that sums are exact.
    along : (axes,) float64
        Unit vector of the slip.
    before : (axes,) float64
        Response before the slip, in steps.
    look : Look
        The scan that raised the slip.
    kink : KinkFit

    Attributes
    ----------
    skew_s : float
        How long after the scan began its channels were sampled, on the average of their weights.
    """

    def __init__(
        self, weights: FloatArray, along: FloatArray, before: FloatArray, look: Look, kink: KinkFit
    ) -> None:
        self._weights, self._before = weights, before
        self._n_before = kink.n_before
        self.kink_delay_scans = kink.middle_scans
        self.turn(along, look)

    def turn(self, along: FloatArray, look: Look) -> None:
        """Look along another direction from now on."""
        self._along = along
        weights = np.abs(along @ self._weights)
        # A direction without channels, such as x on an array that has shear along y alone, has no weights.
        self.skew_s = float(np.average(look.channel_offset_s, weights=weights)) if weights.any() else 0.0

    def now(self, look: Look) -> float:
        """Response, in steps."""
        return self._above(self._weights @ look.steps[-1])

    def before_kink(self, look: Look) -> float:
        """Response before any kink that the filter answers to now."""
        return self._above(mean_response(self._weights, look.steps[: self._n_before]))

    def kinks_back(self, look: Look) -> bool:
        """Whether it kinks against the motion."""
        return bool(self._along @ (self._weights @ look.coefficients) < 0)

    def _above(self, response: FloatArray) -> float:
        return float((response - self._before) @ self._along)


class Slide:
    """A slip from its onset to its end.

    Parameters
    ----------
    onset : SlipEvent
    response : MotionResponse or None
        None for an array without shear channels, whose slips end with their last crossing.
    heading : Heading or None
        The same.
    now_s : float
        Instant of the scan that raised it.
    rate_hz : float

    Attributes
    ----------
    trace_s : float
        When the slip ended, should it turn out that it has.
    """

    def __init__(
        self,
        onset: SlipEvent,
        response: MotionResponse | None,
        heading: Heading | None,
        now_s: float,
        rate_hz: float,
    ) -> None:
        self._onset = onset
        self._response = response
        self._heading = heading
        self._rate_hz = rate_hz
        self.trace_s = now_s
        self._before_kinks = 0.0  # largest response before the opposite kinks of this burst of crossings
        self._kinking_back = False

    def turn(self, look: Look) -> list[SlipEvent]:
        """End and onset where the slip has turned; to be asked at every scan."""
        if self._heading is None or self._response is None:
            return []
        if (turn := self._heading.follow(look.steps[-1])) is None:
            return []
        self._response.turn(turn.along, look)
        turned_s = float(look.time_s + self._response.skew_s - turn.delay_scans / self._rate_hz)
        end = self.ended(turned_s, look.time_s, valid=not look.late)
        self._onset = dataclasses.replace(
            end,
            state="onset",
            onset_s=turned_s,
            onset_sd_s=float(np.hypot(turn.delay_sd_scans / self._rate_hz, look.time_sd_s)),
            direction_deg=float(np.degrees(np.arctan2(turn.along[1], turn.along[0]))),
            direction_sd_deg=turn.direction_sd_deg,
            detector=TURN_DETECTOR,
            statistic=turn.turned_deg,
            threshold=self._heading.turn_deg,
        )
        self._before_kinks, self._kinking_back = 0.0, False
        self.trace_s = look.time_s
        return [end, self._onset]

    def cross(self, look: Look, *, is_first: bool) -> None:
        """Take in a crossing, the first of a burst or one more."""
        if self._response is None:
            self.trace_s = look.time_s
            return
        if is_first:
            self._before_kinks, self._kinking_back = 0.0, False
        kinks_back = self._response.kinks_back(look)
        if kinks_back:
            self._before_kinks = max(self._before_kinks, self._response.before_kink(look))
            if not self._kinking_back:
                delay_s = self._response.kink_delay_scans / self._rate_hz
                self.trace_s = look.time_s + self._response.skew_s - delay_s
        self._kinking_back = kinks_back

    def gave_back(self, look: Look, relaxed_part: float) -> bool:
        """Whether the response has lost that part of what it was before it kinked back, or all of it.

        Not while it points elsewhere: a slow turn looks like that for a while. Nor when it falls just now:
        that fall belongs to a kink which the filter has yet to answer to.
        """
        if self._response is None or self._heading is None:
            return True
        if self._heading.is_off:
            return False
        left = (1 - relaxed_part) * self._before_kinks
        now, before = self._response.now(look), self._response.before_kink(look)
        return now < left and (before < left or before - now < relaxed_part / 2 * self._before_kinks)

    def ended(self, ended_s: float, detected_s: float, *, valid: bool) -> SlipEvent:
        """Event for the end; it repeats what the onset's event said."""
        return dataclasses.replace(
            self._onset, state="end", time_s=ended_s, detected_s=detected_s, valid=valid
        )
