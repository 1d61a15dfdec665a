"""AMASS: poses, translations and shape of an SMPL-type body in one ``.npz``; metres, radians, Z up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..._exchange.body_layout import SMPL
from ..._exchange.progress import Progress
from ..._exchange.so3 import rotvec_from_matrix
from ...body.body_choice import body_path_of
from ...body.body_file import read_body
from ...body.shape import get_betas
from ...conventions.coordinates import R_ARMATURE_BODY
from ...conventions.skeleton import NUM_JOINTS, PARENTS
from ...errors import NothingToExport
from ..plain_take import is_body
from ..pose_samples import PoseSamples, sample_joints
from ..take import ExportTake, uniform_scale

POSE_WIDTH = 156
"""SMPL-H: root, 21 body joints, 2 x 15 finger joints, 3 numbers each (Mahmood et al. 2019)."""
_BODY = 1 + SMPL.num_solved
"""Joints that AMASS shares with SMPL."""
_SCALED = 1e-3


def export_amass(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write a take of this add-on.

    SMPL's hand joints, which AMASS does not know, go into ``hand_pose``; the joints into ``joints``.

    Raises:
        NothingToExport: it is not known which shape the body has.
        BodyMissing: its shape was changed, and the file of the body it was solved for is not at hand.
    """
    betas, rest_pelvis = _shape(take)
    _require_own_size(take)
    pose = sample_joints(take, progress)
    rotvec = local_rotvec(pose)
    poses = np.zeros((pose.num_frames, POSE_WIDTH))
    poses[:, : 3 * _BODY] = rotvec[:, :_BODY].reshape(pose.num_frames, -1)
    np.savez_compressed(
        path,
        poses=poses,
        trans=pose.heads[:, 0] - rest_pelvis,
        betas=betas,
        gender=np.array("neutral"),
        mocap_framerate=np.array(pose.fps),
        surface_model_type=np.array("smplh"),
        hand_pose=rotvec[:, _BODY:].reshape(pose.num_frames, -1),
        joints=pose.heads,
        body=np.array(take.armature["body"]),
    )


def _require_own_size(take: ExportTake) -> None:
    """Check that the world shows the body as large as its shape says."""
    if abs(take.metres_a_unit * uniform_scale(take) - 1) > _SCALED:
        raise NothingToExport(
            "The armature is scaled.", where=take.name, hint="AMASS knows no scale: set it, and its parents', to 1."
        )


def _shape(take: ExportTake) -> tuple[np.ndarray, np.ndarray]:
    """Return the (10,) betas that the body shows, and the (3,) pelvis of that shape at rest in the body's frame."""
    if "betas" not in take.armature:
        raise NothingToExport(
            "The armature does not say which body and shape it has.",
            where=take.name,
            hint="AMASS describes a body's shape: export an armature that this add-on baked.",
        )
    solved, rest_pelvis = np.array(take.armature["betas"]), np.array(take.armature["rest_pelvis"])
    betas = get_betas(take.meshes[0]) if take.meshes and is_body(take) else solved
    if np.allclose(betas, solved, atol=1e-4):
        return solved, rest_pelvis
    body = read_body(body_path_of(take.armature.get("provenance", "")))
    if body.id != take.armature["body"]:
        raise NothingToExport(
            "The body's shape was changed after the solve, and its body file is not at hand.",
            where=take.name,
            hint="Set the shape sliders back to the solved shape.",
        )
    return betas, body.rest_joints(betas)[0]


def local_rotvec(pose: PoseSamples) -> np.ndarray:
    """Return the (F, 24, 3) axis-angles in the body's frame: the root's to the world, the others' to their parents'."""
    world = pose.rotations @ R_ARMATURE_BODY
    local = world.copy()
    for j in range(1, NUM_JOINTS):
        local[:, j] = world[:, PARENTS[j]].swapaxes(1, 2) @ world[:, j]
    return rotvec_from_matrix(local)
