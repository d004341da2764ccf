"""The one filter of a contact: from loads and shears of the taxels to a posterior that all events share.

Each look of 20 ms, trees judge the signs of the moment alone (`signs`); the odds that they give enter the
memory (`memory`); other trees weigh memory and a few signs and give the posterior of the state: utilisation
in `EDGES`, or sliding. A third forest gives the time to gross slip of what does not slide yet. All three are
trained by `bench.learnt.fit`.

A slip opens and closes by thresholds on this one posterior, with hysteresis. What is published of the state
follows the slip that is open, so that slip events, grip messages and contact state never differ.
"""

import math
from array import array
from collections.abc import Mapping
from typing import Any, NamedTuple

from bench.learnt.fast import Memory, Signs, Trees
from bench.learnt.gate import SlipGate
from bench.learnt.signs import LOOK_S, NAMES
from tactiled.array import FloatArray

# Utilisation at which a tenth of a ball's area slips in first loading: the sticking share is (1 - u)^(2/3)
# (Mindlin 1949; Johnson, Contact Mechanics, 7.2). Above it, cells are narrow where a controller works.
INCIPIENT_USED = 1.0 - 0.9**1.5
EDGES = (0.0, INCIPIENT_USED, 0.3, 0.45, 0.6, 0.7, 0.8, 0.9, 1.0)
N_STATES = len(EDGES)
"""Cells of utilisation, and sliding, which is the last one."""
HORIZONS_S = (0.05, 0.1, 0.3)
STATE_SIGNS = (
    *("load_unevenness", "loaded_part", "moment", "shear_load_correlation", "ratio", "log_ratio_of_largest"),
    *("since_largest_s", "own_ratio_sd", "own_ratio_most", "ratio_change_80ms", "log_ratio_change_300ms"),
    *("log_load_change_300ms", "above_least_500ms", "ratio_sd_160ms", "wander_noises_160ms", "log_noise"),
    *("ripple_travels", "acceleration", "is_seen"),
)
"""Signs that the second trees are given beside the memory."""
LEAST_GROSS_USED = 0.9  # while a gross slip is open
_QUANTILES = (0.05, 0.5, 0.95)
_FIVE_PERCENT = 1.645
_LEAST_RATIO = 0.02  # below it, the ratio says nothing of friction


class Verdict(NamedTuple):
    """Posterior after a look.

    Attributes
    ----------
    utilisation, friction : tuple of 3 float
        Quantiles of 5, 50 and 95 %; friction in units of the readings.
    slipping_share : float
        Mean part of the contact area that slips.
    p_gross : tuple of 3 float
        That gross slip goes on or begins within `HORIZONS_S`.
    p_sliding, p_incipient : float
        That all of the contact slides now; that a tenth of its area or more slips now.
    """

    utilisation: tuple[float, float, float]
    friction: tuple[float, float, float]
    slipping_share: float
    p_gross: tuple[float, float, float]
    p_sliding: float
    p_incipient: float


class Learnt(NamedTuple):
    """Trees and the base rate of what they were trained on."""

    signs: Trees
    state: Trees
    soon: Trees
    base_odds: float


def learnt_from(table: Mapping[str, Any]) -> Learnt:
    """Make trees from the arrays that `bench.learnt.fit.fit` returns."""

    def forest(name: str) -> Trees:
        prefix = f"{name}."
        return Trees({key.removeprefix(prefix): table[key] for key in table if key.startswith(prefix)})

    return Learnt(forest("signs"), forest("state"), forest("soon"), float(table["base_odds"]))


