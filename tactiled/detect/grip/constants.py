"""Numbers of the contact model that were set on emulated worlds (`bench.worlds.laws`, seeds from 20000).

Everything else in this room is derived, physical with a source, or a prior, and stands beside the code that
uses it; docs/grip.md names the priors that were chosen on the same worlds. The worlds that `./run bench grip`
reports are others.
"""

TEMPER = 0.35  # weight of a look at the shares: successive looks repeat the same misfit
MISFIT = 0.02  # of a taxel's shear over the mean one: what the mechanics leave unexplained
WALK_PART = 0.25  # of the prior's spread, by which log friction may change in a second: wetting, a new spot


class Wander:
    """Log likelihood ratio of sliding over sticking, from the shares' changes over 80 ms."""

    SLOPE, OFFSET = 1.25, -0.8  # of the logarithm of their mean square over what holding explains


class Ahead:
    """Probability that a growth of the ratio arrives at the limit (`forecast.p_gross_within`)."""

    FRESH = 0.9  # of growths beyond what was borne before
    REVISITED = 0.12  # of growths below it: swings turn where they turned before
    E_FOLDS = 7.5  # ends of growths for each e-fold of the ratio: what a hand wants is near what it bears
    TIME_PART = 0.64  # extrapolated time over the horizon, at which half of those that arrive are in time
    TIME_POWER = 1.75  # exponent of the log-logistic distribution of that time
