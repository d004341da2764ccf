"""Instants of the first gross slip of a scene, from the emulator's truth.

`FirstSlip.shear_s` is when the tangential load begins to grow towards the slip, as the emulator's truth
states it, or the end of a later rest (an object that hangs still and is then jerked). Both are instants at
which the load has grown by 0.2 % of the grip.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tactiled.array import FloatArray
from tactiled.emulator.scene.truth import TrueSlip, Truth

GRID_S = 0.005  # step of the contact models: truth is no finer
# The load is at rest where it changes by less than this part of the grip within so many seconds.
_REST_CHANGE, _REST_S = 0.002, 0.1


@dataclass(frozen=True)
class FirstSlip:
    """First gross slip of a scene, in scene time.

    Attributes
    ----------
    shear_s, incipient_s, gross_s, end_s : float
        The tangential load begins to grow; 10 %, then 90 % of the contact slip; less than 10 % again.
    direction_deg : float or None
        None where the skin turned on the spot.
    """

    shear_s: float
    incipient_s: float
    gross_s: float
    end_s: float
    direction_deg: float | None


def loads_at(truth: Truth, time_s: FloatArray) -> FloatArray:
    """Tangential and normal load (2, n) of all taxels together at instants (n,)."""
    state = truth.state(time_s)
    return np.stack([np.linalg.norm(state.tangential_n, axis=-1).sum(axis=1), state.normal_n.sum(axis=1)])


class LoadHistory:
    """Search the load of a scene for rests.

    Parameters
    ----------
    time_s, shear_n, normal_n : (n,) float64
        Instants every `GRID_S`; tangential and normal load of all taxels.
    """

    def __init__(self, time_s: FloatArray, shear_n: FloatArray, normal_n: FloatArray) -> None:
        back = round(_REST_S / GRID_S)
        change_n = np.ptp(sliding_window_view(shear_n, back + 1), axis=1)
        self._at_rest_s = time_s[back:][change_n <= _REST_CHANGE * normal_n[back:]]

    def shear_s(self, slip: TrueSlip) -> float:
        """Instant at which the tangential load began to grow towards a slip."""
        rested = self._at_rest_s[self._at_rest_s <= slip.onset_s]
        return max(slip.shear_s or 0.0, float(rested[-1]) if len(rested) else 0.0)


def first_gross_slip(truth: Truth, load: LoadHistory) -> FirstSlip | None:
    """First gross slip of a scene; None where there is none."""
    gross = next((slip for slip in truth.slips if slip.gross_s is not None), None)
    if gross is None or gross.gross_s is None:
        return None
    shear_s = load.shear_s(gross)
    # The contact may slip in part, hold, and slip again on its way to gross slip.
    partial = [e.onset_s for e in truth.episodes if e.end_s > shear_s and e.onset_s <= gross.onset_s]
    return FirstSlip(
        shear_s=shear_s,
        incipient_s=max(min(partial), shear_s),
        gross_s=gross.gross_s,
        end_s=gross.end_s,
        direction_deg=gross.direction_deg,
    )
