"""Define the anatomical axes of body segments, and their rotations relative to their parents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.finger_joints import FIRST_FINGER
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.arrays import Array, array_namespace, identity
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import unit, unpacked
from solver_backend.types import Motion
from solver_backend.types.shapes import Float

WORLD_TO_GROUND: np.ndarray = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation from our world (Z up) to the ground axes of ISB, OpenSim and TRC files (Y up)."""
MIRROR: np.ndarray = np.diag([1.0, 1.0, -1.0])  # Reflects left segments, so that both sides' angles agree in sign.
TRUNK = {"pelvis": ("ground", "pelvis"), "thorax": ("pelvis", "spine3"), "head": ("thorax", "head")}
LIMBS = {
    "thigh": ("pelvis", "hip"), "shank": ("thigh", "knee"), "foot": ("shank", "ankle"), "toes": ("foot", "foot"),
    "upper_arm": ("thorax", "shoulder"), "forearm": ("upper_arm", "elbow"), "hand": ("forearm", "wrist"),
}  # fmt: skip
"""For each segment with a side, the parent segment and the body joint that moves it."""
SEGMENTS: dict[str, tuple[str, str]] = TRUNK | {
    f"{side}_{name}": (above if above in TRUNK else f"{side}_{above}", f"{side}_{joint}")
    for side in ("left", "right")
    for name, (above, joint) in LIMBS.items()
}


def has_segments(body: Body) -> bool:
    """Return whether a body has the joints of all segments, as bodies of the SMPL family do."""
    return {joint for _, joint in SEGMENTS.values()} <= set(body.layout.joints)


def turn_covariance(
    body: Body, local: Float[Array, "frames n 3 3"], pose: Float[Array, "frames p p"], constant_m: np.ndarray
) -> Float[Array, "frames segments 3 3"]:
    """Return (F, S, 3, 3) covariances in rad² of each segment's rotation relative to its parent.

    ``C = A P Aᵀ + c² I``, where P is the covariance of the pose. A maps a change of the pose to the rotation d of the
    segment, the sum over the joints k between the two segments: ``d = Σ_k R_1 … R_{k-1} d_k``. c is the deviation in
    radians due to constant errors at both ends of the segment's bone. C is in the axes of the parent segment's joint,
    or in world axes for the pelvis.

    Args:
        local: rotations of joints 1..n.
        pose: covariance of the pose's tangent: first the root's rotation, then three columns per joint.
        constant_m: (J,) standard deviation per axis of the recorded joints' constant errors, in metres.
    """
    xp, names, parents = array_namespace(pose), body.layout.joints, body.parents
    recorded, found = list(body.recorded_joints), []
    for parent, joint in SEGMENTS.values():
        j, top = names.index(joint), -1 if parent == "ground" else names.index(SEGMENTS[parent][1])
        chain = [j]
        while chain[-1] != top and parents[chain[-1]] != top:
            chain.append(parents[chain[-1]])
        turn, mixes = None, []
        for k in reversed(chain):
            mixes.append(xp.broadcast_to(identity(3, pose), (pose.shape[0], 3, 3)) if turn is None else turn)
            if k != j:
                R = xp.astype(local[:, k - 1], pose.dtype)
                turn = R if turn is None else xp.matmul(turn, R)
        blocks = [slice(3 * k, 3 * k + 3) for k in reversed(chain)]
        columns = xp.concat([pose[:, :, block] for block in blocks], axis=2)
        part, mix = xp.concat([columns[:, block] for block in blocks], axis=1), xp.concat(mixes, axis=2)
        length, below = _bone(body, j)
        ends = [constant_m[recorded.index(k)] for k in (j, below) if k in recorded]
        spread = float(sum(end**2 for end in ends)) / max(length, MIN_BONE_M) ** 2
        found.append(xp.matmul(xp.matmul(mix, part), xp.matrix_transpose(mix)) + spread * identity(3, pose))
    return xp.stack(found, axis=1)


def _bone(body: Body, joint: int) -> tuple[float, int]:
    """Return the length in metres and the end joint of the longest bone that starts at a joint."""
    rest = body.joints_template
    lengths = ((float(np.linalg.norm(rest[k] - rest[joint])), k) for k, p in enumerate(body.parents) if p == joint)
    return max(lengths, default=(0.0, joint))


