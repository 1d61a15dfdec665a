"""Convert the result of a pose-estimation network to a motion of our body."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_skeleton import informed_joints
from solver_backend.body.hands import JOINTS_OF_A_HAND, by_joint, flat_hands, hand_skeletons, with_fingers
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.skeleton_fingers import finger_angles
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import BodyInvalid, MotionInvalid
from solver_backend.exchange.finger_joints import from_flat
from solver_backend.exchange.joint_sets import NUM_JOINTS, SIDES
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.hands.solve_hands import with_finger_turns
from solver_backend.fitters.motion_import.import_motion import floor_height, standing_feet
from solver_backend.geometry.arrays import true_runs
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import Capture, MarkerCloud, Motion
from solver_backend.types.network_result import CAMERA_TO_Z_UP, NUM_TURNED, NetworkResult

RATE = 30.0  # Default frames per second. GVHMR and GEM-X convert every video to this rate.
_LEG = ("hip", "knee", "ankle")
_ALIKE = 1.25  # Points are in metres if leg lengths differ from the body's by less than this factor.


def network_motion(
    people: tuple[NetworkResult, ...],
    body: Body,
    *,
    person: str | None = None,
    fps: float | None = None,
    settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
) -> tuple[Motion, list[Diagnostic]]:
    """Convert one person in a network's result to a motion on the floor.

    Rotations are copied. Points are solved as joint positions. Frames without the person are interpolated.

    Args:
        person: name of the person, or None for the person with the most frames.
        fps: frames per second of the video, or None for the rate in the file or the default.

    Raises:
        MotionInvalid: there is no such person.
        MocapError: the solve of a result with points fails.
    """
    chosen = next((one for one in people if person in (None, one.person)), None)
    if chosen is None:
        known = ", ".join(one.person for one in people)
        raise MotionInvalid(f"The result has no person '{person}'.", where="person", hint=f"Choose one of {known}.")
    rate = fps or chosen.fps or RATE
    found = [] if fps or chosen.fps else [diagnostic("frame_rate_assumed", rate=RATE)]
    if len(people) > 1:
        shares = ", ".join(f"{one.person} ({len(one.frames)} frames)" for one in people if one is not chosen)
        found.append(diagnostic("people_left_out", shares=shares))
    frames = chosen.frames - chosen.frames[0]
    unseen = np.setdiff1d(np.arange(frames[-1] + 1), frames)
    if len(unseen):
        runs = true_runs(np.isin(np.arange(frames[-1] + 1), unseen))
        found.append(diagnostic("frames_unseen", frames=runs, reason="single"))
    whole = without_gaps(chosen)
    if whole.local is not None:
        motion = _of_rotations(whole, body, rate)
        found.append(diagnostic("other_body_read", result="motion"))
    else:
        motion = _of_points(whole, body, rate, settings, progress)
    raised = -floor_height(body, motion.betas, motion.joints[:, :NUM_JOINTS])
    up = np.array([0.0, 0.0, raised])
    motion = replace(motion, transl=motion.transl + up, joints=motion.joints + up)
    contacts = standing_feet(body, motion.betas, motion.joints[:, :NUM_JOINTS], rate)
    if motion.num_frames == 1:
        found.append(diagnostic("single_frame", severity=Severity.NOTE))
    record = {"source": chosen.program, "person": chosen.person, "method": "network result"}
    return replace(motion, contacts=contacts, provenance={**motion.provenance, **record}), found


def without_gaps(result: NetworkResult) -> NetworkResult:
    """Interpolate the missing frames between a result's first and last frame."""
    frames = np.arange(result.frames[0], result.frames[-1] + 1)
    after = np.clip(np.searchsorted(result.frames, frames), 0, len(result.frames) - 1)
    before = np.maximum(after - (result.frames[after] > frames), 0)
    span = np.maximum(result.frames[after] - result.frames[before], 1)
    share = (frames - result.frames[before]) / span

    def between(values: np.ndarray | None, turns: bool) -> np.ndarray | None:
        if values is None or len(frames) == len(result.frames):
            return values
        one, other = values[before], values[after]
        weight = share.reshape(-1, *(1,) * (values.ndim - 1))
        if not turns:
            return np.asarray(one + weight * (other - one))
        step = np.asarray(log_so3(np.swapaxes(one, -1, -2) @ other))
        return np.asarray(one @ np.asarray(exp_so3(weight[..., 0] * step)))

    turned: dict[str, Any] = {name: between(getattr(result, name), True) for name in ("local", "fingers", "world")}
    moved: dict[str, Any] = {name: between(getattr(result, name), False) for name in ("transl", "points", "hands")}
    return replace(result, frames=frames, **turned, **moved)


