"""A slip in progress, and the rule for its end; `slip` states the rule."""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.signal.opposed_pairs import mean_response
from tactiled.detect.wang2019.heading import HeadingTracker
from tactiled.detect.wang2019.kink import KinkFit
from tactiled.events.types import SlipEvent

TURN_DETECTOR = "wang2019-turn"


class ScanView(NamedTuple):
    """Inputs of the rule in one scan."""

    time_s: float
    time_sd_s: float
    late: bool
    coefficients: FloatArray  # (channels,)
    analysed: NDArray[np.bool_]  # (channels,): usable, and on a taxel in contact
    crossing: NDArray[np.bool_]  # (channels,)
    steps: FloatArray  # (taps, channels): the readings that the coefficients are computed from
    channel_offset_s: FloatArray  # (channels,): delay of each channel's sample after `time_s`


class MotionResponse:
    """Summed pair response along the direction of a slip, relative to that before the slip.

    Parameters
    ----------
    weights : (axes, channels) float64
        From readings to the response of each axis; on a grid, so that sums are exact.
    along : (axes,) float64
        Unit vector of the slip.
    before : (axes,) float64
        Response before the slip, in grid steps.
    view : ScanView
        The scan in which the slip was detected.

    Attributes
    ----------
    skew_s : float
        Weighted mean of the delay from the beginning of the scan to the samples of its channels.
    """

    def __init__(
        self, weights: FloatArray, along: FloatArray, before: FloatArray, view: ScanView, kink: KinkFit
    ) -> None:
        self._weights, self._before = weights, before
        self._n_before = kink.n_before
        self.kink_delay_scans = kink.middle_scans
        self.turn(along, view)

    def turn(self, along: FloatArray, view: ScanView) -> None:
        """Use another direction from now on."""
        self._along = along
        weights = np.abs(along @ self._weights)
        # A direction without channels, such as x on an array with shear along y only, has no weights.
        self.skew_s = float(np.average(view.channel_offset_s, weights=weights)) if weights.any() else 0.0

    def now(self, view: ScanView) -> float:
        """Response of the newest scan, in grid steps."""
        return self._above(self._weights @ view.steps[-1])

    def before_kink(self, view: ScanView) -> float:
        """Response before any kink that the filter responds to now."""
        return self._above(mean_response(self._weights, view.steps[: self._n_before]))

    def opposes_motion(self, view: ScanView) -> bool:
        """True where the response kinks against the motion."""
        return bool(self._along @ (self._weights @ view.coefficients) < 0)

    def _above(self, response: FloatArray) -> float:
        return float((response - self._before) @ self._along)


class ActiveSlip:
    """Track one slip from its onset to its end.

    Parameters
    ----------
    response : MotionResponse or None
        None for an array without shear channels, whose slips end with their last crossing.
    heading : HeadingTracker or None
        None under the same condition.
    now_s : float
        Instant of the scan in which the slip was detected.

    Attributes
    ----------
    trace_s : float
        Instant of the end, if the slip proves to have ended.
    """

    def __init__(
        self,
        onset: SlipEvent,
        response: MotionResponse | None,
        heading: HeadingTracker | None,
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

    def turn(self, view: ScanView) -> list[SlipEvent]:
        """End and onset where the slip has changed direction; to be called for every scan."""
        if self._heading is None or self._response is None:
            return []
        if (turn := self._heading.follow(view.steps[-1])) is None:
            return []
        self._response.turn(turn.along, view)
        turned_s = float(view.time_s + self._response.skew_s - turn.delay_scans / self._rate_hz)
        end = self.ended(turned_s, view.time_s, valid=not view.late)
        self._onset = dataclasses.replace(
            end,
            state="onset",
            onset_s=turned_s,
            onset_sd_s=float(np.hypot(turn.delay_sd_scans / self._rate_hz, view.time_sd_s)),
            direction_deg=float(np.degrees(np.arctan2(turn.along[1], turn.along[0]))),
            direction_sd_deg=turn.direction_sd_deg,
            detector=TURN_DETECTOR,
            statistic=turn.turned_deg,
            threshold=self._heading.turn_deg,
        )
        self._before_kinks, self._kinking_back = 0.0, False
        self.trace_s = view.time_s
        return [end, self._onset]

    def cross(self, view: ScanView, *, is_first: bool) -> None:
        """Process a crossing, the first of a burst or a later one."""
        if self._response is None:
            self.trace_s = view.time_s
            return
        if is_first:
            self._before_kinks, self._kinking_back = 0.0, False
        opposes_motion = self._response.opposes_motion(view)
        if opposes_motion:
            self._before_kinks = max(self._before_kinks, self._response.before_kink(view))
            if not self._kinking_back:
                delay_s = self._response.kink_delay_scans / self._rate_hz
                self.trace_s = view.time_s + self._response.skew_s - delay_s
        self._kinking_back = opposes_motion

    def has_relaxed(self, view: ScanView, relaxed_part: float) -> bool:
        """True where the response has lost `relaxed_part` of its value before the opposite kink, or all.

        False while the response points elsewhere, since a slow change of direction looks alike for a while.
        False also while the response is falling: that fall belongs to a kink that the filter has not
        responded to yet.
        """
        if self._response is None or self._heading is None:
            return True
        if self._heading.is_off_direction:
            return False
        left = (1 - relaxed_part) * self._before_kinks
        now, before = self._response.now(view), self._response.before_kink(view)
        return now < left and (before < left or before - now < relaxed_part / 2 * self._before_kinks)

    def ended(self, ended_s: float, detected_s: float, *, valid: bool) -> SlipEvent:
        """Event for the end, with the other fields of the onset's event."""
        return dataclasses.replace(
            self._onset, state="end", time_s=ended_s, detected_s=detected_s, valid=valid
        )
