"""Simulate the hands in a shot: finger motion, visibility in each camera, and detections."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.hand_skeleton import NUM_ANGLES, HandSkeleton, finger_overlap
from solver_backend.body.hands import by_joint, hand_of_shape, with_fingers
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.mesh import pose_mesh
from solver_backend.cameras.projection import project
from solver_backend.exchange.joint_sets import HAND_POINTS, NUM_HAND_POINTS, SIDES
from solver_backend.priors.hand_prior import HandPrior, load_hand_prior
from solver_backend.synthesis.faults import autoregressive, bursts
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.sight import BodySight, cast_lines, hidden_by_ellipsoids
from solver_backend.synthesis.studio.z_buffer import in_pictures
from solver_backend.types import UNSEEN_POINT, Cameras, Capture, JointSet
from solver_backend.types.shapes import Bool, Float

_WRIST, _KNUCKLE = 0, 9
BEYOND = np.array([k > 0 and (k - 1) % 4 > 0 for k in range(NUM_HAND_POINTS)])  # (21,) points beyond the knuckles.


@dataclass(frozen=True)
class HandFaults:
    """Errors of a hand detector. The unit of length is the palm (wrist to middle knuckle).

    ``whole``, ``drift`` and ``jitter`` were measured for MediaPipe's model on palms of 35 to 60 px (Pose2Sim's
    balancing videos, refined cameras, ``python -m tests.benchmarks.hands.real_noise``). On palms of 60 to 140 px, they
    are 0.03, 0.04 and 0.016.
    """

    whole: float = 0.05  # Standard deviation per axis of an error common to a whole hand, correlated over ``drift_s``.
    drift: float = 0.10  # The same for an error of each individual point.
    jitter: float = 0.036  # Standard deviation of each point's error that is independent in every frame.
    drift_s: float = 0.3  # Time constant of the drift in seconds.
    guessed: float = 2.5  # Factor applied to the errors of hidden points.
    least_seen: float = 0.5  # Smallest fraction of visible points with which a hand is detected.
    missing: float = 0.06  # Fraction of frames without a detection of a visible hand.
    missing_s: float = 0.15  # Duration of a miss in seconds.
    wrong: float = 0.01  # Fraction of frames with a detection one or two palms away.
    exchanged: float = 0.005  # Fraction of frames with left and right swapped.
    held: bool = False  # A held object hides the fingers. They are guessed, and hands are detected half as often.
    gloved: bool = False  # Hands wear gloves. All points are guessed, and hands are detected half as often.
    small_px: float = 15.0  # Palm size in pixels. Errors grow with the square of the ratio for smaller palms.


def detect_hands(
    cameras: Cameras, points: np.ndarray, hidden: np.ndarray, fps: float, faults: HandFaults, rng: np.random.Generator
) -> np.ndarray:
    """Simulate a hand detector: (C, F, 2, 21, 3) pixels and confidence, NaN and 0 if undetected.

    ``points`` (F, 2, 21, 3) are in metres, left hand first. ``hidden`` (C, F, 2, 21) marks occluded points.
    """
    hidden = hidden | faults.gloved
    if faults.held:
        hidden = hidden | BEYOND
    px = project(cameras, points)
    palm = np.linalg.norm(px[..., _KNUCKLE, :] - px[..., _WRIST, :], axis=-1)
    # The palm appears short when the hand points at the camera, so the size of the whole hand is used.
    size = np.fmax(palm, np.nanmax(np.linalg.norm(px - px[..., :1, :], axis=-1), axis=-1) / 2)
    unit = (size * np.maximum(1.0, (faults.small_px / np.maximum(size, 1.0)) ** 2))[..., None, None]
    keep = float(np.exp(-1.0 / (faults.drift_s * fps)))
    whole = faults.whole * autoregressive((*px.shape[:3], 1, 2), keep, rng)
    own = faults.drift * autoregressive(px.shape, keep, rng) + faults.jitter * rng.normal(size=px.shape)
    error = whole + own * np.where(hidden, faults.guessed, 1.0)[..., None]
    shape = px.shape[:3]
    wrong = bursts(rng.random(shape), faults.wrong, max(1.0, 0.2 * fps))
    away = rng.normal(size=(*shape, 1, 2))
    error = error + np.where(wrong[..., None, None], 1.5 * away / np.linalg.norm(away, axis=-1, keepdims=True), 0.0)
    xy = px + unit * error
    inside = ((xy >= 0) & (xy < cameras.image_size[:, None, None, None])).all(-1)
    lost = bursts(rng.random(shape), faults.missing, max(1.0, faults.missing_s * fps))
    enough = (~hidden & inside).mean(-1) >= faults.least_seen
    # A detector that has learned such hands tolerates hidden fingers, but misses every second hand.
    if faults.held or faults.gloved:
        enough = bursts(rng.random(shape), 0.5, max(1.0, faults.missing_s * fps)) & inside.all(-1)
    found = ~lost & enough
    confidence = np.clip(0.9 - 0.25 * hidden + 0.08 * rng.normal(size=hidden.shape), 0.05, 1.0)
    hands = np.concatenate([xy, confidence[..., None]], axis=-1)
    hands[~(found[..., None] & inside)] = UNSEEN_POINT
    exchanged = bursts(rng.random(shape[:2]), faults.exchanged, max(1.0, 0.2 * fps))
    return np.where(exchanged[..., None, None, None], hands[:, :, ::-1], hands)


FINGER_M, PALM_M = 0.008, 0.011  # Radius of a finger, and half the thickness of a palm (ANSUR II: 15-20 and 27 mm).
_BONES = np.array(  # Points at both ends of each hand bone: metacarpals first, then three per finger.
    [[0, 1 + 4 * finger] for finger in range(5)]
    + [[1 + 4 * finger + k, 2 + 4 * finger + k] for finger in range(5) for k in range(3)]
)
_RADII = np.array([PALM_M] * 5 + [FINGER_M] * 15)  # Radius of each bone in metres.
_CHUNK = 64  # Number of frames processed together.


def hidden_by_hands(
    centres: Float[np.ndarray, "cameras 3"], points: Float[np.ndarray, "frames 2 21 3"]
) -> Bool[np.ndarray, "cameras frames 2 21"]:
    """Return a (C, F, 2, 21) mask of the hand points that a bone of either hand occludes.

    A bone occludes a point if the distance from the line of sight to the bone is less than the bone's radius.
    """
    frames = len(points)
    hidden = np.zeros((len(centres), frames, 2, NUM_HAND_POINTS), bool)
    for start in range(0, frames, _CHUNK):
        part = points[start : start + _CHUNK]
        flat = part.reshape(len(part), -1, 3)
        ends = part[:, :, _BONES].reshape(len(part), -1, 2, 3)
        for camera, centre in enumerate(centres):
            near = _segment_distances(flat, centre, ends) < np.tile(_RADII, 2)
            hidden[camera, start : start + _CHUNK] = (near & ~_OWN).any(-1).reshape(len(part), 2, NUM_HAND_POINTS)
    return hidden


def _own_bones() -> np.ndarray:
    """Return a (42, 40) mask of the bones next to each hand point. These bones cannot occlude the point."""
    own = (np.arange(NUM_HAND_POINTS)[:, None, None] == _BONES).any(-1)
    knuckles = [HAND_POINTS.index(name) for name in HAND_POINTS if name.endswith("_mcp")]
    own[[0, *knuckles], :5] = True
    both = np.zeros((2 * NUM_HAND_POINTS, 2 * len(_BONES)), bool)
    for hand in range(2):
        rows, columns = (slice(hand * count, (hand + 1) * count) for count in (NUM_HAND_POINTS, len(_BONES)))
        both[rows, columns] = own
    return both


_OWN = _own_bones()


def _segment_distances(points: np.ndarray, centre: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the (f, P, B) distances (m) between the bones and the segments from points to a camera."""
    sight = centre - points
    bone = ends[:, :, 1] - ends[:, :, 0]
    between = points[:, :, None] - ends[:, None, :, 0]
    a = (sight * sight).sum(-1)[:, :, None]
    c = (bone * bone).sum(-1)[:, None, :]
    b = np.einsum("fpi,fbi->fpb", sight, bone)
    d = np.einsum("fpi,fpbi->fpb", sight, between)
    e = np.einsum("fbi,fpbi->fpb", bone, between)
    along = np.clip((b * e - c * d) / np.maximum(a * c - b * b, 1e-12), 0.0, 1.0)
    on_bone = np.clip((b * along + e) / np.maximum(c, 1e-12), 0.0, 1.0)
    along = np.clip((b * on_bone - d) / np.maximum(a, 1e-12), 0.0, 1.0)
    gap = between + along[..., None] * sight[:, :, None] - on_bone[..., None] * bone[:, None]
    return np.linalg.norm(gap, axis=-1)