def turn_spread(body: Body, sigma_m: np.ndarray) -> Float[np.ndarray, "frames segments"]:
    """Convert joint position deviations (F, J) in metres to segment rotation deviations (F, S) in radians."""
    recorded, found = list(body.recorded_joints), []
    for _, joint in SEGMENTS.values():
        j = body.layout.joints.index(joint)
        length, below = _bone(body, j)
        ends = sum(sigma_m[:, recorded.index(k)] ** 2 for k in (j, below) if k in recorded)
        found.append(np.sqrt(ends) / max(length, MIN_BONE_M))
    return np.stack(found, axis=1)


def segment_turns(body: Body, root: np.ndarray, local: np.ndarray) -> Float[np.ndarray, "frames segments 3 3"]:
    """Return the (F, S, 3, 3) rotations of the segments relative to their parents."""
    names, found = body.layout.joints, []
    for parent, joint in SEGMENTS.values():
        if parent == "ground":
            found.append(root)
            continue
        j, top = names.index(joint), names.index(SEGMENTS[parent][1])
        turn = local[:, j - 1]
        while body.parents[j] != top:
            j = body.parents[j]
            turn = local[:, j - 1] @ turn
        found.append(turn)
    return np.stack(found, axis=1)


MIN_BONE_M = 0.05  # Shortest bone in metres for constant errors. The last joints in a chain have no such bone.


PALPATED = {"knee": ("KNE", "KNM"), "ankle": ("ANK", "ANM"), "elbow": ("ELB", "ELM")}
"""Bony landmarks on both sides of a joint, without L or R."""
_PELVIS_PLACES = ("LFWT", "RFWT", "LBWT", "RBWT")
_TRUNK_PLACES = (*_PELVIS_PLACES, "C7", "CLAV", "STRN", "T8")


def anatomical_frames(
    body: Body, betas: np.ndarray, worn: Mapping[str, np.ndarray]
) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Return each segment's anatomical axes at rest as columns: x forward, y up, z right.

    - Pelvis: z through the anterior iliac spines, x in the plane of these spines and the midpoint of the posterior
      spines (Wu et al. 2002, hip).
    - Thorax: y from the midpoint of xiphoid process and T8 to the midpoint of jugular notch and C7 (Wu et al. 2005,
      2.3.1).
    - Thigh, shank, upper arm, forearm: y along the line of joint centres, z along the lower end's hinge. The z axes
      of forearm and hand point to the right at full supination (Wu et al. 2002, hip and ankle, and 2005, 2.3.4, 2.3.6).
    - Foot and toes: level and straight ahead, as in the rest pose (Wu et al. 2002, ankle).

    The standards define these axes by palpated landmarks. If the person wears markers on these landmarks, the marker
    positions are used for the pelvis, the thorax, and the centres of knee, ankle and elbow. All other landmarks come
    from the body model.

    Args:
        worn: for each location with a marker, the offset (3,) of the marker from the body model's landmark, in metres
          in the rest pose.
    """
    right, up, forward = -np.eye(3)[0], np.eye(3)[1], np.eye(3)[2]
    if not worn.keys() >= set(_PELVIS_PLACES):  # A plane that moves at only one edge would tilt.
        worn = {place: offset for place, offset in worn.items() if place not in _PELVIS_PLACES}
    at, skin = _centres(body, betas, worn), _skin(body, betas, _TRUNK_PLACES, worn)
    front, back = (0.5 * (skin[f"L{name}"] + skin[f"R{name}"]) for name in ("FWT", "BWT"))
    across = skin["RFWT"] - skin["LFWT"]
    frames = {
        "pelvis": _axes(np.cross(across, front - back), across),
        "thorax": _axes(0.5 * (skin["CLAV"] + skin["C7"] - skin["STRN"] - skin["T8"]), right),
        "head": _axes(up, right),
    }
    for side, sign in (("left", -1.0), ("right", 1.0)):
        hip, knee, ankle, shoulder, elbow, wrist, hand = (
            at[f"{side}_{name}"] for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist", "hand")
        )
        limbs = {
            "thigh": _axes(hip - knee, right),
            "shank": _axes(knee - ankle, right),
            "foot": _axes(up, right),
            "toes": _axes(up, right),
            "upper_arm": _axes(shoulder - elbow, sign * up),  # In the rest pose, the arms are level with palms down.
            "forearm": _axes(elbow - wrist, sign * forward),
            "hand": _axes(wrist - hand, sign * forward),
        }
        frames |= {f"{side}_{name}": axes for name, axes in limbs.items()}
    return frames


def worn_offsets(motion: Motion) -> dict[str, np.ndarray]:
    """Return the offset (3,) in metres of each worn marker from its location on the body.

    A marker on the sacrum also counts as both posterior iliac spines.
    """
    if motion.layout is None or motion.offsets is None:
        return {}
    worn = dict(zip(motion.layout, motion.offsets, strict=True))
    if "SACR" in worn:  # The sacrum marker is between the posterior spines.
        worn = {"LBWT": worn["SACR"], "RBWT": worn["SACR"], **worn}
    return worn


def _centres(body: Body, betas: np.ndarray, worn: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the rest position of each joint. Knees, ankles and elbows are midway between their palpated landmarks."""
    at = dict(zip(body.layout.joints, body.rest_joints(betas), strict=True))
    names = tuple(side + place for places in PALPATED.values() for place in places for side in "LR")
    skin = _skin(body, betas, names, {})
    for joint, places in PALPATED.items():
        for side in ("left", "right"):
            pair = [side[0].upper() + place for place in places]
            moved = [worn[name] for name in pair if name in worn] or [np.zeros(3)]
            centre, hinge = at[f"{side}_{joint}"], np.eye(3)[1 if joint == "elbow" else 0]
            shift = np.mean([skin[name] for name in pair], axis=0) + np.mean(moved, axis=0) - centre
            at[f"{side}_{joint}"] = centre + shift - hinge * (hinge @ shift)
    return at


