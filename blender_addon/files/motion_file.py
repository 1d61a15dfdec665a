"""The motion file: an AMASS-readable ``.npz`` with joints, keyframes and provenance beside."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..conventions.skeleton import NUM_BETAS, NUM_JOINTS
from ..errors import AddonError, MotionInvalid
from .arrays import read_arrays, require_format, text

FORMAT, VERSION = "manifold_mocap_motion", 1
FLAG_UNSEEN, FLAG_UNSURE = 1, 2
"""The frame was bridged from its neighbours; its residual, or a joint's uncertainty, is far above the take's."""
_BODY = 66
"""Columns of ``poses`` before the fingers: the root and joints 1..21."""
_OPTIONAL = (
    "format", "version", "betas", "mocap_framerate", "mocap_frame_rate", "body", "joints", "hand_pose", "keypoints3d",
    "joint_set", "keyframes", "joint_sigma", "flags", "provenance",
)  # fmt: skip


@dataclass(frozen=True)
class MotionFile:
    """An animated body, F frames; metres, radians, world Z up."""

    name: str
    """Name of the take."""
    rotvec: np.ndarray
    """(F, 24, 3) axis-angle: the root maps body to world, the others child to parent."""
    transl: np.ndarray
    """(F, 3) metres: the pelvis is at ``J_0(betas) + transl``."""
    betas: np.ndarray
    """(10,) shape."""
    fps: float
    """Frames per second."""
    body: str = ""
    """Id of the body it was solved for, "" if the file does not say."""
    joints: np.ndarray | None = None
    """(F, 24, 3) world metres."""
    keypoints3d: np.ndarray | None = None
    """(F, K, 3) triangulated keypoints in world metres, NaN where unseen."""
    joint_set: str = ""
    """Name of the set of ``keypoints3d``."""
    keyframes: np.ndarray | None = None
    """(F,) bool: the frame is a keyframe of the solver."""
    joint_sigma: np.ndarray | None = None
    """(F, 24) standard deviation of each joint in metres."""
    flags: np.ndarray | None = None
    """(F,) bit mask of ``FLAG_UNSEEN`` and ``FLAG_UNSURE``."""
    provenance: str = ""
    """JSON text: version, settings and sources of the solve."""

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.rotvec)


def is_motion(path: Path) -> bool:
    """Return whether a file is a motion of ours or of AMASS; one that cannot be read is none."""
    if path.suffix.lower() != ".npz":
        return False
    try:
        arrays = read_arrays(path, required=(), optional=("format", "poses"))
    except AddonError:
        return False
    return text(arrays, "format") == FORMAT or ("poses" in arrays and "format" not in arrays)


def read_motion(path: Path) -> MotionFile:
    """Read a motion file, or a plain AMASS file.

    Raises:
        FileMissing, FileDamaged: see ``read_arrays``.
        MotionInvalid: shapes disagree, there are no frames, or values are not finite.
    """
    path = Path(path)
    arrays = read_arrays(path, required=("poses", "trans"), optional=_OPTIONAL)
    require_format(arrays, FORMAT, VERSION, path=path)
    rotvec = _rotations(arrays, str(path))
    frames = len(rotvec)
    _require(frames > 0, "The motion has no frames.", path)
    motion = MotionFile(
        name=path.stem,
        rotvec=rotvec,
        transl=_shaped(arrays, "trans", (frames, 3), path),
        betas=_betas(arrays),
        fps=_frame_rate(arrays, path),
        body=text(arrays, "body"),
        joints=_shaped(arrays, "joints", (frames, NUM_JOINTS, 3), path) if "joints" in arrays else None,
        keypoints3d=_keypoints(arrays, frames, path),
        joint_set=text(arrays, "joint_set"),
        keyframes=_shaped(arrays, "keyframes", (frames,), path).astype(bool) if "keyframes" in arrays else None,
        joint_sigma=_shaped(arrays, "joint_sigma", (frames, NUM_JOINTS), path) if "joint_sigma" in arrays else None,
        flags=_shaped(arrays, "flags", (frames,), path).astype(np.uint8) if "flags" in arrays else None,
        provenance=text(arrays, "provenance"),
    )
    for name in ("rotvec", "transl", "betas", "joints"):
        value = getattr(motion, name)
        _require(value is None or bool(np.isfinite(value).all()), f"{name} holds NaN or infinite values.", path)
    return motion


def _rotations(arrays: dict[str, np.ndarray], where: str) -> np.ndarray:
    poses = np.asarray(arrays["poses"], dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] < _BODY:
        raise MotionInvalid(f"poses has shape {poses.shape}; (frames, 66 or more) is expected.", where=where)
    rotvec = np.zeros((len(poses), NUM_JOINTS, 3))
    rotvec[:, :22] = poses[:, :_BODY].reshape(len(poses), 22, 3)
    hands = poses[:, _BODY:] if poses.shape[1] == 3 * NUM_JOINTS else arrays.get("hand_pose")
    if hands is not None and np.shape(hands) == (len(poses), 6):
        rotvec[:, 22:] = np.asarray(hands, dtype=np.float64).reshape(len(poses), 2, 3)
    return rotvec


def _betas(arrays: dict[str, np.ndarray]) -> np.ndarray:
    betas = np.zeros(NUM_BETAS)
    given = np.asarray(arrays.get("betas", betas), dtype=np.float64).reshape(-1)[:NUM_BETAS]
    betas[: len(given)] = given
    return betas


def _frame_rate(arrays: dict[str, np.ndarray], path: Path) -> float:
    key = "mocap_framerate" if "mocap_framerate" in arrays else "mocap_frame_rate"
    _require(key in arrays, "The motion does not say its frame rate (mocap_framerate).", path)
    fps = float(np.asarray(arrays[key]).reshape(-1)[0])
    _require(np.isfinite(fps) and 0.01 <= fps <= 30000, f"The frame rate must be 0.01 to 30000, not {fps}.", path)
    return fps


def _keypoints(arrays: dict[str, np.ndarray], frames: int, path: Path) -> np.ndarray | None:
    if "keypoints3d" not in arrays:
        return None
    value = np.asarray(arrays["keypoints3d"], dtype=np.float64)
    good = value.ndim == 3 and value.shape[0] == frames and value.shape[2] == 3
    _require(good, f"keypoints3d has shape {value.shape}; ({frames}, keypoints, 3) is expected.", path)
    return value


def _shaped(arrays: dict[str, np.ndarray], key: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    value = np.asarray(arrays[key], dtype=np.float64)
    _require(value.shape == shape, f"{key} has shape {value.shape}; {shape} is expected.", path)
    return value


def _require(good: bool, message: str, path: Path) -> None:
    if not good:
        raise MotionInvalid(message, where=str(path))
