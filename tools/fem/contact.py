"""One taxel pressed on a rigid plate and slid over it: finite strain, Yeoh rubbers, Coulomb friction.

The only module that needs `felupe` (GPL-3, optional extra ``tactiled[fem]``), loaded when a `TaxelPress` is
built. Equilibrium by Newton's method; an increment that does not converge is halved.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse.linalg import splu

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import HeldQuantity, Surface
from tactiled.errors import DataError
from tools.fem import plate
from tools.fem.mesh import TaxelMesh
from tools.fem.readout import EDGE_MM, centre, read_out, side_parts, surface_areas
from tools.fem.rubber import CellwiseYeoh

# Stiffness of contact and of sticking, over the mean stiffness of a surface point. On a flat plate a quarter
# of it moves friction at the knee by 0.7 % and the approach by 0.3 um. Over grooves points touch and part in
# turn, which takes so stiff a contact many halvings; a twentieth lets points creep while they stick (flat:
# friction 4 % late at the knee, 1.6 um of approach) and leaves full slip as it is (halves within 0.2 %).
PENALTY, PENALTY_SLIP = 80.0, 20.0
GROOVED_PENALTY, GROOVED_PENALTY_SLIP = 4.0, 1.0
TOLERANCE = 1e-6  # residual over reaction
MOST_STEPS = 8  # an increment that converges takes 4 or 5
MOST_HALVINGS = 7


@dataclass(frozen=True)
class ImposedState:
    """Imposed normal force (N) or approach (mm), and place of the bump over the plate."""

    held: HeldQuantity
    value: float
    base_mm: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Equilibrium at one instant; forces on the skin, N, in the frame of `base`.

    `half_n`, `edge_n` (4,) are the sides of `readout.SIDES`, negative where the bonded chip is pulled.
    `continued` (3,) is the share of each material beyond its stable range, `slipping` that of the contact.
    """

    normal_n: float
    tangential_n: FloatArray
    half_n: FloatArray
    edge_n: FloatArray
    centre_n: float
    approach_mm: float
    contact_mm2: float
    slipping: float
    continued: FloatArray
    newton_steps: int
    halvings: int


def penalties(surface: Surface) -> tuple[float, float]:
    """Stiffness of contact and of sticking on a plate."""
    flat = surface.depth_mm == 0
    return (PENALTY, PENALTY_SLIP) if flat else (GROOVED_PENALTY, GROOVED_PENALTY_SLIP)


def load_felupe() -> Any:
    """The optional library.

    Raises
    ------
    DataError
        It is not installed.
    """
    try:
        import felupe
    except ImportError:
        raise DataError("finite elements need felupe: pip install 'tactiled[fem]'") from None
    return felupe


