"""Unilateral contact with Coulomb friction on surface nodes: a semismooth Newton method.

A node k carries a force ``f_k = (p, t_1, t_2)`` in its contact frame. With the body's compliance the gap and
the slip of a step are affine in all forces and in the body's further approach ``a``, which is unknown where
the total force is known::

    v = free + W f - lift a,        v_k = (gap, slip_1, slip_2)

and Signorini's and Coulomb's laws hold where these functions vanish, for any ``rho > 0``
(Alart & Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353)::

    p - max(0, p - rho gap)
    t - projection of (t - rho slip) onto the disc of radius mu max(0, p - rho gap)

Newton's method on them is an active-set method: free nodes have no forces, sticking nodes have no slip,
slipping nodes lie on the cone. Little changes between two steps, so the factorisation is reused while it
contracts and no node changes its state. It needs some three iterations; a plain iteration between contact
and friction failed on a fifth of the steps of a slide over grooves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from tactiled.array import FloatArray

IntArray = NDArray[np.int64]

_ITERATIONS = 60  # no solution in the tests needs more than 30; a cycle does not end
_TOLERANCE = 1e-7  # of the load, or of `_SMALL_N`: a hundredth of a change of the ADC's last bit of any side
_SMALL_N = 1e-3  # load below which the tolerance is absolute
_CONTRACTION = 0.3  # of the residual in a step; a factorisation that does worse is renewed


@dataclass(frozen=True, eq=False)
class Solution:
    """Nodal forces in their contact frames, with the state of the nodes."""

    force_n: FloatArray  # (3, n)
    approach_mm: float
    slips: NDArray[np.bool_]  # (n,) touching and on the cone
    converged: bool


@dataclass(frozen=True, eq=False)
class _Factorisation:
    """Factorised Newton matrix of a contact state."""

    nodes: IntArray
    slipping: IntArray  # places among `nodes`
    lu: FloatArray
    pivots: IntArray


class ContactSolver:
    """Solve one step after the other for one body, keeping the last factorisation.

    ``compliance[i, k, j, l]`` is the displacement of node k by a force on node l, mm/N; symmetric, positive
    definite. Components i and j: into the body, x, y.
    """

    def __init__(self, compliance: FloatArray, friction: float) -> None:
        self._compliance = compliance
        self._n = compliance.shape[1]
        self._flat = compliance.reshape(3 * self._n, 3 * self._n)
        stiffness = 1.0 / np.diag(self._flat).reshape(3, self._n)
        self._rho_n, self._rho_t = stiffness[0], stiffness[1:].min(axis=0)
        self.friction = friction
        self._factor: _Factorisation | None = None

    def solve(self, frame: FloatArray, free: FloatArray, force_n: FloatArray, load_n: float) -> Solution:
        """Solve one step for a total force `load_n` into the body, above 0, from a first guess (3, n).

        ``frame[i, :, k]`` is the contact direction i (normal into the body, two tangents) of node k in body
        components, whose first is also the `lift`. `free` (3, n) are the gap, and the slip of this step, that
        the nodes would have without forces and further approach, mm.
        """
        lift, force, approach = frame[:, 0], force_n.copy(), 0.0
        scale = max(load_n, _SMALL_N)
        last = np.inf
        slips = np.zeros(self._n, dtype=bool)
        for _ in range(_ITERATIONS):
            v, pull = self._motion(frame, free, force, approach)
            push = force[0] - self._rho_n * v[0]
            touches, bound = push > 0, self.friction * np.maximum(push, 0.0)
            size = np.hypot(pull[0], pull[1])
            slips = touches & ((size > bound) | (self.friction == 0))
            kept = np.minimum(1.0, bound / np.maximum(size, 1e-300))
            residual = max(
                float(np.abs(force[0] - np.maximum(push, 0.0)).max()),
                float(np.abs(force[1:] - kept * pull).max()),
                abs(float((lift * force).sum()) - load_n),
            )
            if residual <= _TOLERANCE * scale:
                return Solution(force, approach, slips, True)
            if not touches.any():
                # Some node must carry the load: begin again with the nearest one alone, without friction.
                nearest = int(np.argmin(v[0] / lift[0]))
                force[:] = 0.0
                force[0, nearest] = load_n / lift[0, nearest]
                v, _ = self._motion(frame, free, force, approach)
                approach += float(v[0, nearest] / lift[0, nearest])
                continue
            nodes = np.flatnonzero(touches)
            if (~touches & (force != 0).any(axis=0)).any():
                force[:, ~touches] = 0.0
                v, pull = self._motion(frame, free, force, approach)
            stale = residual > _CONTRACTION * last
            last = residual
            step = self._newton_step(frame, force, v, pull, nodes, slips[nodes], load_n, stale)
            if step is None:
                break
            force[:, nodes] += step[: 3 * len(nodes)].reshape(3, -1)
            approach += float(step[-1])
        return Solution(force, approach, slips, False)

    def _motion(
        self, frame: FloatArray, free: FloatArray, force: FloatArray, approach: float
    ) -> tuple[FloatArray, FloatArray]:
        """Gaps and slips under forces, and the trial friction ``t - rho slip``."""
        body_force = np.einsum("ijk,ik->jk", frame, force)
        moved = (self._flat @ body_force.ravel()).reshape(3, self._n)
        v = free + np.einsum("ijk,jk->ik", frame, moved) - frame[:, 0] * approach
        return v, force[1:] - self._rho_t * v[1:]

    def _newton_step(
        self,
        frame: FloatArray,
        force: FloatArray,
        v: FloatArray,
        pull: FloatArray,
        nodes: IntArray,
        slips: NDArray[np.bool_],
        load_n: float,
        stale: bool,
    ) -> FloatArray | None:
        """Newton's step of the touching nodes' forces and of the approach; None where it is singular."""
        slipping = np.flatnonzero(slips)
        among = nodes[slipping]
        size = np.maximum(np.hypot(*pull[:, among]), 1e-300)
        along = pull[:, among] / size
        bound = self.friction * np.maximum(force[0, among], 0.0)
        goal = -v[:, nodes]
        goal[1:, slipping] = bound * along - force[1:, among]
        right = np.append(goal.ravel(), load_n - (frame[:, 0] * force).sum())
        factor = self._factor
        if (
            stale
            or factor is None
            or not np.array_equal(factor.nodes, nodes)
            or not np.array_equal(factor.slipping, slipping)
        ):
            matrix = self._matrix(frame, nodes, slipping, along, bound / size)
            lu, pivots, info = lapack.dgetrf(matrix, overwrite_a=1)
            if info:
                return None
            factor = self._factor = _Factorisation(nodes, slipping, lu, pivots)
        step, _ = lapack.dgetrs(factor.lu, factor.pivots, right)
        return np.asarray(step) if np.isfinite(step).all() else None

    def _matrix(
        self, frame: FloatArray, nodes: IntArray, slipping: IntArray, along: FloatArray, ratio: FloatArray
    ) -> FloatArray:
        """Derivative of the functions above at the touching nodes, bordered by the load."""
        count = len(nodes)
        axes = frame[:, :, nodes].transpose(2, 0, 1)  # (k, 3, 3): one rotation a node
        part = self._compliance[:, nodes][:, :, :, nodes].transpose(1, 0, 2, 3).reshape(count, 3, -1)
        rotated = (axes @ part).reshape(count, 3, 3, count).transpose(3, 2, 1, 0).reshape(count, 3, -1)
        local = (axes @ rotated).reshape(count, 3, 3, count).transpose(2, 3, 1, 0)
        matrix = np.zeros((3 * count + 1,) * 2, order="F")
        matrix[: 3 * count, : 3 * count] = local.reshape(3 * count, 3 * count)
        lift = frame[:, 0, nodes].ravel()
        matrix[:-1, -1], matrix[-1, :-1] = -lift, lift
        if len(slipping):
            one, two = count + slipping, 2 * count + slipping
            ratio = np.minimum(ratio, 1.0)  # beyond 1 the derivative turns over and Newton runs away
            across = np.array([ratio * along[1] ** 2, -ratio * along[0] * along[1], ratio * along[0] ** 2])
            rho = self._rho_t[nodes[slipping]]
            first, second = matrix[one], matrix[two]
            matrix[one] = (rho * across[0])[:, None] * first + (rho * across[1])[:, None] * second
            matrix[two] = (rho * across[1])[:, None] * first + (rho * across[2])[:, None] * second
            matrix[one, one] += 1 - across[0]
            matrix[two, two] += 1 - across[2]
            matrix[one, two] -= across[1]
            matrix[two, one] -= across[1]
            matrix[one, slipping] -= self.friction * along[0]
            matrix[two, slipping] -= self.friction * along[1]
        return matrix