def hidden_points(person: Person, cameras: Cameras, points: np.ndarray) -> np.ndarray:
    """Return a (C, F, 2, 21) mask of the hand points that other body parts occlude."""
    frames, _, count = points.shape[:3]
    sight = BodySight(person.body, person.betas, keypoint_landmarks(person.body, JointSet.COCO_17))
    joints, bone = person.body.layout.joints, sight.proxy.bone
    own = [[j for j, name in enumerate(joints) if name in (f"{s}_wrist", f"{s}_hand")] for s in SIDES]
    counted = np.repeat(np.stack([~np.isin(bone, parts) for parts in own], axis=1), count, axis=1)
    hidden = np.zeros((frames, len(cameras), 2 * count), dtype=bool)
    for chunk, posed, lines in cast_lines(sight.proxy, person, cameras, points.reshape(frames, -1, 3)):
        hidden[chunk] = hidden_by_ellipsoids(cameras.centres, lines, posed.middle, posed.shape, counted)
    return np.swapaxes(hidden, 0, 1).reshape(len(cameras), frames, 2, count)


SPREAD = 0.7  # Factor on the hand prior's standard deviations. The prior is as wide as its widest source.
SLOWEST_HZ, FASTEST_HZ = 0.1, 0.7  # Range of motion frequencies in Hz. Gestures open or close a hand in half a second.
SHARES = tuple(np.linspace(1.0, 0.0, 11)[:-1].tolist())  # Fractions of a pose tried until no fingers intersect.
TOUCH_M = 0.002  # Largest overlap in metres of touching fingers that do not intersect.
EASE_S = 0.2  # Seconds to relax a hand before its fingers would intersect, and to return afterwards.
_WAVES = 4  # Number of waves per angle. Chosen by hand.


