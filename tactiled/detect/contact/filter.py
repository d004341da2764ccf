"""The one filter of a contact: from loads and shears of the taxels to a posterior that all messages share.

Each look of 20 ms, trees judge the signs of the moment alone (`signs`); the odds that they give enter the
memory (`memory`); other trees weigh the memory and a few signs and give the posterior of the state
(`posterior`): utilisation in cells, or sliding. The log odds of sliding are the mean of those by both. A
third forest gives the time to gross slip of what does not slide yet. All three are trained by
``./run train slip``.

A slip opens and closes by thresholds on this one posterior, with hysteresis (`gate`). What is published of
the state follows the slip that is open, so that slip events, grip messages and contact state never differ.
"""

import math
from typing import NamedTuple

from tactiled.array import FloatArray
from tactiled.detect.contact.fast import Memory, Posterior, Signs
from tactiled.detect.contact.friction import FrictionMemory, kept_load
from tactiled.detect.contact.gate import OFF, SlipHysteresis
from tactiled.detect.contact.learnt import Learnt
from tactiled.detect.contact.memory import NAMES as MEMORY_NAMES
from tactiled.detect.contact.posterior import LEAST_GROSS_USED, RIPPLE_P
from tactiled.detect.contact.signs import GROWTH_S, LOOK_S, NAMES

HORIZONS_S = (0.05, 0.1, 0.3)  # choice
STATE_SIGNS = (
    *("load_unevenness", "loaded_part", "moment", "shear_load_correlation", "ratio", "log_ratio_of_largest"),
    *("since_largest_s", "own_ratio_sd", "own_ratio_most", "ratio_change_80ms", "log_ratio_change_300ms"),
    *("log_load_change_300ms", "above_least_500ms", "ratio_sd_160ms", "wander_noises_160ms", "log_noise"),
    *("ripple_travels", "acceleration", "is_seen"),
)
"""Signs that the second trees are given beside the memory."""
ROW_NAMES = (*NAMES, *STATE_SIGNS, *MEMORY_NAMES)
"""Names of the inputs by place: of the first trees, then of the second ones."""
LOAD_CHANGE = NAMES.index("log_load_change_300ms")
_ODDS = MEMORY_NAMES.index("odds")
_LEAST_RATIO = 0.02  # physical: that a slide bears: the friction of wet ice


class Verdict(NamedTuple):
    """Posterior after a look."""

    # utilisation, friction: quantiles of 5, 50 and 95 %; friction in units of the readings
    utilisation: tuple[float, float, float]
    friction: tuple[float, float, float]
    slipping_share: float  # mean part of the contact area that slips
    # That gross slip begins within `HORIZONS_S`, if the contact does not slide yet; 1 while a gross slip is
    # open
    p_gross: tuple[float, float, float]
    p_sliding: float  # that all of the contact slides now


