"""Transfer the motion of another skeleton to our body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_skeleton import informed_joints
from solver_backend.body.hands import JOINTS_OF_A_HAND, by_joint, hand_skeletons, with_fingers
from solver_backend.body.kinematics import subtree_matrix
from solver_backend.body.skeleton_fingers import finger_angles, finger_points, fingers_move
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import BodyInvalid, MotionInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, NUM_JOINTS, SIDES, SMPL_PARENTS
from solver_backend.exchange.rigs.rest_frames import UP, level, limb_frame, limb_turns, stage_axes, swing
from solver_backend.exchange.rigs.skeleton import JOINT_OF, LIMBS, chain_roles
from solver_backend.fitters.hands.solve_hands import with_finger_turns
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import Motion, SkeletonMotion

R_STAGE_BODY = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # Body (Y up, +Z front) to stage.
NUM_TURNED = 1 + NUM_BODY_JOINTS  # Rotating joints: all except SMPL's two hand joints.
_SPINE = SMPL.numbers("spine1", "spine2", "spine3")
_NECK, _HEAD = SMPL.numbers("neck", "head")
_BALL_AFTER_ANKLE, _HAND_AFTER_WRIST = 3, 2


@dataclass(frozen=True)
class Measured:
    """Joint positions (world metres) and rotations of our body, measured on the motion of another skeleton."""

    places: np.ndarray  # (F, NUM_JOINTS, 3), NaN where the skeleton has no such joint.
    turns: np.ndarray  # (F, 22, 3, 3) rotations from our body's rest axes to the world.
    rest: np.ndarray  # (NUM_JOINTS, 3) the skeleton's joints at rest, NaN where it has none.


def measure(motion: SkeletonMotion, roles: dict[str, str], own_rest: np.ndarray) -> Measured:
    """Measure the positions and rotations of our body's joints on another skeleton.

    Let G be a joint's rotation relative to the skeleton's rest pose, and A the rotation from its bone at rest to our
    body's bone. R_s and R_b map the rest axes of skeleton and body to common axes. The body's rotation is
    ``G R_s^T A^T R_b``, so that its bones point in the same directions.

    Args:
        roles: maps each role to a joint of the skeleton.
        own_rest: (NUM_JOINTS, 3) joints of the body at rest in metres, Y up.

    Raises:
        MotionInvalid: left and right are not known.
    """
    index = {role: motion.names.index(name) for role, name in roles.items()}
    R = stage_axes({role: motion.rest[j] for role, j in index.items()})
    if R is None:
        hint = "Use a skeleton with both thighs or both upper arms."
        raise MotionInvalid("The left and right sides of the skeleton are unknown.", where=motion.name, hint=hint)
    places, rest = np.full((motion.num_frames, NUM_JOINTS, 3), np.nan), np.full((NUM_JOINTS, 3), np.nan)
    for role, joint in JOINT_OF.items():
        if role in index and role != "pelvis" and not role.endswith("clavicle"):
            places[:, joint], rest[joint] = motion.joints[:, index[role]], motion.rest[index[role]]
    aligned = _alignments(index, motion.rest @ R.T, own_rest @ R_STAGE_BODY.T)
    G = {role: motion.turns[:, j] @ R.T @ aligned.get(role, np.eye(3)).T @ R_STAGE_BODY for role, j in index.items()}
    return Measured(places, _turns(G, motion.num_frames), rest)


def _alignments(index: dict[str, int], rest: np.ndarray, own: np.ndarray) -> dict[str, np.ndarray]:
    """Return each role's rotation from the skeleton's bone at rest to our body's bone at rest, in common axes."""
    aligned: dict[str, np.ndarray] = {}
    for limb, roles in LIMBS.items():
        if not set(roles[:2]) <= index.keys():
            continue
        side, is_arm = limb.partition("_")[0], limb.endswith("arm")
        joints = [JOINT_OF[role] for role in roles]
        first, second = rest[index[roles[0]]], rest[index[roles[1]]]
        # A limb without hand or foot is assumed to be straight at rest.
        end = rest[index[roles[2]]] if roles[2] in index else 2 * second - first
        points = np.stack([first, second, end])
        upper, lower = limb_turns(points, own[joints], is_arm)
        aligned |= {roles[0]: upper, roles[1]: lower, roles[2]: lower}
        if roles[2] not in index:
            continue
        if is_arm:
            fingers = [f"{side}_{finger}_1" for finger in ("index", "middle", "ring", "pinky")]
            if knuckles := [index[role] for role in fingers if role in index]:
                reach = own[joints[2] + _HAND_AFTER_WRIST] - own[joints[2]]
                aligned[roles[2]] = swing(lower @ (rest[knuckles].mean(0) - points[2]), reach) @ lower
        elif f"{side}_toe" in index:
            heading = level(lower @ (rest[index[f"{side}_toe"]] - points[2]))
            wanted = level(own[joints[2] + _BALL_AFTER_ANKLE] - own[joints[2]])
            aligned[roles[2]] = limb_frame(wanted, UP) @ limb_frame(heading, UP).T @ lower
            aligned[f"{side}_toe"] = aligned[roles[2]]
    return aligned


