"""Edit whole clips: trim, resample, change the speed, mirror, and make in-place or root motions.

Rotations and pelvis positions are interpolated by cubic splines, and other numbers linearly. Contacts and flags come
from the nearest frame. Joint positions are computed from the tree, so bone lengths do not change.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .contact_parts import MIRRORED
from .errors import MotionInvalid
from .ground_path import ground_path
from .motion_file import FRAMES_AXIS, OBSERVED, MotionFile
from .props import Prop
from .so3 import matrix_from_rotvec, quat_from_rotvec, rotvec_from_matrix, rotvec_from_quat, sign_continuous

R_STAGE_BODY = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from the body's axes (Y up, Z forward) to the stage's axes (Z up, -Y forward)."""
_ACROSS = np.array([-1.0, 1.0, 1.0])  # Reflection of the body's coordinates in its plane of symmetry.
_UPRIGHT = 0.5  # Smallest horizontal part of the forward direction that still defines the mirror plane.
_MOST_FRAMES = 1_000_000  # Largest number of resampled frames: more than two hours at 120 Hz. Chosen by hand.
_MOVED = {f"motion {edit}" for edit in ("trim", "loop", "mirror", "join", "retime", "resample", "in-place")}
_POSE = ("rotvec", "transl", "joints")
_CROSS = ((0, 1, 2), (1, 3, 4), (2, 4, 5))  # Index of each covariance matrix entry among the six stored numbers.
_SIX = ((0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2))


# The tree


