"""AMASS: poses, translations and shape of an SMPL-type body in one ``.npz``; metres, radians, Z up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..bake.coordinates import R_ARMATURE_BODY
from ..bake.rotations import rotvec_from_matrix
from ..errors import NothingToExport
from ..files.skeleton import NUM_JOINTS, PARENTS
from ..progress import Progress
from .pose_samples import PoseSamples, sample_joints
from .take import ExportTake

POSE_WIDTH = 156
"""SMPL-H: root, 21 body joints, 2 x 15 finger joints, 3 numbers each (Mahmood et al. 2019)."""
_BODY = 66


def export_amass(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write a take of this add-on.

    SMPL's hand joints 22 and 23, which AMASS does not know, go into ``hand_pose``; the joints into ``joints``.

    Raises:
        NothingToExport: the armature does not say which shape it has.
    """
    if "betas" not in take.armature:
        raise NothingToExport(
            "The armature does not say which body and shape it has.",
            where=take.name,
            hint="AMASS describes a body's shape: export an armature that this add-on baked.",
        )
    pose = sample_joints(take, progress)
    rotvec = local_rotvec(pose)
    poses = np.zeros((pose.num_frames, POSE_WIDTH))
    poses[:, :_BODY] = rotvec[:, :22].reshape(pose.num_frames, _BODY)
    np.savez_compressed(
        path,
        poses=poses,
        trans=pose.heads[:, 0] - pose.rest_heads[0] @ R_ARMATURE_BODY,
        betas=np.array(take.armature["betas"], np.float64),
        gender=np.array("neutral"),
        mocap_framerate=np.array(pose.fps),
        surface_model_type=np.array("smplh"),
        hand_pose=rotvec[:, 22:].reshape(pose.num_frames, -1),
        joints=pose.heads,
        body=np.array(take.armature["body"]),
    )


def local_rotvec(pose: PoseSamples) -> np.ndarray:
    """Return the (F, 24, 3) axis-angles in the body's frame: the root's to the world, the others' to their parents'."""
    world = pose.rotations @ R_ARMATURE_BODY
    local = world.copy()
    for j in range(1, NUM_JOINTS):
        local[:, j] = world[:, PARENTS[j]].swapaxes(1, 2) @ world[:, j]
    return rotvec_from_matrix(local)
