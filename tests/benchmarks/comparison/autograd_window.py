"""Cost and gradient of one window as BundleMoCap++ was published, by automatic differentiation in PyTorch."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.mesh import pose_mesh
from solver_backend.cameras.projection import project
from solver_backend.fitters.model.keyframe_layout import lagrange
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.recipes.bundlemocap import KeyState, Window
from solver_backend.geometry.arrays import constant, to_numpy
from solver_backend.geometry.interpolation import sider2
from solver_backend.geometry.rotations import matrix_from_quat, quat_from_matrix, quat_left_tangent
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.terms import geman_mcclure
from solver_backend.types import NUM_BODY_JOINTS

NEAREST = 16  # Number of vertices that define a keypoint.


def keypoint_regressor(body: Body, points: np.ndarray) -> np.ndarray:
    """Return (L, V) weights, with rows that sum to 1, that give (L, 3) rest points from the nearest vertices.

    SMPL's keypoints are defined in this way: the mesh is posed, and keypoints are sums over its vertices.
    """
    regressor = np.zeros((len(points), len(body.v_template)))
    for row, point in zip(regressor, points, strict=True):
        near = np.argsort(np.linalg.norm(body.v_template - point, axis=1))[:NEAREST]
        conditions = np.vstack([body.v_template[near].T, np.ones(NEAREST)])
        row[near] = np.linalg.lstsq(conditions, np.append(point, 1.0), rcond=None)[0]
    return regressor


def resident(body: Body, like: Any) -> Body:
    """Return the body with its large arrays as tensors, as in SMPL's layer."""
    kept = copy.copy(body)
    used = 9 * NUM_BODY_JOINTS
    parts = {"v_template": body.v_template, "shapedirs": body.shapedirs, "weights": body.weights}
    for name, values in {**parts, "posedirs": np.ascontiguousarray(body.posedirs[..., :used])}.items():
        object.__setattr__(kept, name, constant(values, like))
    return kept


@dataclass(frozen=True)
class AutogradWindow:
    """A window of SPoser's codes with a gradient from PyTorch."""

    window: Window
    """Constant data of the window. Its root rotates by SIDER-2."""
    term: ReprojectionTerm
    """Data of the window's frames as tensors."""
    mesh: tuple[Body, Any] | None = None
    """Body with tensors and (L, V) regressor of its keypoints, to pose the whole mesh. None uses only landmarks."""

    def objective(self, state: KeyState) -> tuple[float, KeyState]:
        """Return the cost and its gradient by the free keys: ambient for codes, left tangent for rotations."""
        quats = quat_from_matrix(np.concatenate([self.window.first[1], state[1]]))
        quats = quats * np.cumprod(np.r_[1.0, np.where((quats[1:] * quats[:-1]).sum(-1) < 0, -1.0, 1.0)])[:, None]
        like = self.term.cameras.K
        fixed = [constant(part, like) for part in (self.window.first[0], quats[:1], self.window.first[2])]
        free = [constant(part, like).clone().requires_grad_() for part in (state[0], quats[1:], state[2])]
        cost = self._cost(fixed, free)
        cost.backward()
        by_code, by_quat, by_transl = (to_numpy(part.grad) for part in free)
        turns = (quat_left_tangent(quats[1:]).swapaxes(-1, -2) @ by_quat[..., None])[..., 0]
        return float(cost.detach()), (by_code, turns, by_transl)

    def _cost(self, fixed: list[Any], free: list[Any]) -> Any:
        term, subject = self.term, self.window.subject
        xp, t = _torch(), constant(self.window.time, term.cameras.K)
        z, quat, transl = (xp.concat([a, b]) for a, b in zip(fixed, free, strict=True))
        local = self.window.prior.decode(sider2(z[:1], z[1:2], z[2:], t))
        root = matrix_from_quat(sider2(quat[:1], quat[1:2], quat[2:], t))
        frames = PosedFrames(root, local, lagrange(t) @ transl)
        known = Subject(
            subject.body, subject.landmarks, *(constant(p, term.cameras.K) for p in (subject.betas, subject.offsets))
        )
        if self.mesh is None:
            points = pose(known, frames).points
        else:
            body, regressor = self.mesh
            points = regressor @ pose_mesh(body, known.betas, frames.root, frames.local, frames.transl)
        px = project(term.cameras, points)
        seen = term.weight > 0
        error = xp.where(seen[..., None], px - term.xy, xp.zeros_like(px))
        per_sigma = term.weight / xp.where(seen, term.confidence, xp.ones_like(term.confidence))
        penalty, _ = geman_mcclure(per_sigma * (error**2).sum(-1), self.window.scale)
        return 0.5 * (term.confidence * penalty).sum()


def _torch() -> Any:
    import torch

    return torch
