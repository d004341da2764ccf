"""What rung `compliance` remembers of a taxel from step to step."""

import numpy as np
from numpy.typing import NDArray

from tactiled.emulator.mechanics.base import Held
from tactiled.emulator.mechanics.skin import SkinCompliance
from tactiled.emulator.mechanics.solver import ContactSolver

FloatArray = NDArray[np.float64]


class TaxelHistory:
    """State of one taxel between steps, without contact at first."""

    def __init__(self, skin: SkinCompliance, friction: float) -> None:
        n = len(skin.x_mm)
        self.solver = ContactSolver(skin.compliance, friction)
        self.force_n = np.zeros((3, n))  # body components: into the skin, x, y
        self.moved_mm = np.zeros((3, n))
        self.slips = np.zeros(n, dtype=bool)
        self.turned_mm = np.zeros((3, n))  # part of it by the couples of displaced forces
        self.approach_mm = 0.0
        self.base_mm: FloatArray | None = None
        self.value: float | None = None
        self.held: Held = "force"
        self.warning = 0
        self.failures = 0  # solves of this step that did not converge
