"""What slips are scored against: the first gross slip of a scene.

`t_shear` is when the tangential load begins to grow towards it: `slipwatch`'s instant, or a later one where
the load first rested (an object that hangs still and is then jerked). Either is known only to what counts as
growth, 0.2 % of the grip, and is the end of that: a pull that swells has grown for up to 60 ms by then, to
some twenty times what noise of 0.3 mV makes of the mean of nine taxels. So truth has a second instant, the
last at which the load did not grow at all (`TrueInstants.grows_s`). Who speaks between the two, oracle or
detector, speaks of this slip and of what has happened; who speaks before raises a false alarm. Latencies
count from `t_shear` all the same, and of who speaks before it are negative.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tactiled.emulator.scene.truth import TrueSlip, Truth

FloatArray = NDArray[np.float64]

GRID_S = 0.005  # step of the plates' contact models: truth is no finer
# A load rests where it changed by less than this part of the grip (as in `slipwatch`) in so many seconds.
_RESTS, _RESTS_S = 0.002, 0.1
# It does not grow where it does by less than this part in `GRID_S`. Held still, it changes by rounding; the
# slowest pull that swells grows by so much within 10 ms of its beginning.
_STILL = 1e-5


@dataclass(frozen=True)
class TrueInstants:
    """First gross slip of a scene, scene time.

    Attributes
    ----------
    shear_s, incipient_s, gross_s, end_s : float
        The tangential load begins to grow; 10 %, 90 % of the contact slip; less than 10 % again.
    direction_deg : float or None
        None where the skin turned on the spot.
    grown_for_s : float
        By `shear_s`, by less than what counts as growth.
    """

    shear_s: float
    incipient_s: float
    gross_s: float
    end_s: float
    direction_deg: float | None
    grown_for_s: float = 0.0

    @property
    def grows_s(self) -> float:
        """The load has not grown at all until then."""
        return self.shear_s - self.grown_for_s


def loads_at(truth: Truth, time_s: FloatArray) -> FloatArray:
    """Tangential and normal load (2, n) of all taxels at instants (n,)."""
    state = truth.state(time_s)
    return np.stack([np.linalg.norm(state.tangential_n, axis=-1).sum(axis=1), state.normal_n.sum(axis=1)])


class Course:
    """The load of a scene.

    Parameters
    ----------
    time_s, shear_n, normal_n : (n,) float64
        Instants every `GRID_S`, and the tangential and normal load of all taxels.
    """

    def __init__(self, time_s: FloatArray, shear_n: FloatArray, normal_n: FloatArray) -> None:
        back = round(_RESTS_S / GRID_S)
        moved_n = np.ptp(sliding_window_view(shear_n, back + 1), axis=1)
        self._rests_s = time_s[back:][moved_n <= _RESTS * normal_n[back:]]
        self._still_s = time_s[1:][np.diff(shear_n) <= _STILL * normal_n[1:]]

    def shear_s(self, slip: TrueSlip) -> float:
        """When the tangential load began to grow to a slip."""
        rested = self._rests_s[self._rests_s <= slip.onset_s]
        return max(slip.shear_s or 0.0, float(rested[-1]) if len(rested) else 0.0)

    def grown_for_s(self, shear_s: float) -> float:
        """For how long it had grown at all when it began to; before `_RESTS_S` is another time."""
        still = self._still_s[self._still_s <= shear_s]
        return min(shear_s - float(still[-1]), _RESTS_S) if len(still) else 0.0


def first_gross(truth: Truth, load: Course) -> TrueInstants | None:
    """What is scored; None where nothing ever slips as a whole."""
    gross = next((slip for slip in truth.slips if slip.gross_s is not None), None)
    if gross is None or gross.gross_s is None:
        return None
    shear_s = load.shear_s(gross)
    # The contact may slip in part, hold, and slip again on its way to gross slip.
    before = [e.onset_s for e in truth.episodes if e.end_s > shear_s and e.onset_s <= gross.onset_s]
    return TrueInstants(
        shear_s=shear_s,
        incipient_s=max(min(before), shear_s),
        gross_s=gross.gross_s,
        end_s=gross.end_s,
        direction_deg=gross.direction_deg,
        grown_for_s=load.grown_for_s(shear_s),
    )
