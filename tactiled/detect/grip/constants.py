"""Numbers of the contact model that were set on emulated worlds (`bench.grip.worlds`, seeds from 10000).

Everything else in this room is derived, physical with a source, or a prior with a source, and stands beside
the code that uses it. The worlds that `./run bench grip` reports are others.
"""

TEMPER = 0.25  # weight of a look at the shares: successive looks repeat the same misfit
MISFIT = 0.05  # of a taxel's shear over the mean one, before the contact's own residuals are known


class Ripple:
    """Wavelet details of the taxels' shear as evidence for sliding."""

    LEAK = 0.2  # part of a common movement that unequal gains leave in the details
    TEMPER = 0.5  # looks are 20 ms apart, and the coarser level's filter is longer


WALK_PART = 0.25  # of the prior's spread, by which log friction may change in a second: wetting, a new spot
EXCESS_SD = 0.10  # of log ratio by which a sliding contact may exceed its friction
FALL_RATE = 0.02  # 1/s, at which friction falls away under a load that it bore
SLIDE_S = 0.4  # mean duration of gross slip: then it is caught, or the object is lost
SOFT = 0.2  # log ratios over which a limit is met: friction differs between taxels and with speed
END_EACH = 10.0  # ends of trends for each e-fold of the shear: what a hand wants is near what it bears