@dataclass(frozen=True)
class MovingHands:
    """Finger motion of both hands of a person over F frames, left hand first."""

    skeletons: tuple[HandSkeleton, HandSkeleton]
    angles: np.ndarray  # (F, 2, A) joint angles in radians.
    points: np.ndarray  # (F, 2, 21, 3) positions of ``HAND_POINTS`` in metres.

    def rotations(self) -> np.ndarray:
        """Return (F, 30, 3, 3) rotations of the finger joints in SMPL-H's order."""
        both = [by_joint(s.local_rotations(self.angles[:, side])) for side, s in enumerate(self.skeletons)]
        return np.concatenate(both, axis=1)


def move_hands(person: Person, fps: float, rng: np.random.Generator) -> MovingHands:
    """Create independent random finger motions for a person's hands.

    Raises:
        BodyInvalid: the body has no finger joints.
    """
    body, frames = with_fingers(person.body), len(person.transl)
    prior = load_hand_prior()
    skeletons = hand_of_shape(body, person.betas, 0), hand_of_shape(body, person.betas, 1)
    drawn = [_draw(prior, frames, fps, rng) for _ in SIDES]
    angles = np.stack([_apart(s, a, prior.mean, fps) for s, a in zip(skeletons, drawn, strict=True)], axis=1)
    return MovingHands(skeletons, angles, points_of_hands(person, skeletons, angles))


