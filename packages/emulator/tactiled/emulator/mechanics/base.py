"""Interface of the physical contact models of taxels.

A model steps through time, because friction depends on the past. It runs on a fixed grid of instants, so that
chunking changes nothing; `stepper` interpolates for any instant.

Frame of a taxel: origin on the axis of its bump, x and y as in the array, z out of the skin. `base_mm` is the
place of that origin over the surface (taxel place plus travel of the skin). Forces are those on the skin.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from tactiled.array import FloatArray

# Shape of a taxel: chip, rubber base and the bump above it; assumed where the paper gives none (Wang et al.
# 2019, figure 1 has heights only).
CHIP_MM = 0.5  # paper: adhesive layer that holds the chips
BASE_MM = 0.4  # assumed: half of the 0.8 mm of PDMS
RIM_MM = 0.1  # assumed: straight side of the bump
CAP_MM = 0.3  # assumed: height of its spherical cap; base + rim + cap are the paper's 0.8 mm
BUMP_MM = RIM_MM + CAP_MM  # height of the bump: pressed deeper, the plate meets the base

# Area under a side electrode. ``edge``: the chip beyond 1 mm from its axis, which reproduces the paper's 0.07
# N a side and its change of almost 100 %; ``half``: half the chip, for comparison with finite elements.
Readout = Literal["edge", "half"]


@dataclass(frozen=True)
class Surface:
    """Surface under the bumps.

    Grooves have the height ``depth (1 + cos(2 pi s / period)) / 2`` above the valleys, with s along the
    groove normal (cos angle, sin angle); ``depth_mm = 0`` is a flat plate.
    """

    friction: float  # Coulomb coefficient, while sliding
    period_mm: float = 1.0
    angle_deg: float = 0.0
    depth_mm: float = 0.0
    static_ratio: float = 1.0  # friction at rest over friction while sliding
    stribeck_mm_s: float = 1.0  # speed scale of the fall between them
    # Standard deviation of friction from place to place, over its mean (`unevenness`). Solved tables are
    # named by the text of even plates.
    unevenness: float = field(default=0.0, repr=False)


@dataclass(frozen=True, eq=False)
class TaxelForces:
    """Forces on the skin and state of the contact at one instant, for t taxels."""

    normal_n: FloatArray  # (t,): total normal force, 0 or more
    tangential_n: FloatArray  # (t, 2): friction force on the skin
    # (t, a): normal force on the read-out area at each azimuth, 0 or more (the sensor measures no tension)
    side_n: FloatArray
    slipping: FloatArray  # (t,): share of the contact area that slips, 0 to 1; 0 without contact
    indentation_mm: FloatArray  # (t,): approach since first touch of a flat plate


class TaxelModel(ABC):
    """Contact model of taxels: surface, azimuths (a,) of the read-out areas and number of taxels.

    The constructor raises `ConfigError` for a surface that the model cannot play.
    """

    step_s: ClassVar[float]  # of the grid on which scenes run it

    @abstractmethod
    def __init__(
        self, surface: Surface, azimuth_deg: FloatArray, n_taxels: int, readout: Readout = "edge"
    ) -> None: ...

    @abstractmethod
    def reset(self) -> None:
        """Return to no contact and no history."""

    @abstractmethod
    def run(self, load_n: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """Advance by n steps to loads (n, t) and places over the surface (n, t, 2) at their ends.

        The forces have a leading axis n.
        """

    def step(self, load_n: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """Advance by one step: `run` without the axis n."""
        felt = self.run(load_n[None], base_mm[None], dt_s)
        return TaxelForces(**{name: rows[0] for name, rows in vars(felt).items()})
