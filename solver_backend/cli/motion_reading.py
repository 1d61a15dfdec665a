"""Convert motions from other programs to motions of our body."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.body.files.choices import load_chosen_body
from solver_backend.body.hands import flat_hands
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import BodyInvalid, MotionInvalid
from solver_backend.exchange.finger_joints import from_flat
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.rigs.rest_frames import bent_at_rest
from solver_backend.fitters.hands.solve_hands import with_finger_turns
from solver_backend.fitters.motion_import.import_motion import ImportedMotion, import_motion
from solver_backend.fitters.motion_import.network_motion import network_motion
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.load import load_motion
from solver_backend.io.motions.amass import AmassClip, motion_of
from solver_backend.io.motions.foreign_skeleton import read_foreign_clip
from solver_backend.io.motions.network_results import is_network_result, read_network_result
from solver_backend.types import Motion, SkeletonMotion
from solver_backend.types.network_result import CAMERA_TO_Z_UP, NUM_TURNED, NetworkResult

_FAR_MM = 20.0  # Largest mean distance between a joint and its source without a note. Chosen by hand.
_RAISED_M = 0.02  # Largest change in a motion's height without a note, in metres. Chosen by hand.
_STRANGE = 5.0  # Magnitude of an unusual shape coefficient in standard deviations. Chosen by hand.
_FITS_MM = 12.0  # Largest distance of limbs from the skeleton that still confirms an unusual shape. Chosen by hand.
_LOOSE = ("_toe", "head")  # Joints whose positions are excluded from the fit.


def any_motion(path: Path, choice: str, *, keep_shape: bool = True, fps: float | None = None) -> Motion:
    """Read a motion file, an AMASS file or a network result as a motion of the chosen body.

    The fingers in an AMASS file are kept if the body has finger joints.

    Args:
        choice: name or path of the body.
        keep_shape: use the shape coefficients in an AMASS file. They are for the body to which the file was fitted.
        fps: frame rate to use instead of the frame rate in an AMASS file.

    Raises:
        MotionInvalid: the file is in none of these formats.
    """
    if is_network_result(path):
        return network_motion(read_network_result(path), load_chosen_body(choice))[0]
    motion = load_motion(path) if fps is None else load_motion(path, fps=fps)
    if isinstance(motion, Motion):
        return motion
    if not isinstance(motion, AmassClip):
        hint = "Choose a motion file (.npz) or an AMASS file."
        raise MotionInvalid("The file does not contain a body motion.", where=str(path), hint=hint)
    if not keep_shape:
        motion = replace(motion, betas=np.zeros_like(motion.betas))
    body = load_chosen_body(choice)

    def joints_of(betas: np.ndarray, root: np.ndarray, pose: np.ndarray, transl: np.ndarray) -> np.ndarray:
        local = exp_so3(pose.reshape(len(pose), -1, 3))[:, : len(body.parents) - 1]
        return forward_kinematics(body, betas, exp_so3(root), local, transl).joints[:, :NUM_JOINTS]

    made, hands = motion_of(motion, body.id, joints_of), motion.hand_pose
    if hands is None or not hands.any():
        return made
    turns = log_so3(from_flat(exp_so3(hands.reshape(len(hands), -1, 3)), flat_hands(body)))
    try:
        return with_finger_turns(made, body, turns)
    except BodyInvalid:
        return made


@dataclass(frozen=True)
class ForeignMotion:
    """A motion of another skeleton, transferred to our body."""

    source: SkeletonMotion  # The clip as stored in its file.
    roles: dict[str, str]  # Joints of the clip, by role.
    done: ImportedMotion  # The result on our body.
    diagnostics: tuple[Diagnostic, ...]  # Diagnostics from reading the file and from the fit.

    @property
    def limbs_mm(self) -> float:
        """RMS distance in mm between the limb joints of the body and of the skeleton."""
        return _limbs_mm(self.done)


def read_foreign_motion(
    path: Path,
    body: str,
    progress: Progress,
    *,
    unit: str = "",
    up_axis: str = "",
    keep_height: bool = False,
    fps: float | None = None,
) -> ForeignMotion:
    """Read a motion of another skeleton, and fit our body to it.

    Args:
        path: a BVH, MVNX, ASF or AMC file, or a C3D file that contains rotations.
        body: name or path of the body.
        unit: length unit of the clip. If empty, it is estimated from the leg length.
        up_axis: axis that points up in the clip. If empty, it is detected.
        keep_height: do not move the lowest sole to the floor.
        fps: frame rate of an AMC file, which does not store it.
    """
    progress("reading the clip", 0, 1)
    source, roles, found = read_foreign_clip(path, unit, up_axis, fps)
    progress("fitting the body", 0, 1)
    done = import_motion(source, roles, load_chosen_body(body), keep_height=keep_height)
    progress("fitting the body", 1, 1)
    bent = bent_at_rest({role: source.rest[source.names.index(name)] for role, name in roles.items()})
    return ForeignMotion(source, roles, done, (*found, *([bent] if bent else []), *_found_in(done)))


def network_of_bvh(path: Path, body: str, progress: Progress) -> NetworkResult:
    """Read a BVH file written by SAM3DBody-cpp d9a5143 as a network result."""
    motion = read_foreign_motion(path, body, progress, up_axis="y", keep_height=True).done.motion
    turns = np.concatenate([motion.global_orient, motion.body_pose], axis=1).reshape(motion.num_frames, -1, 3)
    local = np.asarray(exp_so3(turns[:, :NUM_TURNED]))
    local[:, 0] = CAMERA_TO_Z_UP.T @ local[:, 0]
    return NetworkResult("BVH", "0", np.arange(motion.num_frames), local, transl=motion.transl)


def _limbs_mm(done: ImportedMotion) -> float:
    placed = [off for role, off in done.distances_mm.items() if not role.endswith(_LOOSE)]
    return float(np.sqrt(np.mean(np.square(placed))))


def _found_in(done: ImportedMotion) -> list[Diagnostic]:
    found = list[Diagnostic]()
    if done.motion.num_frames == 1:
        found.append(diagnostic("single_frame", severity=Severity.NOTE))
    if abs(done.raised_m) > _RAISED_M:
        way = "raised" if done.raised_m > 0 else "lowered"
        found.append(diagnostic("motion_on_floor", way=way, size=abs(done.raised_m)))
    far = {r: off for r, off in done.distances_mm.items() if off > _FAR_MM and not r.endswith(_LOOSE)}
    if far:
        off = [f"{role.replace('_', ' ')} {size:.0f} mm" for role, size in far.items()]
        found.append(diagnostic("motion_joints_elsewhere", joints=list(far), off=off))
    if (size := np.abs(done.motion.betas).max()) > _STRANGE and _limbs_mm(done) > _FITS_MM:
        found.append(diagnostic("shape_odd", size=size, limit=_STRANGE))
    return found