class ContactFilter:
    """Filter of one contact after the other.

    Parameters
    ----------
    x, y : (taxels,) float64
        Places from their mean, over their mean distance from it.
    rate_hz : float
    shear_per_friction : float
        Reading of shear over that of load at a friction of 1.
    friction, log_sd : float
        Median of friction before any contact, in units of the readings, and sd of its logarithm.
    incipient_p, gross_p : float
        Probabilities from which a slip is open; it closes below half of them.
    learnt : Learnt
    """

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        rate_hz: float,
        shear_per_friction: float,
        friction: float,
        log_sd: float,
        incipient_p: float,
        gross_p: float,
        learnt: Learnt,
    ) -> None:
        self._x, self._y = x.tolist(), y.tolist()
        self.per_friction = shear_per_friction
        self.n_look = max(1, round(LOOK_S * rate_hz))
        self.look_s = self.n_look / rate_hz
        self._learnt = learnt
        self.memory = Memory(friction / shear_per_friction, log_sd, self._learnt.base_odds)
        self._columns = [NAMES.index(name) for name in STATE_SIGNS]
        self._row = array("d", bytes(8 * (len(self._columns) + len(self.memory.row))))
        self.gate = SlipGate(incipient_p, gross_p, self.look_s)
        self.begin(is_seen=True)

    def begin(self, *, is_seen: bool) -> None:
        """Begin a contact, whose touch was seen or not."""
        self.signs = Signs(self._x, self._y, self.look_s, self.per_friction, is_seen=is_seen)
        self.memory.begin_contact()
        self.is_known = is_seen
        """The beginning was seen, or a slide since."""
        self.cells = [1.0 / N_STATES] * N_STATES
        self.p_soon = (0.0, 0.0, 0.0)
        self.gate.close()

    def restart(self) -> None:
        """Begin windows anew, after a gap in which the contact went on."""
        self.signs.restart()
        self.gate.close()

    def end(self) -> None:
        """End the contact."""
        self.memory.end_contact()

    def look(self, noise: float, acceleration: float = math.nan) -> None:
        """Look at the scans that `signs` has taken."""
        signs, memory, learnt, row = self.signs, self.memory, self._learnt, self._row
        signs.look(noise, acceleration)
        learnt.signs.evaluate(signs.row)
        memory.take(_logistic(learnt.signs.scores[0]), signs.ratio, self.look_s)
        for k, column in enumerate(self._columns):
            row[k] = signs.row[column]
        row[len(self._columns) :] = array("d", memory.row)
        learnt.state.evaluate(row)
        self.cells = _softmax(learnt.state.scores)
        learnt.soon.evaluate(row)
        none, _, in_100, in_50 = _softmax(learnt.soon.scores)
        self.p_soon = (in_50, in_50 + in_100, 1.0 - none)
        self.gate.look(1.0 - self.cells[0], self.cells[-1], signs.ratio)
        self.is_known = self.is_known or self.gate.is_gross

    def verdict(self) -> Verdict:
        """Return the posterior, as it is published."""
        cells = self.cells
        if self.gate.is_gross:  # a slip that is open is what is published, until it closes
            cells = [0.0] * (N_STATES - 2) + [cells[-2], max(cells[-1], self.gate.gross_p / 2)]
            total = cells[-2] + cells[-1]
            cells[-2], cells[-1] = cells[-2] / total, cells[-1] / total
        p_soon = tuple(1.0 if self.gate.is_gross else cells[-1] + (1.0 - cells[-1]) * p for p in self.p_soon)
        share = cells[-1]
        for k in range(N_STATES - 1):
            middle = (EDGES[k] + EDGES[k + 1]) / 2
            share += cells[k] * (1.0 - (1.0 - middle) ** (2.0 / 3.0))
        return Verdict(
            utilisation=quantiles(cells),
            friction=self._friction(cells),
            slipping_share=min(share, 1.0),
            p_gross=(p_soon[0], p_soon[1], p_soon[2]),
            p_sliding=cells[-1],
            p_incipient=1.0 - cells[0],
        )

    def _friction(self, cells: list[float]) -> tuple[float, float, float]:
        """Return quantiles of friction: the ratio over utilisation, or memory where it knows more."""
        memory = self.memory
        log_friction, variance = memory.log_friction, memory.variance
        ratio = self.signs.ratio
        if ratio > _LEAST_RATIO:
            mean, square = 0.0, 0.0
            for k, p in enumerate(cells):
                middle = 1.0 if k == N_STATES - 1 else max((EDGES[k] + EDGES[k + 1]) / 2, 0.05)
                log_one = -math.log(middle)
                mean, square = mean + p * log_one, square + p * log_one * log_one
            now = max(square - mean * mean, 0.01)
            if now < variance:
                log_friction, variance = math.log(ratio) + mean, now
        reach = _FIVE_PERCENT * math.sqrt(variance)
        low, median, high = (
            self.per_friction * math.exp(log_friction + sds * reach) for sds in (-1.0, 0.0, 1.0)
        )
        return low, median, high


def _logistic(score: float) -> float:
    return 1.0 / (1.0 + math.exp(-min(max(score, -30.0), 30.0)))


def _softmax(scores: "array[float]") -> list[float]:
    most = max(scores)
    parts = [math.exp(score - most) for score in scores]
    total = sum(parts)
    return [part / total for part in parts]


def quantiles(cells: list[float]) -> tuple[float, float, float]:
    """Return quantiles of utilisation, linear within a cell; sliding is 1."""
    found = []
    for wanted in _QUANTILES:
        up_to, value = 0.0, 1.0
        for k in range(N_STATES - 1):
            if up_to + cells[k] >= wanted:
                value = EDGES[k] + (EDGES[k + 1] - EDGES[k]) * (wanted - up_to) / max(cells[k], 1e-12)
                break
            up_to += cells[k]
        found.append(min(value, 1.0))
    return found[0], found[1], found[2]
