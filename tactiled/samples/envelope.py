"""All straight lines that pass through a set of vertical bands, their mean and their spread.

Set-membership estimation (Milanese, Norton, Piet-Lahanier, Walter (eds.), "Bounding Approaches to System
Identification", Plenum 1996, ch. 1): when errors are bounded and nothing else is known of them, every line
within all bounds is as good as another. A line is a point (y at the first x, y at the last x); a bound is
a half-plane; what is left of the plane is a convex polygon, and its centroid and second moments are the
mean and the covariance of a uniform posterior.
"""

from collections.abc import Sequence
from math import inf, sqrt
from typing import NamedTuple

Point = tuple[float, float]


class Line:
    """A line with the covariance of its two ends.

    Parameters
    ----------
    x0, x1 : float
        Ends; ``x1 > x0``.
    y0, y1 : float
        Mean heights there.
    var00, var01, var11 : float
        Covariance of the heights.
    """

    def __init__(
        self, x0: float, x1: float, y0: float, y1: float, var00: float, var01: float, var11: float
    ) -> None:
        self.x0, self.x1, self.y0 = x0, x1, y0
        self.var00, self.var01, self.var11 = var00, var01, var11
        self.slope = (y1 - y0) / (x1 - x0)

    def at(self, x: float) -> float:
        """Mean height at `x`."""
        return self.y0 + (x - self.x0) * self.slope

    def variance_at(self, x: float) -> float:
        """Variance of the height at `x`; grows outside the ends."""
        u = (x - self.x0) / (self.x1 - self.x0)
        return max((1 - u) * (1 - u) * self.var00 + 2 * u * (1 - u) * self.var01 + u * u * self.var11, 0.0)


class Band(NamedTuple):
    """Constraint on the line: above `low` (or -inf) at `low_x`, below `high` at `high_x`."""

    low_x: float
    low: float
    high_x: float
    high: float
    is_answered: bool = False  # `low` is of a ping: no host, however busy, makes it too high


class Lines:
    """Estimate from a set of bands, with and without the limit on the slope.

    Parameters
    ----------
    line : Line
        The estimate.
    free : Line
        Mean of the lines with no limit but `steepest`. Where it differs from `line`, the limit decides, not
        the data; `sd_at` adds the distance.
    is_steep : bool
        The bands contradict the limit on the slope; `line` is then equal to `free`.
    """

    def __init__(self, line: Line, free: Line, is_steep: bool) -> None:
        self.line, self.free, self.is_steep = line, free, is_steep

    def sd_at(self, x: float) -> float:
        """Standard deviation of the height at `x`."""
        difference = self.free.at(x) - self.line.at(x)
        return sqrt(self.line.variance_at(x) + difference * difference)


OPEN_S = 1.0  # assumed width where no band has a lower bound; timers of adapters are shorter
# A step of the clock or a stall may contradict a few bands. A slope beyond the limit is accepted only where
# it satisfies at least STEEP_BANDS bands, and STEEP_FACTOR times as many as lines within the limit.
STEEP_BANDS = 3
STEEP_FACTOR = 2


def lines_through(bands: Sequence[Band], max_slope: float, steepest: float) -> Lines:
    """Compute the mean of all lines through the bands, and decide whether the slope limit applies.

    Parameters
    ----------
    bands : sequence of Band
        At least two, whose `high_x` increases. A bound that contradicts newer ones is ignored: the line has
        bent since then (a clock was slewed), or the bound was wrong.
    max_slope : float
        Expected largest slope.
    steepest : float
        Largest possible slope; at least `max_slope`.
    """
    # Indices are never negative: the compiled form does not count from the end.
    x0, x1 = bands[0].high_x, bands[len(bands) - 1].high_x
    free, n_free = _feasible(bands, steepest, steepest)
    span = x1 - x0
    limited = _clip(_clip(free, -1.0, 1.0, max_slope * span), 1.0, -1.0, max_slope * span)
    n_limited = n_free
    if not limited or n_free < len(bands):
        limited, n_limited = _feasible(bands, max_slope, steepest)
    without = Line(x0, x1, *_moments(free))
    if n_free >= max(STEEP_BANDS, STEEP_FACTOR * n_limited) and abs(without.slope) > max_slope:
        return Lines(without, without, True)
    within = Line(x0, x1, *_moments(limited))
    return Lines(within, without if n_free >= n_limited else within, False)


