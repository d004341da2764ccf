"""The one filter of a contact: from loads and shears of the taxels to a posterior that all messages share.

Each look of 20 ms, trees judge the signs of the moment alone (`signs`); the odds that they give enter the
`Memory`; other trees weigh the memory and a few signs and give the `Posterior` of the state: utilisation in
cells, or sliding. The log odds of sliding are the mean of those by both, and the posterior is averaged over
some looks. A third forest gives the time to gross slip of what does not slide yet. All three are trained by
``./run train slip``. What is known of friction outlives the contact (`FrictionMemory`).

A slip opens and closes by thresholds on this one posterior (`SlipHysteresis`). What is published of the state
follows the slip that is open, so that slip events, grip messages and contact state never differ.

The file is plain Python, which Cython compiles with the types of `filter.pxd` (`tactiled.compiled`).
"""

from array import array
from math import exp, hypot, sqrt
from typing import TYPE_CHECKING, Literal

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.contact.hysteresis import CLOSING_PART
from tactiled.detect.contact.memory import MEMORY_NAMES, kept_load
from tactiled.detect.contact.posterior import (
    FIVE_PERCENT,
    INCIPIENT_SHARE,
    INCIPIENT_USED,
    LEAST_BORNE,
    LEAST_GROSS_USED,
    RIPPLE_P,
)
from tactiled.detect.contact.signs import LOOK_S, NAMES
from tactiled.detect.signal.front_end import zeros
from tactiled.events.types import GripEvent, GripState

if TYPE_CHECKING:
    from tactiled.detect.contact.friction import FrictionMemory
    from tactiled.detect.contact.hysteresis import SlipHysteresis
    from tactiled.detect.contact.learnt import Learnt
    from tactiled.detect.contact.memory import Memory
    from tactiled.detect.contact.posterior import Posterior
    from tactiled.detect.contact.signs import Signs

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
NEEDED_UTILISATION = 0.7  # choice
"""Utilisation that `needed_load` would leave."""
# choice: standard deviations by which the ratio falls where a contact is unloaded: less shear, or a firmer
# grip
_SURELY_FALLS = 2.0
HISTORY_S = 1.0  # choice: in which the beginning of a slip is looked for


