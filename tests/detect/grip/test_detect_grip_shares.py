"""Evidence of the shares: where a look counts, and what it says of an ideal contact."""

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.rings import RingForces, mindlin_rings
from tactiled.detect.grip.shares import ShareEvidence

LOAD = np.array([0.3, 0.6, 1.0, 1.4, 1.7])
FRICTION = np.exp(np.linspace(-1.2, 0.3, 16))
MU = FRICTION[8]


class IdealContact:
    """A contact of known friction that is pulled in the plane, beside the model's hypotheses."""

    def __init__(self) -> None:
        none = np.zeros_like(LOAD)
        self.truth = RingForces(np.array([MU]), none, none, mindlin_rings(40))
        self.model = RingForces(FRICTION, none, none, mindlin_rings())
        self.evidence = ShareEvidence(FRICTION, len(LOAD))

    def pull(self, used: float, gain: FloatArray | float = 1.0, angle: float = 0.0) -> FloatArray | None:
        wanted = used * MU * LOAD.sum() * np.array([np.cos(angle), np.sin(angle), 0.0])
        self.truth.advance(LOAD, wanted)
        shear = self.truth.taxel_forces()[:, 0] * gain
        total = np.array([*shear.sum(axis=1), 0.0])
        self.model.advance(LOAD, total)
        predicted = self.model.taxel_forces()
        whole = LOAD.sum()
        mean = whole / len(LOAD)
        borne = np.hypot(*predicted.sum(axis=2)) / whole
        return self.evidence.log_likelihood(
            shear / mean, predicted / mean, borne, LOAD / mean, total / whole, 1e-4
        )


def test_a_look_counts_at_new_places_on_the_way_up_only() -> None:
    contact = IdealContact()
    counted = [contact.pull(used) is not None for used in (0.3, 0.301, 0.4, 0.3, 0.2, 0.38, 0.4, 0.5)]
    assert counted == [True, False, True, False, False, True, False, True]
    assert IdealContact().pull(0.01) is None


def test_shares_of_a_growing_shear_find_friction_before_slip_whatever_the_gains() -> None:
    gain = np.array([1.1, 0.93, 1.05, 0.9, 1.02])
    contact, found = IdealContact(), np.zeros_like(FRICTION)
    for used in np.arange(0.05, 0.8, 0.01):
        some = contact.pull(float(used), gain)
        found += 0 if some is None else some
    weights = np.exp(found - found.max())
    mean = float(weights @ np.log(FRICTION) / weights.sum())
    assert abs(mean - np.log(MU)) < 0.2
    # What can hardly bear the shear and what hardly begins to slip under it are both refuted.
    assert weights[0] < 0.01
    assert weights[-1] < 0.1


def test_a_pull_that_turns_meets_gains_that_are_not_known_yet() -> None:
    gain = np.array([[1.1, 0.93, 1.05, 0.9, 1.02], [0.94, 1.04, 0.9, 1.08, 1.04]])
    contact, found = IdealContact(), np.zeros_like(FRICTION)
    for used in np.arange(0.05, 0.4, 0.01):
        contact.pull(float(used), gain)
    for angle in np.arange(0.1, 1.5, 0.1):
        some = contact.pull(0.4, gain, float(angle))
        found += 0 if some is None else some
    weights = np.exp(found - found.max())
    # 40 % of the limit says little between the truth and twice of it, and that it slips is wrong.
    assert weights[8:].max() > 0.9
    assert weights[FRICTION < 0.55 * MU].sum() < 0.1 * weights[8:].sum()
