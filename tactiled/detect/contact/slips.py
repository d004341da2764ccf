"""Slip events from the slips that open and close on the posterior of a contact.

A slip is incipient where a tenth of the contact area slips with at least some probability, and gross where
all of it slides with at least some other (`SlipHysteresis`). An event adds instant, direction and taxels.
"""

import dataclasses
import math
from typing import Literal, NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.contact.direction import AVERAGED, direction, opposed
from tactiled.detect.contact.filter import HISTORY_S, ContactFilter
from tactiled.detect.contact.hysteresis import DIRECTION_S
from tactiled.detect.contact.posterior import FIVE_PERCENT, INCIPIENT_USED
from tactiled.events.types import SlipEvent

DETECTOR = "grip"
_GAP_STEPS = 1.5  # derived: times the time between scans: a longer one is a gap
_FULL = 0.97  # prior: of the ratio at the limit: taxels of unequal friction slip one after the other
# derived: quantiles of a normal distribution in seven equal parts: values of the logarithm of friction, over
# its sd.
_SDS = np.array([-1.465, -0.792, -0.366, 0.0, 0.366, 0.792, 1.465])
_LEAST_PART = 1e-3  # derived: of the load: a taxel with less is not loaded
_LEAST_GROWTH = 1e-3  # derived: 1/s: slower growth does not tell when it began


class Past(NamedTuple):
    """Scans of the last second of a contact, the newest one last."""

    time_s: FloatArray  # (n,)
    p_sliding: FloatArray  # (n,)
    size: FloatArray  # (n,): ratio of shear and load: see `ContactFilter.size`
    shear: FloatArray  # (n, 2, taxels): force of the object on the skin, over the total load


def past_of(contact: ContactFilter) -> Past:
    """Return the scans that a contact has kept."""
    table = contact.kept_scans()
    size = np.array([math.hypot(*ratio) for ratio in table[:, 2:5].tolist()])
    shear = np.ascontiguousarray(table[:, 5:]).reshape(len(table), 2, -1)
    return Past(table[:, 0].copy(), table[:, 1], size, shear)


class PosteriorSlips:
    """Report the slips of contacts.

    Attributes
    ----------
    open : SlipEvent or None
        Newest onset of the slip that goes on.
    """

    def __init__(self, rate_hz: float) -> None:
        self._step_s = 1.0 / rate_hz
        self._n_averaged = max(1, min(AVERAGED, round(DIRECTION_S / self._step_s)))
        self.open: SlipEvent | None = None
        self._ended_s = -math.inf  # the newest slip: the next one begins later

    @property
    def kind(self) -> str:
        """Kind of the slip that goes on; empty for none."""
        return "" if self.open is None else self.open.kind

    def step(
        self, contact: ContactFilter, time_s: float, time_sd_s: float, *, valid: bool
    ) -> list[SlipEvent]:
        """Take the newest scan of a contact and return the slip events that it completes."""
        now = contact.hysteresis
        events: list[SlipEvent] = []
        if self.open is not None and not now.is_open:
            events.append(self.end(contact, time_s, valid=valid))
        if now.is_open and self.open is None:
            self.open = self._slip(contact, time_s, time_sd_s, "incipient", valid=valid)
            events.append(self.open)
        if now.is_gross and self.open is not None and self.open.kind == "incipient":
            self.open = self._slip(contact, time_s, time_sd_s, "gross", valid=valid)
            if events and events[-1].state == "onset":  # both at once go one way
                sd_deg, angle_deg = self.open.direction_sd_deg, self.open.direction_deg
                events[-1] = dataclasses.replace(events[-1], direction_deg=angle_deg, direction_sd_deg=sd_deg)
            events.append(self.open)
        return events

    def end(self, contact: ContactFilter, time_s: float, *, valid: bool) -> SlipEvent:
        """End the slip that goes on, and return its end; the next one begins later."""
        assert self.open is not None
        contact.forget_past()
        ended = dataclasses.replace(self.open, state="end", time_s=time_s, detected_s=time_s, valid=valid)
        self.open, self._ended_s = None, time_s
        return ended

    def _slip(
        self,
        contact: ContactFilter,
        time_s: float,
        time_sd_s: float,
        kind: Literal["incipient", "gross"],
        *,
        valid: bool,
    ) -> SlipEvent:
        past, is_gross = past_of(contact), kind == "gross"
        if contact.rippled_s:  # it fills a window, and the growth may be over for long
            began_s, sd_s = max(time_s - contact.rippled_s, self._ended_s), contact.rippled_s / 4
            towards = opposed(contact, past.shear[-self._n_averaged :])
        else:
            limits = np.array([_FULL * contact.size]) if is_gross else INCIPIENT_USED * _friction(contact)
            began_s, sd_s = self._began(limits, contact, past)
            towards = direction(contact, past.shear, self._n_averaged, is_gross=is_gross)
        if is_gross:
            assert self.open is not None  # a gross slip was an incipient one
            p, threshold = contact.p_sliding_now, contact.hysteresis.gross_p
            taxels = np.flatnonzero(past.shear[-1].any(axis=0)).tolist()  # not those that are out
            began_s = max(began_s, self.open.onset_s)
            if not contact.rippled_s:
                # What slides bears its limit: it did not slide before the ratio came there, nor while sliding
                # was less likely than it is without any sign.
                unlikely = np.flatnonzero(past.p_sliding < contact.prior_p)
                if len(unlikely):
                    began_s = max(began_s, float(past.time_s[unlikely[-1]]))
                sd_s = math.hypot(sd_s, (time_s - began_s) / math.sqrt(12))
        else:
            p, threshold = contact.p_incipient, contact.hysteresis.incipient_p
            taxels = _slipping_taxels(contact, past.shear[-1])
        return SlipEvent(
            time_s=began_s,
            state="onset",
            kind=kind,
            onset_s=began_s,
            onset_sd_s=math.hypot(sd_s, time_sd_s),
            direction_deg=towards.angle_deg,
            direction_sd_deg=towards.sd_deg,
            confidence=p,
            taxels=tuple(taxels),
            detector=DETECTOR,
            statistic=p,
            threshold=threshold,
            valid=valid,
            detected_s=time_s,
        )

    def _began(self, limit: FloatArray, contact: ContactFilter, past: Past) -> tuple[float, float]:
        """Return mean and sd of the instant at which the ratio last rose beyond limits (n,), all as likely.

        Limits that the ratio does not meet now are left out; where it meets none, it meets all of them now.
        """
        time_s, size = past.time_s, past.size
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
        growth = contact.per_friction * contact.signs.growth
        noise_s = min(contact.signs.ratio_noise / max(growth, _LEAST_GROWTH), HISTORY_S)
        return mean_s, math.sqrt(spread + noise_s**2 + self._step_s**2 / 12)


def _friction(contact: ContactFilter) -> FloatArray:
    """Return values of friction that are equally likely."""
    low, median, high = contact.friction_now
    return np.asarray(median * np.exp(_SDS * math.log(high / low) / (2 * FIVE_PERCENT)))


def _slipping_taxels(contact: ContactFilter, shear: FloatArray) -> list[int]:
    """Return the taxels whose own shear uses so much of what their load bears that a tenth of them slips.

    Where a tenth of the contact slips, so does the taxel that uses most, if no other.
    """
    load = np.maximum(np.array(contact.signs.scan_load) / contact.signs.total_load, _LEAST_PART)
    used = np.where(load > _LEAST_PART, np.sqrt((shear**2).sum(axis=0)) / load / contact.friction_now[1], 0.0)
    return np.flatnonzero((used > 0) & (used >= min(INCIPIENT_USED, used.max()))).tolist()