class TaxelPress:
    """One taxel and one plate; `follow` a list of instants."""

    def __init__(self, mesh: TaxelMesh, surface: Surface) -> None:
        fem = load_felupe()
        self._fem, self._mesh = fem, mesh
        self._parts = read_out(mesh, [*side_parts(0.0), *side_parts(EDGE_MM), centre])
        self._areas = surface_areas(mesh)
        # The plate starts where its ridges would touch the apex.
        top = float(mesh.points_mm[:, 2].max()) + surface.depth_mm
        self._plate_point = len(mesh.points_mm)
        body = fem.Mesh(np.vstack([mesh.points_mm, [0.0, 0.0, top]]), mesh.cells, "hexahedron")
        region = fem.RegionHexahedron(body)
        self._field = fem.FieldContainer([fem.Field(region, dim=3)])
        self._rubber = CellwiseYeoh(mesh.material)
        self._solid = fem.SolidBodyNearlyIncompressible(self._rubber, self._field, bulk=self._rubber.bulk_mpa)
        stiff, stick = penalties(surface)
        self._contact = _contact_class(fem)(
            self._field,
            surface,
            points=mesh.surface,
            centerpoint=self._plate_point,
            friction=surface.friction,
            items=[self._solid],
            multiplier=stiff,
            multiplier_tangential=stick,
            multiplier_update="once",
        )
        self._load = fem.PointLoad(self._field, [self._plate_point])
        self._held_points = (3 * mesh.bottom[:, None] + np.arange(3)).ravel()

    def follow(self, instants: list[ImposedState]) -> Iterator[Equilibrium]:
        """Find equilibria one after another, the first from no contact.

        Raises
        ------
        DataError
            An increment has no equilibrium, however small it is.
        """
        value = {"force": 0.0, "displacement": 0.0}
        base_mm = instants[0].base_mm
        for goal in instants:
            solution = self._reach(ImposedState(goal.held, value[goal.held], base_mm), goal, 0)
            value = {"force": solution.normal_n, "displacement": solution.approach_mm}
            base_mm = goal.base_mm
            yield solution

    def _reach(self, before: ImposedState, goal: ImposedState, halvings: int) -> Equilibrium:
        kept = [item.checkpoint() for item in (self._solid, self._contact)]
        try:
            return self._equilibrium(goal, halvings)
        except self._fem.NewtonConvergenceError:
            if halvings == MOST_HALVINGS:
                raise DataError(
                    f"no equilibrium at {goal} after {halvings} halvings of the increment"
                ) from None
        for item, state in zip((self._solid, self._contact), kept, strict=True):
            item.restore(state)
        self._field = self._solid.field
        middle = ImposedState(
            goal.held,
            (before.value + goal.value) / 2,
            ((before.base_mm[0] + goal.base_mm[0]) / 2, (before.base_mm[1] + goal.base_mm[1]) / 2),
        )
        halfway = self._reach(before, middle, halvings + 1)
        there = self._reach(middle, goal, halvings + 1)
        return replace(
            there,
            newton_steps=halfway.newton_steps + there.newton_steps,
            halvings=max(halfway.halvings, there.halvings),
        )

    def _equilibrium(self, goal: ImposedState, halvings: int) -> Equilibrium:
        fixed, values = self._held_points, np.zeros(len(self._held_points))
        plate_unknowns = 3 * self._plate_point + np.arange(3)
        place = np.array([-goal.base_mm[0], -goal.base_mm[1], -goal.value])
        axes = 3 if goal.held == "displacement" else 2
        fixed = np.concatenate([fixed, plate_unknowns[:axes]])
        values = np.concatenate([values, place[:axes]])
        self._load.update([[0.0, 0.0, -goal.value if goal.held == "force" else 0.0]])
        free = np.setdiff1d(np.arange(3 * (self._plate_point + 1)), fixed)
        result = self._fem.newtonraphson(
            x0=self._field,
            items=[self._solid, self._contact, self._load],
            dof0=fixed,
            dof1=free,
            ext0=values,
            solver=_solve,
            tol=TOLERANCE,
            maxiter=MOST_STEPS,
            verbose=0,
        )
        self._field = result.x
        return self._solution(result, halvings)

    def _solution(self, result: Any, halvings: int) -> Equilibrium:
        force = self._contact.results.force.toarray()[3 * self._plate_point :, 0]
        pressed = self._parts @ result.fun[3 * self._mesh.bottom + 2]
        active, slip = self._contact.results.active, self._contact.results.slip
        touching = float(self._areas[active].sum())
        deformation = self._solid.results.kinematics[0]
        return Equilibrium(
            normal_n=-float(force[2]),
            tangential_n=force[:2],
            half_n=pressed[:4],
            edge_n=pressed[4:8],
            centre_n=float(pressed[8]),
            approach_mm=-float(self._field[0].values[self._plate_point, 2]),
            contact_mm2=touching,
            slipping=float(self._areas[slip].sum()) / touching if touching else 0.0,
            continued=self._rubber.continued(deformation),
            newton_steps=result.iterations,
            halvings=halvings,
        )


def _solve(matrix: Any, right: FloatArray) -> FloatArray:
    """Sparse LU; the friction tangent is not symmetric but its pattern is, which halves the fill.

    NaN where there is no answer: Newton's method then gives up this increment, and it is halved.
    """
    lost = np.full(len(right), np.nan)
    if not np.all(np.isfinite(matrix.data)):
        return lost
    try:
        factors = splu(
            matrix.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.001,
            options={"SymmetricMode": True},
        )
    except RuntimeError:  # exactly singular
        return lost
    return np.asarray(factors.solve(right))


def _contact_class(fem: Any) -> Callable[..., Any]:
    """The plate as a rigid surface of felupe; made here because felupe is loaded late."""

    class RigidPlate(fem.mechanics.ContactRigidBase):  # type: ignore[misc]
        def __init__(self, field: Any, surface: Surface, **options: Any) -> None:
            self.surface = surface
            super().__init__(field, **options)

        def _kinematics(self, dx: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            return plate.distance(self.surface, dx)

    return RigidPlate
