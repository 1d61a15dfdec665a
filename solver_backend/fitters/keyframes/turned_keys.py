"""Keys that turn off the manifold where it left them: codes stay, roots, places and residual rotations are free.

What exact markers of a known person say of a pose, they say of its joints: a code that is free beside the residual
rotations is told twice, and Gauss-Newton's steps overshoot along what nothing tells. With codes that stay, the decoder
leaves the loop, and a key has 69 unknowns instead of 99.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.state_layout import StateLayout
from solver_backend.fitters.keyframes.bundle_objective import BundleObjective
from solver_backend.fitters.keyframes.normal_equations import (
    BLOCK_FRAMES,
    HESSIAN_FRAMES,
    DataEquations,
    KeyframeNormalEquations,
    matrices_by_keys,
)
from solver_backend.fitters.keyframes.optimise import BundleModel, KeySolution, Schedule, at_windows
from solver_backend.fitters.keyframes.temporal_prior import MotionPrior
from solver_backend.fitters.model.codes import d_pose_d_state
from solver_backend.fitters.model.keyframe_curve import by_turns, lagrange, rows_of, summed_by_keys, turns_of
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, WindowRows
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import frame_equations
from solver_backend.fitters.solution import Convergence
from solver_backend.geometry.arrays import Array, constant, zeros
from solver_backend.geometry.interpolation import sider_weights
from solver_backend.geometry.parallel import block_size, map_blocks
from solver_backend.geometry.rotations import (
    exp_so3,
    left_jacobian_so3,
    matrix_from_quat,
    quat_left_tangent,
)
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import LazyNormalEquations

LOOSENESS = 2.0
"""So many times as far as beside free codes joints may turn: codes that follow take a part of every turn."""


def solve_turned(
    model: BundleModel, layout: KeyframeLayout, start: Keyframes, schedule: Schedule, fixed: np.ndarray | None = None,
    alive: Callable[[], None] = lambda: None,
) -> KeySolution:  # fmt: skip
    """Solve the free keyframes at once, their codes as they are; arguments as of ``solve_keys``."""
    xp, free = array_namespace(start.z), model.layout
    fixed = np.zeros(layout.num_keys, dtype=bool) if fixed is None else fixed
    judged, keys = _Judged.of(model, layout, start, schedule), hemisphere_aligned(start)
    solution = None

    def retract(state: Keyframes, step: Array) -> Keyframes:
        return state.retract(xp.reshape(step, (-1, free.dof))[: layout.num_keys], free)

    for scale in schedule.scales:

        def linearise(state: Keyframes, scale: float = scale) -> tuple[Array, LazyNormalEquations]:
            alive()
            cost, form = judged.equations(state, scale)
            return cost[None], LazyNormalEquations(lambda: form().with_fixed(fixed).block_tridiagonal())

        result = levenberg_marquardt(
            keys, linearise, retract, LMSettings(schedule.iterations, schedule.tolerance, schedule.promise)
        )
        keys = result.state
        solution = KeySolution(keys, float(xp.sum(result.cost)), Convergence.of(result))
    assert solution is not None
    return solution


@dataclass(frozen=True)
class _Judged:
    """What the keys are judged by, and the poses that their codes make of all frames that are looked at."""

    model: BundleModel
    objective: BundleObjective
    """Its terms on keys know of no codes."""
    rows: WindowRows
    columns: np.ndarray
    """Of the rows, whose Hessians are formed."""
    blocks: list[slice]
    """Ranges of windows."""
    local: list[Array]
    """(W·n, J, 3, 3) of each range: what the codes decode to."""

    @classmethod
    def of(cls, model: BundleModel, layout: KeyframeLayout, keys: Keyframes, schedule: Schedule) -> _Judged:
        rows = layout.rows(schedule.stride)
        terms = tuple(
            replace(term, codes=False) if isinstance(term, MotionPrior) else term for term in model.objective.keys
        )
        blocks = rows.blocks(block_size(BLOCK_FRAMES, keys.z))

        def decode(windows: slice) -> Array:
            triples = keys.triples(np.arange(windows.start, windows.stop))
            codes = sider_weights(triples.z[:, None], constant(rows.time[windows], keys.z))
            return model.prior.decode(rows_of(codes.value))

        local = map_blocks(decode, blocks, keys.z)
        objective = replace(model.objective, keys=terms)
        return cls(model, objective, rows, rows.columns(schedule.hessian_frames), blocks, local)

    def equations(self, keys: Keyframes, scale: float) -> tuple[Array, Callable[[], KeyframeNormalEquations]]:
        """Return the objective (N,) of each window, and what forms the equations; see ``BundleModel.equations``."""

        def block(number: int) -> tuple[Array, Array, Callable[[], Array]]:
            windows = self.blocks[number]
            part = keys.select(slice(2 * windows.start, 2 * windows.stop + 1))
            return self._block(part, self.rows.select(windows), self.local[number], scale)

        parts = map_blocks(block, range(len(self.blocks)), keys.z)
        gradient = zeros((keys.z.shape[0], self.model.layout.dof), keys.z)
        for windows, (_, by_keys, _) in zip(self.blocks, parts, strict=True):
            gradient[2 * windows.start : 2 * windows.stop + 1] += by_keys
        cost = array_namespace(gradient).concat([part[0] for part in parts])
        data = DataEquations(cost, gradient, self.model.layout, self.blocks, [part[2] for part in parts])

        def form() -> KeyframeNormalEquations:
            equations = data.normal_equations()
            for term in self.objective.keys:
                term.add_to(equations, keys)
            return equations

        return at_windows(cost, self.objective.keys, keys), form

    def _block(
        self, keys: Keyframes, rows: WindowRows, decoded: Array, scale: float
    ) -> tuple[Array, Array, Callable[[], Array]]:
        """Return costs (N,), their (2 N + 1, n) derivative, and what forms the (N, 3 n, 3 n) matrices.

        ``R_f = exp(Σ_k w_k ρ_k) G(z_f)`` with Lagrange's weights w, root and translation as in ``KeyframeCurve``.
        """
        xp = array_namespace(keys.z)
        count, width = rows.frames.shape
        time, triples = constant(rows.time, keys.z), keys.triples(np.arange(count))
        quats, shares = sider_weights(triples.quat[:, None], time), lagrange(time)
        shares_T = xp.matrix_transpose(shares)
        turns = xp.matmul(shares, xp.reshape(triples.residual, (count, 3, -1)))
        turns = xp.reshape(turns, (-1, *keys.residual.shape[1:]))
        local = xp.matmul(exp_so3(turns), decoded)
        poses = PosedFrames(matrix_from_quat(rows_of(quats.value)), local, rows_of(xp.matmul(shares, triples.transl)))
        chosen = (np.arange(count)[:, None] * width + self.columns).reshape(-1)
        objective = self.objective.frames.select(rows.frames.reshape(-1))
        found = frame_equations(self.model.subject, poses, objective, scale, chosen)
        weight = constant(rows.weight.reshape(-1), keys.z)
        by_pose = found.gradient * weight[:, None]
        joints = xp.reshape(by_pose[:, poses.layout.joints], (*turns.shape, 1))
        by_turns_ = xp.matmul(xp.matrix_transpose(left_jacobian_so3(turns)), joints)
        root = xp.reshape(by_pose[:, poses.layout.root], (count, width, 3, 1))
        by_quat = xp.matmul(4.0 * quat_left_tangent(quats.value), root)[..., 0]
        by_transl = xp.reshape(by_pose[:, poses.layout.transl], (count, width, 3))
        gradient = xp.concat(
            [
                by_turns(keys.quat, summed_by_keys(xp.sum(quats.vjp(by_quat), axis=1))),
                summed_by_keys(xp.matmul(shares_T, by_transl)),
                turns_of(
                    summed_by_keys(xp.matmul(shares_T, xp.reshape(by_turns_, (count, width, -1)))), self.model.layout
                ),
            ],
            axis=-1,
        )
        cost = xp.sum(xp.reshape(found.cost * weight, (count, width)), axis=1)

        def form() -> Array:
            return matrices_by_keys(rows.sampled(self.columns), found.hessian, d_pose_d_turned(self.model.layout, keys))

        return cost, gradient, form


def turned_information(
    model: BundleModel, layout: KeyframeLayout, keys: Keyframes, scale: float
) -> KeyframeNormalEquations:
    """Return the equations at a solution whose codes stay; see ``BundleModel.information``."""
    schedule = Schedule((scale,), 1, stride=int(np.diff(layout.bounds).max()) // HESSIAN_FRAMES or 1)
    return _Judged.of(model, layout, keys, schedule).equations(keys, scale)[1]()


def d_pose_d_turned(layout: StateLayout, keys: Keyframes) -> Array:
    """Return (K, p, n): the pose tangents of keys by the tangents of states whose codes stay."""
    return d_pose_d_state(layout, None, by_residual=left_jacobian_so3(keys.residual))