class ContactFilter:
    """Filter of one contact after the other.

    Parameters
    ----------
    x, y : (taxels,) float64
        Places from their mean, over their mean distance from it.
    shear_per_friction : float
        Reading of shear over that of load at a friction of 1.
    friction, log_sd : float
        Median of friction before any contact, in units of the readings, and sd of its logarithm.
    incipient_p, gross_p : float
        Probabilities from which a slip is open; it closes below a third of them.

    Attributes
    ----------
    gate : SlipHysteresis
        Slips at these two probabilities, which `verdict` follows.
    is_known : bool
        The zero of the shear was known at a look, or a slide was seen.
    slid_at : float
        Largest ratio since the gross slip opened that is open; 0.0 without one. A hand that grips harder
        lowers the ratio of a slide: friction is what the slide bore.
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
        self.memory = Memory(learnt.base_odds)
        self.friction_memory = FrictionMemory(friction / shear_per_friction, log_sd)
        self.posterior = Posterior([NAMES.index(name) for name in STATE_SIGNS], len(self.memory.row))
        self.gate = SlipHysteresis(incipient_p, gross_p, self.look_s)
        # Each access to an array of a compiled class makes a view: a microsecond, and a look needs ten.
        self._memory_row, self._state_row = self.memory.row, self.posterior.row
        self._score = learnt.signs.scores
        self._state_scores, self._soon_scores = learnt.state.scores, learnt.soon.scores
        self.begin(is_seen=True)

    def begin(self, *, is_seen: bool) -> None:
        """Begin a contact, whose touch was seen or not."""
        self.signs = Signs(self._x, self._y, self.look_s, self.per_friction, is_seen=is_seen)
        self._row = self.signs.row
        self.memory.begin_contact()
        self.friction_memory.begin_contact()
        self.is_known = is_seen
        self.posterior.begin()
        self.slid_at = 0.0
        self.gate.begin(is_seen=is_seen)

    def restart(self) -> None:
        """Begin windows anew, after a gap in which the contact went on."""
        self.signs.restart()
        self.gate.close()

    def end(self) -> None:
        """End the contact."""
        self.friction_memory.end_contact()

    def look(
        self,
        noise: float,
        acceleration: float = math.nan,
        *,
        has_zero: bool,
        ripple_travels: bool = False,
    ) -> None:
        """Look at the scans that `signs` has taken.

        Parameters
        ----------
        noise : float
            Standard deviation of a taxel's shear in one scan, in units of the readings.
        acceleration : float
            Of the hand, as announced, m/s^2; NaN where it is not.
        has_zero : bool
            The zero of the shear is known: the contact was seen to begin, or most of its load to come.
        ripple_travels : bool
            A ripple travels over the taxels: proof of sliding (`travelling`).
        """
        signs, memory, learnt, posterior = self.signs, self.memory, self._learnt, self.posterior
        row = self._row
        signs.look(noise, acceleration)
        learnt.signs.evaluate(row)
        p = 1.0 / (1.0 + math.exp(-min(max(self._score[0], -30.0), 30.0)))
        p = max(p, RIPPLE_P) if ripple_travels else p
        friction = self.friction_memory
        kept = kept_load(row[LOAD_CHANGE])
        if has_zero:
            friction.learn(self.p_sliding, signs.ratio, kept, self.look_s)
        memory.take(p, signs.ratio, self.look_s, kept)
        posterior.gather(row, self._memory_row)
        learnt.state.evaluate(self._state_row)
        learnt.soon.evaluate(self._state_row)
        posterior.take(
            self._state_scores,
            self._soon_scores,
            learnt.base_odds + self._memory_row[_ODDS],
            signs.ratio,
            friction.contact_log_mean,
            friction.contact_variance,
            has_zero,
            ripple_travels,
        )
        self.gate.look(self.p_incipient, self.p_sliding, signs.ratio, self.ratio_sd)
        self.is_known = self.is_known or has_zero or self.gate.is_gross
        self.slid_at = max(self.slid_at, signs.ratio) if self.gate.is_gross else 0.0

    @property
    def p_sliding(self) -> float:
        """Probability that all of the contact slides, by this look alone: `verdict` has the published one."""
        return self.posterior.cells[-1]

    @property
    def prior_p(self) -> float:
        """Probability that all of the contact slides, where there is no sign of it or against it."""
        return 1.0 / (1.0 + math.exp(-self._learnt.base_odds))

    @property
    def p_incipient(self) -> float:
        """Probability that a tenth of its area or more slips."""
        return 1.0 - self.posterior.cells[0]

    @property
    def friction(self) -> tuple[float, float, float]:
        """Quantiles of friction of 5, 50 and 95 %, in units of the readings, whichever slip is open."""
        low, median, high = self.posterior.friction
        return self.per_friction * low, self.per_friction * median, self.per_friction * high

    def verdict(self) -> Verdict:
        """Return the posterior, as it is published."""
        posterior, gate = self.posterior, self.gate
        posterior.publish(
            gate.is_gross,
            OFF * gate.gross_p,
            self.signs.ratio,
            self.friction_memory.log_mean,
            self.friction_memory.variance,
        )
        low, median, high = posterior.utilisation
        friction = self.friction
        if gate.is_gross:
            slid_at = self.per_friction * max(self.slid_at, _LEAST_RATIO)
            friction = LEAST_GROSS_USED * slid_at, slid_at, slid_at / LEAST_GROSS_USED
        in_50, in_100, in_300 = (1.0, 1.0, 1.0) if gate.is_gross else posterior.soon
        return Verdict(
            utilisation=(low, median, high),
            friction=friction,
            slipping_share=posterior.slipping_share,
            p_gross=(in_50, in_100, in_300),
            p_sliding=posterior.p_sliding,
        )

    @property
    def growth_sd(self) -> float:
        """Standard deviation of the growth of the ratio by the noise of its readings, 1/s."""
        return math.sqrt(2.0) * self.ratio_sd / max(GROWTH_S, self.look_s)

    @property
    def ratio_sd(self) -> float:
        """Standard deviation of the ratio of a look by the noise of its readings, in units of friction."""
        return self.signs.ratio_noise / self.per_friction / math.sqrt(self.n_look)
