"""Markers and joints of many people in many poses at once, in torch, where the network trains."""

from __future__ import annotations

import numpy as np
import torch

from solver_backend.body.body import Body
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import marker_landmarks, skin_normals
from solver_backend.labelling.outputs import MARKERS, OTHER_PLACES

PLACES: tuple[str, ...] = (*MARKERS, *OTHER_PLACES)


def rodrigues(rotvec: torch.Tensor) -> torch.Tensor:
    """Return ``exp([v]x)`` of (..., 3) rotation vectors: (..., 3, 3)."""
    angle = (rotvec.square().sum(-1) + 1e-12).sqrt()[..., None, None]
    x, y, z = rotvec.unbind(-1)
    zero = torch.zeros_like(x)
    K = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))
    eye = torch.eye(3, device=rotvec.device, dtype=rotvec.dtype)
    return eye + (angle.sin() / angle) * K + ((1.0 - angle.cos()) / angle.square()) * (K @ K)


class BodyPoints:
    """The skinned places and the joints of a body; B samples, P places, J = 24 joints.

    ``y_l = sum_b w_lb p_b + G_b (a_lb + S_lb beta + w_lb o_l - w_lb J_b(beta)) + blend_l P_l f`` as in
    ``Landmarks`` (Loper et al. 2015, eqs. 2-10), with a shape and offsets o of each sample's own.
    """

    def __init__(self, body: Body, device: str) -> None:
        marks = marker_landmarks(body, PLACES)
        self.device = device
        self.levels = [tuple(torch.tensor(x, device=device) for x in level) for level in _levels(body.parents)]
        self.parents = body.parents
        self.weights = self._tensor(marks.weights)
        self.anchors = self._tensor(marks.anchors)
        self.shapedirs = self._tensor(marks.shapedirs.reshape(-1, marks.shapedirs.shape[-1]).T)
        assert marks.posedirs is not None
        self.posedirs = self._tensor(marks.posedirs.reshape(-1, marks.posedirs.shape[-1]).T)
        self.joints = self._tensor(body.joints_template)
        self.joint_shapes = self._tensor(body.joints_shapedirs.reshape(-1, body.joints_shapedirs.shape[-1]).T)
        self.normals = self._tensor(skin_normals(body, PLACES))
        spread = np.array([load_layouts().spread_of(name) for name in PLACES])
        self.spread = self._tensor(spread)
        """(P, 2) metres off the skin and along it by which places stray from their rules."""

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(array, dtype=np.float32), device=self.device)

    def __call__(
        self, root: torch.Tensor, local: torch.Tensor, betas: torch.Tensor, offsets: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (B, P, 3) markers and (B, 24, 3) joints, the pelvis at rest height, in the rest frame's axes.

        Args:
            root: (B, 3, 3).
            local: (B, 21, 3, 3).
            betas: (B, 10).
            offsets: (B, P, 3) metres in the rest frame.
        """
        count, places = len(root), len(PLACES)
        rest = self.joints + (betas @ self.joint_shapes).unflatten(-1, (-1, 3))
        G, joints = self._posed(root, local, rest)
        levers = self.anchors + (betas @ self.shapedirs).view(count, places, -1, 3)
        levers = levers + self.weights[..., None] * (offsets[:, :, None] - rest[:, None])
        flat = G.permute(0, 2, 1, 3).reshape(count, 3, -1)
        points = torch.bmm(levers.view(count, places, -1), flat.transpose(1, 2))
        points = points + torch.matmul(self.weights, joints)
        eye = torch.eye(3, device=root.device)
        feature = torch.cat(((local - eye).flatten(1), torch.zeros(count, 18, device=root.device)), 1)
        correction = (feature @ self.posedirs).unflatten(-1, (places, 3))
        blend = torch.matmul(self.weights, G.flatten(2)).unflatten(-1, (3, 3))
        return points + (blend @ correction[..., None])[..., 0], joints

    def _posed(self, root: torch.Tensor, local: torch.Tensor, rest: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return global rotations (B, 24, 3, 3) and joints (B, 24, 3), level by level of the tree."""
        count = len(root)
        hands = torch.eye(3, device=root.device).expand(count, 2, 3, 3)
        local = torch.cat((root[:, None], local, hands), 1)
        G, joints = local.clone(), rest.clone()
        for children, parents in self.levels:
            G[:, children] = G[:, parents] @ local[:, children]
            step = (G[:, parents] @ (rest[:, children] - rest[:, parents])[..., None])[..., 0]
            joints[:, children] = joints[:, parents] + step
        return G, joints


def _levels(parents: tuple[int, ...]) -> list[tuple[list[int], list[int]]]:
    """Return joints by their distance from the root, with their parents."""
    depth = [0] * len(parents)
    for joint, parent in enumerate(parents):
        depth[joint] = 0 if parent < 0 else depth[parent] + 1
    levels = [[j for j in range(len(parents)) if depth[j] == d] for d in range(1, max(depth) + 1)]
    return [(level, [parents[j] for j in level]) for level in levels]
