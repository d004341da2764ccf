"""Slip events from the slips that open and close on the posterior of a contact.

A slip is incipient where a tenth of the contact area slips with at least some probability, and gross where
all of it slides with at least some other (`gate`). An event adds instant, direction and taxels.
"""

import collections
import dataclasses
import math
from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.contact.direction import Direction, averaged_scans, direction, opposed
from tactiled.detect.contact.gate import SlipHysteresis
from tactiled.detect.contact.posterior import FIVE_PERCENT, INCIPIENT_USED, RIPPLE_P
from tactiled.detect.contact.touch import ContactScan
from tactiled.events.types import SlipEvent

DETECTOR = "grip"
_HISTORY_S = 1.0  # choice: in which the beginning of a slip is looked for
_GAP_STEPS = 1.5  # derived: times the time between scans: a longer one is a gap
_FULL = 0.97  # prior: of the ratio at the limit: taxels of unequal friction slip one after the other
# derived: quantiles of a normal distribution in seven equal parts: values of the logarithm of friction, over
# its sd.
_SDS = np.array([-1.465, -0.792, -0.366, 0.0, 0.366, 0.792, 1.465])
_LEAST_PART = 1e-3  # derived: of the load: a taxel with less is not loaded
_LEAST_GROWTH = 1e-3  # derived: 1/s: slower growth does not tell when it began


class ScanInstant(NamedTuple):
    """Instant of a scan with its sd; not valid where the scan came late or too few taxels are read."""

    time_s: float
    time_sd_s: float
    is_valid: bool


class _Past(NamedTuple):
    """One scan of the last second; fields as in `ContactScan`."""

    time_s: float
    size: float
    shear: FloatArray
    p_sliding: float


