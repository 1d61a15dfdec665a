"""Write AMASS files: poses, translations and shape in one ``.npz`` file, Z up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..._exchange.body_layout import SMPL, SMPL_HANDS
from ..._exchange.finger_joints import to_flat
from ..._exchange.npz import read_arrays
from ..._exchange.progress import Progress
from ..._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from ...body.body_file import body_path_of, default_hands_path, read_body
from ...body.face import expressions_of, face_bones, turns_of_shapes
from ...body.shape import body_mesh, get_betas
from ...conventions.coordinates import R_ARMATURE_BODY
from ...conventions.skeleton import layout_of
from ...errors import NothingToExport
from ..plain_take import is_body, sample_expressions
from ..take import ExportTake, PoseSamples, against_parents, sample_pose, uniform_scale

_BODY = 1 + SMPL.num_solved  # Number of joints that AMASS shares with SMPL.
_SCALED = 1e-3  # Scales that deviate from 1 by more than this are not supported. Chosen by hand.


def export_amass(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write a take of this add-on in SMPL-H form, with axis-angle vectors ``poses`` (F, 156) in radians.

    Finger rotations are relative to a flat hand, as in AMASS. ``hand_pose`` has the rotations of SMPL's hand joints,
    which AMASS does not have, and ``joints`` has the joint positions. The take's shape and body file must be known.
    """
    arrays, parts = _read_take(take, progress)
    poses = np.concatenate([parts[key] for key in ("root_orient", "pose_body", "pose_hand")], axis=1)
    np.savez_compressed(path, poses=poses, surface_model_type=np.array("smplh"), **arrays)


def export_amass_x(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write a take of this add-on in SMPL-X form, with ``poses`` (F, 165).

    Jaw and eye rotations are the sum of the bone rotations and the facial shapes. Other facial shapes are not written.
    """
    arrays, parts = _read_take(take, progress)
    order = ("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand")
    poses = np.concatenate([parts[key] for key in order], axis=1)
    np.savez_compressed(path, poses=poses, surface_model_type=np.array("smplx"), **arrays, **parts)


def _read_take(take: ExportTake, progress: Progress) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the arrays that SMPL-H and SMPL-X files have in common, and the poses of SMPL-X's parts by name."""
    betas, rest_pelvis = _shape(take)
    _require_own_size(take)
    joints, bones = layout_of(take.armature.data.bones).joints, face_bones(take.armature)
    pose = sample_pose(take, progress, (*joints, *bones))
    turned, frames = local_rotvec(pose), pose.num_frames
    rotvec, face = turned[:, : len(joints)], _shape_turns(take)
    for j, name in enumerate(pose.names):
        if name in face:
            face[name] += turned[:, j]
    arrays = {"trans": pose.heads[:, 0] - rest_pelvis, "betas": betas, "gender": np.array("neutral")}
    arrays |= {"mocap_framerate": np.array(pose.fps), "joints": pose.heads[:, : len(joints)]}
    arrays |= {"body": np.array(take.armature["body"])}
    beyond, fingers = rotvec[:, _BODY:], np.zeros((frames, SMPL_HANDS.num_joints - _BODY, 3))
    if rotvec.shape[1] == SMPL_HANDS.num_joints:
        fingers = _fingers(beyond, str(take.armature["body"]))
    else:
        arrays["hand_pose"] = beyond.reshape(frames, -1)
    body = rotvec[:, 1:_BODY].reshape(frames, -1)
    parts = {"root_orient": rotvec[:, 0], "pose_body": body, "pose_jaw": face["jaw"]}
    parts |= {"pose_eye": np.hstack([face["left_eye"], face["right_eye"]]), "pose_hand": fingers.reshape(frames, -1)}
    return arrays, parts


def _shape_turns(take: ExportTake) -> dict[str, np.ndarray]:
    values, mesh = dict[str, np.ndarray](), body_mesh(take.armature)
    if mesh is not None:
        values = {key.name: np.full(take.num_frames, key.value) for key in expressions_of(mesh)}
        values |= sample_expressions(take, mesh)
    return turns_of_shapes(values, take.num_frames)


def _fingers(rotvec: np.ndarray, body: str) -> np.ndarray:
    hands = read_arrays(default_hands_path(), required=("body_id", "flat"))
    if body != str(hands["body_id"]):
        return rotvec
    return rotvec_from_matrix(to_flat(matrix_from_rotvec(rotvec), np.asarray(hands["flat"], np.float64)))


def _require_own_size(take: ExportTake) -> None:
    if abs(take.metres_a_unit * uniform_scale(take) - 1) > _SCALED:
        hint = "AMASS files have no scale. Set the scale of the armature and its parents to 1."
        raise NothingToExport("The armature is scaled.", where=take.name, hint=hint)


def _shape(take: ExportTake) -> tuple[np.ndarray, np.ndarray]:
    if "betas" not in take.armature:
        hint = "Choose an armature that this add-on baked, because AMASS files describe a body shape."
        raise NothingToExport("The armature does not state its body and shape.", where=take.name, hint=hint)
    solved, rest_pelvis = np.array(take.armature["betas"]), np.array(take.armature["rest_pelvis"])
    betas = get_betas(take.meshes[0]) if take.meshes and is_body(take) else solved
    if np.allclose(betas, solved, atol=1e-4):
        return solved, rest_pelvis
    body = read_body(body_path_of(take.armature.get("provenance", "")))
    if body.id != take.armature["body"]:
        message = "The body's shape was changed after the solve, and its body file is missing."
        raise NothingToExport(message, where=take.name, hint="Set the shape sliders back to the solved shape.")
    return betas, body.rest_joints(betas)[0]


def local_rotvec(pose: PoseSamples) -> np.ndarray:
    """Return axis-angle vectors (F, J, 3). The root is relative to the world, other joints to their parents."""
    return rotvec_from_matrix(against_parents(pose.rotations @ R_ARMATURE_BODY, pose.parents))
