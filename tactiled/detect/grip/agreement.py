"""Grip messages while a slip is open: they say of the contact what the slip event says.

A slip stays open until the ratio of shear and load has fallen, because a skin that stops keeps its shear. The
posterior of the model forgets within tenths of a second why the slip was opened. What is published of both
follows the slip that is open, so that a controller never reads two answers.
"""

import dataclasses

from tactiled.detect.grip.model import INCIPIENT_USED, NEEDED_UTILISATION
from tactiled.events.types import GripEvent, SlipEvent

LEAST_GROSS_USED = 0.9
"""Utilisation, at least, while a gross slip is open: what slides bears its limit, up to uneven friction."""


def agreeing(grip: GripEvent, slip: SlipEvent | None, slid_at: float, gross_p: float) -> GripEvent:
    """Return the grip event that agrees with the slip that is open.

    Parameters
    ----------
    grip : GripEvent
        Of the model alone, in contact.
    slip : SlipEvent or None
        Newest onset of the slip that is open.
    slid_at : float
        Largest ratio of shear and load since a gross slip opened.
    gross_p : float
        Probability from which a gross slip is open; it closes below half of it.
    """
    if slip is None:
        # A slip is not yet open right after a gap, or where the other gate sees no contact.
        return dataclasses.replace(grip, state="partial") if grip.state == "gross" else grip
    if slip.kind == "incipient":
        return dataclasses.replace(
            grip,
            state="partial",
            utilisation=max(grip.utilisation, INCIPIENT_USED),
            utilisation_high=max(grip.utilisation_high, INCIPIENT_USED),
        )
    # Friction is the largest ratio that the slide bore, and not the present one: a hand that grips harder
    # lowers the ratio, and would otherwise be asked for more with each message.
    size = grip.needed_load * NEEDED_UTILISATION * grip.friction_low
    friction_low = LEAST_GROSS_USED * slid_at
    return dataclasses.replace(
        grip,
        state="gross",
        utilisation=1.0,
        utilisation_low=LEAST_GROSS_USED,
        utilisation_high=1.0,
        friction=slid_at,
        friction_low=friction_low,
        friction_high=slid_at / LEAST_GROSS_USED,
        slipping_share=1.0,
        p_sliding=max(grip.p_sliding, gross_p / 2),
        p_gross_50ms=1.0,
        p_gross_100ms=1.0,
        p_gross_300ms=1.0,
        needed_load=size / (NEEDED_UTILISATION * friction_low),
    )