def _of_rotations(result: NetworkResult, body: Body, fps: float) -> Motion:
    assert result.local is not None and result.transl is not None
    count = len(result.frames)
    root = result.world if result.world is not None else CAMERA_TO_Z_UP @ result.local[:, 0]
    betas = np.zeros(body.shapedirs.shape[-1])
    local = np.tile(np.eye(3), (count, len(body.parents) - 1, 1, 1))
    local[:, : NUM_TURNED - 1] = result.local[:, 1:]
    joints = np.asarray(forward_kinematics(body, betas, root, local, result.transl).joints)[:, :NUM_JOINTS]
    pose = np.zeros((count, NUM_JOINTS - 1, 3))
    pose[:, : NUM_TURNED - 1] = log_so3(result.local[:, 1:])
    motion = Motion(
        betas=betas[:10],
        global_orient=np.asarray(log_so3(root)),
        body_pose=pose.reshape(count, -1),
        transl=result.transl,
        fps=fps,
        body=body.id,
        joints=joints,
    )
    if result.fingers is None:
        return motion
    try:
        turns = np.asarray(log_so3(from_flat(result.fingers, flat_hands(body))))
        return with_finger_turns(motion, body, turns)
    except BodyInvalid:
        return motion


def metric_scale(points: np.ndarray, names: tuple[str, ...], body: Body) -> float:
    """Return the factor that scales a network's points (F, K, 3) to the body's leg length."""
    rest, joints = body.rest_joints(np.zeros(body.shapedirs.shape[-1])), body.layout.joints
    theirs, ours = 0.0, 0.0
    for side in SIDES:
        for upper, lower in (_LEG[:2], _LEG[1:]):
            a, b = (names.index(f"{side}_{part}") for part in (upper, lower))
            theirs += float(np.nanmedian(np.linalg.norm(points[:, a] - points[:, b], axis=-1)))
            a, b = (joints.index(f"{side}_{part}") for part in (upper, lower))
            ours += float(np.linalg.norm(rest[a] - rest[b]))
    if not np.isfinite(theirs) or theirs <= 0.0:
        raise MotionInvalid("The network's points do not include legs, which determine the scale.", where="points")
    return 1.0 if 1.0 / _ALIKE < ours / theirs < _ALIKE else ours / theirs


def _of_points(result: NetworkResult, body: Body, fps: float, settings: SolveSettings, progress: Progress) -> Motion:
    from solver_backend.fitters.pipeline import solve

    assert result.points is not None
    scale = metric_scale(result.points, result.names, body)
    cloud = MarkerCloud(scale * result.points @ CAMERA_TO_Z_UP.T, fps, result.names)
    capture = Capture(result.program, None, None, markers=cloud)
    motion = solve(capture, replace(settings, body=settings.body), progress).motion
    return motion if result.hands is None else _with_points_of_hands(motion, body, result.hands)


def _with_points_of_hands(motion: Motion, body: Body, hands: np.ndarray) -> Motion:
    try:
        fingered = with_fingers(body)
    except BodyInvalid:
        return motion
    shape, prior = (motion.num_frames, len(SIDES), JOINTS_OF_A_HAND), load_hand_prior()
    turns, resting = np.zeros((*shape, 3)), np.ones(shape, bool)
    for side, skeleton in enumerate(hand_skeletons(fingered)):
        angles = finger_angles(hands[:, side] @ CAMERA_TO_Z_UP.T, side)[0]
        turns[:, side] = log_so3(by_joint(skeleton.local_rotations(prior.completed(angles))))
        resting[:, side] = by_joint(~informed_joints(np.isfinite(angles)))
    if resting.all():
        return motion
    flat = (motion.num_frames, len(SIDES) * JOINTS_OF_A_HAND)
    return with_finger_turns(motion, body, turns.reshape(*flat, 3), resting.reshape(flat))