def points_of_hands(person: Person, skeletons: tuple[HandSkeleton, HandSkeleton], angles: np.ndarray) -> np.ndarray:
    """Return (F, 2, 21, 3) hand points in metres at a person's wrists, for joint angles (F, 2, A)."""
    posed = forward_kinematics(person.body, person.betas, person.orient, person.local, person.transl)
    found = []
    for side, skeleton in enumerate(skeletons):
        wrist = person.body.layout.joints.index(f"{SIDES[side]}_wrist")
        own = skeleton.sites(skeleton.pose(angles[:, side]), skeleton.keypoints())
        found.append(posed.joints[:, None, wrist] + (posed.G[:, None, wrist] @ own[..., None])[..., 0])
    return np.stack(found, axis=1)


def _draw(prior: HandPrior, frames: int, fps: float, rng: np.random.Generator) -> np.ndarray:
    """Draw random (F, A) finger angles: slow waves with the prior's covariance, within its ranges."""
    rate = rng.uniform(SLOWEST_HZ, FASTEST_HZ, (1, NUM_ANGLES, _WAVES))
    phase = rng.uniform(0.0, 1.0, rate.shape)
    waves = np.sin(2 * np.pi * (np.arange(frames)[:, None, None] / fps * rate + phase)).sum(-1) / np.sqrt(_WAVES / 2)
    drawn = prior.mean + SPREAD * waves @ np.linalg.cholesky(prior.covariance).T
    return np.clip(drawn, prior.low, prior.high)


def _apart(skeleton: HandSkeleton, angles: np.ndarray, relaxed: np.ndarray, fps: float) -> np.ndarray:
    """Move (F, A) finger angles towards a relaxed hand around frames in which fingers intersect."""
    need = np.ones(len(angles))
    for share in SHARES:
        mixed = relaxed + share * (angles - relaxed)
        deep = finger_overlap(skeleton.sites(skeleton.pose(mixed), skeleton.keypoints())) > TOUCH_M
        need = np.where(deep, np.minimum(need, share - SHARES[0] + SHARES[1]), need)
    half = max(1, round(EASE_S * fps))
    window = np.lib.stride_tricks.sliding_window_view(np.pad(need, 2 * half, mode="edge"), 2 * half + 1).min(axis=1)
    eased = np.convolve(window, np.hanning(2 * half + 3)[1:-1] / (half + 1.0), mode="valid")
    return relaxed + eased[:, None] * (angles - relaxed)


def skin_with_hands(person: Person, hands: MovingHands, frames: np.ndarray) -> np.ndarray:
    """Return the (n, V, 3) skin of a person with moving fingers in the given frames."""
    body = with_fingers(person.body)
    local = np.concatenate([person.local[frames], hands.rotations()[frames]], axis=1)
    return pose_mesh(body, person.betas, person.orient[frames], local, person.transl[frames])


def hidden_of(person: Person, cameras: Cameras, hands: MovingHands) -> np.ndarray:
    """Return a (C, F, 2, 21) mask of the hand points that the body or the hands occlude."""
    return hidden_points(person, cameras, hands.points) | hidden_by_hands(cameras.centres, hands.points)


def with_true_hands(capture: Capture, cameras: Cameras, hands: MovingHands, hidden: np.ndarray) -> Capture:
    """Add all hand points inside the images, and their ground truth, to a clean capture."""
    assert capture.keypoints is not None
    px = project(cameras, hands.points)
    found = np.concatenate([px, np.ones((*px.shape[:-1], 1))], axis=-1)
    found[~in_pictures(px, cameras.image_size)] = UNSEEN_POINT
    truth = {"hand_points": hands.points, "hand_angles": hands.angles, "hand_hidden": hidden}
    return replace(capture, keypoints=replace(capture.keypoints, hands=found), truth=capture.truth | truth)


def with_found_hands(
    capture: Capture, cameras: Cameras, hands: MovingHands, hidden: np.ndarray, fps: float, rng: np.random.Generator
) -> Capture:
    """Add detected hands to a perturbed capture. ``hidden`` comes from ``hidden_of``."""
    assert capture.keypoints is not None
    found = detect_hands(cameras, hands.points, hidden, fps, HandFaults(), rng)
    return replace(capture, keypoints=replace(capture.keypoints, hands=found))
