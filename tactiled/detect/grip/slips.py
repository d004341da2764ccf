"""Slip events as thresholds on the posterior of the contact model.

A slip is incipient where a tenth of the contact area slips with at least some probability, and gross where
all of it slides with at least some other. An incipient slip ends when its probability has fallen to half and
the friction limit was hardly met: an end is no reason to open a hand while the skin may slide. A skin that
stops sliding keeps its shear, and looks like one that still slides: a gross slip stays open until shear over
load has fallen. Where friction falls, that happens while the skin slides: the shares of the taxels must be
silent, too. While a ripple travels over the taxels (`detect.sliding.travelling`), all of the contact slides.
"""

import collections
import dataclasses
import math
from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.detector import ContactScan
from tactiled.detect.grip.direction import Direction, averaged_scans, direction, opposed
from tactiled.detect.grip.friction import FULL
from tactiled.detect.grip.model import INCIPIENT_USED
from tactiled.events.types import UNKNOWN_SD_DEG, SlipEvent

DETECTOR = "grip"
_OFF_S = 0.08  # a slip ends when it was unlikely for so long
_MAY_SLIDE = 0.05  # probability that the limit was met, below which an incipient slip may end
_HISTORY_S = 1.0  # in which the beginning of a slip is looked for
# Kinetic friction of rubber scatters by less about its mean, and a skin that relaxes loses more: a prior.
_RELAXED = 0.85
_GAP_STEPS = 1.5  # times the time between scans: a longer one is a gap
_RIPPLE_P = 0.99  # of sliding where a ripple travels: hands that hold had one in 2 windows of 1.7 h
_GROWN = 1.1  # of the smallest ratio since a slip ended, beyond which the next may begin


class ScanInstant(NamedTuple):
    """Instant of a scan with its sd; not valid where the scan came late or too few taxels are read."""

    time_s: float
    time_sd_s: float
    is_valid: bool


