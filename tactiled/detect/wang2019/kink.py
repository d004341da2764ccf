"""Onset of a response's rise, from the wavelet coefficient that its kink causes.

A response that rises with slope s from t0 on has risen by ``s tau`` after tau scans and causes the
coefficient ``s K(tau)``, where K is the filter's response to a unit kink (`wavelet.kink_response`). Their
ratio ``tau / K(tau)`` does not depend on s. K oscillates in growing lobes of alternating sign and peaks in
the last one. A kink is first detected on the rising side of the last lobe or, if it is stronger, of an
earlier lobe. On each of these sides the ratio falls monotonically towards zero, so its size and sign yield
tau.

The delay correction is ours: the paper states no onset instant.
"""

from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.signal.wavelet import kink_response, taps
from tactiled.events.types import UNKNOWN_SD_DEG

# choice: smallest response to a unit kink that is considered: there a coefficient of 2 mV needs 200 V per
# scan.
_FAINTEST_GAIN = 1e-5


class KinkDelay(NamedTuple):
    """Scans since a kink, with the standard deviation."""

    scans: float
    sd_scans: float


class KinkOnset(NamedTuple):
    """Beginning and direction of a movement in one or two axes."""

    delay: KinkDelay
    along: FloatArray  # (axes,): unit vector of the movement
    # direction_deg, direction_sd_deg: its angle from the first axis towards the second; a standard deviation
    # of 180 where nothing moved
    direction_deg: float
    direction_sd_deg: float


class KinkFit:
    """Delay from a kink to the scan whose coefficient crosses the threshold.

    Attributes
    ----------
    n_before : int
        Scans at the beginning of the filter's window that precede any kink it responds to.
    longest_scans : int
        Delay at which a kink's coefficient peaks.
    middle_scans : float
        Delay assumed for a kink about which only the crossing is known.

    Examples
    --------
    A rise of 10 mV per scan that begins 13 scans before the newest one:

    >>> import numpy as np
    >>> from tactiled.detect.signal.wavelet import taps
    >>> coif1 = taps(3)
    >>> rng, scans = np.random.default_rng(0), np.arange(len(coif1)) - len(coif1) + 1
    >>> window = 0.01 * np.maximum(scans + 13, 0) + 1e-4 * rng.standard_normal(len(coif1))
    >>> delay = KinkFit(level=3).fit(window, float(coif1 @ window[::-1]))
    >>> print(f"{delay.scans:.1f} +- {delay.sd_scans:.1f} scans ago")
    13.0 +- 2.0 scans ago
    """

    def __init__(self, level: int) -> None:
        response = kink_response(level)
        self.longest_scans = int(np.argmax(response))
        self.n_before = max(2, len(taps(level)) // 4)
        self._sides = [_LobeSide(response, self.longest_scans)]
        while (first := self._sides[-1].first) > 2:
            # The lobe before has the opposite sign; stronger kinks than those it responds to do not occur.
            earlier = response[:first] * -self._sides[-1].sign
            if earlier.max() < _FAINTEST_GAIN:
                break
            self._sides.append(_LobeSide(response, int(np.argmax(earlier))))
        self.middle_scans = self._sides[0].middle_scans

    def fit(self, window: FloatArray, coefficient: float) -> KinkDelay:
        """Scans since the kink, seen from the newest scan.

        The standard deviation is the root sum of squares of three terms: noise of rise and coefficient,
        propagated through the ratio (at most that of the side's range, ``range / sqrt(12)``); half a scan of
        rounding, ``1 / sqrt(12)``; and a quarter of the range, since real responses begin rounder or steeper
        than a kink (on steps, exponentials and parabolas the error is that large, in both directions).

        Parameters
        ----------
        window : (taps,) float64
            Response with the kink, newest scan last.
        coefficient : float
            Filter output for that window.
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
        return KinkDelay(delay, float(np.sqrt(from_noise**2 + 1 / 12 + (side.range_scans / 4) ** 2)))

    def onset(self, responses: FloatArray, coefficients: FloatArray) -> KinkOnset:
        """Delay and direction of a kink.

        The direction is that of the change from before the kink to the newest scan. Its standard deviation is
        the noise of that change, estimated before the kink, divided by its size.

        Parameters
        ----------
        responses : (taps, axes) float64
            Newest scan last.
        coefficients : (axes,) float64
            Filter output for them.
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
        return KinkOnset(
            self.fit(responses @ along, float(along @ coefficients)), along, direction_deg, direction_sd_deg
        )


def _noise(responses: FloatArray) -> float:
    """Standard deviation of white noise from first differences, which a trend does not affect."""
    return float(np.diff(responses, axis=0).std() / np.sqrt(2))


class _LobeSide:
    """Rising side of one lobe: delay as a function of the size of rise over coefficient.

    Attributes
    ----------
    first : int
        Scan at which the lobe begins to rise.
    """

    def __init__(self, response: FloatArray, peak: int) -> None:
        self.sign = float(np.sign(response[peak]))
        size = response * self.sign
        first = peak
        while first > 1 and 0 < size[first - 1] < size[first]:
            first -= 1
        delays = np.arange(first, peak + 1, dtype=np.float64)
        # Logarithms, because the ratio spans decades and is closer to a straight line in them.
        self._log_ratios = np.log(delays / size[first : peak + 1])[::-1]
        self._delays = delays[::-1]
        self.first = first
        self.range_scans = float(peak - first)
        self.middle_scans = (first + peak) / 2

    def delay(self, ratio: float) -> float:
        """Delay in scans at a ratio."""
        return float(np.interp(np.log(ratio), self._log_ratios, self._delays))

    def misfit(self, ratio: float) -> float:
        """Distance of a ratio from the range of this side, in natural logarithms."""
        log_ratio = np.log(ratio)
        return float(max(self._log_ratios[0] - log_ratio, log_ratio - self._log_ratios[-1], 0.0))

    def relative_slope(self, delay: float) -> float:
        """Decrease of the ratio's logarithm per scan around a delay."""
        around = np.interp([delay - 0.5, delay + 0.5], self._delays[::-1], self._log_ratios[::-1])
        return max(float(around[0] - around[1]), 1e-9)
