"""Our motion file as a motion in the solver's types, every array required to be as the solver writes it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from solver_backend.exchange import motion_file
from solver_backend.exchange.amass_poses import AMASS_POSE_WIDTH
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.motion_file import (
    FORMAT,
    STORED,
    VERSION,
    MotionFile,
    layout_of,
    motion_of,
)
from solver_backend.exchange.plain_values import as_plain
from solver_backend.exchange.schema import Fields, read_fields
from solver_backend.io.native.provenance import read_provenance
from solver_backend.types import NUM_BETAS, Motion

_SAME = (
    "betas", "transl", "fps", "body", "body_layout", "joints", "keypoints3d", "joint_sigma", "joint_covariance",
    "keyframes", "contacts", "flags", "resting", "reprojection_px", "markers", "marker_residual_mm", "marker_flags",
    "marker_sigma", "cleaned_markers", "offsets", "props",
)  # fmt: skip
"""What a motion and its file call by one name."""


def write_motion(path: Path | str, motion: Motion, overwrite: bool = False, name: str | None = None) -> Path:
    """Write a motion, under another name than the file's if asked; optional parts it lacks are left out.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
    """
    rotvec = np.concatenate([motion.global_orient, motion.body_pose], axis=1)
    record = MotionFile(
        name=Path(path).stem if name is None else name,
        rotvec=rotvec.reshape(motion.num_frames, -1, 3),
        joint_set="" if motion.joint_set is None else motion.joint_set.value,
        marker_labels=motion.marker_labels or (),
        layout=motion.layout or (),
        provenance=json.dumps(as_plain(motion.provenance), sort_keys=True),
        **{name: getattr(motion, name) for name in _SAME},
    )
    return motion_file.write_motion(path, record, overwrite=overwrite)


def read_motion(path: Path | str) -> Motion:
    """Read a motion file.

    Raises:
        FileMissing, FileDamaged: it is not there, truncated, of another format or lacks fields.
        MotionInvalid: its values are not finite, or its layout is none.
    """
    fields = read_fields(path, STORED)
    if "format" not in fields and "poses" in fields:
        raise FileDamaged(
            "The file is AMASS, not a motion file of this program: it has no joint positions.",
            where=str(path),
            hint="Convert it first.",
        )
    fields.require_format(FORMAT, VERSION)
    _require_arrays(fields)
    record = motion_of(fields)
    return Motion(
        global_orient=record.rotvec[:, 0].copy(),
        body_pose=record.rotvec[:, 1:].reshape(record.num_frames, -1),
        joint_set=fields.joint_set() if "joint_set" in fields else None,
        marker_labels=record.marker_labels or None,
        layout=record.layout or None,
        provenance=read_provenance(fields),
        **{name: getattr(record, name) for name in _SAME},
    )


def _require_arrays(fields: Fields) -> None:
    """Make sure that every array is there that the solver writes, and of the shape it has then.

    Raises:
        FileDamaged: one is not.
    """
    layout = layout_of(fields)
    width = AMASS_POSE_WIDTH if layout == SMPL else 3 * layout.num_joints
    frames = len(fields.numbers("poses", (None, width)))
    shapes = {"betas": (NUM_BETAS,), "trans": (frames, 3), "mocap_framerate": (), "hand_pose": (frames, 6)}
    shapes |= motion_file.optional_shapes(frames, layout.num_joints)
    for key, shape in shapes.items():
        if key in fields or key in ("betas", "trans", "mocap_framerate", "joints"):
            fields.numbers(key, shape)
    fields.text("body")
