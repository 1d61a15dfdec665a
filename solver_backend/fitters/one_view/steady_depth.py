"""Depth that trembles is calmed: what one camera measures least is smoothed in time most."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.fitters.measurements.base import OneView
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.solution import SolvedFrames
from solver_backend.geometry.arrays import constant, to_numpy
from solver_backend.geometry.rotations import exp_so3

DEPTH_S, ACROSS_S = 0.067, 0.023
"""Standard deviations of the Gaussians over time, along the line of sight and across it. A bone of known length that
lies nearly in the picture turns pixels of noise into centimetres of depth: without smoothing, accelerations along the
line of sight are farther off than none at all would be. Joints stay as far off with 0.05 as with 0.1 s (0.3 mm)."""
_REACH = 3.0
"""Standard deviations after which a Gaussian ends."""
_LEAST = 1e-6
"""Keeps what a joint without a turn of its own has open from being divided by zero."""


def steady_depth(solved: SolvedFrames, one: OneView, fps: float) -> SolvedFrames:
    """Return the solution with bones and place smoothed in time, along the line of sight more than across.

    With s the line of sight and G the Gaussians, a bone of direction u turns to ``G_d (u·s) s + G_a (u - (u·s) s)`` by
    the smallest turn of the joint it hangs from, over all bones that hang from it; the root goes to the smoothed
    distance in the smoothed direction. Lengths stay.

    Args:
        solved: the take.
        one: the camera's place and the line of sight to the person.
        fps: frames per second.
    """
    body, frames, sight = solved.subject.body, solved.frames, one.sight
    if len(sight) < 3:
        return solved
    root, local, transl = (to_numpy(part) for part in (frames.root, frames.local, frames.transl))
    rest = np.asarray(body.rest_joints(to_numpy(solved.subject.betas)))[: local.shape[1] + 1]
    parents = np.array(body.parents[: local.shape[1] + 1])
    G = np.empty((len(root), len(parents), 3, 3))
    G[:, 0] = root
    for j in range(1, len(parents)):  # over the tree
        G[:, j] = G[:, parents[j]] @ local[:, j - 1]
    turned = exp_so3(_turns(G, rest, parents, sight, fps)) @ G
    local = np.swapaxes(turned[:, parents[1:]], -1, -2) @ turned[:, 1:]
    away = transl + rest[0] - one.centre
    distance = np.linalg.norm(away, axis=1)
    way = smooth(away / distance[:, None], ACROSS_S * fps)
    way *= (smooth(distance[:, None], DEPTH_S * fps)[:, 0] / np.linalg.norm(way, axis=1))[:, None]
    like = frames.transl
    calm = PosedFrames(*(constant(part, like) for part in (turned[:, 0], local, way + one.centre - rest[0])))
    return replace(solved, frames=calm)


def _turns(G: np.ndarray, rest: np.ndarray, parents: np.ndarray, sight: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, J, 3) rotation vectors in the world: ``(Σ 1 - u uᵀ)⁺ Σ u × u'`` over the bones of each joint."""
    children = np.arange(1, len(parents))
    bones = rest[children] - rest[parents[children]]
    u = np.einsum("fjab,jb->fja", G[:, parents[children]], bones / np.linalg.norm(bones, axis=1, keepdims=True))
    along = np.einsum("fja,fa->fj", u, sight)[..., None]
    wanted = smooth(along, DEPTH_S * fps) * sight[:, None] + smooth(u - along * sight[:, None], ACROSS_S * fps)
    wanted /= np.linalg.norm(wanted, axis=-1, keepdims=True)
    hangs = (parents[children] == np.arange(len(parents))[:, None]).astype(float)
    H = np.einsum("jc,fcab->fjab", hangs, np.eye(3) - u[..., :, None] * u[..., None, :])
    g = np.einsum("jc,fca->fja", hangs, np.cross(u, wanted))
    return np.einsum("fjab,fjb->fja", np.linalg.inv(H + _LEAST * np.eye(3)), g)


def smooth(values: np.ndarray, sigma: float) -> np.ndarray:
    """Return (F, ...) values under a Gaussian over frames, which go on beyond the ends as they came: ``2 x_0 - x_i``.

    Args:
        values: (F, ...).
        sigma: standard deviation in frames.
    """
    reach = min(int(np.ceil(_REACH * sigma)), len(values) - 1)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, _LEAST)) ** 2)
    padded = np.pad(values, [(reach, reach), *[(0, 0)] * (values.ndim - 1)], mode="reflect", reflect_type="odd")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)
    return windows @ (weights / weights.sum())
