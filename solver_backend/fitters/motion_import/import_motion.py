"""A foreign skeleton's motion as a motion of our body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_angles import informed_joints
from solver_backend.body.hands import JOINTS_OF_A_HAND, by_joint, hand_skeletons, with_fingers
from solver_backend.body.skeleton_fingers import finger_angles, finger_points, fingers_move
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.exchange.hand_points import SIDES
from solver_backend.exchange.joint_sets import NUM_JOINTS, SMPL_PARENTS
from solver_backend.exchange.rigs.skeleton import JOINT_OF
from solver_backend.fitters.hands.wide_motion import with_finger_turns
from solver_backend.fitters.motion_import.pose_fit import NUM_TURNED, deviations, fit_poses, measure
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import Motion, SkeletonMotion

_HIPS, _SHOULDERS = SMPL.both("hip"), SMPL.both("shoulder")
_BONES = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
_PAIRS = (
    *(((a,), (b,)) for start, end in _BONES for a, b in zip(SMPL.both(start), SMPL.both(end), strict=True)),
    *((pair[:1], pair[1:]) for pair in (_HIPS, _SHOULDERS)),
    *((_HIPS, _SHOULDERS), (_SHOULDERS, SMPL.numbers("head"))),
)
"""Ends of the compared lengths: bones of the limbs, widths, trunk, and shoulders to head; of several joints the
middle."""
_STARTS, _ENDS = (np.array([(pair[end][0], pair[end][-1]) for pair in _PAIRS]) for end in (0, 1))
"""(12, 2) the one or two joints at each end."""
_SIGMA_M = np.array([0.004] * 8 + [0.008, 0.006, 0.008, 0.04])
"""Deviation of lengths, metres. Where widths and trunk may differ by 20 mm, collars fold to make up for it (44 degrees
on `cmu_daz_martial_07`). The head's joint is drawn anywhere."""
_ROUNDS = 4
_EXACT, _SAME_M, _PLAUSIBLE = 16.0, 0.001, 5.0
"""A skeleton is one of our body's own where these lengths, with so many times the certainty, leave at most a millimetre
with a shape of at most five standard deviations: then it is that shape, not one drawn to the mean."""


def shape_from_lengths(body: Body, rest: np.ndarray) -> np.ndarray:
    """Return the (10,) shape with the nearest lengths, ``min Σ (l(β) - l)² / σ² + |β|²`` by Gauss-Newton.

    ``rest`` are (24, 3) joints of a skeleton at rest, NaN where it has none.
    """
    wanted = _lengths(rest)
    known = np.isfinite(wanted)
    exact = _nearest(body, wanted, known, _EXACT)
    apart = np.abs(wanted - _lengths(body.rest_joints(exact)[:NUM_JOINTS]))[known]
    if known.all() and apart.max() < _SAME_M and np.abs(exact).max() < _PLAUSIBLE:
        return exact
    return _nearest(body, wanted, known, 1.0)


def _nearest(body: Body, wanted: np.ndarray, known: np.ndarray, certainty: float) -> np.ndarray:
    betas = np.zeros(body.joints_shapedirs.shape[-1])
    weight = certainty / _SIGMA_M[known]
    by_shape = _ways(body.joints_shapedirs)
    for _ in range(_ROUNDS):
        ways = _ways(body.rest_joints(betas))
        lengths = np.linalg.norm(ways, axis=1)
        J = np.einsum("pa,pab->pb", ways / lengths[:, None], by_shape)[known] * weight[:, None]
        r = (wanted - lengths)[known] * weight
        betas = betas + np.linalg.solve(J.T @ J + np.eye(len(betas)), J.T @ r - betas)
    return betas


def _lengths(joints: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(_ways(joints), axis=1))


def _ways(joints: np.ndarray) -> np.ndarray:
    """Return (12, ...) from the middle of the starts to the middle of the ends, of (J, ...) places or their slopes."""
    return np.asarray(joints[_ENDS].mean(axis=1) - joints[_STARTS].mean(axis=1))


_FEET = ((7, 10), (8, 11))  # Ankle and ball of each foot.
_LOWEST_SHARE = 2.0  # Percentile of the frames' lowest soles that is the floor: single frames may lie deeper.
_NEAR_M, _STILL_M_S = 0.04, 0.3
"""Largest height of a standing ball of the foot over its height at rest, and its largest speed."""


def floor_height(body: Body, betas: np.ndarray, joints: np.ndarray) -> float:
    """Return the height in metres at which the lowest soles stand.

    A sole is below ankle and ball by their height in the shaped body at rest. A foot that stands has both down. Joints
    are (F, 24, 3) in the world.
    """
    above = _rest_heights(body, betas)
    lowest = np.min([joints[:, joint, 2] - above[joint] for foot in _FEET for joint in foot], axis=0)
    return float(np.percentile(lowest, _LOWEST_SHARE))


