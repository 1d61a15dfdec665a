"""Apply Pose-NDF to whole motions: denoise, complete, interpolate, sample and fit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.kinematics import forward_kinematics, recorded_vectors
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.body.mesh import pose_mesh
from solver_backend.exchange.errors import JobInvalid, MotionInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.version import VERSION
from solver_backend.fitters.hands.solve_hands import finger_turns_of, with_finger_turns, without_fingers
from solver_backend.fitters.model.subject import PosedFrames, Subject
from solver_backend.fitters.pose_ndf.complete import (
    CompleteSettings,
    DenoiseSettings,
    KeypointSettings,
    complete,
    denoise,
    fit_keypoints,
    interpolate_poses,
    missing_joints,
)
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import exp_so3, log_so3, matrix_from_quat, quat_from_matrix
from solver_backend.priors.pose_ndf import PoseNDF
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import Capture, Motion

LAYOUT = "MANIFOLD_53"  # Skin points that represent the mesh.
SAMPLED_FPS = 30.0  # Frame rate of a motion that consists of independent samples.
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # Y up to Z up.


def denoised_motion(
    motion: Motion, body: Body, prior: PoseNDF, settings: DenoiseSettings, progress: Progress
) -> Motion:
    """Denoise a motion with Pose-NDF (see ``motion denoise``).

    Raises:
        MotionInvalid: the motion is for another body.
    """
    frames = denoise(skin_of(motion, body), prior, frames_of(motion, body), motion.fps, settings, progress)
    return _with_frames(motion, body, prior, frames, {"verb": "motion denoise"})


def completed_motion(
    motion: Motion, body: Body, prior: PoseNDF, missing: tuple[str, ...], settings: CompleteSettings, progress: Progress
) -> Motion:
    """Replace the rotations of named joints or limbs in a motion by plausible ones.

    Raises:
        MotionInvalid: the motion is for another body.
        JobInvalid: a joint is unknown.
    """
    columns = missing_joints(missing)
    frames = frames_of(motion, body)
    found = complete(skin_of(motion, body), prior, frames, columns, motion.fps, settings, progress)
    edit = {"verb": "motion complete", "missing": list(missing), "seed": settings.seed}
    return _with_frames(motion, body, prior, found, edit)


def interpolated_motion(
    motion: Motion, body: Body, prior: PoseNDF, first: int, last: int, count: int, progress: Progress = silent
) -> Motion:
    """Build a motion of frame ``first``, ``count`` plausible frames, and frame ``last``.

    The root moves at constant speed.

    Raises:
        MotionInvalid: the motion is for another body.
        JobInvalid: a frame is not in the motion, or ``count`` is below 1.
    """
    frames = frames_of(motion, body)
    if not (0 <= first < motion.num_frames and 0 <= last < motion.num_frames) or first == last:
        message = f"Frames {first} and {last} are not two frames of the motion."
        raise JobInvalid(message, where="frames", hint=f"Choose two frames from 0 to {motion.num_frames - 1}.")
    if count < 1:
        raise JobInvalid(f"{count} frames were requested, but at least 1 is needed.", where="count")
    ends = [first, last]
    between = interpolate_poses(prior, frames.local[ends[:1]], frames.local[ends[1:]], count, progress=progress)[0]
    local = np.concatenate([frames.local[ends[:1]], between, frames.local[ends[1:]]])
    share = np.linspace(0.0, 1.0, count + 2)
    root = _on_the_way(frames.root[ends][:, None], share)[:, 0]
    transl = (1 - share)[:, None] * frames.transl[first] + share[:, None] * frames.transl[last]
    edit = {"verb": "motion interpolate", "frames": ends, "count": count}
    made, fingers = _new_motion(motion, body, prior, PosedFrames(root, local, transl), edit), finger_turns_of(motion)
    if fingers is None:
        return made
    return with_finger_turns(made, body, log_so3(_on_the_way(exp_so3(fingers[ends]), share)))


def sampled_motion(body: Body, prior: PoseNDF, count: int, seed: int) -> Motion:
    """Create a motion on the floor with one sampled pose per frame.

    Raises:
        JobInvalid: ``count`` is below 1.
    """
    if count < 1:
        raise JobInvalid(f"{count} samples were requested, but at least 1 is needed.", where="count")
    local, root = prior.sample(count, seed), np.tile(_UPRIGHT, (count, 1, 1))
    betas, layout = np.zeros(10), body.layout.recorded
    lowest = pose_mesh(body, betas, root, local, np.zeros((count, 3)))[..., 2].min(axis=1)
    transl = np.stack([np.zeros(count), np.zeros(count), -lowest], axis=1)
    zero, turns, joints = np.zeros((1, 3)), np.zeros((1, 3 * (layout.num_joints - 1))), layout.num_joints
    rest = Motion(betas, zero, turns, zero.copy(), SAMPLED_FPS, body.id, np.zeros((1, joints, 3)), layout)
    edit = {"verb": "motion sample", "count": count, "seed": seed}
    return _new_motion(rest, body, prior, PosedFrames(root, local, transl), edit)


def fitted_motion(
    capture: Capture, motion: Motion, body: Body, prior: PoseNDF, noise_px: float, settings: KeypointSettings
) -> Motion:
    """Fit poses and one body shape to a capture's keypoints (see ``fit_keypoints``).

    Args:
        capture: one or more calibrated views of one person.
        motion: initial poses in the same frames.
        noise_px: standard deviation in pixels of a detection with full confidence.

    Raises:
        CalibrationMissing, NoDetections, TooFewViews: there are no calibrated views of a person.
        MotionInvalid: the motion is for another body, or has other frames than the capture.
    """
    cameras, keypoints = capture.require_views()
    frames = frames_of(motion, body)
    if motion.num_frames != keypoints.xy.shape[1]:
        message = f"The motion has {motion.num_frames} frames, but the capture has {keypoints.xy.shape[1]}."
        hint = "Use a motion that was solved from this capture."
        raise MotionInvalid(message, where=capture.name, hint=hint)
    joints, betas = keypoints.joint_set, motion.betas.astype(np.float64)
    person = Subject(body, keypoint_landmarks(body, joints), betas, np.zeros((joints.num_keypoints, 3)))
    term = ReprojectionTerm.of(cameras, keypoints, np.full(joints.num_keypoints, noise_px), np.zeros(1))
    found = fit_keypoints(person, prior, term, frames, settings)
    edit = {"verb": "motion fit", "noise_px": noise_px, "adaptive": settings.adaptive, "cost": found.cost}
    made = _new_motion(replace(motion, betas=np.asarray(found.betas)), body, prior, found.frames, edit)
    return _with_own_fingers(made, motion, body)


def frames_of(motion: Motion, body: Body) -> PosedFrames:
    """Return a motion's poses as rotations, without fingers.

    Raises:
        MotionInvalid: the motion is for another body.
    """
    motion = without_fingers(motion)
    motion.require_body(body.id, body.layout.recorded, where="body")
    return PosedFrames.of_motion(motion, motion.transl.astype(np.float64))


def skin_of(motion: Motion, body: Body) -> Subject:
    """Return the motion's person, with skin points as landmarks."""
    names = marker_layout(LAYOUT)
    return Subject(body, marker_landmarks(body, names), motion.betas.astype(np.float64), np.zeros((len(names), 3)))


