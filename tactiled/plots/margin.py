"""Panel of a log's picture: part of the friction limit in use, and probability of gross slip."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from tactiled.events.types import GripEvent
from tactiled.plots.palette import MARGIN, SLIP, TRUTH

FloatArray = NDArray[np.float64]
_TOP = 1.5  # of the axis: a posterior that knows little reaches far beyond 1


@dataclass(frozen=True, eq=False)
class KnownMargin:
    """True utilisation (n,) at n instants (n,) in seconds; NaN without contact."""

    time_s: FloatArray
    utilisation: FloatArray


def draw_margin(axis: Axes, grips: Sequence[GripEvent], truth: KnownMargin | None, origin_s: float) -> None:
    """Draw utilisation with its 90 % interval over the truth, and `p_gross_300ms`.

    Parameters
    ----------
    origin_s : float
        Instant that is 0 on the axis of time.
    """
    time_s = np.array([grip.time_s for grip in grips]) - origin_s
    known = np.array([grip.valid and grip.state != "none" for grip in grips])
    low, middle, high, gross = (
        np.where(known, [getattr(grip, name) for grip in grips], np.nan)
        for name in ("utilisation_low", "utilisation", "utilisation_high", "p_gross_300ms")
    )
    if truth is not None:
        axis.plot(truth.time_s - origin_s, truth.utilisation, color=TRUTH, lw=3, alpha=0.6, label="true")
    axis.fill_between(time_s, low, high, color=MARGIN, alpha=0.2, lw=0, label="5 to 95 %")
    axis.plot(time_s, middle, color=MARGIN, lw=1.2, label="utilisation")
    axis.plot(time_s, gross, color=SLIP, lw=0.9, ls="--", label="probability of gross\nslip within 0.3 s")
    axis.axhline(1.0, color="black", lw=0.6)
    axis.set_ylim(0, _TOP)
    axis.set_ylabel("shear over\nfriction limit")