def _turns(G: dict[str, np.ndarray], frames: int) -> np.ndarray:
    """Return the rotations (F, 22, 3, 3) of our body's joints. Missing spine and neck rotations are interpolated."""
    turns = np.empty((frames, NUM_TURNED, 3, 3))
    turns[:, 0] = G["pelvis"]
    spine = [G[role] for role in chain_roles(dict.fromkeys(G, ""), "spine")]
    line = [turns[:, 0], *spine]
    for k, joint in enumerate(_SPINE):
        turns[:, joint] = _along(line, (k + 1) / len(_SPINE))
    chest = turns[:, _SPINE[-1]]
    turns[:, _HEAD] = G.get("head", chest)
    necks = [G[role] for role in chain_roles(dict.fromkeys(G, ""), "neck")]
    turns[:, _NECK] = _along(necks, 0.5) if necks else _along([chest, turns[:, _HEAD]], 0.5)
    for side in SIDES:
        above = {"clavicle": chest, "upper_arm": None, "forearm": None, "hand": None}
        above |= {"thigh": turns[:, 0], "shin": None, "foot": None, "toe": None}
        last = chest
        for part, start in above.items():
            last = G.get(f"{side}_{part}", start if start is not None else last)
            turns[:, JOINT_OF[f"{side}_{part}"]] = last
    return turns


def _along(line: list[np.ndarray], share: float) -> np.ndarray:
    at = share * (len(line) - 1)
    low = min(int(at), len(line) - 1)
    if at - low < 1e-9 or low + 1 >= len(line):
        return line[low]
    step = log_so3(np.swapaxes(line[low], -1, -2) @ line[low + 1])
    return line[low] @ exp_so3((at - low) * step)