def _skin(
    body: Body, betas: np.ndarray, names: tuple[str, ...], worn: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    places = marker_landmarks(body, names)
    points = (places.anchors + places.shapedirs @ betas).sum(axis=1)
    return {name: point + worn.get(name, 0.0) for name, point in zip(names, points, strict=True)}


def _axes(y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return right-handed axes as columns (3, 3): y along ``y``, and z in the plane of ``y`` and ``z``."""
    y = unit(y)
    x = unit(np.cross(y, z))
    return np.stack([x, y, np.cross(x, y)], axis=-1)


@dataclass(frozen=True)
class PosedSegments:
    """Rotations and joint centres of all segments in F frames."""

    rotations: dict[str, np.ndarray]  # (F, 3, 3) each segment's axes relative to the ground, Y up.
    joints: dict[str, np.ndarray]  # (F, 3) metres, joint centres in the world, Z up.
    ground: np.ndarray  # (3, 3) from the world to the ground. The person faces along x within 45 degrees.
    above: dict[str, np.ndarray]  # (3, 3) axes of the parent segment relative to its joint, for deviations.

    @property
    def turned_deg(self) -> int:
        """Angle in degrees about the vertical from the world's axes to the ground's axes, a multiple of 90."""
        R = WORLD_TO_GROUND.T @ self.ground
        return round(float(np.degrees(np.arctan2(R[1, 0], R[0, 0]))))

    def relative(self, segment: str) -> np.ndarray:
        """Return a segment's rotations (F, 3, 3) relative to its parent. Left segments are mirrored."""
        above = SEGMENTS[segment][0]
        turns = self.rotations[segment]
        turns = turns if above == "ground" else np.swapaxes(self.rotations[above], -1, -2) @ turns
        return MIRROR @ turns @ MIRROR if segment.startswith("left_") else turns


BENT_DEG, HINGE_DEG = 15.0, 25.0
"""Smallest mean bend of an elbow that reveals its hinge, and otherwise its assumed rotation from the vertical in the
level rest pose: 20 to 34 degrees in four arms (``PiG_Motion-FlatFoot-*``, Biomechanical Toolkit's test data)."""


def _hinge_turn(upper: np.ndarray, forearm: np.ndarray, sign: float) -> np.ndarray:
    """Return the rotation (3, 3) about the upper arm's y axis that aligns z with the hinge.

    The elbow's hinge is perpendicular to the long axes of upper arm and forearm (Wu et al. 2005, 2.3.5). The hinge
    directions of all frames are averaged, weighted by the sine of the elbow's bend. If the mean bend is less than
    ``BENT_DEG``, the rotation is ``HINGE_DEG``.
    """
    normal = np.cross(upper[..., 1], forearm[..., 1])
    bend = np.linalg.norm(normal, axis=-1).mean()
    x, _, z = np.einsum("fij,fi->fj", upper, normal).mean(axis=0)
    default = sign * np.radians(HINGE_DEG)
    angle = np.arctan2(x, z) if bend > np.sin(np.radians(BENT_DEG)) else default
    return exp_so3(np.array([[0.0, angle, 0.0]]))[0]


def posed_segments(motion: Motion, body: Body) -> PosedSegments:
    """Compute the anatomical segments of a motion.

    If all four iliac spines have markers, the pelvis rotation is the best rigid fit to the spines on the posed skin,
    not the rotation of the body model's pelvis joint. The joint's rotation is 10 degrees off in squats (``squats1``).

    Raises:
        MotionInvalid: the motion is for another body, or the body does not have the SMPL family's joints.
    """
    motion.require_body(body.id, body.layout.recorded, "motion")
    names = body.layout.joints
    if not has_segments(body):
        hint = "Choose a motion of the neutral body or of an SMPL-type body."
        raise MotionInvalid(f"The body {body.id} has no SMPL joints.", where="motion", hint=hint)
    own = [j - 1 for j in body.recorded_joints[1:]]
    local = np.zeros((motion.num_frames, len(names) - 1, 3))
    local[:, own] = motion.body_pose.reshape(motion.num_frames, -1, 3)
    turned = exp_so3(local[:, : max(own) + 1].astype(np.float64))
    root, betas = exp_so3(motion.global_orient.astype(np.float64)), motion.betas.astype(np.float64)
    transl, worn = motion.transl.astype(np.float64), worn_offsets(motion)
    posed = forward_kinematics(body, betas, root, turned, transl)
    frames = anatomical_frames(body, betas, worn)
    number = {segment: names.index(joint) for segment, (_, joint) in SEGMENTS.items()}
    ground = WORLD_TO_GROUND @ _quarter_turn(posed.G[:, names.index("pelvis"), :2, 2].mean(axis=0))
    rotations = {segment: ground @ posed.G[:, j] @ frames[segment] for segment, j in number.items()}
    if worn.keys() >= set(_PELVIS_PLACES):
        rest = np.stack([*_skin(body, betas, _PELVIS_PLACES, worn).values()])
        places, moved = marker_landmarks(body, _PELVIS_PLACES), np.stack([worn[name] for name in _PELVIS_PLACES])
        skin = pose_landmarks(body, places, betas, root, turned, transl, offsets=moved).points
        rotations["pelvis"] = ground @ umeyama(np.broadcast_to(rest, skin.shape), skin)[1] @ frames["pelvis"]
    for side in ("left", "right"):
        arm = f"{side}_upper_arm"
        turn = _hinge_turn(rotations[arm], rotations[f"{side}_forearm"], 1.0 if side == "left" else -1.0)
        rotations[arm], frames[arm] = rotations[arm] @ turn, frames[arm] @ turn
    above = {segment: frames.get(parent, ground.T) for segment, (parent, _) in SEGMENTS.items()}
    return PosedSegments(rotations, dict(zip(names, np.moveaxis(posed.joints, 1, 0), strict=True)), ground, above)


def without_fingers(motion: Motion, body: Body) -> Motion:
    """Remove a motion's finger joints. Only the joints that motions of ``body`` store remain."""
    layout = body.layout.recorded
    own, theirs = motion.body_layout.shared_with(layout)
    if motion.body_layout.joints == layout.joints or len(own) < FIRST_FINGER:
        return motion
    shape, wide = (motion.num_frames, layout.num_joints), motion.body_pose.reshape(motion.num_frames, -1, 3)
    pose, joints, resting = np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros(shape, dtype=bool)
    pose[:, theirs[1:]] = wide[:, np.array(own[1:]) - 1]
    joints[:, theirs] = motion.joints[:, own]
    if motion.resting is not None:
        resting[:, theirs] = motion.resting[:, own]
    turns = pose[:, 1:].reshape(len(pose), -1)
    known = {"joint_sigma": None, "joint_covariance": None}
    return replace(motion, body_layout=layout, body_pose=turns, joints=joints, resting=resting, **known)


def turn_covariances(motion: Motion) -> dict[str, np.ndarray] | None:
    """Return each segment's rotation covariances (F, 3, 3) in rad², or None if the motion has no covariances.

    They are NaN in frames where a joint of the segment is assumed to be at rest.
    """
    if motion.turn_covariance is None:
        return None
    found, layout = unpacked(motion.turn_covariance.astype(np.float64)), motion.body_layout
    for k, (_, joint) in enumerate(SEGMENTS.values()):
        j = layout.joints.index(joint)
        moved = [child for child, parent in enumerate(layout.parents) if parent == j] or [j]
        if motion.resting is not None:
            found[motion.resting[:, moved].any(axis=1), k] = np.nan
    return dict(zip(SEGMENTS, np.moveaxis(found, 1, 0), strict=True))


def _quarter_turn(forward: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) about the vertical that best aligns ``forward`` (2,) with x, in steps of 90 degrees.

    OpenSim's inverse kinematics starts facing x, and finds wrong minima for people who face another way.
    """
    quarters = round(float(np.arctan2(forward[1], forward[0])) / (0.5 * np.pi))
    return np.round(exp_so3(np.array([[0.0, 0.0, -0.5 * np.pi * quarters]]))[0])
