"""Scores of grip events against the truth of the worlds."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.worlds.laws import HANDS
from bench.worlds.world import World
from tactiled.detect.grip.detector import GripDetector, GripParams
from tactiled.detect.grip.forecast import p_gross_within
from tactiled.detect.grip.model import HORIZONS_S
from tactiled.detect.grip.trend import Trend
from tactiled.events.types import GripEvent

FloatArray = NDArray[np.float64]
_OFF_S = 0.08  # an alarm ends when the probability was below half of its threshold for so long
_SLOW_S = 0.2  # slips that take as long from a tenth of the area to all of it
_AHEAD_S = 0.1


@dataclass(frozen=True, eq=False)
class GripRecord:
    """Estimates of one world, by scan, beside its truth.

    Attributes
    ----------
    time_s, utilisation : (n,) float64
    quantiles : (n, 3) float64
        Estimated utilisation: 5, 50 and 95 %.
    p_gross : (n, 3) float64
    gross : (n,) bool
    told_gross : (n,) bool
    within : (n, 3) bool
        Gross slip begins within each horizon.
    p_bound : (n, 3) float64
        The same forecast from the true utilisation in place of the posterior: what the hand leaves open.
    """

    world: World
    time_s: FloatArray
    utilisation: FloatArray
    quantiles: FloatArray
    p_gross: FloatArray
    gross: NDArray[np.bool_]
    told_gross: NDArray[np.bool_]
    within: NDArray[np.bool_]
    p_bound: FloatArray

    @property
    def calm(self) -> NDArray[np.bool_]:
        """Scans without gross slip now or just before: those at which a forecast is asked for."""
        was = np.zeros(len(self.gross), dtype=np.bool_)
        after = round(0.3 * self.world.rate_hz)
        for k in np.flatnonzero(self.gross):
            was[k : k + after] = True
        return ~was

    @property
    def first_gross_s(self) -> float:
        """First gross slip; infinite where there is none."""
        return self.world.gross_s[0] if self.world.gross_s else np.inf


def tell(world: World, params: GripParams) -> GripRecord:
    """Run the detector over a world."""
    detector = GripDetector(world.array, params)
    found = detector.process(world.block)
    events = [
        event for event in found if isinstance(event, GripEvent) and event.valid and event.state != "none"
    ]
    scans = np.array([round(e.time_s * world.rate_hz) for e in events], dtype=int)
    time_s = scans / world.rate_hz
    begins = np.array([*world.gross_s, np.inf])
    next_gross = begins[np.searchsorted(begins, time_s)] if len(scans) else np.zeros(0)
    return GripRecord(
        world=world,
        time_s=time_s,
        utilisation=np.minimum(world.utilisation[scans], 1.0),
        quantiles=np.array([(e.utilisation_low, e.utilisation, e.utilisation_high) for e in events]).reshape(
            -1, 3
        ),
        p_gross=np.array([(e.p_gross_50ms, e.p_gross_100ms, e.p_gross_300ms) for e in events]).reshape(-1, 3),
        gross=world.gross[scans],
        told_gross=np.array([e.state == "gross" for e in events], dtype=np.bool_),
        within=np.stack([next_gross - time_s <= h for h in HORIZONS_S], axis=1),
        p_bound=_bound(world, events, scans),
    )


def _bound(world: World, events: Sequence[GripEvent], scans: NDArray[np.int64]) -> FloatArray:
    """Return the forecast (n, 3) of a posterior that knows the utilisation."""
    found = np.zeros((len(events), 3))
    if len(events) < 3:
        return found
    radius_mm = float(np.hypot(world.array.x_mm, world.array.y_mm).mean())
    ratios = np.array([(e.shear_x, e.shear_y, e.torsion / radius_mm) for e in events]).reshape(-1, 3)
    ratios /= np.array([e.load for e in events])[:, np.newaxis]
    # The noise of white readings is the standard deviation of their second differences over sqrt(6).
    noise = float(np.median(np.abs(np.diff(ratios, 2, axis=0)))) / 0.6745 / np.sqrt(6)
    trend = Trend()
    for k, (ratio, scan) in enumerate(zip(ratios, scans, strict=True)):
        trend.step(ratio, noise, 1 / world.rate_hz)
        used = np.log([max(float(world.utilisation[scan]), 1e-9)])
        scale = max(trend.size, 1e-2)
        found[k] = p_gross_within(
            used, np.ones(1), trend.growth / scale, trend.rate_sd / scale, trend.is_fresh, HORIZONS_S
        )
    return found


class Forecast(NamedTuple):
    """Quality of a probability over the scans of many worlds."""

    brier_skill: float
    calibration_error: float
    said: FloatArray
    seen: FloatArray
    time_s: FloatArray


def forecast(told: Iterable[GripRecord], horizon: int, *, bound: bool = False) -> Forecast:
    """Brier skill over the base rate, and calibration error over scans with a probability above 0.1.

    Each scan weighs by its time, so that fast boards count no more than slow ones. `bound` scores the
    forecast that knows the utilisation.
    """
    parts = []
    for t in told:
        p = (t.p_bound if bound else t.p_gross)[t.calm, horizon]
        parts.append((p, t.within[t.calm, horizon], np.full(len(p), 1 / t.world.rate_hz)))
    p, y, w = (np.concatenate([part[k] for part in parts]) for k in range(3))
    base = float(np.average(y, weights=w))
    brier = float(np.average((p - y) ** 2, weights=w))
    bins = np.linspace(0, 1, 11)
    which = np.clip(np.digitize(p, bins) - 1, 0, 9)
    count: FloatArray = np.bincount(which, w, 10).astype(np.float64)
    said = np.bincount(which, w * p, 10) / np.maximum(count, 1e-12)
    seen = np.bincount(which, w * y, 10) / np.maximum(count, 1e-12)
    error = float(np.average(np.abs(said - seen)[1:], weights=count[1:])) if count[1:].sum() else np.nan
    return Forecast(1 - brier / max(base * (1 - base), 1e-12), error, said, seen, count)


class Margin(NamedTuple):
    """Errors of the utilisation told, over scans with a true one from 0.5 up."""

    rms: float
    bias: float
    coverage: float


def margin(told: Iterable[GripRecord]) -> Margin:
    """Errors and coverage of the 90 % intervals."""
    errors, inside, weights = [], [], []
    for t in told:
        chosen = (t.utilisation >= 0.5) & ~t.gross
        errors.append(t.quantiles[chosen, 1] - t.utilisation[chosen])
        slack = 1e-3
        inside.append(
            (t.quantiles[chosen, 0] <= t.utilisation[chosen] + slack)
            & (t.utilisation[chosen] <= t.quantiles[chosen, 2] + slack)
        )
        weights.append(np.full(int(chosen.sum()), 1 / t.world.rate_hz))
    e, i, w = np.concatenate(errors), np.concatenate(inside), np.concatenate(weights)
    if not len(e):
        return Margin(np.nan, np.nan, np.nan)
    return Margin(
        float(np.sqrt(np.average(e**2, weights=w))),
        float(np.average(e, weights=w)),
        float(np.average(i, weights=w)),
    )


def alarms(p: FloatArray, threshold: float, rate_hz: float) -> NDArray[np.bool_]:
    """Scans (n,) in alarm: on where the probability (n,) is at the threshold, off below half for `_OFF_S`."""
    on, low = False, 0.0
    out = np.zeros(len(p), dtype=np.bool_)
    for k, now in enumerate(p.tolist()):
        low = 0.0 if now >= threshold / 2 else low + 1 / rate_hz
        on = now >= threshold or (on and low < _OFF_S)
        out[k] = on
    return out


class Warned(NamedTuple):
    """Slips told in time, and the price of it."""

    ahead: list[bool]
    time_in_alarm: float
    per_hour: float


def warned(told: Sequence[GripRecord], threshold: float) -> Warned:
    """Slow slips told 100 ms ahead, and the time in alarm of the scans that no gross slip follows in 1 s."""
    ahead: list[bool] = []
    alarm_s = calm_s = 0.0
    n_alarms = 0
    for t in told:
        if not len(t.time_s):
            continue
        on = alarms(t.p_gross[:, 2], threshold, t.world.rate_hz)
        first = t.first_gross_s
        if (
            np.isfinite(first)
            and first - t.world.tenth_s[0] >= _SLOW_S
            and t.time_s[0] < first - 2 * _AHEAD_S
        ):
            before = (t.time_s <= first - _AHEAD_S) & (t.time_s > first - 1.0)
            ahead.append(bool(on[before][-1]) if before.any() else False)
        free = ~t.gross & (t.time_s < first - 1.0)
        alarm_s += float(on[free].sum()) / t.world.rate_hz
        calm_s += float(free.sum()) / t.world.rate_hz
        n_alarms += int((np.diff(on[free].astype(int)) > 0).sum())
    return Warned(ahead, alarm_s / max(calm_s, 1e-9), 3600 * n_alarms / max(calm_s, 1e-9))


def threshold_for(told: Sequence[GripRecord], time_in_alarm: float) -> float:
    """Return the lowest threshold with at most so much time in alarm."""
    for threshold in np.linspace(0.02, 0.98, 49):
        if warned(told, float(threshold)).time_in_alarm <= time_in_alarm:
            return float(threshold)
    return 1.0


def gross_told(told: Sequence[GripRecord], within_s: float) -> list[bool]:
    """Return, for each world with gross slip, True if its first one was reported as gross within a time."""
    out = []
    for t in told:
        if not t.world.slips or not len(t.time_s) or t.time_s[0] > t.first_gross_s:
            continue
        first = t.first_gross_s
        near = (t.time_s >= first - 0.1) & (t.time_s <= first + within_s)
        out.append(bool(t.told_gross[near].any()))
    return out


def rests_called_gross(told: Sequence[GripRecord], most_used: float = 1.0) -> list[bool]:
    """Return, for each world without gross slip, True if one was reported.

    Parameters
    ----------
    most_used : float
        Worlds whose utilisation exceeds it are left out.
    """
    return [
        bool(t.told_gross.any())
        for t in told
        if not t.world.slips and len(t.time_s) and t.utilisation.max() <= most_used
    ]


def without_falling_friction(told: Iterable[GripRecord]) -> list[GripRecord]:
    """Worlds but those whose friction falls at constant load, which have rows of their own."""
    return [t for t in told if t.world.hand != "falling-friction"]


def by_hand(told: Sequence[GripRecord]) -> dict[str, list[GripRecord]]:
    """Worlds by kind of hand."""
    return {hand: [t for t in told if t.world.hand == hand] for hand in dict.fromkeys(HANDS)}
