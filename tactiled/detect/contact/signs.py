"""Signs of sliding and of partial slip in the loads and shears of the taxels, a row each look of 20 ms.

Every sign has a name in `NAMES`. Ratios are shear over load, in units in which they are friction where the
skin slides; parts of taxels are over the mean load of a taxel. Details are those of the stationary coif1
transform over looks (Mallat, A Wavelet Tour of Signal Processing, 3rd ed., 5.5), causal: level 1 is 12 to 25
changes a second, level 2 is 6 to 12 and level 3 is 3 to 6.
"""

from array import array
from collections.abc import Mapping, Sequence
from math import log, sqrt

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.signal.front_end import zeros
from tactiled.detect.signal.wavelet import exact_taps

LOOK_S = 0.02  # choice: a controller acts no faster, and neighbouring scans tell the same
"""Time between looks; each scan is a look where scans are farther apart."""
# choice: from two looks to a slow grip, each about twice the one before. The trees take from them what they
# need.
_TIMES_S = (0.04, 0.08, 0.16, 0.3, 0.5)
# derived: of these times: that of the growth, and that of a mean as long as the longest forecast
_GROWTH_S, _MEAN_S = _TIMES_S[1], _TIMES_S[3]
WINDOWS_S: Mapping[str, tuple[float, ...]] = {
    "change": _TIMES_S,
    "turn": _TIMES_S[1:4],
    "spread": _TIMES_S[2::2],
    "wander": _TIMES_S[:4],
    "moves": _TIMES_S[1:],
}
"""Windows of the signs by kind."""
LEVELS = (1, 2, 3)  # choice
# choice: longest window and time of a sign; `largest` and `dropped_from` last as long as the contact
_LONGEST_S = 1.0
LEAST_RATIO = 0.01  # derived: below it the logarithm of a ratio is that of noise
_EVEN = 0.03  # prior: of the mean load: where loads differ by less, they say nothing of the shears
_UNKNOWN = float("nan")
_LOADED = 0.25  # prior: of the mean load: a taxel with less has no ratio of its own
# prior: of the ratio before: a fall to less within a tenth of a second is a jerk of the object
_SUDDEN_DROP = 0.85
_DROP_S = 0.1  # prior: so long a jerk takes
# choice: parts of the newest ratio; when it was last below each of them tells in which course it grew.
_PARTS = (0.5, 0.9, 0.95, 0.98)
_LAST_PART = 0.2  # derived: (0.98 - 0.9) / (0.9 - 0.5) of `_PARTS`: in an even growth
_KEPT = 0.1  # prior: change of the ratio, in parts of it, up to which a course tells how it came about
# choice: a ripple of 0.2 to 20 Hz between two leaky means, and the time over which its delays are averaged.
_RIPPLE_FAST_S, _RIPPLE_SLOW_S, _RIPPLE_MEAN_S = 0.03, 0.8, 1.5


def _ms(kind: str) -> list[str]:
    return [f"{1000 * time_s:.0f}ms" for time_s in WINDOWS_S[kind]]


NAMES: tuple[str, ...] = (
    *("load_unevenness", "loaded_part", "moment", "shear_on_load", "shear_load_correlation", "across_part"),
    *("ratio", "ratio_mean", "ratio_largest", "log_ratio_of_largest", "since_largest_s"),
    *("own_ratio_sd", "own_ratio_least", "own_ratio_most"),
    *(f"ratio_change_{t}" for t in _ms("change")),
    *(f"log_ratio_change_{t}" for t in _ms("change")),
    *(f"log_load_change_{t}" for t in _ms("change")),
    *(f"turn_{t}" for t in _ms("turn")),
    *(f"{kind}_{t}" for t in _ms("spread") for kind in ("above_least", "below_most", "ratio_sd")),
    *(f"wander_{t}" for t in _ms("wander")),
    *(f"wander_noises_{t}" for t in _ms("wander")),
    *(f"load_moves_{t}" for t in _ms("moves")),
    *(f"load_moves_noises_{t}" for t in _ms("moves")),
    *(f"detail_{level}" for level in LEVELS),
    *(f"detail_noises_{level}" for level in LEVELS),
    *(f"detail_common_{level}" for level in LEVELS),
    *(f"since_below_{100 * part:.0f}_s" for part in _PARTS),
    *("log_growth_s", "growth_slows"),
    *("roughness", "roughness_noises", "load_jerk", "log_ratio_of_drop", "log_noise"),
    *("ripple", "ripple_travels", "acceleration", "is_seen"),
)
# derived: places of the signs in a row: the first of each kind.
_SHAPE, _RATIO, _OWN = (NAMES.index(name) for name in ("load_unevenness", "ratio", "own_ratio_sd"))
_CHANGES, _TURNS, _SPREADS = (
    NAMES.index(name) for name in ("ratio_change_40ms", "turn_80ms", "above_least_160ms")
)
_WANDER, _DETAILS, _SINCE = (NAMES.index(name) for name in ("wander_40ms", "detail_1", "since_below_50_s"))
_GROWTH, _ROUGHNESS, _JERK = (NAMES.index(name) for name in ("log_growth_s", "roughness", "load_jerk"))
_NOISE, _RIPPLE, _HAND = (NAMES.index(name) for name in ("log_noise", "ripple", "acceleration"))
_MOVES = NAMES.index("load_moves_80ms")