def pose_tree(
    rest: np.ndarray, parents: tuple[int, ...], rotvec: np.ndarray, transl: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute forward kinematics: ``G_j = G_p R_j``, ``p_j = p_p + G_p (J_j - J_p)`` with parent p of joint j.

    Args:
        rest: (J, 3) joint positions at rest in metres.
        parents: parent of each joint, -1 for the root.
        rotvec: (F, J, 3) rotation vectors in radians.
        transl: (F, 3) translations in metres.

    Returns:
        (F, J, 3, 3) global rotations and (F, J, 3) world positions.
    """
    R = matrix_from_rotvec(rotvec)
    G, p = np.empty_like(R), np.empty(rotvec.shape)
    G[:, 0], p[:, 0] = R[:, 0], rest[0] + transl
    for j, parent in enumerate(parents[1:], 1):
        G[:, j] = G[:, parent] @ R[:, j]
        p[:, j] = p[:, parent] + G[:, parent] @ (rest[j] - rest[parent])
    return G, p


def unpose(parents: tuple[int, ...], rotvec: np.ndarray, joints: np.ndarray, transl: np.ndarray) -> np.ndarray:
    """Compute (J, 3) rest joints from one pose: ``J_j = J_p + G_pᵀ (x_j - x_p)``.

    Args:
        parents: parent of each joint, -1 for the root.
        rotvec: (J, 3) rotation vectors in radians.
        joints: (J, 3) world positions x in metres.
        transl: (3,) translation in metres.
    """
    local = matrix_from_rotvec(rotvec)
    G, rest = [local[0]], [joints[0] - transl]
    for j, parent in enumerate(parents[1:], 1):
        rest.append(rest[parent] + G[parent].T @ (joints[j] - joints[parent]))
        G.append(G[parent] @ local[j])
    return np.stack(rest)


def require_joints(motion: MotionFile) -> np.ndarray:
    """Return a motion's (F, J, 3) joint positions. Raise MotionInvalid if it has none."""
    if motion.joints is None:
        hint = "Convert it with motion convert first."
        raise MotionInvalid("The motion has no joint positions.", where=motion.name, hint=hint)
    return motion.joints


def rest_joints(motion: MotionFile) -> np.ndarray:
    """Compute the (J, 3) rest positions of a motion's joints (see ``unpose``)."""
    return unpose(motion.body_layout.parents, motion.rotvec[0], require_joints(motion)[0], motion.transl[0])


def repose(motion: MotionFile, rotvec: np.ndarray, pelvis: np.ndarray) -> MotionFile:
    """Replace a motion's rotation vectors (F, J, 3) and pelvis positions (F, 3). Recompute its joints."""
    rest = rest_joints(motion)
    transl = pelvis - rest[0]
    joints = pose_tree(rest, motion.body_layout.parents, rotvec, transl)[1]
    return replace(motion, rotvec=rotvec, transl=transl, joints=joints)


def unobserved(motion: MotionFile) -> MotionFile:
    """Remove a motion's detections and markers, which no longer match the body after an edit."""
    return replace(motion, **{name: getattr(MotionFile, name) for name in OBSERVED})


def note_edit(motion: MotionFile, edit: str, **values: Any) -> MotionFile:
    """Add an edit to a motion's provenance. If the provenance has another format, keep it under ``earlier``."""
    record = _record_of(motion)
    record["edits"] = [*edits_of(motion), {"verb": f"motion {edit}", **values}]
    return replace(motion, provenance=json.dumps(record, sort_keys=True))


def edits_of(motion: MotionFile) -> list[Any]:
    """Return the edits listed in a motion's provenance, in order."""
    edits = _record_of(motion).get("edits")
    return edits if isinstance(edits, list) else []


def _record_of(motion: MotionFile) -> dict[str, Any]:
    try:
        record = json.loads(motion.provenance or "{}")
    except ValueError:
        record = None
    return record if isinstance(record, dict) else {"earlier": motion.provenance}


def require_own_frames(edits: Sequence[object], where: str) -> None:
    """Raise MotionInvalid if the motion no longer matches its recording after an edit such as trim or mirror."""
    for edit in edits:
        if isinstance(edit, Mapping) and edit.get("verb") in _MOVED:
            what = f"The motion was changed by {edit['verb']}, so its frames no longer match the recording."
            raise MotionInvalid(what, where=where, hint="Choose the motion that was solved from this recording.")


# Frames and time


def take_frames(motion: MotionFile, frames: np.ndarray) -> MotionFile:
    """Select the given frames (N,) of a motion, in that order."""
    chosen: dict[str, Any] = {
        name: np.take(value, frames, axis=axis)
        for name, axis in FRAMES_AXIS.items()
        if (value := getattr(motion, name)) is not None
    }
    fields = ("rotvec", "transl", "sigma", "seen")
    props = (replace(prop, **{name: getattr(prop, name)[frames] for name in fields}) for prop in motion.props)
    return replace(motion, **chosen, props=tuple(props))


def trim(motion: MotionFile, first: int, last: int) -> MotionFile:
    """Trim a motion to the frames from ``first`` to ``last``, counted from 0.

    Raises:
        MotionInvalid: the range is empty or extends beyond the motion.
    """
    if not 0 <= first <= last < motion.num_frames:
        what = f"Frames {first} to {last} are outside the motion."
        hint = f"Choose frames from 0 to {motion.num_frames - 1}."
        raise MotionInvalid(what, where=motion.name, hint=hint)
    return note_edit(take_frames(motion, np.arange(first, last + 1)), "trim", frames=[first, last])


def resample(motion: MotionFile, fps: float) -> MotionFile:
    """Resample a motion to another frame rate without changing its speed."""
    done = _sample(motion, _steps(motion, motion.fps / fps), fps)
    return note_edit(done, "resample", fps=fps, before=motion.fps)


def retime(motion: MotionFile, speed: float) -> MotionFile:
    """Make a motion play ``speed`` times as fast at the same frame rate."""
    return note_edit(_sample(motion, _steps(motion, speed), motion.fps), "retime", speed=speed)


def _steps(motion: MotionFile, step: float) -> np.ndarray:
    """Return the fractional frames 0, step, 2 step ... up to the last frame of a motion.

    Raises:
        MotionInvalid: there would be too many frames.
    """
    last = motion.num_frames - 1
    if not last < _MOST_FRAMES * step:
        what = f"The result would have more than {_MOST_FRAMES:,} frames."
        raise MotionInvalid(what, where=motion.name, hint="Choose a lower rate, or a higher speed.")
    return np.minimum(step * np.arange(int(last / step + 1e-6) + 1), float(last))


def _sample(motion: MotionFile, at: np.ndarray, fps: float) -> MotionFile:
    nearest = take_frames(motion, np.rint(at).astype(int))
    linear: dict[str, Any] = {
        name: _between(value, at, axis)
        for name, axis in FRAMES_AXIS.items()
        if (value := getattr(motion, name)) is not None and value.dtype.kind == "f" and name not in _POSE
    }
    props = tuple(_prop_at(prop, same, at) for prop, same in zip(motion.props, nearest.props, strict=True))
    pelvis = _spline(motion.transl, at) + rest_joints(motion)[0]
    return replace(repose(nearest, _turns_at(motion.rotvec, at), pelvis), fps=fps, props=props, **linear)


def _prop_at(prop: Prop, nearest: Prop, at: np.ndarray) -> Prop:
    places = {"transl": _spline(prop.transl, at), "sigma": _between(prop.sigma, at, 0)}
    return replace(nearest, rotvec=_turns_at(prop.rotvec, at), **places)


def _turns_at(rotvec: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate rotation vectors (F, ..., 3) at fractional frames (N,) with a quaternion spline."""
    quat = _spline(sign_continuous(quat_from_rotvec(rotvec)), at)
    return rotvec_from_quat(quat / np.linalg.norm(quat, axis=-1, keepdims=True))


def _spline(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate values (F, ...) at fractional frames (N,) with cubic splines (Catmull and Rom 1974)."""
    if len(values) < 3:
        return _between(values, at, 0)
    ends = (3 * (values[a] - values[b]) + values[c] for a, b, c in (([0], [1], [2]), ([-1], [-2], [-3])))
    padded = np.insert(values, [0, len(values)], np.concatenate([*ends]), axis=0)
    first = np.clip(np.floor(at).astype(int), 0, len(values) - 2)
    u = (at - first).reshape(-1, *[1] * (values.ndim - 1))
    a, b, c, d = (padded[first + k] for k in range(4))
    return b + 0.5 * u * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a)))