def standing_feet(body: Body, betas: np.ndarray, joints: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, 2) bool: left and right ball of the foot are down and still, the floor at z = 0."""
    balls = joints[:, [foot[1] for foot in _FEET]]
    heights = _rest_heights(body, betas)[[foot[1] for foot in _FEET]]
    if len(balls) < 2:
        return balls[..., 2] < heights + _NEAR_M
    speed = np.linalg.norm(np.gradient(balls, axis=0), axis=-1) * fps
    return (balls[..., 2] < heights + _NEAR_M) & (speed < _STILL_M_S)


def _rest_heights(body: Body, betas: np.ndarray) -> np.ndarray:
    vertices = body.v_template + body.shapedirs @ betas
    return body.rest_joints(betas)[:NUM_JOINTS, 1] - vertices[:, 1].min()


_ARMS = tuple(zip(*map(SMPL.both, ("elbow", "wrist", "hand")), strict=True))  # Elbow, wrist and hand of each arm.


@dataclass(frozen=True)
class ImportedMotion:
    """A motion on our body, and its distance from the source."""

    motion: Motion
    distances_mm: dict[str, float]  # Root mean square distance of each joint from the skeleton's, by role.
    raised_m: float  # Height by which the motion was raised for the soles to stand on the floor.


def import_motion(
    source: SkeletonMotion, roles: dict[str, str], body: Body, *, keep_height: bool = False
) -> ImportedMotion:
    """Return the motion of a skeleton on our body, with the shape of its bones' lengths, and its fingers if they move.

    Args:
        roles: the skeleton's joint by role.
        body: with SMPL's joints first.
        keep_height: leave the motion at the clip's height; its lowest soles stand at z = 0 otherwise.

    Raises:
        MotionInvalid: left and right are not known.
    """
    measured = measure(source, roles, body.rest_joints(np.zeros(10))[:NUM_JOINTS])
    betas = shape_from_lengths(body, measured.rest)
    rest = body.rest_joints(betas)[:NUM_JOINTS]
    G, joints = fit_poses(rest, measured)
    off = 1000.0 * np.sqrt(((joints - measured.places) ** 2).sum(-1).mean(0))
    sigma, resting = deviations(joints, measured.places), _resting(measured.places)
    raised = 0.0 if keep_height else -floor_height(body, betas, joints)
    joints = joints + [0.0, 0.0, raised]
    parents = list(SMPL_PARENTS[1:NUM_TURNED])
    local = np.swapaxes(G[:, parents], -1, -2) @ G[:, 1:]
    pose = np.zeros((source.num_frames, NUM_JOINTS - 1, 3))
    pose[:, : NUM_TURNED - 1] = log_so3(local)
    motion = Motion(
        betas=betas,
        global_orient=log_so3(G[:, 0]),
        body_pose=pose.reshape(len(pose), -1),
        transl=joints[:, 0] - rest[0],
        fps=source.fps,
        body=body.id,
        joints=joints,
        contacts=standing_feet(body, betas, joints, source.fps),
        joint_sigma=sigma,
        resting=resting,
        provenance={"source": source.name, "method": "motion import", "roles": roles},
    )
    motion = _with_own_fingers(motion, body, source, roles)
    distances = {role: float(off[joint]) for role, joint in JOINT_OF.items() if np.isfinite(off[joint])}
    return ImportedMotion(motion, distances, raised)


def _with_own_fingers(motion: Motion, body: Body, source: SkeletonMotion, roles: dict[str, str]) -> Motion:
    """Return the motion with the skeleton's fingers, where they ever turn and the body has finger joints."""
    moving = [side for side in range(len(SIDES)) if fingers_move(source, roles, side)]
    try:
        fingered = with_fingers(body)
    except BodyInvalid:
        return motion
    shape = (motion.num_frames, len(SIDES), JOINTS_OF_A_HAND)
    turns, resting, prior = np.zeros((*shape, 3)), np.ones(shape, bool), load_hand_prior()
    for side, skeleton in enumerate(hand_skeletons(fingered)):
        points = finger_points(source, roles, side) if side in moving else None
        if points is not None:
            angles = finger_angles(points, side)[0]
            turns[:, side] = log_so3(by_joint(skeleton.local_rotations(prior.completed(angles))))
            resting[:, side] = by_joint(~informed_joints(np.isfinite(angles)))
    if resting.all():
        return motion
    flat = (motion.num_frames, len(SIDES) * JOINTS_OF_A_HAND)
    return with_finger_turns(motion, body, turns.reshape(*flat, 3), resting.reshape(flat))


def _resting(places: np.ndarray) -> np.ndarray | None:
    """Return (F, 24) the joints that nothing shows, elbows, wrists and hands of missing arms; or None."""
    unknown = np.isnan(places[0, :, 0])
    resting = np.zeros(places.shape[:2], dtype=bool)
    for elbow, wrist, hand in _ARMS:
        resting[:, elbow], resting[:, [wrist, hand]] = unknown[elbow], unknown[wrist]
    return resting if resting.any() else None
