"""When a response began to rise, from the coefficient that its kink left.

A response that rises with slope s from t0 on has risen by ``s tau`` after tau scans and leaves the
coefficient ``s K(tau)``, K being the filter's answer to a unit kink (`wavelet.kink_response`). Their ratio
``tau / K(tau)`` knows nothing of s. K swings to ever larger lobes of alternating sign and peaks in the last
one; a kink is first noticed on the growing side of the last lobe or, the stronger it is, of a lobe before.
On each of these sides the ratio falls steadily towards zero, so its size and sign give tau.

This is our reading of a delay to correct for: the paper states no onset instant.
"""

from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.signal.wavelet import kink_response, taps
from tactiled.events.types import UNKNOWN_SD_DEG

# Least answer to a unit kink that is looked for: 2 mV need a kink of 200 V a scan there.
_FAINTEST_GAIN = 1e-5


class Delay(NamedTuple):
    """How far back a kink lies, in scans."""

    scans: float
    sd_scans: float


class Onset(NamedTuple):
    """Where a response of one or two axes began to move, and which way.

    Attributes
    ----------
    delay : Delay
    along : (axes,) float64
        Unit vector of the movement.
    direction_deg, direction_sd_deg : float
        The same as an angle from the first axis towards the second; 180 where nothing moved.
    """

    delay: Delay
    along: FloatArray
    direction_deg: float
    direction_sd_deg: float


class KinkFit:
    """Delay of a crossing behind its kink.

    Parameters
    ----------
    level : int
        Wavelet level of the coefficient.

    Attributes
    ----------
    n_before : int
        Scans at the beginning of the filter's window that lie before any kink it answers to.
    longest_scans : int
        Delay at which a kink's coefficient peaks.
    middle_scans : float
        Delay of a kink of which no more is known than that it crosses.
    """

    def __init__(self, level: int) -> None:
        response = kink_response(level)
        self.longest_scans = int(np.argmax(response))
        self.n_before = max(2, len(taps(level)) // 4)
        self._sides = [_Side(response, self.longest_scans)]
        while (first := self._sides[-1].first) > 2:
            # The lobe before has the other sign; stronger kinks than it answers to there are none.
            earlier = response[:first] * -self._sides[-1].sign
            if earlier.max() < _FAINTEST_GAIN:
                break
            self._sides.append(_Side(response, int(np.argmax(earlier))))
        self.middle_scans = self._sides[0].middle_scans

    def fit(self, window: FloatArray, coefficient: float) -> Delay:
        """Delay of the newest scan behind the kink.

        Parameters
        ----------
        window : (taps,) float64
            The response that kinks, newest scan last.
        coefficient : float
            The filter's output for that window.

        Notes
        -----
        The sigma is the root sum of squares of: noise of rise and coefficient, carried through the ratio (at
        most what the side's range alone says, ``range / sqrt(12)``); half a scan of rounding, as
        ``1 / sqrt(12)``; a quarter of the range, since real responses begin rounder or steeper than a kink
        (on steps, exponentials and parabolas the fit is off by so much, to both sides).
        """
        before = window[: self.n_before]
        rise = float(window[-1] - before.mean())
        side = self._sides[0]
        from_noise = widest = side.range_scans / np.sqrt(12)
        delay = side.middle_scans
        if rise != 0 and coefficient != 0:
            ratio = rise / coefficient
            same_sign = [s for s in self._sides if s.sign * ratio > 0] or [side]
            side = min(same_sign, key=lambda s: s.misfit(abs(ratio)))
            delay = side.delay(abs(ratio))
            widest = side.range_scans / np.sqrt(12)
            relative_noise = _noise(before) * np.hypot(1 / rise, 1 / coefficient)
            from_noise = min(widest, relative_noise / side.relative_slope(delay))
        return Delay(delay, float(np.sqrt(from_noise**2 + 1 / 12 + (side.range_scans / 4) ** 2)))

    def onset(self, responses: FloatArray, coefficients: FloatArray) -> Onset:
        """Delay and direction of a kink.

        Parameters
        ----------
        responses : (taps, axes) float64
            Newest scan last.
        coefficients : (axes,) float64
            The filter's output for them.

        Notes
        -----
        The direction is that of the change from before the kink to now; its sigma is the noise of that
        change, taken from the scans before the kink, over its size.
        """
        before = responses[: self.n_before]
        moved = responses[-1] - before.mean(axis=0)
        size = float(np.sqrt((moved**2).sum()))
        if size == 0:
            along, direction_deg, direction_sd_deg = np.eye(1, len(moved))[0], 0.0, UNKNOWN_SD_DEG
        else:
            along = moved / size
            noise = _noise(before) * np.sqrt(1 + 1 / len(before))
            direction_deg = float(np.degrees(np.arctan2(moved[1], moved[0]))) if len(moved) == 2 else 0.0
            direction_sd_deg = min(UNKNOWN_SD_DEG, float(np.degrees(noise / size)))
        return Onset(
            self.fit(responses @ along, float(along @ coefficients)), along, direction_deg, direction_sd_deg
        )


def _noise(responses: FloatArray) -> float:
    """Standard deviation of white noise, from the differences of neighbours so that a trend is not noise."""
    return float(np.diff(responses, axis=0).std() / np.sqrt(2))


class _Side:
    """The growing side of one lobe: delay as a function of the size of rise over coefficient.

    Attributes
    ----------
    sign : float
        Of the lobe.
    first : int
        Scan at which it begins to grow.
    """

    def __init__(self, response: FloatArray, peak: int) -> None:
        self.sign = float(np.sign(response[peak]))
        size = response * self.sign
        first = peak
        while first > 1 and 0 < size[first - 1] < size[first]:
            first -= 1
        delays = np.arange(first, peak + 1, dtype=np.float64)
        # Logarithms: the ratio spans decades, and is nearer to a straight line in them.
        self._log_ratios = np.log(delays / size[first : peak + 1])[::-1]
        self._delays = delays[::-1]
        self.first = first
        self.range_scans = float(peak - first)
        self.middle_scans = (first + peak) / 2

    def delay(self, ratio: float) -> float:
        return float(np.interp(np.log(ratio), self._log_ratios, self._delays))

    def misfit(self, ratio: float) -> float:
        """How far a ratio lies outside those of this side."""
        log_ratio = np.log(ratio)
        return float(max(self._log_ratios[0] - log_ratio, log_ratio - self._log_ratios[-1], 0.0))

    def relative_slope(self, delay: float) -> float:
        """By how much the logarithm of the ratio falls from scan to scan around a delay."""
        around = np.interp([delay - 0.5, delay + 0.5], self._delays[::-1], self._log_ratios[::-1])
        return max(float(around[0] - around[1]), 1e-9)