def _feasible(bands: Sequence[Band], max_slope: float, steepest: float) -> tuple[list[Point], int]:
    """Polygon of the lines through the bands, and the number of newest bands without a contradiction."""
    x0, x1 = bands[0].high_x, bands[len(bands) - 1].high_x
    span = x1 - x0
    least = min((band.low for band in bands if band.low > -inf), default=bands[len(bands) - 1].high - OPEN_S)
    floor = least - max_slope * span
    top = max(band.high for band in bands) + max_slope * span
    polygon: list[Point] = [(floor, floor), (top, floor), (top, top), (floor, top)]
    # Never empty, whatever the numbers: the compiled form reads corners without a check.
    polygon = _clip(polygon, -1.0, 1.0, max_slope * span) or polygon
    polygon = _clip(polygon, 1.0, -1.0, max_slope * span) or polygon
    # An answer holds where the line has bent since, too, by `steepest` at most. Without this bound, arrivals
    # after the last answer let the line fall to those before the bend.
    answers = [band.low - steepest * abs(x1 - band.low_x) for band in bands if band.is_answered]
    if answers:
        polygon = _clip(polygon, 0.0, -1.0, -min(max(answers), bands[len(bands) - 1].high)) or polygon
    held, contradicted = 0, False
    for band in reversed(bands):
        u = (band.high_x - x0) / span
        under = _clip(polygon, 1 - u, u, band.high)
        polygon = under or polygon
        u = (band.low_x - x0) / span
        over = _clip(polygon, u - 1, -u, -band.low) if band.low > -inf else polygon
        polygon = over or polygon
        contradicted = contradicted or not (under and over)
        held += not contradicted
    return polygon, held


def _clip(polygon: list[Point], a: float, b: float, limit: float) -> list[Point]:
    """Part of a convex polygon where ``a p + b q <= limit`` (Sutherland, Hodgman 1974)."""
    kept: list[Point] = []
    if not polygon:
        return kept
    p1, q1 = polygon[len(polygon) - 1]
    over1 = a * p1 + b * q1 - limit
    for p2, q2 in polygon:
        over2 = a * p2 + b * q2 - limit
        if (over1 > 0) != (over2 > 0):
            share = over1 / (over1 - over2)
            kept.append((p1 + share * (p2 - p1), q1 + share * (q2 - q1)))
        if over2 <= 0:
            kept.append((p2, q2))
        p1, q1, over1 = p2, q2, over2
    return kept


def _moments(polygon: list[Point]) -> tuple[float, float, float, float, float]:
    """Centroid and covariance of a convex polygon, by its fan of triangles.

    Of one triangle with corners v, about any origin: E[z z'] = (sum v v' + (sum v)(sum v)') / 12.
    """
    p0, q0 = polygon[0]
    area = mp = mq = mpp = mpq = mqq = 0.0
    for k in range(1, len(polygon) - 1):
        pa, qa = polygon[k]
        pb, qb = polygon[k + 1]
        ap, aq, bp, bq = pa - p0, qa - q0, pb - p0, qb - q0
        weight = ap * bq - aq * bp
        sp, sq = ap + bp, aq + bq
        area += weight
        mp += weight * sp / 3
        mq += weight * sq / 3
        mpp += weight * (ap * ap + bp * bp + sp * sp) / 12
        mpq += weight * (ap * aq + bp * bq + sp * sq) / 12
        mqq += weight * (aq * aq + bq * bq + sq * sq) / 12
    if abs(area) < 1e-18:  # the bounds meet in a point or on a segment: take the mean of its corners
        n = len(polygon)
        return sum(p for p, _ in polygon) / n, sum(q for _, q in polygon) / n, 0.0, 0.0, 0.0
    mp, mq = mp / area, mq / area
    return p0 + mp, q0 + mq, mpp / area - mp * mp, mpq / area - mp * mq, mqq / area - mq * mq
