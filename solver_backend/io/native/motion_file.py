"""Our motion file: one ``.npz`` that other tools read as AMASS, with our own arrays beside."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.fields import Fields, read_fields
from solver_backend.io.files import write_npz
from solver_backend.types import NUM_BETAS, NUM_BODY_JOINTS, NUM_JOINTS, Motion

FORMAT = "manifold_mocap_motion"
VERSION = 1
AMASS_POSE_WIDTH = 156
"""SMPL-H: root, 21 body joints, 2 x 15 finger joints, 3 numbers each (Mahmood et al. 2019)."""
_OBSERVED = 3 + 3 * NUM_BODY_JOINTS


def write_motion(path: Path | str, motion: Motion, overwrite: bool = False) -> Path:
    """Write a motion; optional parts it lacks are left out of the file.

    ``poses`` (F, 156) holds the root and joints 1..21; SMPL's hand joints 22 and 23, which AMASS does not know, are
    kept in ``hand_pose`` (F, 6) where they are not zero.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
    """
    frames = motion.num_frames
    poses = np.zeros((frames, AMASS_POSE_WIDTH), np.float32)
    poses[:, :3] = motion.global_orient
    poses[:, 3:_OBSERVED] = motion.body_pose[:, : 3 * NUM_BODY_JOINTS]
    hands = np.asarray(motion.body_pose[:, 3 * NUM_BODY_JOINTS :], np.float32)
    arrays: dict[str, np.ndarray] = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        "poses": poses,
        "trans": np.asarray(motion.transl, np.float32),
        "betas": np.asarray(motion.betas, np.float32),
        "mocap_framerate": np.array(float(motion.fps)),
        "gender": np.array("neutral"),
        "body": np.array(motion.body),
        "joints": np.asarray(motion.joints, np.float32),
        "provenance": np.array(json.dumps(_plain(motion.provenance), sort_keys=True)),
    }
    if hands.any():
        arrays["hand_pose"] = hands
    if motion.joint_set is not None:
        arrays["joint_set"] = np.array(motion.joint_set.value)
    for key in ("keypoints3d", "joint_sigma", "joint_covariance", "reprojection_px"):
        if (value := getattr(motion, key)) is not None:
            arrays[key] = np.asarray(value, np.float32)
    for key, dtype in (("keyframes", np.bool_), ("contacts", np.bool_), ("flags", np.uint8)):
        if (value := getattr(motion, key)) is not None:
            arrays[key] = np.asarray(value, dtype)
    return write_npz(path, arrays, overwrite=overwrite)


def read_motion(path: Path | str) -> Motion:
    """Read a motion file.

    Raises:
        FileMissing, FileDamaged: it is not there, truncated, of another format or lacks fields.
        MotionInvalid: its arrays disagree or are not finite.
    """
    fields = read_fields(path)
    if "format" not in fields and "poses" in fields:
        raise FileDamaged(
            "The file is AMASS, not one of our motion files: it has no joint positions.",
            where=str(path),
            hint="Convert it first.",
        )
    fields.require_format(FORMAT, VERSION)
    poses = fields.numbers("poses", (None, AMASS_POSE_WIDTH))
    frames = len(poses)
    hands = fields.numbers("hand_pose", (frames, 6)) if "hand_pose" in fields else np.zeros((frames, 6))
    return Motion(
        betas=fields.numbers("betas", (NUM_BETAS,)),
        global_orient=poses[:, :3].copy(),
        body_pose=np.concatenate([poses[:, 3:_OBSERVED], hands], axis=1),
        transl=fields.numbers("trans", (frames, 3)),
        fps=fields.number("mocap_framerate"),
        body=fields.text("body"),
        joints=fields.numbers("joints", (frames, NUM_JOINTS, 3)),
        keypoints3d=_optional(fields, "keypoints3d", (frames, None, 3)),
        joint_set=fields.joint_set() if "joint_set" in fields else None,
        joint_sigma=_optional(fields, "joint_sigma", (frames, NUM_JOINTS)),
        joint_covariance=_optional(fields, "joint_covariance", (frames, NUM_JOINTS, 6)),
        keyframes=_optional(fields, "keyframes", (frames,), np.bool_),
        contacts=_optional(fields, "contacts", (frames, 2), np.bool_),
        flags=_optional(fields, "flags", (frames,), np.uint8),
        reprojection_px=_optional(fields, "reprojection_px", (None, frames, None)),
        provenance=_provenance(fields),
    )


def _optional(fields: Fields, key: str, shape: tuple[int | None, ...], dtype: type = np.float64) -> np.ndarray | None:
    return fields.numbers(key, shape).astype(dtype) if key in fields else None


def _plain(value: Any) -> Any:
    """Return the value in JSON's types: arrays as lists, numbers that are not finite as null, the rest as text."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def _provenance(fields: Fields) -> dict[str, Any]:
    try:
        value = json.loads(fields.text("provenance", "{}"))
    except ValueError as error:
        raise FileDamaged(f"The provenance is not JSON ({error}).", where=str(fields.path)) from error
    if not isinstance(value, dict):
        raise FileDamaged("The provenance is not a JSON object.", where=str(fields.path))
    return value