def _between(values: np.ndarray, at: np.ndarray, axis: int) -> np.ndarray:
    """Interpolate values along an axis linearly at fractional frames. The result is exact at whole frames."""
    first = np.minimum(at.astype(int), values.shape[axis] - 1)
    second = np.minimum(np.ceil(at).astype(int), values.shape[axis] - 1)
    u = (at - first).reshape(-1, *[1] * (values.ndim - 1 - axis))
    here, there = np.take(values, first, axis=axis), np.take(values, second, axis=axis)
    with np.errstate(invalid="ignore"):  # standard deviations may be infinite
        return np.where(u > 0.0, (1 - u) * here + u * there, here)


# Sides


def mirror(motion: MotionFile) -> MotionFile:
    """Swap left and right in a motion. The start position and direction do not change.

    The world is reflected in the vertical plane through the first pelvis position and the forward direction. If A is
    the reflection of the world and M the reflection of the body's coordinates, the root's rotation R becomes ``A R M``.
    Every other joint becomes ``M R' M``, where R' is the rotation of the corresponding joint on the other side. A
    rotation vector (x, y, z) of R' becomes ``(x, -y, -z)``. Mirroring twice restores the original motion.
    """
    rest, other = rest_joints(motion), list(motion.body_layout.mirror)
    R, pelvis = matrix_from_rotvec(motion.rotvec[:, 0]), rest[0] + motion.transl
    ahead, head = R[0, :, 2], R[0, :, 1]
    x, y = ahead[:2] if np.hypot(*ahead[:2]) > _UPRIGHT else head[:2]
    across = np.array([y, -x, 0.0]) / np.hypot(x, y)
    A = np.eye(3) - 2.0 * np.outer(across, across)
    rotvec = motion.rotvec[:, other] * -_ACROSS
    rotvec[:, 0] = rotvec_from_matrix(A @ R * _ACROSS)
    done = repose(unobserved(motion), rotvec, (pelvis - pelvis[0]) @ A + pelvis[0])
    sided: dict[str, Any] = {name: _others(getattr(motion, name), other) for name in ("joint_sigma", "resting")}
    contacts = None if motion.contacts is None else motion.contacts[:, ::-1]
    sided["touches"] = _others(motion.touches, list(MIRRORED))
    covariance = _others(motion.joint_covariance, other)
    covariance = None if covariance is None else turn_covariance(covariance, A)
    props = tuple(
        replace(
            prop,
            points=prop.points * _ACROSS,
            rotvec=rotvec_from_matrix(A @ matrix_from_rotvec(prop.rotvec) * _ACROSS),
            transl=(prop.transl - pelvis[0]) @ A + pelvis[0],
        )
        for prop in motion.props
    )
    root = motion.root
    if root is not None:
        way = (root[:, :2] - pelvis[0, :2]) @ A[:2, :2] + pelvis[0, :2]
        root = np.column_stack([way, 2.0 * np.arctan2(x, -y) - root[:, 2]])
    done = replace(done, contacts=contacts, joint_covariance=covariance, props=props, root=root, **sided)
    return note_edit(done, "mirror")


