"""A slip that is going on, and how one sees that it has ended: see `slip_wavelet` for the rule."""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.kink import KinkFit
from tactiled.detect.pairs import whole_weights
from tactiled.events.types import SlipEvent


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
    weights : (channels,) float64
        Readings to the response.
    look : Look
        The scan that raised the slip.
    kink : KinkFit

    Attributes
    ----------
    skew_s : float
        How long after the scan began its channels were sampled, on the average of their weights.
    """

    def __init__(self, weights: FloatArray, look: Look, kink: KinkFit) -> None:
        self._weights = whole_weights(weights)
        self.skew_s = float(np.average(look.channel_offset_s, weights=np.abs(weights)))
        self._n_before = kink.n_before
        self.kink_delay_scans = kink.middle_scans
        self._reference = 0.0
        self._reference = self.before_kink(look)

    def now(self, look: Look) -> float:
        """Response, in steps."""
        return float(look.steps[-1] @ self._weights) - self._reference

    def before_kink(self, look: Look) -> float:
        """Response before any kink that the filter answers to now."""
        return float((look.steps[: self._n_before] @ self._weights).mean()) - self._reference

    def kinks_back(self, look: Look) -> bool:
        """Whether it kinks against the motion."""
        return bool(self._weights @ look.coefficients < 0)


class Slide:
    """A slip from its onset to its end.

    Parameters
    ----------
    onset : SlipEvent
    response : MotionResponse or None
        None for an array without shear channels, whose slips end with their last crossing.
    now_s : float
        Instant of the scan that raised it.
    rate_hz : float

    Attributes
    ----------
    trace_s : float
        When the slip ended, should it turn out that it has.
    """

    def __init__(
        self, onset: SlipEvent, response: MotionResponse | None, now_s: float, rate_hz: float
    ) -> None:
        self._onset = onset
        self._response = response
        self._rate_hz = rate_hz
        self.trace_s = now_s
        self._before_kinks = 0.0  # largest response before the opposite kinks of this burst of crossings
        self._kinking_back = False

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
        """Whether the response has lost that part of what it was before it kinked back, or all of it."""
        if self._response is None:
            return True
        return self._response.now(look) < (1 - relaxed_part) * self._before_kinks

    def ended(self, ended_s: float, detected_s: float, *, valid: bool) -> SlipEvent:
        """Event for the end; it repeats what the onset's event said."""
        return dataclasses.replace(
            self._onset, state="end", time_s=ended_s, detected_s=detected_s, valid=valid
        )
