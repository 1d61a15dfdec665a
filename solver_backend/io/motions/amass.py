"""Read AMASS npz files of the first release (SMPL-H) and of the later one (SMPL-X)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.body_layout import SMPL, SMPL_H, SMPL_X
from solver_backend.exchange.errors import FileDamaged, MotionInvalid, NonFiniteData
from solver_backend.exchange.plausible import LARGEST_BETA, LARGEST_TURN, require_within
from solver_backend.exchange.schema import Fields, read_fields
from solver_backend.io.files import npz_names
from solver_backend.io.reader import Reader
from solver_backend.types import NUM_BETAS, NUM_BODY_JOINTS, NUM_JOINTS, Motion

_RATES = ("mocap_framerate", "mocap_frame_rate", "fps")
_PARTS = "poses trans betas root_orient pose_body pose_hand surface_model_type gender"
_STORED = (*_RATES, *_PARTS.split())
_WIDTHS = {3 * SMPL.num_joints: "smpl", 3 * SMPL_H.num_joints: "smplh", 3 * SMPL_X.num_joints: "smplx"}
"""Body model for each possible number of columns in ``poses``."""
_BODY = 3 * NUM_BODY_JOINTS
_FINGERS = 3 * len(SMPL_H.group("left_hand") + SMPL_H.group("right_hand"))
"""Number of pose parameters for both hands (rotation vectors)."""

JointsOf = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Function that maps betas (10,), global_orient (F, 3), body_pose (F, 69) and transl (F, 3) to joints (F, 24, 3)."""


@dataclass(frozen=True)
class AmassClip:
    """An AMASS sequence of SMPL parameters, in metres and radians with Z up."""

    betas: np.ndarray  # (B,) shape coefficients, often 10 or 16, for the body given by ``gender`` and ``model``.
    global_orient: np.ndarray  # (F, 3) rotation vectors from body to world axes.
    body_pose: np.ndarray  # (F, 69) rotation vectors of joints 1..23. Joints 22 and 23 are zero except in SMPL files.
    transl: np.ndarray  # (F, 3) translations in metres.
    fps: float
    gender: str  # 'male', 'female', 'neutral' or 'unknown'.
    model: str  # 'smpl', 'smplh' or 'smplx'.
    hand_pose: np.ndarray | None = None  # (F, 90) rotation vectors of the fingers, left hand first, or None.


def read_amass(path: Path | str, *, fps: float | None = None) -> AmassClip:
    """Read an AMASS file. It contains ``poses``, or ``root_orient`` and ``pose_body``.

    ``fps`` replaces the file's frame rate.

    Raises:
        FileMissing, FileDamaged: the file is missing or truncated, or has no poses, translations or frame rate.
        NonFiniteData: a value is NaN or infinite.
        MotionInvalid: there are no frames, or a rotation or shape is out of range.
    """
    fields = read_fields(path, _STORED)
    transl = fields.numbers("trans", (None, 3))
    root, body, hands, model = _poses(fields, len(transl))
    betas = fields.numbers("betas", (None,)) if "betas" in fields else np.zeros(NUM_BETAS)
    if not len(transl):
        raise MotionInvalid("The motion has no frames.", where=str(path))
    turns = np.hstack([root, body] if hands is None else [root, body, hands])
    for name, value in {"poses": turns, "trans": transl, "betas": betas}.items():
        if not np.isfinite(value).all():
            raise NonFiniteData(f"'{name}' contains NaN or infinite values.", where=str(path))
    require_within("'poses'", turns, LARGEST_TURN, MotionInvalid, str(path))
    require_within("'betas'", betas, LARGEST_BETA, MotionInvalid, str(path))
    return AmassClip(betas, root, body, transl, _frame_rate(fields, fps), _gender(fields), model, hands)


def motion_of(clip: AmassClip, body: str, joints_of: JointsOf) -> Motion:
    """Convert an AMASS clip to a motion of the given body. ``joints_of`` computes the joints.

    Shape coefficients are valid only for the body they were fitted to. Set them to zero for another body.
    """
    betas = np.zeros(NUM_BETAS)
    count = min(NUM_BETAS, len(clip.betas))
    betas[:count] = clip.betas[:count]
    return Motion(
        betas=betas,
        global_orient=clip.global_orient,
        body_pose=clip.body_pose,
        transl=clip.transl,
        fps=clip.fps,
        body=body,
        joints=joints_of(betas, clip.global_orient, clip.body_pose, clip.transl),
        provenance={"source": "AMASS", "model": clip.model, "gender": clip.gender},
    )


def _poses(fields: Fields, frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, str]:
    """Return the rotation vectors of root, body and fingers (None without fingers), and the name of the body model."""
    body = np.zeros((frames, 3 * (NUM_JOINTS - 1)))
    if "poses" in fields:
        poses = fields.numbers("poses", (frames, None))
        if poses.shape[1] not in _WIDTHS:
            what = f"'poses' has {poses.shape[1]} columns. AMASS files have {', '.join(map(str, _WIDTHS))}."
            raise FileDamaged(what, where=str(fields.path))
        model = _WIDTHS[poses.shape[1]]
        used = poses[:, 3:] if model == "smpl" else poses[:, 3 : 3 + _BODY]
        body[:, : used.shape[1]] = used
        return poses[:, :3].copy(), body, None if model == "smpl" else poses[:, -_FINGERS:].copy(), model
    if "pose_body" not in fields or "root_orient" not in fields:
        what = "The file is not AMASS: it has neither 'poses' nor 'root_orient' and 'pose_body'."
        raise FileDamaged(what, where=str(fields.path))
    body[:, :_BODY] = fields.numbers("pose_body", (frames, _BODY))
    hands = fields.numbers("pose_hand", (frames, 90)) if "pose_hand" in fields else None
    return fields.numbers("root_orient", (frames, 3)), body, hands, fields.text("surface_model_type", "smplh").lower()


def _frame_rate(fields: Fields, fps: float | None) -> float:
    key = next((key for key in _RATES if key in fields), None)
    if fps is None and key is None:
        hint = "Specify it with --fps, for example --fps 60."
        raise FileDamaged(f"The file has no frame rate ({', '.join(_RATES)}).", where=str(fields.path), hint=hint)
    rate = fps if fps is not None else fields.number(str(key))
    if not (np.isfinite(rate) and rate > 0):
        raise NonFiniteData(f"The frame rate must be a positive number, not {rate}.", where=str(fields.path))
    return rate


def _gender(fields: Fields) -> str:
    if "gender" not in fields or fields.array("gender").dtype.kind not in "US":
        return "unknown"
    gender = fields.text("gender").strip().lower()
    return gender if gender in ("male", "female", "neutral") else "unknown"


def is_amass(path: Path) -> bool:
    """Return whether an .npz file contains AMASS poses."""
    names = npz_names(path)
    return "format" not in names and ("poses" in names or "pose_body" in names)


READER = Reader("AMASS .npz", is_amass, lambda path, options: read_amass(path, fps=options.fps), frozenset({"fps"}))