class ContactFilter:
    """Filter of one contact after the other.

    Parameters
    ----------
    signs : Signs
        Signs of the taxels, at `look_s` of the same scan rate.
    learnt : Learnt
        Trees, whose scores are read right after each evaluation.
    memory : Memory
    friction_memory : FrictionMemory
    posterior : Posterior
    hysteresis : SlipHysteresis
        Parts of this filter alone. The slip that `hysteresis` has open is what is published.
    rate_hz : float
        Scan rate.
    radius_mm : float
        Mean distance of the taxels from their centre.

    Attributes
    ----------
    is_begun : bool
        The contact has a look: its load was large enough to tell.
    is_look : bool
        The newest scan completed a look.
    is_known : bool
        The zero of the shear was known at a look, or a slide was seen.
    slid_at : float
        Largest ratio since the gross slip opened that is open; 0.0 without one. A hand that grips harder
        lowers the ratio of a slide: friction is what the slide bore.
    rippled_s : float
        Length of the window in which a ripple travels over the taxels; 0.0 where none does.
    zero_sd : float
        Standard deviation of shear over load by what is not known of the zero of the shear.
    total_x, total_y, moment, load : float
        Sums of the newest scan.
    prior_p : float
        Probability that all of the contact slides, where there is no sign of it or against it.
    friction : tuple of 3 floats
        Quantiles of 5, 50 and 95 %, as they are published, in units of the readings.
    p_gross : tuple of 3 floats
        Probability that gross slip begins within `HORIZONS_S`, if the contact does not slide yet; 1 while a
        gross slip is open.
    """

    def __init__(
        self,
        signs: "Signs",
        learnt: "Learnt",
        memory: "Memory",
        friction_memory: "FrictionMemory",
        posterior: "Posterior",
        hysteresis: "SlipHysteresis",
        rate_hz: float,
        radius_mm: float = 1.0,
        unit: Literal["N", "relative"] = "relative",
    ) -> None:
        self.signs, self.radius_mm, self.unit = signs, radius_mm, unit
        self.per_friction = signs.shear_per_friction
        self.n_look, self.look_s = scans_of_look(rate_hz), signs.look_s
        self.growth_s = signs.n_growth * self.look_s
        self.sign_trees, self.state_trees, self.soon_trees = learnt.signs, learnt.state, learnt.soon
        self.prior_p = 1.0 / (1.0 + exp(-memory.base_odds))
        self.memory, self.friction_memory = memory, friction_memory
        self.posterior, self.hysteresis = posterior, hysteresis
        self.columns = array("q", [NAMES.index(name) for name in STATE_SIGNS])
        self.row = zeros(len(STATE_SIGNS) + len(MEMORY_NAMES))
        # Each access to an array of another compiled class makes a view, which takes half a microsecond.
        self.sign_row, self.memory_row, self.over_load = signs.row, memory.row, signs.over_load
        self.sign_scores, self.state_scores = learnt.signs.scores, learnt.state.scores
        self.soon_scores = learnt.soon.scores
        self.n_kept = max(2, round(HISTORY_S * rate_hz))
        self.past = zeros(self.n_kept * (5 + len(self.over_load)))
        self.begin(is_seen=True)

    def begin(self, *, is_seen: bool) -> None:
        """Begin a contact, whose touch was seen or not."""
        self.signs.begin(is_seen=is_seen)
        self.memory.begin_contact()
        self.friction_memory.begin_contact()
        self.posterior.begin()
        self.hysteresis.begin(is_seen=is_seen)
        self.is_known = is_seen
        self.is_begun = self.is_look = False
        self.n_past = self.newest = 0
        self.ratio = self.slid_at = self.rippled_s = self.zero_sd = 0.0
        self.weigh(0.0, 0.0, 0.0, 0.0)
        self.publish()

    def restart(self) -> None:
        """Begin windows anew, after a gap in which the contact went on."""
        self.signs.restart()
        self.posterior.is_begun = False
        self.hysteresis.close()
        self.publish()

    def weigh(self, total_x: float, total_y: float, moment: float, load: float) -> None:
        """Set the sums of the newest scan."""
        self.total_x, self.total_y, self.moment, self.load = total_x, total_y, moment, max(load, 1e-9)

    def take(
        self,
        time_s: float,
        reading: FloatArray,
        zero: FloatArray,
        noise: float,
        acceleration: float,
        was_seen: bool,
        rippled_s: float,
        touches: bool,
    ) -> None:
        """Take a scan; each look of 20 ms, the first scan of a contact among them, changes the posterior.

        Parameters
        ----------
        reading : (3 * taxels,) float64
            Loads, shears along x and shears along y.
        zero : (2 * taxels,) float64
            Shear that pressing alone makes, over the load.
        noise : float
            Standard deviation of a taxel's shear in one scan, in units of the readings.
        acceleration : float
            Of the hand, as announced, m/s^2; NaN where it is not.
        was_seen : bool
            The contact was seen to begin, or most of its load to come, so that its zero of shear is known.
        rippled_s : float
            Length of the window in which a ripple travels over the taxels: proof of sliding (`travelling`).
        touches : bool
            The contact gate sees a contact; without one, no slip is open, and friction is not learnt.
        """
        signs = self.signs
        signs.take(reading, zero)
        self.rippled_s = rippled_s
        self.is_look = not self.is_begun or signs.n_scans >= self.n_look
        if self.is_look:
            self.look(noise, acceleration, was_seen, touches)
        if not touches:
            self.hysteresis.close()
        if self.is_look or not touches:
            self.publish()
        self.is_begun = True
        self.weigh(signs.total_x, signs.total_y, signs.moment, signs.total_load)
        if touches:
            self._keep(time_s)

    def look(self, noise: float, acceleration: float, was_seen: bool, touches: bool) -> None:
        """Look at the scans that `signs` has taken; parameters as in `take`."""
        signs, friction, ripple_travels = self.signs, self.friction_memory, self.rippled_s > 0.0
        row, sign_row, memory_row = self.row, self.sign_row, self.memory_row
        signs.look(noise, acceleration)
        self.ratio = signs.ratio
        self.sign_trees.evaluate(self.sign_row)
        p = 1.0 / (1.0 + exp(-min(max(self.sign_scores[0], -30.0), 30.0)))
        p = max(p, RIPPLE_P) if ripple_travels else p
        kept = kept_load(sign_row[LOAD_CHANGE])
        if was_seen and touches:  # what the gate takes for noise tells nothing of friction
            friction.learn(self.p_sliding_now, self.ratio, kept, self.look_s)
        self.memory.take(p, self.ratio, self.look_s, kept)
        n = len(self.columns)
        for k in range(n):
            row[k] = sign_row[self.columns[k]]
        for k in range(len(memory_row)):
            row[n + k] = memory_row[k]
        self.state_trees.evaluate(self.row)
        self.soon_trees.evaluate(self.row)
        self.posterior.take(
            self.state_scores,
            self.soon_scores,
            self.memory.base_odds + memory_row[0],
            self.ratio,
            friction.contact_log_mean,
            friction.contact_variance,
            was_seen,
            ripple_travels,
        )
        self.hysteresis.look(self.p_incipient, self.p_sliding_now, self.ratio, self.ratio_sd)
        self.is_known = self.is_known or was_seen or self.hysteresis.is_gross
        self.slid_at = max(self.slid_at, self.ratio) if self.hysteresis.is_gross else 0.0

    def publish(self) -> None:
        """Fill in the posterior as it is published."""
        posterior, slips, friction = self.posterior, self.hysteresis, self.friction_memory
        posterior.publish(
            slips.is_gross, CLOSING_PART * slips.gross_p, self.ratio, friction.log_mean, friction.variance
        )
        if slips.is_gross:
            slid_at = self.per_friction * max(self.slid_at, LEAST_BORNE)
            self.friction = LEAST_GROSS_USED * slid_at, slid_at, slid_at / LEAST_GROSS_USED
            self.p_gross = 1.0, 1.0, 1.0
        else:
            self.friction = self.friction_now
            self.p_gross = posterior.soon

    def _keep(self, time_s: float) -> None:
        """Keep the scan for the beginning of a slip."""
        width = 5 + len(self.over_load)
        self.newest = self.newest + 1 if self.newest + 1 < self.n_kept else 0
        self.n_past = min(self.n_past + 1, self.n_kept)
        at = self.newest * width
        self.past[at], self.past[at + 1] = time_s, self.p_sliding_now
        self.past[at + 2] = self.total_x / self.load
        self.past[at + 3] = self.total_y / self.load
        self.past[at + 4] = self.moment / self.load
        for k in range(width - 5):
            self.past[at + 5 + k] = self.over_load[k]

    def forget_past(self) -> None:
        """Forget all scans but the newest one: how shear came to what it is was another slip."""
        self.n_past = min(self.n_past, 1)

    def kept_scans(self) -> FloatArray:
        """Return the scans of the last second, the newest one last, as a table.

        Its columns are time, probability of sliding, ratio of total shear and load along x and y and of the
        moment, and the shears of the taxels along x, then along y, over the total load.
        """
        rows = (np.arange(self.newest - self.n_past, self.newest) + 1) % self.n_kept
        return np.asarray(np.asarray(self.past).reshape(self.n_kept, -1)[rows])

    def event(self, time_s: float, is_trusted: bool, is_late: bool) -> GripEvent:
        """Return the event of the newest scan."""
        low, median, high = self.posterior.utilisation
        friction_low, friction, friction_high = self.friction
        in_50, in_100, in_300 = self.p_gross
        share, is_known = self.posterior.slipping_share, self.is_known and self.is_begun
        state: GripState = "unknown"
        if not is_known:  # it may hold or slide, with any shear: nothing is in use for sure, nor free
            low, median, high = 0.0, 0.5, 1.0
            if self.hysteresis.is_open:
                state, low = "partial", INCIPIENT_USED
        elif self.hysteresis.is_gross:
            state = "gross"
        elif self.hysteresis.is_open:
            state = "partial"
            median, high = max(median, INCIPIENT_USED), max(high, INCIPIENT_USED)
        elif self.signs.growth < -_SURELY_FALLS * (sqrt(2.0) * self.ratio_sd / self.growth_s):
            state = "unloading"
        else:
            state = "partial" if share > INCIPIENT_SHARE else "sticking"
        # What is not known of the zero is more shear that may be borne.
        size = hypot(self.total_x, self.total_y, self.moment) + FIVE_PERCENT * self.zero_sd * self.load
        needed_load = size / (NEEDED_UTILISATION * friction_low)
        return GripEvent(
            time_s=time_s,
            utilisation=median,
            utilisation_low=low,
            utilisation_high=high,
            friction=friction,
            friction_low=friction_low,
            friction_high=friction_high,
            slipping_share=share,
            p_sliding=self.posterior.p_sliding,
            p_gross_50ms=in_50,
            p_gross_100ms=in_100,
            p_gross_300ms=in_300,
            load=self.load,
            shear_x=self.total_x,
            shear_y=self.total_y,
            torsion=self.moment * self.radius_mm + 0.0,  # never -0.0
            unit=self.unit,
            needed_load=needed_load if is_known else max(needed_load, self.load),
            state=state,
            valid=is_trusted and self.is_begun,
            late=is_late,
        )

    @property
    def p_sliding_now(self) -> float:
        """Probability that all of the contact slides, whichever slip is open."""
        return self.posterior.p_sliding_now

    @property
    def p_incipient(self) -> float:
        """Probability that a tenth of its area or more slips."""
        return self.posterior.p_incipient

    @property
    def friction_now(self) -> tuple[float, float, float]:
        """Quantiles of friction of 5, 50 and 95 %, in units of the readings, whichever slip is open."""
        low, median, high = self.posterior.friction
        return self.per_friction * low, self.per_friction * median, self.per_friction * high

    @property
    def ratio_sd(self) -> float:
        """Standard deviation of the ratio of a look by the noise of its readings, in units of friction."""
        return self.signs.ratio_noise / self.per_friction / sqrt(self.n_look)

    @property
    def size(self) -> float:
        """Ratio of the newest scan: by the ellipsoid of Howe and Cutkosky (1996), compared with friction."""
        return hypot(self.total_x / self.load, self.total_y / self.load, self.moment / self.load)


def scans_of_look(rate_hz: float) -> int:
    """Return the number of scans of a look."""
    return max(1, round(LOOK_S * rate_hz))