class Signs:
    """Signs of one contact after the other.

    Parameters
    ----------
    x, y : sequence of float
        Places of the taxels from their mean, over their mean distance from it.
    shear_per_friction : float
        Reading of shear over that of load at a friction of 1.

    Attributes
    ----------
    row : array of float
        Newest signs, in the order of `NAMES`.
    ratio_x, ratio_y, turn, ratio : float
        Newest ratio of shear and load along x and y, its moment over the mean distance of the taxels from
        their centre, and the length of all three: friction, by the ellipsoid of Howe and Cutkosky (1996),
        where the contact slips.
    growth : float
        Change of the ratio's length over 80 ms, 1/s.
    ratio_noise : float
        Standard deviation of the ratio in one scan, in units of the readings.
    over_load : (2 * taxels,) array of float
        Shears along x, then along y, of the newest scan over its total load, in units of the readings.
    total_x, total_y, moment, total_load : float
        Of the newest scan, in units of the readings.
    """

    def __init__(
        self,
        x: Sequence[float],
        y: Sequence[float],
        look_s: float,
        shear_per_friction: float = 1.0,
    ) -> None:
        n = len(x)
        self.n_taxels = n
        self.look_s = look_s
        self.x, self.y = array("d", x), array("d", y)
        self.shear_per_friction, self.shear_scale = shear_per_friction, 1.0 / shear_per_friction
        self.scan_load, self.scan_x, self.scan_y = zeros(n), zeros(n), zeros(n)
        self.over_load = zeros(2 * n)
        self.load, self.shear_x, self.shear_y = zeros(n), zeros(n), zeros(n)
        self.row = zeros(len(NAMES))
        looks = {
            kind: array("q", [_looks(time_s, look_s) for time_s in times_s])
            for kind, times_s in WINDOWS_S.items()
        }
        self.change_looks, self.turn_looks = looks["change"], looks["turn"]
        self.spread_looks, self.wander_looks = looks["spread"], looks["wander"]
        self.move_looks = looks["moves"]
        self.n_growth, self.n_mean = _looks(_GROWTH_S, look_s), _looks(_MEAN_S, look_s)
        self.n_drop = _looks(_DROP_S, look_s)
        filters = [exact_taps(level, sqrt(2.0)) for level in LEVELS]  # of the gain of a normalised transform
        self.taps = array("d", [tap for one in filters for tap in one])
        self.n_taps = array("q", [len(one) for one in filters])
        self.n_longest = _looks(_LONGEST_S, look_s) + 1
        self.length = max(self.n_longest, *(len(one) for one in filters))
        self.past_x, self.past_y, self.past_ratio = (zeros(self.length) for _ in range(3))
        self.parts = array("d", _PARTS)
        self.since = zeros(len(_PARTS))
        self.past_log_ratio, self.past_log_load = zeros(self.length), zeros(self.length)
        self.parts_x, self.parts_y = zeros(self.length * n), zeros(self.length * n)
        self.load_parts = zeros(self.length * n)
        self.pairs = _neighbours(x, y)
        self.fast, self.slow, self.lag, self.power = zeros(n), zeros(n), zeros(n), zeros(n)
        self.turns = zeros(len(self.pairs) // 2)
        self.keep_fast, self.keep_slow, self.keep_mean = (
            1.0 - min(1.0, look_s / t) for t in (_RIPPLE_FAST_S, _RIPPLE_SLOW_S, _RIPPLE_MEAN_S)
        )
        self.begin(is_seen=True)

    def begin(self, *, is_seen: bool) -> None:
        """Begin a contact, whose touch was seen or not."""
        self.is_seen = 1.0 if is_seen else 0.0
        self.ratio_x = self.ratio_y = self.turn = self.ratio = self.growth = self.whole = self.ratio_noise = (
            0.0
        )
        self.total_x = self.total_y = self.moment = self.total_load = 0.0
        for k in range(len(self.parts)):
            self.since[k] = 0.0
        self.restart()

    def restart(self) -> None:
        """Begin all windows anew, after a gap."""
        self.n = 0
        self.at = -1
        self.largest = self.dropped_from = 0.0
        self.since_largest_s = 0.0
        self.grown_to = 0.0
        self.log_growth_s = self.growth_slows = _UNKNOWN
        self.n_scans = 0
        self.steps2 = 0.0

    def take(self, reading: FloatArray, zero: FloatArray) -> None:
        """Add a scan to the look.

        Parameters
        ----------
        reading : (3 * taxels,) float64
            Loads, shears along x and shears along y.
        zero : (2 * taxels,) float64
            Shear that pressing alone makes, over the load.
        """
        n, scale, total_x, total_y, moment, total = self.n_taxels, self.shear_scale, 0.0, 0.0, 0.0, 0.0
        is_first = self.n_scans == 0
        goes_on = self.n > 0 or self.n_scans > 0
        for k in range(n):
            load = reading[k]
            x = reading[n + k] - zero[k] * load
            y = reading[2 * n + k] - zero[n + k] * load
            total += load
            total_x += x
            total_y += y
            moment += self.x[k] * y - self.y[k] * x
            self.over_load[k], self.over_load[n + k] = x, y
            x *= scale
            y *= scale
            load = max(load, 0.0)
            self.load[k] = load if is_first else self.load[k] + load
            self.shear_x[k] = x if is_first else self.shear_x[k] + x
            self.shear_y[k] = y if is_first else self.shear_y[k] + y
            if goes_on:
                dx, dy = x - self.scan_x[k], y - self.scan_y[k]
                self.steps2 += dx * dx + dy * dy
            self.scan_load[k], self.scan_x[k], self.scan_y[k] = load, x, y
        whole = max(total, 1e-12)
        for k in range(2 * n):
            self.over_load[k] /= whole
        self.n_scans += 1
        self.total_x, self.total_y, self.moment, self.total_load = total_x, total_y, moment, total

    def look(self, noise: float, acceleration: float) -> None:
        """Look at the scans since the last look.

        Parameters
        ----------
        noise : float
            Standard deviation of a taxel's shear in one scan, in units of the readings.
        acceleration : float
            Of the hand, as announced, m/s^2; NaN where it is not.
        """
        n_scans = max(self.n_scans, 1)
        for k in range(self.n_taxels):
            self.load[k] /= n_scans
            self.shear_x[k] /= n_scans
            self.shear_y[k] /= n_scans
        self.ratio_noise = noise * sqrt(self.n_taxels) / max(self.total_load, 1e-12)
        noise *= self.shear_scale
        roughness = sqrt(self.steps2 / (2.0 * n_scans * self.n_taxels))
        self.n_scans, self.steps2 = 0, 0.0
        self._store()
        noise_scan = noise
        noise = noise / sqrt(n_scans)
        self._take_shape()
        self._take_course()
        self._take_growth()
        self._take_wander(noise)
        self._take_moves(noise * self.shear_per_friction)
        self._take_ripple()
        row, mean = self.row, self.whole / self.n_taxels
        row[_ROUGHNESS] = roughness / mean
        row[_ROUGHNESS + 1] = roughness / max(noise_scan, 1e-12)
        row[_NOISE] = log(max(noise / mean, 1e-6))
        row[_HAND] = acceleration
        row[_HAND + 1] = self.is_seen

    def _store(self) -> None:
        """Put the look into the windows; the first look fills them."""
        n, whole, total_x, total_y, turn = self.n_taxels, 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            whole += self.load[k]
            total_x += self.shear_x[k]
            total_y += self.shear_y[k]
            turn += self.x[k] * self.shear_y[k] - self.y[k] * self.shear_x[k]
        whole = max(whole, 1e-12)
        self.whole = whole
        self.ratio_x, self.ratio_y = total_x / whole, total_y / whole
        self.turn = turn / whole
        planar2 = self.ratio_x * self.ratio_x + self.ratio_y * self.ratio_y
        self.ratio = sqrt(planar2 + self.turn * self.turn)
        first = self.n == 0
        self.n += 1
        for _ in range(self.length if first else 1):
            self.at = self.at + 1 if self.at + 1 < self.length else 0
            at = self.at
            self.past_x[at], self.past_y[at], self.past_ratio[at] = self.ratio_x, self.ratio_y, self.ratio
            self.past_log_ratio[at] = log(max(self.ratio, LEAST_RATIO))
            self.past_log_load[at] = log(whole)
            for k in range(n):
                self.parts_x[at * n + k] = self.shear_x[k] / whole
                self.parts_y[at * n + k] = self.shear_y[k] / whole
                self.load_parts[at * n + k] = self.load[k] / whole
        if first:
            for k in range(n):
                self.fast[k] = self.slow[k] = self.load[k] / whole
                self.lag[k] = self.power[k] = 0.0
            for p in range(len(self.turns)):
                self.turns[p] = 0.0

    def _back(self, looks: int) -> int:
        """Return the place of the look so many looks ago."""
        at = self.at - looks
        return at if at >= 0 else at + self.length

    def _take_shape(self) -> None:
        """Signs of one instant: how load and shear are spread over the taxels."""
        n, row, whole, ratio = self.n_taxels, self.row, self.whole, max(self.ratio, LEAST_RATIO)
        mean = whole / n
        planar = sqrt(self.ratio_x * self.ratio_x + self.ratio_y * self.ratio_y)
        cos, sin = self.ratio_x / max(planar, LEAST_RATIO), self.ratio_y / max(planar, LEAST_RATIO)
        loads2, crossed, along2, across2 = 0.0, 0.0, 0.0, 0.0
        own, own2, least, most, n_loaded = 0.0, 0.0, 1e9, -1e9, 0
        mean_along = planar * mean
        for k in range(n):
            load, x, y = self.load[k], self.shear_x[k], self.shear_y[k]
            along, across = cos * x + sin * y, cos * y - sin * x
            loads2 += (load - mean) * (load - mean)
            crossed += (load - mean) * (along - mean_along)
            along2 += (along - mean_along) * (along - mean_along)
            across2 += across * across
            if load > _LOADED * mean:
                one = along / load
                own += one
                own2 += one * one
                least, most, n_loaded = min(least, one), max(most, one), n_loaded + 1
        row[_SHAPE] = sqrt(loads2 / n) / mean
        row[_SHAPE + 1] = float(n_loaded) / n
        row[_SHAPE + 2] = abs(self.turn)
        if loads2 > n * _EVEN * _EVEN * mean * mean:
            row[_SHAPE + 3] = crossed / loads2 / ratio
            row[_SHAPE + 4] = crossed / max(sqrt(loads2 * along2), 1e-6 * mean * mean)
        else:
            row[_SHAPE + 3] = row[_SHAPE + 4] = _UNKNOWN
        row[_SHAPE + 5] = sqrt(across2 / n) / (mean * ratio)
        n_own = max(n_loaded, 1)
        own /= n_own
        row[_OWN] = sqrt(max(own2 / n_own - own * own, 0.0)) / ratio
        row[_OWN + 1] = least / ratio if n_loaded else 0.0
        row[_OWN + 2] = most / ratio if n_loaded else 0.0

    def _take_course(self) -> None:
        """Signs of the course of the ratio and of the load."""
        row, at, ratio = self.row, self.at, self.ratio
        total = 0.0
        for j in range(self.n_mean):
            total += self.past_ratio[self._back(j)]
        if ratio >= self.largest:
            self.largest, self.since_largest_s = ratio, 0.0
        else:
            self.since_largest_s += self.look_s
        scale = max(ratio, LEAST_RATIO)
        row[_RATIO], row[_RATIO + 1], row[_RATIO + 2] = ratio, total / self.n_mean, self.largest
        row[_RATIO + 3] = log(scale / max(self.largest, LEAST_RATIO))
        row[_RATIO + 4] = min(self.since_largest_s, _LONGEST_S)
        kinds = len(self.change_looks)
        for j in range(kinds):
            back = self._back(self.change_looks[j])
            row[_CHANGES + j] = ratio - self.past_ratio[back]
            row[_CHANGES + kinds + j] = self.past_log_ratio[at] - self.past_log_ratio[back]
            row[_CHANGES + 2 * kinds + j] = self.past_log_load[at] - self.past_log_load[back]
        for j in range(len(self.turn_looks)):
            back = self._back(self.turn_looks[j])
            crossed = self.ratio_x * self.past_y[back] - self.ratio_y * self.past_x[back]
            row[_TURNS + j] = abs(crossed) / (scale * max(self.past_ratio[back], LEAST_RATIO))
        for j in range(len(self.spread_looks)):
            looks = self.spread_looks[j] + 1
            least, most, mean, squares = 1e9, 0.0, 0.0, 0.0
            for i in range(looks):
                one = self.past_ratio[self._back(i)]
                least, most = min(least, one), max(most, one)
                mean += one
                squares += one * one
            mean /= looks
            row[_SPREADS + 3 * j] = (ratio - least) / scale
            row[_SPREADS + 3 * j + 1] = (most - ratio) / scale
            row[_SPREADS + 3 * j + 2] = sqrt(max(squares / looks - mean * mean, 0.0)) / scale
        before = self.past_ratio[self._back(self.n_growth)]
        self.growth = (ratio - before) / (self.n_growth * self.look_s)
        before = self.past_ratio[self._back(self.n_drop)]
        if ratio < _SUDDEN_DROP * before:
            self.dropped_from = before
        log_load = self.past_log_load
        row[_JERK] = abs(log_load[at] - 2.0 * log_load[self._back(1)] + log_load[self._back(2)])
        row[_JERK + 1] = log(scale / max(self.dropped_from, LEAST_RATIO)) if self.dropped_from > 0 else 0.0

    def _take_growth(self) -> None:
        """Signs of the course in which the ratio grew to where it is.

        A contact that is moved comes to its limit in tenths of a millimetre, and slower the nearer it is; at
        even speed by Mindlin's curve, ``1 - (1 - x)^(3/2)``. A load that is laid on comes evenly and stops; a
        hand ends by minimum jerk (Flash and Hogan, J. Neurosci. 5, 1985). The course of the last growth is
        kept for as long as the ratio is.
        """
        row, now, longest = self.row, self.past_ratio[self.at], min(self.n, self.n_longest) - 1
        back, after = 0, now
        for j in range(len(self.parts) - 1, -1, -1):
            value = self.parts[j] * now
            while back < longest:
                before = self.past_ratio[self._back(back + 1)]
                if before < value:
                    break
                after = before
                back += 1
            if back < longest:
                self.since[j] = self.look_s * (back + (after - value) / max(after - before, 1e-12))
            else:
                self.since[j] = _LONGEST_S
            row[_SINCE + j] = self.since[j]
        if self.since[0] < _LONGEST_S:
            least_s = 0.5 * self.look_s
            self.grown_to = now
            self.log_growth_s = log(max(self.since[0] - self.since[2], least_s))
            even_s = _LAST_PART * max(self.since[0] - self.since[1], least_s)
            self.growth_slows = log(max(self.since[1] - self.since[3], least_s) / even_s)
        elif abs(now - self.grown_to) > _KEPT * self.grown_to:
            self.log_growth_s = self.growth_slows = _UNKNOWN
        row[_GROWTH] = self.log_growth_s
        row[_GROWTH + 1] = self.growth_slows

    def _take_wander(self, noise: float) -> None:
        """Signs of taxels that move on their own: changes of their parts, and wavelet details."""
        n, row, at = self.n_taxels, self.row, self.at
        relative = max(noise / self.whole, 1e-12)
        kinds = len(self.wander_looks)
        for j in range(kinds):
            back = self._back(self.wander_looks[j])
            change_x, change_y = self.ratio_x - self.past_x[back], self.ratio_y - self.past_y[back]
            squares = 0.0
            for k in range(n):
                part = self.load[k] / self.whole
                dx = self.parts_x[at * n + k] - self.parts_x[back * n + k] - part * change_x
                dy = self.parts_y[at * n + k] - self.parts_y[back * n + k] - part * change_y
                squares += dx * dx + dy * dy
            size = sqrt(squares / n)
            row[_WANDER + j] = size * n
            row[_WANDER + kinds + j] = size / relative
        kinds, first = len(self.n_taps), 0
        for j in range(kinds):
            taps = self.n_taps[j]
            common_x, common_y, squares = 0.0, 0.0, 0.0
            for i in range(taps):
                back = self._back(i)
                common_x += self.taps[first + i] * self.past_x[back]
                common_y += self.taps[first + i] * self.past_y[back]
            for k in range(n):
                dx, dy = 0.0, 0.0
                for i in range(taps):
                    back = self._back(i) * n + k
                    dx += self.taps[first + i] * self.parts_x[back]
                    dy += self.taps[first + i] * self.parts_y[back]
                part = self.load[k] / self.whole
                dx -= part * common_x
                dy -= part * common_y
                squares += dx * dx + dy * dy
            size = sqrt(squares / n)
            row[_DETAILS + j] = size * n
            row[_DETAILS + kinds + j] = size / relative
            row[_DETAILS + 2 * kinds + j] = sqrt(common_x * common_x + common_y * common_y)
            first += taps

    def _take_moves(self, noise: float) -> None:
        """Signs of load that moves over the taxels: what slides or turns takes its pressures along.

        The noise is that of a taxel's shear in a look, in units of the readings, taken for that of its load.
        """
        n, row, at = self.n_taxels, self.row, self.at
        relative = max(noise / self.whole, 1e-12)
        kinds = len(self.move_looks)
        for j in range(kinds):
            back = self._back(self.move_looks[j])
            squares = 0.0
            for k in range(n):
                change = self.load_parts[at * n + k] - self.load_parts[back * n + k]
                squares += change * change
            row[_MOVES + j] = sqrt(squares)
            row[_MOVES + kinds + j] = sqrt(squares / n) / relative

    def _take_ripple(self) -> None:
        """Signs of a ripple of the loads: its size, and the part of it that travels from taxel to taxel.

        Two taxels that a wave meets one after the other have a product of the one with the rate of the other
        that keeps its sign; a ripple of all at once has none.
        """
        n, size, travels = self.n_taxels, 0.0, 0.0
        for k in range(n):
            part = self.load[k] / self.whole
            self.fast[k] = self.keep_fast * self.fast[k] + (1.0 - self.keep_fast) * part
            self.slow[k] = self.keep_slow * self.slow[k] + (1.0 - self.keep_slow) * part
            wave = self.fast[k] - self.slow[k]
            self.power[k] = self.keep_mean * self.power[k] + (1.0 - self.keep_mean) * wave * wave
            size += self.power[k]
        for p in range(len(self.turns)):
            a, b = self.pairs[2 * p], self.pairs[2 * p + 1]
            wave_a, wave_b = self.fast[a] - self.slow[a], self.fast[b] - self.slow[b]
            turn = wave_a * self.lag[b] - wave_b * self.lag[a]
            self.turns[p] = self.keep_mean * self.turns[p] + (1.0 - self.keep_mean) * turn
            travels += abs(self.turns[p])
        for k in range(n):  # the wave some time ago, for the rate of the next looks
            wave = self.fast[k] - self.slow[k]
            self.lag[k] = self.keep_fast * self.lag[k] + (1.0 - self.keep_fast) * wave
        self.row[_RIPPLE] = sqrt(size / n) * n
        self.row[_RIPPLE + 1] = travels / max(len(self.turns), 1) / max(size / n, 1e-12)


def _looks(time_s: float, look_s: float) -> int:
    return max(1, round(time_s / look_s))


def _neighbours(x: Sequence[float], y: Sequence[float]) -> "array[int]":
    """Return the pairs of taxels that are next to each other, one after the other."""
    apart2 = np.subtract.outer(x, x) ** 2 + np.subtract.outer(y, y) ** 2
    nearest2 = np.sort(np.where(np.eye(len(x)) > 0, np.inf, apart2).min(axis=1))
    limit2 = 1.5 * nearest2[len(x) // 2]  # next to, and not across
    return array("q", np.argwhere(np.tril(apart2 <= limit2, -1)).ravel())