def _with_frames(motion: Motion, body: Body, prior: PoseNDF, frames: PosedFrames, edit: dict[str, Any]) -> Motion:
    """Replace the poses of a motion, and remove measurements that are no longer valid."""
    made, solved = _new_motion(motion, body, prior, frames, edit), 3 * frames.layout.num_joints
    pose = np.concatenate([made.body_pose[:, :solved], without_fingers(motion).body_pose[:, solved:]], axis=1)
    kept = replace(made, body_pose=pose, keyframes=motion.keyframes, contacts=motion.contacts, flags=motion.flags)
    return _with_own_fingers(kept, motion, body)


def _with_own_fingers(made: Motion, motion: Motion, body: Body) -> Motion:
    fingers = finger_turns_of(motion)
    return made if fingers is None else with_finger_turns(made, body, fingers)


def _on_the_way(ends: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return rotations (n, K, 3, 3) at positions from 0 to 1 along geodesics between two poses."""
    a, b = quat_from_matrix(ends)
    b = np.where((a * b).sum(-1, keepdims=True) >= 0, b, -b)
    shape = (len(share), *a.shape)
    shares = np.broadcast_to(share[:, None], shape[:-1])
    return matrix_from_quat(slerp(np.broadcast_to(a, shape), np.broadcast_to(b, shape), shares))


def _new_motion(motion: Motion, body: Body, prior: PoseNDF, frames: PosedFrames, edit: dict[str, Any]) -> Motion:
    """Build a motion from given poses, with another motion's shape, frame rate and history."""
    count = len(frames.transl)
    pose = recorded_vectors(body, log_so3(frames.local)).reshape(count, -1)
    skeleton = forward_kinematics(body, motion.betas.astype(np.float64), frames.root, frames.local, frames.transl)
    edit = {**edit, "prior": prior.name, "weights": prior.metadata.get("sha256", ""), "version": VERSION}
    record = {**motion.provenance, "edits": [*motion.provenance.get("edits", []), edit]}
    layout, joints = body.layout.recorded, skeleton.joints[:, list(body.recorded_joints)]
    made = Motion(motion.betas, log_so3(frames.root), pose, frames.transl, motion.fps, body.id, joints, layout)
    return replace(made, provenance=record)