class PosteriorSlips:
    """Track the slips of one contact.

    Parameters
    ----------
    incipient_p, gross_p : float
        Probabilities at which slips of the two kinds are reported.
    rate_hz : float
    """

    def __init__(self, incipient_p: float, gross_p: float, rate_hz: float) -> None:
        self._p, self._gross_p = incipient_p, gross_p
        self._slides = False
        self._step_s = 1.0 / rate_hz
        self._rippled_s = 0.0
        self._n_averaged = averaged_scans(self._step_s)
        self._n_off = max(1, round(_OFF_S * rate_hz))
        length = max(2, round(_HISTORY_S * rate_hz))
        self._past: collections.deque[tuple[float, float, FloatArray]] = collections.deque(maxlen=length)
        self.open: SlipEvent | None = None
        """Newest onset of the slip that goes on."""
        self._n_waits = 0  # scans after a gap, before a direction can be told
        self._n_low = 0
        self.slid_at = 0.0
        """Largest ratio of shear and load in the gross slip that goes on."""
        self._least = 0.0  # ratio since the last slip ended

    def step(self, scan: ContactScan, at: ScanInstant, rippled_s: float = 0.0) -> list[SlipEvent]:
        """Take a scan and return the slip events that it completes.

        Parameters
        ----------
        scan : ContactScan
        at : ScanInstant
        rippled_s : float
            Length of the window in which a ripple travels over the taxels; 0.0 where none does.
        """
        grip, size = scan.grip, scan.model.trend.size
        if self._past and at.time_s - self._past[-1][0] > _GAP_STEPS * self._step_s:
            self._n_waits = self._n_averaged
        self._past.append((at.time_s, size, scan.shear))
        self._least = min(self._least, size)
        self._rippled_s = rippled_s
        least = self._gross_p / 2 if self._slides else self._gross_p
        self._slides = rippled_s > 0 or grip.p_sliding > least
        events: list[SlipEvent] = []
        self._n_waits = max(0, self._n_waits - 1)
        if self._n_waits:
            return events
        if self.open is not None and self._has_ended(self.open, scan, size):
            events.append(self.end(at.time_s, valid=at.is_valid))
        if self.open is None and self._may_begin(scan, size):
            self._n_low = 0
            self.open = self._onset(scan, at)
            events.append(self.open)
        if self.open is not None and self.open.kind == "incipient" and self._slides:
            self.slid_at, self._n_low = size, 0
            self.open = self._gross(self.open, scan, at)
            events.append(self.open)
        return events

    def end(self, time_s: float, *, valid: bool) -> SlipEvent:
        """End the slip that goes on, and return its end."""
        assert self.open is not None
        ended = dataclasses.replace(self.open, state="end", time_s=time_s, detected_s=time_s, valid=valid)
        self.open = None
        self._least = self._past[-1][1]
        return ended

    def _may_begin(self, scan: ContactScan, size: float) -> bool:
        return self._slides or (scan.grip.p_incipient >= self._p and size >= _GROWN * self._least)

    def _has_ended(self, slip: SlipEvent, scan: ContactScan, size: float) -> bool:
        if slip.kind == "gross":
            self.slid_at = max(self.slid_at, size)
            is_low = size < _RELAXED * self.slid_at and scan.model.sliding_log_odds <= 0
        else:
            friction = scan.model.friction
            is_low = scan.grip.p_incipient < self._p / 2
            is_low = is_low and float(friction.weights @ friction.met) < _MAY_SLIDE
        self._n_low = self._n_low + 1 if is_low and not self._slides else 0
        return self._n_low >= self._n_off

    def _onset(self, scan: ContactScan, at: ScanInstant) -> SlipEvent:
        friction, p = scan.model.friction, scan.grip.p_incipient
        if self._rippled_s:
            began_s, sd_s = self._ripple_began(at)
            p = max(p, _RIPPLE_P)
        else:
            began_s, sd_s = self._began(INCIPIENT_USED * friction.friction, friction.weights, scan)
        towards = self._direction(scan, is_gross=False)
        return SlipEvent(
            time_s=began_s,
            state="onset",
            kind="incipient",
            onset_s=began_s,
            onset_sd_s=math.hypot(sd_s, at.time_sd_s),
            direction_deg=towards.angle_deg,
            direction_sd_deg=min(UNKNOWN_SD_DEG, towards.sd_deg),
            confidence=p,
            taxels=scan.model.slipping_taxels(),
            detector=DETECTOR,
            statistic=p,
            threshold=self._p,
            valid=at.is_valid,
            detected_s=at.time_s,
        )

    def _gross(self, slip: SlipEvent, scan: ContactScan, at: ScanInstant) -> SlipEvent:
        if self._rippled_s:
            began_s, sd_s = self._ripple_began(at)
            began_s = max(began_s, slip.onset_s)
        else:
            began_s, sd_s = self._limit_met(slip, scan, at)
        towards = self._direction(scan, is_gross=True)
        p = max(scan.grip.p_sliding, _RIPPLE_P if self._rippled_s else 0.0)
        return dataclasses.replace(
            slip,
            kind="gross",
            time_s=began_s,
            onset_s=began_s,
            onset_sd_s=math.hypot(sd_s, at.time_sd_s),
            direction_deg=towards.angle_deg,
            direction_sd_deg=min(UNKNOWN_SD_DEG, towards.sd_deg),
            confidence=p,
            taxels=tuple(np.flatnonzero(scan.shear.any(axis=0)).tolist()),  # not those that are out
            statistic=p,
            threshold=self._gross_p,
            valid=at.is_valid,
            detected_s=at.time_s,
        )

    def _limit_met(self, slip: SlipEvent, scan: ContactScan, at: ScanInstant) -> tuple[float, float]:
        """Return instant and sd of the beginning of a slide that shear tells.

        What slides bears its limit: a lower value that has weight is the model's misfit. It slid neither
        before the ratio came there nor, most likely, after it was found: any instant between is as likely.
        """
        friction = scan.model.friction
        limit = np.maximum(friction.friction, FULL * self._past[-1][1])
        reached_s, sd_s = self._began(limit, friction.weights * friction.met, scan)
        reached_s = max(reached_s, slip.onset_s)
        return (reached_s + at.time_s) / 2, math.hypot(sd_s, (at.time_s - reached_s) / math.sqrt(12))

    def _ripple_began(self, at: ScanInstant) -> tuple[float, float]:
        """Return instant and sd of the beginning of a slide whose ripple fills a window."""
        return at.time_s - self._rippled_s, self._rippled_s / 4

    def _direction(self, scan: ContactScan, *, is_gross: bool) -> Direction:
        past = [shear for _, _, shear in self._past]
        if self._rippled_s:  # the growth may be over for long
            return opposed(scan, past[-self._n_averaged :])
        return direction(scan, past, self._n_averaged, is_gross=is_gross)

    def _began(self, limit: FloatArray, weights: FloatArray, scan: ContactScan) -> tuple[float, float]:
        """Return mean and sd of the instant at which the ratio last rose beyond a limit (hypotheses,).

        Limits that the ratio has not met count as being met now.
        """
        time_s = np.array([past[0] for past in self._past])
        size = np.array([past[1] for past in self._past])
        below = size[:, np.newaxis] < limit
        # One after the last scan below the limit; the oldest scan where there is none.
        row = np.where(below.any(axis=0), len(size) - np.argmax(below[::-1], axis=0), 0)
        row = np.minimum(row, len(size) - 1)
        unseen_s = np.maximum(time_s[row] - time_s[np.maximum(row - 1, 0)] - _GAP_STEPS * self._step_s, 0.0)
        began_s = time_s[row] - unseen_s / 2  # the ratio may have met the limit at any time of a gap
        met = weights * ~below[-1]
        if met.sum() <= 0:
            met = weights
        mean_s = float(np.average(began_s, weights=met))
        spread = float(np.average((began_s - mean_s) ** 2 + unseen_s**2 / 12, weights=met))
        trend = scan.model.trend
        noise_s = min(trend.value_sd / max(trend.growth, 1e-3), _HISTORY_S)
        return mean_s, math.sqrt(spread + noise_s**2 + self._step_s**2 / 12)
