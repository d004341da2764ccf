"""The contact model on the compiled path: `compiled_contact.c` has the state of a contact in a block."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled import compiled
from tactiled.array import FloatArray
from tactiled.detect.grip.friction import FrictionPosterior
from tactiled.detect.grip.model import ContactModel, Grip, contact_numbers
from tactiled.detect.grip.observe import approximation_taps
from tactiled.detect.grip.rings import mindlin_rings
from tactiled.detect.grip.wander import HALF

_N_SEEN = 26  # reals of `seen`, with which `struct contact` begins


class TrendValues(NamedTuple):
    """Attributes of `Trend` that others read."""

    value: tuple[float, float, float]
    value_sd: float
    rate_sd: float
    size: float
    growth: float
    is_fresh: bool


class CompiledContactModel:
    """`ContactModel`, with the same bits.

    Parameters
    ----------
    x, y, friction, history
        As in `ContactModel`; the history stays where it is.
    step_s : float
        Time between scans, at least.
    """

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        friction: FrictionPosterior,
        history: FloatArray,
        step_s: float,
    ) -> None:
        library = compiled.library()
        assert library is not None
        self.friction = friction
        n_taxels, rings = len(x), mindlin_rings()
        self.parts, self._shear = np.zeros((2, 2, n_taxels))
        self._slips = np.empty(n_taxels, dtype=np.bool_)
        # Arrays whose addresses are bound must live as long as this object.
        self._bound = (
            *(contact_numbers(x, y, friction), compiled.dense(x, np.float64), compiled.dense(y, np.float64)),
            np.stack(rings),
            *(friction.friction, friction.log_friction, friction.walk_rates),
            *(friction.weights, friction.met, friction.penalty),
            *(history[-1], self.parts, self._shear),
        )
        sizes = len(friction.friction), n_taxels, len(rings.limit), HALF
        begin = compiled.bind(library.tactiled_model, *sizes, step_s, *self._bound)
        self._block = np.zeros(begin(None))
        begin(compiled.address(self._block))
        self._seen = self._block[:_N_SEEN]
        self.measure = compiled.bind(library.tactiled_model_measure, self._block)
        self.follow = compiled.bind(library.tactiled_model_follow, self._block)
        self._look = compiled.bind(library.tactiled_model_look, self._block)
        self._grip = compiled.bind(library.tactiled_model_grip, self._block)
        self._loosen = compiled.bind(library.tactiled_model_loosen, self._block)
        self._find_taxels = compiled.bind(library.tactiled_model_taxels, self._block, self._slips)
        self._skip = compiled.bind(library.tactiled_model_skip, self._block)
        self.total = (0.0, 0.0, 0.0)
        self.sliding_log_odds = 0.0
        """As those of `ContactModel`, as of the newest `grip`."""

    @property
    def trend(self) -> TrendValues:
        """Ratio of shear and load, and its growth."""
        x, y, moment, value_sd, rate_sd, size, growth, is_fresh = self._seen[3:11].tolist()
        return TrendValues((x, y, moment), value_sd, rate_sd, size, growth, is_fresh > 0)

    @property
    def shear(self) -> FloatArray:
        """Shear (2, taxels) over the total load."""
        return self._shear.copy()

    def skip(self, gap_s: float) -> None:
        """Predict over a gap: friction walks, and windows begin anew."""
        self.friction.walk(gap_s)
        self._skip()

    def loosen(self, taxels: NDArray[np.bool_]) -> None:
        """Forget the gains of taxels (taxels,) that are read otherwise from now on."""
        self._loosen(compiled.address(taxels))

    def look(self, level: int, noise_sd: float, step_s: float) -> None:
        """Look at the shares of the taxels, in the coif1 approximation of a level."""
        taps = approximation_taps(level)
        self._look(len(taps), compiled.address(taps), noise_sd, step_s)

    def grip(self) -> Grip:
        """Return the present posterior."""
        self._grip()
        seen = self._seen.tolist()
        self.total = seen[:3]
        share, p_sliding, p_incipient, is_gross, is_unloading, self.sliding_log_odds = seen[20:]
        return Grip(
            *(seen[11:14], seen[14:17], share, seen[17:20]),
            *(p_sliding, p_incipient, is_gross > 0, is_unloading > 0),
        )

    def slipping_taxels(self) -> tuple[int, ...]:
        """Return the taxels of which a tenth or more slips."""
        self._find_taxels()
        return tuple(np.flatnonzero(self._slips).tolist())


AnyContactModel = ContactModel | CompiledContactModel


def contact_model(
    x: FloatArray, y: FloatArray, friction: FrictionPosterior, history: FloatArray, step_s: float
) -> AnyContactModel:
    """Return the model of a contact, on the compiled path where there is one."""
    if compiled.library() is None:
        return ContactModel(x, y, friction, history)
    return CompiledContactModel(x, y, friction, history, step_s)