_PLACED = SMPL.both("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
"""Limb joints that the fit positions. Programs place head and toes differently, so only their rotations count."""
_PLACE_SIGMA_M = 0.004  # Deviation of a limb joint from the skeleton's, in metres.
_TURN_SIGMA = np.full(NUM_TURNED, 0.12)
"""Standard deviation of rotations in radians: less for the tilted pelvis, more for differently placed collars."""
_TURN_SIGMA[0], _TURN_SIGMA[[13, 14]] = 0.06, 0.2
_ROUNDS, _BLOCK = 20, 256
_DAMPING, _EASED, _STIFFENED = 1e-3, 0.2, 8.0
"""Initial damping relative to the normal equations' diagonal, and its factors after a good and a bad step."""
_LEAST_GAIN, _CONVERGED, _LONGEST_STEP = 1e-3, 1e-3, 0.4
"""Relative decrease of the cost and step in radians at which the fit ends, and largest rotation per step."""
_ABOVE = subtree_matrix(SMPL_PARENTS).T[:, :NUM_TURNED] > 0  # (24, 22) rotating joints above each joint, or itself.
_MOVED = _ABOVE & ~np.eye(NUM_JOINTS, NUM_TURNED, dtype=bool)  # (24, 22) joints moved by each rotation.


def fit_poses(rest: np.ndarray, measured: Measured) -> tuple[np.ndarray, np.ndarray]:
    """Fit rotations (F, 22, 3, 3) and joints (F, 24, 3) to a skeleton by Levenberg-Marquardt.

    World rotations δ_i of the joints i above joint k move it by ``Σ δ_i × (p_k - p_i)`` and rotate it by ``Σ δ_i``.
    Therefore, its change is linear in δ and the root's shift. ``rest`` (24, 3) are the shaped body's rest joints in
    metres.
    """
    parts = [
        _fit_block(rest, measured.places[at : at + _BLOCK], measured.turns[at : at + _BLOCK])
        for at in range(0, len(measured.places), _BLOCK)
    ]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _fit_block(rest: np.ndarray, places: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    known, prior = _known(places), _prior()
    G, root = turns.copy(), np.zeros((len(places), 3))
    root += (places[:, known] - posed(rest, G, root)[:, known]).mean(1)
    above = _ABOVE[:NUM_TURNED] / _TURN_SIGMA[:, None]
    joints = posed(rest, G, root)
    r, turned, cost = _residuals(joints, G, places, turns, known)
    damping, moving = np.full(len(G), _DAMPING), np.arange(len(G))
    for _ in range(_ROUNDS):
        J = _slopes(joints[moving], known) / _PLACE_SIGMA_M
        g = (np.swapaxes(J, -1, -2) @ r[moving].reshape(len(moving), -1, 1))[..., 0]
        g[:, : 3 * NUM_TURNED] += np.einsum("ki,fkc->fic", above, turned[moving]).reshape(len(moving), -1)
        H = np.swapaxes(J, -1, -2) @ J + prior
        H[:, range(H.shape[-1]), range(H.shape[-1])] *= 1.0 + damping[moving, None]
        step = np.linalg.solve(H, g[..., None])[..., 0]
        delta = step[:, : 3 * NUM_TURNED].reshape(len(moving), NUM_TURNED, 3)
        farthest = np.linalg.norm(delta, axis=-1).max(axis=1)
        share = np.minimum(1.0, _LONGEST_STEP / np.maximum(farthest, 1e-12))[:, None]
        new_G, new_root = _turned(G[moving], share[..., None] * delta), root[moving] + share * step[:, 3 * NUM_TURNED :]
        new_joints = posed(rest, new_G, new_root)
        new_r, new_turned, new_cost = _residuals(new_joints, new_G, places[moving], turns[moving], known)
        better = new_cost < cost[moving]
        kept = moving[better]
        gain = 1.0 - new_cost / np.maximum(cost[moving], 1e-12)
        G[kept], root[kept], joints[kept] = new_G[better], new_root[better], new_joints[better]
        r[kept], turned[kept], cost[kept] = new_r[better], new_turned[better], new_cost[better]
        damping[moving] *= np.where(better, _EASED, _STIFFENED)
        moving = moving[(farthest > _CONVERGED) & ~(better & (gain < _LEAST_GAIN))]
        if not len(moving):
            break
    return G, joints


def _residuals(
    joints: np.ndarray, G: np.ndarray, places: np.ndarray, turns: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r = (places[:, known] - joints[:, known]) / _PLACE_SIGMA_M
    turned = log_so3(turns @ np.swapaxes(G, -1, -2)) / _TURN_SIGMA[:, None]
    return r, turned, (r**2).sum((1, 2)) + (turned**2).sum((1, 2))


def deviations(joints: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return deviations (F, 24) of fitted joints in metres, as root mean square over axes.

    ``σ² = tr(J H⁻¹ J^T) / 3 + |p - q|² / 3``. The first term is the uncertainty of the fit, where H is the matrix of
    its normal equations and J a joint's derivative. The second is the distance of the joint p from the skeleton's joint
    q. ``joints`` and ``places`` are (F, 24, 3) in metres.
    """
    known, prior = _known(places), _prior()
    off = (joints - places)[:, known]
    variance = np.empty(joints.shape[:2])
    for at in range(0, len(joints), _BLOCK):
        J = _slopes(joints[at : at + _BLOCK], np.arange(NUM_JOINTS))
        shown = J.reshape(len(J), NUM_JOINTS, 3, -1)[:, known].reshape(len(J), 3 * len(known), -1) / _PLACE_SIGMA_M
        L = np.linalg.cholesky(np.swapaxes(shown, -1, -2) @ shown + prior)
        open_m = np.linalg.solve(L, np.swapaxes(J, -1, -2))
        variance[at : at + _BLOCK] = (open_m**2).sum(1).reshape(len(J), NUM_JOINTS, 3).sum(-1) / 3.0
    variance[:, known] += (off**2).sum(-1) / 3.0
    return np.sqrt(variance)


def _known(places: np.ndarray) -> np.ndarray:
    return np.array([joint for joint in _PLACED if np.isfinite(places[0, joint, 0])])


def _prior() -> np.ndarray:
    above = _ABOVE[:NUM_TURNED] / _TURN_SIGMA[:, None]
    prior = np.zeros((3 * NUM_TURNED + 3, 3 * NUM_TURNED + 3))
    prior[: 3 * NUM_TURNED, : 3 * NUM_TURNED] = np.kron(above.T @ above, np.eye(3))
    return prior


def posed(rest: np.ndarray, G: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Return joints (F, 24, 3) for rotations (F, 22, 3, 3) and root positions (F, 3)."""
    joints = np.empty((len(G), NUM_JOINTS, 3))
    joints[:, 0] = root
    for j in range(1, NUM_JOINTS):
        parent = SMPL_PARENTS[j]
        joints[:, j] = joints[:, parent] + G[:, parent] @ (rest[j] - rest[parent])
    return joints


def _slopes(joints: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return derivatives (F, 3 K, 69) of K joints w.r.t. all joint rotations and the root."""
    v: np.ndarray = (joints[:, known, None] - joints[:, None, :NUM_TURNED]) * _MOVED[known][..., None]
    J = np.zeros((len(joints), len(known), 3, NUM_TURNED + 1, 3))
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        J[:, :, a, :NUM_TURNED, b] = v[..., c]
        J[:, :, b, :NUM_TURNED, a] = -v[..., c]
    J[:, :, range(3), NUM_TURNED, range(3)] = 1.0
    return J.reshape(len(joints), 3 * len(known), -1)


def _turned(G: np.ndarray, delta: np.ndarray) -> np.ndarray:
    E, whole, new = exp_so3(delta), np.empty_like(G), np.empty_like(G)
    for j in range(NUM_TURNED):
        parent = SMPL_PARENTS[j]
        whole[:, j] = E[:, j] if parent < 0 else whole[:, parent] @ E[:, j]
        new[:, j] = whole[:, j] @ G[:, j]
    return new


_HIPS, _SHOULDERS = SMPL.both("hip"), SMPL.both("shoulder")
_BONES = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
_PAIRS = (
    *(((a,), (b,)) for start, end in _BONES for a, b in zip(SMPL.both(start), SMPL.both(end), strict=True)),
    *((pair[:1], pair[1:]) for pair in (_HIPS, _SHOULDERS)),
    *((_HIPS, _SHOULDERS), (_SHOULDERS, SMPL.numbers("head"))),
)  # Ends of the compared lengths: limb bones, widths, trunk, and shoulders to head, or to the middle of joints.
_STARTS, _ENDS = (np.array([(pair[end][0], pair[end][-1]) for pair in _PAIRS]) for end in (0, 1))  # (12, 2) joints.
_SIGMA_M = np.array([0.004] * 8 + [0.008, 0.006, 0.008, 0.04])
"""Standard deviation of lengths in metres: small for widths and trunk so that collars do not fold, and large for heads,
which differ."""
_SHAPE_ROUNDS = 4
_EXACT, _SAME_M, _PLAUSIBLE = 16.0, 0.001, 5.0
"""Weight factor, largest error in metres and largest shape coefficient that identify a skeleton made from this body."""


def shape_from_lengths(body: Body, rest: np.ndarray) -> np.ndarray:
    """Estimate the body shape (10,) from a skeleton's segment lengths l: ``min Σ (l(β) - l)² / σ² + |β|²``.

    ``rest`` are the skeleton's joints (24, 3) at rest in metres, NaN where missing.
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
    for _ in range(_SHAPE_ROUNDS):
        H, g = _length_equations(body, betas, wanted, known, certainty)
        betas = betas + np.linalg.solve(H, g)
    return betas


def _length_equations(
    body: Body, betas: np.ndarray, wanted: np.ndarray, known: np.ndarray, certainty: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal equations (10, 10) of lengths and shape prior, and their right-hand side (10,)."""
    weight, ways = certainty / _SIGMA_M[known], _ways(body.rest_joints(betas))
    lengths = np.linalg.norm(ways, axis=1)
    J = np.einsum("pa,pab->pb", ways / lengths[:, None], _ways(body.joints_shapedirs))[known] * weight[:, None]
    return J.T @ J + np.eye(len(betas)), J.T @ ((wanted - lengths)[known] * weight) - betas


_SHAPE_FRAMES, _SHAPE_FITS = 64, 3  # Number of frames used to refine a shape, and number of pose fits.


def shape_from_places(body: Body, measured: Measured) -> np.ndarray:
    """Estimate the body shape (10,) from a skeleton's rest lengths and joints in some frames.

    Lengths do not determine the positions of hips and shoulders in the trunk. Poses and shape are fitted alternately.
    For fixed poses, the joints are linear in the shape, and the root is eliminated. Each step minimises the sum of
    three terms: the mean over the frames of ``Σ |p_k(β) - p_k|² / σ²``, the lengths' errors and ``|β|²``.
    """
    betas, known = shape_from_lengths(body, measured.rest), _known(measured.places)
    frames = np.unique(np.linspace(0, len(measured.places) - 1, _SHAPE_FRAMES).astype(int))
    some = Measured(measured.places[frames], measured.turns[frames], measured.rest)
    wanted = _lengths(measured.rest)
    for _ in range(_SHAPE_FITS):
        G, joints = fit_poses(body.rest_joints(betas)[:NUM_JOINTS], some)
        r = (some.places - joints)[:, known]
        if np.sqrt((r**2).sum(-1).mean()) < _SAME_M:
            break
        by_shape, origin = np.moveaxis(body.joints_shapedirs[:NUM_JOINTS], -1, 0), np.zeros((len(G), 3))
        slopes = np.stack([posed(direction, G, origin) for direction in by_shape], axis=-1)
        D = slopes[:, known] - slopes[:, known].mean(axis=1, keepdims=True)
        r = (r - r.mean(axis=1, keepdims=True)) / (_PLACE_SIGMA_M**2 * len(G))
        H, g = _length_equations(body, betas, wanted, np.isfinite(wanted), 1.0)
        H = H + np.einsum("fkax,fkay->xy", D, D) / (_PLACE_SIGMA_M**2 * len(G))
        betas = betas + np.linalg.solve(H, g + np.einsum("fkax,fka->x", D, r))
    return betas


def _lengths(joints: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(_ways(joints), axis=1))


def _ways(joints: np.ndarray) -> np.ndarray:
    """Return (12, ...) vectors between midpoints of joints. The body shape is fitted to the vector lengths."""
    return np.asarray(joints[_ENDS].mean(axis=1) - joints[_STARTS].mean(axis=1))


_FEET = ((7, 10), (8, 11))  # Ankle and ball of each foot.
_LOWEST_SHARE = 2.0  # Percentile of the frames' lowest soles that defines the floor, because single frames are deeper.
_NEAR_M, _STILL_M_S = 0.04, 0.3  # Largest height of a standing foot's ball above its rest height, and speed.


def floor_height(body: Body, betas: np.ndarray, joints: np.ndarray) -> float:
    """Estimate the floor height in metres: a low percentile of the height of the lower sole over all frames.

    Soles are assumed to be as far below the ankles and balls of the feet as at rest. ``joints`` (F, 24, 3) are in
    metres.
    """
    above = _rest_heights(body, betas)
    lowest = np.min([joints[:, joint, 2] - above[joint] for foot in _FEET for joint in foot], axis=0)
    return float(np.percentile(lowest, _LOWEST_SHARE, method="higher"))


def standing_feet(body: Body, betas: np.ndarray, joints: np.ndarray, fps: float) -> np.ndarray:
    """Return an (F, 2) mask of planted feet, left first: the ball of the foot is low and slow."""
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
    """Motion transferred to our body, and its distance from the source skeleton."""

    motion: Motion
    distances_mm: dict[str, float]  # Root mean square distance of each joint from the skeleton's, by role.
    raised_m: float  # Height by which the motion was raised to put the soles on the floor.


def import_motion(
    source: SkeletonMotion, roles: dict[str, str], body: Body, *, keep_height: bool = False
) -> ImportedMotion:
    """Transfer a skeleton's motion to our body, with a shape that fits the skeleton's bones.

    Args:
        roles: maps each role to a joint of the skeleton.
        body: a body that starts with SMPL's joints.
        keep_height: keep the clip's height. Otherwise, the lowest soles are moved to z = 0.

    Raises:
        MotionInvalid: left and right are not known.
    """
    measured = measure(source, roles, body.rest_joints(np.zeros(10))[:NUM_JOINTS])
    betas = shape_from_places(body, measured)
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
    """Return an (F, 24) mask of the arm joints that the skeleton does not have, or None if it has all of them."""
    unknown = np.isnan(places[0, :, 0])
    resting = np.zeros(places.shape[:2], dtype=bool)
    for elbow, wrist, hand in _ARMS:
        resting[:, elbow], resting[:, [wrist, hand]] = unknown[elbow], unknown[wrist]
    return resting if resting.any() else None