def _others(values: np.ndarray | None, other: list[int]) -> np.ndarray | None:
    return None if values is None else values[:, other]


def turn_covariance(six: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Transform the covariances (..., 6) of points by linear maps A (..., 3, 3): ``A C Aᵀ``."""
    return (A @ six[..., _CROSS] @ np.swapaxes(A, -1, -2))[..., _SIX[0], _SIX[1]]


# Travel


def body_path(motion: MotionFile) -> np.ndarray:
    """Return the body's smoothed path (F, 3) on the ground: x, y in metres, and heading from -Y in radians."""
    path = ground_path(
        motion.transl + rest_joints(motion)[0],
        matrix_from_rotvec(motion.rotvec[:, 0]) @ R_STAGE_BODY.T,
        motion.fps,
    )
    return np.column_stack([path.way[:, :2], path.heading])


def in_place(motion: MotionFile, path: np.ndarray | None = None) -> MotionFile:
    """Remove the travel from a motion, but keep sway and heading.

    Args:
        motion: motion to change. Its foot contacts are kept, although the feet then slide.
        path: (F, 2) travel to remove in metres. The default is the smoothed path of the hips.
    """
    path = body_path(motion) if path is None else path
    away = np.column_stack([path[:, :2] - path[0, :2], np.zeros(motion.num_frames)])
    done = repose(unobserved(motion), motion.rotvec, motion.transl + rest_joints(motion)[0] - away)
    props = tuple(replace(prop, transl=prop.transl - away) for prop in motion.props)
    return note_edit(replace(done, props=props, root=None), "in-place")


def root_motion(motion: MotionFile) -> MotionFile:
    """Add a root bone that follows the smoothed travel and heading. The body's pose does not change."""
    return note_edit(replace(motion, root=body_path(motion)), "root-motion")


def without_root(motion: MotionFile) -> MotionFile:
    """Express the body's motion relative to its root bone, and remove the root bone."""
    if motion.root is None:
        return motion
    back = matrix_from_rotvec(motion.root[:, 2:] * [0.0, 0.0, -1.0])
    way = np.column_stack([motion.root[:, :2], np.zeros(motion.num_frames)])
    pelvis = (back @ (motion.transl + rest_joints(motion)[0] - way)[..., None])[..., 0]
    rotvec = motion.rotvec.copy()
    rotvec[:, 0] = rotvec_from_matrix(back @ matrix_from_rotvec(rotvec[:, 0]))
    return replace(repose(motion, rotvec, pelvis), root=None)