class PosteriorSlips:
    """Report the slips of one contact.

    Parameters
    ----------
    gate : SlipHysteresis
        Slips that are open; others step it before each `step`.

    Attributes
    ----------
    open : SlipEvent or None
        Newest onset of the slip that goes on.
    """

    def __init__(self, gate: SlipHysteresis, rate_hz: float) -> None:
        self.gate = gate
        self._step_s = 1.0 / rate_hz
        self._n_averaged = averaged_scans(self._step_s)
        length = max(2, round(_HISTORY_S * rate_hz))
        self._past: collections.deque[_Past] = collections.deque(maxlen=length)
        self.open: SlipEvent | None = None

    def step(self, scan: ContactScan, at: ScanInstant) -> list[SlipEvent]:
        """Take a scan and return the slip events that it completes."""
        self._past.append(_Past(at.time_s, scan.size, scan.shear, scan.filter.p_sliding))
        events: list[SlipEvent] = []
        if self.open is not None and not self.gate.is_open:
            events.append(self.end(at.time_s, valid=at.is_valid))
            self._forget_all_but_newest()
        if self.open is None and self.gate.is_open:
            self.open = self._onset(scan, at)
            events.append(self.open)
        if self.open is not None and self.gate.is_gross and self.open.kind == "incipient":
            self.open = self._gross(self.open, scan, at)
            events.append(self.open)
        return events

    def end(self, time_s: float, *, valid: bool) -> SlipEvent:
        """End the slip that goes on, and return its end."""
        assert self.open is not None
        ended = dataclasses.replace(self.open, state="end", time_s=time_s, detected_s=time_s, valid=valid)
        self.open = None
        return ended

    def _forget_all_but_newest(self) -> None:
        """Forget how shear came to what it is: that was the slip that has ended, and the fall after it."""
        newest = self._past.pop()
        self._past.clear()
        self._past.append(newest)

    def _onset(self, scan: ContactScan, at: ScanInstant) -> SlipEvent:
        p = scan.filter.p_incipient
        if scan.rippled_s:
            began_s, sd_s = _ripple_began(scan, at)
        else:
            began_s, sd_s = self._began(INCIPIENT_USED * _likely_friction(scan), scan)
        towards = self._direction(scan, is_gross=False)
        return SlipEvent(
            time_s=began_s,
            state="onset",
            kind="incipient",
            onset_s=began_s,
            onset_sd_s=math.hypot(sd_s, at.time_sd_s),
            direction_deg=towards.angle_deg,
            direction_sd_deg=towards.sd_deg,
            confidence=p,
            taxels=_slipping_taxels(scan),
            detector=DETECTOR,
            statistic=p,
            threshold=self.gate.incipient_p,
            valid=at.is_valid,
            detected_s=at.time_s,
        )

    def _gross(self, slip: SlipEvent, scan: ContactScan, at: ScanInstant) -> SlipEvent:
        if scan.rippled_s:
            began_s, sd_s = _ripple_began(scan, at)
            began_s = max(began_s, slip.onset_s)
        else:
            began_s, sd_s = self._limit_met(slip, scan, at)
        towards = self._direction(scan, is_gross=True)
        p = max(scan.filter.p_sliding, RIPPLE_P if scan.rippled_s else 0.0)
        return dataclasses.replace(
            slip,
            kind="gross",
            time_s=began_s,
            onset_s=began_s,
            onset_sd_s=math.hypot(sd_s, at.time_sd_s),
            direction_deg=towards.angle_deg,
            direction_sd_deg=towards.sd_deg,
            confidence=p,
            taxels=tuple(np.flatnonzero(scan.shear.any(axis=0)).tolist()),  # not those that are out
            statistic=p,
            threshold=self.gate.gross_p,
            valid=at.is_valid,
            detected_s=at.time_s,
        )

    def _limit_met(self, slip: SlipEvent, scan: ContactScan, at: ScanInstant) -> tuple[float, float]:
        """Return instant and sd of the beginning of a slide that shear tells.

        What slides bears its limit: it did not slide before the ratio came there, nor while sliding was less
        likely than it is without any sign.
        """
        reached_s, sd_s = self._began(np.array([_FULL * scan.size]), scan)
        unlikely_s = next(
            (past.time_s for past in reversed(self._past) if past.p_sliding < scan.filter.prior_p), 0.0
        )
        began_s = max(reached_s, slip.onset_s, unlikely_s)
        return began_s, math.hypot(sd_s, (at.time_s - began_s) / math.sqrt(12))

    def _direction(self, scan: ContactScan, *, is_gross: bool) -> Direction:
        past = [past.shear for past in self._past]
        if scan.rippled_s:  # the growth may be over for long
            return opposed(scan, past[-self._n_averaged :])
        return direction(scan, past, self._n_averaged, is_gross=is_gross)

    def _began(self, limit: FloatArray, scan: ContactScan) -> tuple[float, float]:
        """Return mean and sd of the instant at which the ratio last rose beyond limits (n,), all as likely.

        Limits that the ratio has not met count as being met now.
        """
        time_s = np.array([past.time_s for past in self._past])
        size = np.array([past.size for past in self._past])
        below = size[:, np.newaxis] < limit
        # One after the last scan below the limit; the oldest scan where there is none.
        row = np.where(below.any(axis=0), len(size) - np.argmax(below[::-1], axis=0), 0)
        row = np.minimum(row, len(size) - 1)
        unseen_s = np.maximum(time_s[row] - time_s[np.maximum(row - 1, 0)] - _GAP_STEPS * self._step_s, 0.0)
        began_s = time_s[row] - unseen_s / 2  # the ratio may have met the limit at any time of a gap
        met = ~below[-1] if not below[-1].all() else np.ones_like(below[-1])
        mean_s = float(began_s[met].mean())
        # Where the oldest scan that is kept has met the limit, it may have been met at any time since then.
        since_s = np.where(row == 0, time_s[-1] - time_s[0], 0.0)
        spread = float(((began_s - mean_s) ** 2 + (unseen_s**2 + since_s**2) / 12)[met].mean())
        signs = scan.filter.signs
        growth = scan.filter.per_friction * signs.growth
        noise_s = min(signs.ratio_noise / max(growth, _LEAST_GROWTH), _HISTORY_S)
        return mean_s, math.sqrt(spread + noise_s**2 + self._step_s**2 / 12)


def _likely_friction(scan: ContactScan) -> FloatArray:
    """Return values of friction that are equally likely."""
    low, median, high = scan.filter.friction
    return np.asarray(median * np.exp(_SDS * math.log(high / low) / (2 * FIVE_PERCENT)))


def _slipping_taxels(scan: ContactScan) -> tuple[int, ...]:
    """Return the taxels whose own shear uses so much of what their load bears that a tenth of them slips.

    Where a tenth of the contact slips, so does the taxel that uses most, if no other.
    """
    load = np.maximum(np.array(scan.filter.signs.scan_load) / scan.filter.signs.total_load, _LEAST_PART)
    used = np.where(load > _LEAST_PART, np.hypot(*scan.shear) / load / scan.filter.friction[1], 0.0)
    return tuple(np.flatnonzero(used >= min(INCIPIENT_USED, used.max())).tolist())


def _ripple_began(scan: ContactScan, at: ScanInstant) -> tuple[float, float]:
    """Return instant and sd of the beginning of a slide whose ripple fills a window."""
    return at.time_s - scan.rippled_s, scan.rippled_s / 4
