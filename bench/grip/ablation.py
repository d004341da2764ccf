"""Parts of the contact model, taken out one at a time (``./run bench grip --ablate``).

A part is taken out by another value of a name that the model reads. Friction that is carried from contact to
contact cannot be taken out here: worlds have one contact.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tactiled.detect.grip import detector, observe, shares
from tactiled.detect.grip.constants import Ahead, Wander

WHOLE = "nothing"
# Name of what is left out: (object, name, value) of each change.
ABLATIONS: dict[str, tuple[tuple[Any, str, Any], ...]] = {
    WHOLE: (),
    "shares of the taxels": ((shares, "TEMPER", 1e-9),),
    "memory of places": ((shares, "_PLACE", 0.0),),
    "nuisances of the taxels": (
        (shares, "_GAIN_SD", 1e-6),
        (shares, "_SOFTENING_SD", 1e-6),
        (shares, "_OFFSET_SD", 1e-6),
    ),
    "wandering of the shares": ((Wander, "SLOPE", 0.0), (Wander, "OFFSET", 0.0)),
    "approximation (raw scans)": ((detector, "level_for", lambda *_: 0),),
    "whitening (noise of one step)": (
        (observe, "_MEAN_ABS", math.inf),
        (observe, "_ROUNDING", math.inf),
    ),
    "ends of growths": ((Ahead, "FRESH", 1.0), (Ahead, "REVISITED", 1.0), (Ahead, "E_FOLDS", 0.0)),
}


@contextmanager
def without(part: str) -> Iterator[None]:
    """Take a part out of the model."""
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in ABLATIONS[part]]
    try:
        for owner, name, value in ABLATIONS[part]:
            setattr(owner, name, value)
        yield
    finally:
        for owner, name, value in before:
            setattr(owner, name, value)
