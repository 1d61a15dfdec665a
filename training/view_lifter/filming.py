"""Simulate one camera's detections for windows of recordings, from any side, height and distance, with all faults."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.lifter import POINTS, SIDES
from solver_backend.priors.view_lifter import MIDDLE, WINDOW, WINDOW_FPS
from solver_backend.types import NUM_BETAS, JointSet
from training.data.corpus import EXCHANGED_JOINTS, Corpus, mirrored
from training.data.points import rotation_points

SHAPES = 4  # Number of shape parameters that vary.
TILTED_COSINE = 0.7  # Smallest cosine of the angle between an upright pelvis and the vertical (45 degrees).
TILTED_REPEATS = 4  # How often each tilted pose is used, because tilted poses are rare.
INVERTED_COSINE = -0.3  # Largest cosine of the angle between an inverted pelvis and the vertical.
INVERTED_REPEATS = 20
"""How often each inverted pose is used, because there are only a few dozen frames of cartwheels and flips."""
RAISED_M = 0.05  # Smallest height of raised hands above the head. In inverted poses, they support the body.
RAISED_REPEATS = 2  # How often each pose with raised hands is used, because half of them are inverted.
_SUPPORTS = (*SMPL.both("ankle", "foot", "wrist", "knee"), *SMPL.numbers("pelvis"))
"""Joints that can support a body: ankles, toes, wrists, knees and pelvis."""
_BLOCK = 2048  # Poses processed together, which limits memory. Chosen by hand.


@dataclass(frozen=True)
class Recordings:
    """N frames of recordings, Y up, and the body points in each frame."""

    local: torch.Tensor  # (N, 21, 3, 3) local rotations.
    root: torch.Tensor  # (N, 3, 3) rotations from body to world.
    place: torch.Tensor  # (N, 3) pelvis positions in metres.
    points: torch.Tensor
    """(N, 19, 3, 1 + SHAPES) half precision: points relative to the pelvis, and how they change per shape parameter."""
    raised: torch.Tensor  # (N,) mask of upright poses with both hands above the head.
    clip_start: torch.Tensor  # (N,) first frame of the clip that each frame belongs to.
    clip_end: torch.Tensor  # (N,) end (exclusive) of the clip that each frame belongs to.
    centres: torch.Tensor  # (C,) centre frames of the windows.

    @classmethod
    def of(
        cls, corpus: Corpus, body: Body, exchanged: int, seed: int, device: torch.device = torch.device("cpu")
    ) -> Recordings:
        """Return the recordings in a corpus, and copies with exchanged limbs.

        Args:
            corpus: recordings. Clips with an unknown pelvis rotation are not used.
            body: body that defines the visible points.
            exchanged: number of copies.
            seed: seed of the exchange.
            device: device that computes and stores the recordings.
        """
        kept = np.isfinite(corpus.root).all(axis=(1, 2))
        number = np.cumsum(kept) - 1
        with device:
            local, root = torch.as_tensor(corpus.rotations[kept]), torch.as_tensor(corpus.root[kept])
            start, end = (
                torch.as_tensor(number[edge[kept]] + more)
                for edge, more in ((corpus.clip_start, 0), (corpus.clip_end - 1, 1))
            )
            centres = torch.as_tensor(number[corpus.distinct[kept[corpus.distinct]]])
            axis = root[centres, 1, 1]
            tilted, inverted = centres[axis < TILTED_COSINE], centres[axis < INVERTED_COSINE]
            centres = torch.cat([centres, tilted.repeat(TILTED_REPEATS - 1), inverted.repeat(INVERTED_REPEATS - 1)])
            generator, copies = torch.Generator().manual_seed(seed), [local]
            copies += [_with_limbs_of_others(local, start, end, generator) for _ in range(exchanged)]
            shifts = [len(local) * copy for copy in range(len(copies))]
            local, root = torch.cat(copies), torch.cat([root] * len(copies))
            start, end, centres = (torch.cat([part + shift for shift in shifts]) for part in (start, end, centres))
            place, raised = standing_place(local, root, start), _raised(local, root)
            centres = torch.cat([centres, centres[raised[centres]].repeat(RAISED_REPEATS - 1)])
            return cls(local, root, place, _points(body, local, root), raised, start, end, centres)


def standing_place(local: torch.Tensor, root: torch.Tensor, clip_start: torch.Tensor) -> torch.Tensor:
    """Return pelvis positions (N, 3) in metres such that the lowest joint does not move between frames."""
    blocks = zip(local.split(_BLOCK), root.split(_BLOCK), strict=True)
    joints = torch.cat([torch.matmul(rotation_points(part)[:, :NUM_JOINTS], turn.mT) for part, turn in blocks])
    joints = joints - joints[:, :1]
    supports = joints[:, list(_SUPPORTS)]
    lowest = supports[..., 1].argmin(dim=1)
    row = torch.arange(len(joints))
    here = supports[row, lowest]
    before = torch.cat([supports[:1, lowest[0]], supports[row[:-1], lowest[1:]]])
    moved = before - here
    first = clip_start == row
    moved[first] = 0.0
    place = moved.double().cumsum(dim=0)
    place = (place - place[clip_start]).float()
    place[:, 1] = -here[:, 1]
    return place


def _raised(local: torch.Tensor, root: torch.Tensor) -> torch.Tensor:
    """Return a mask (N,) of upright people with both hands above the head."""
    (head,), hands = SMPL.numbers("head"), list(SMPL.both("wrist"))
    above = []
    for part, turn in zip(local.split(_BLOCK), root.split(_BLOCK), strict=True):
        height = torch.matmul(rotation_points(part)[:, :NUM_JOINTS], turn.mT)[..., 1]
        above.append((height[:, hands] > height[:, head, None] + RAISED_M).all(dim=1))
    return torch.cat(above) & (root[:, 1, 1] > TILTED_COSINE)


def mirrored_points(points: torch.Tensor) -> torch.Tensor:
    """Return points (..., 19, 3, k) with left and right exchanged and x negated."""
    swap = [POINTS.index(_other_side(name)) for name in POINTS]
    return points[..., swap, :, :] * points.new_tensor((-1.0, 1.0, 1.0))[:, None]


def _other_side(name: str) -> str:
    side, _, part = name.partition("_")
    return {"left": f"right_{part}", "right": f"left_{part}"}.get(side, name)


def _points(body: Body, local: torch.Tensor, root: torch.Tensor) -> torch.Tensor:
    """Return points (N, 19, 3, 1 + SHAPES) relative to the pelvis: mean shape, then changes per shape parameter."""
    landmarks = keypoint_landmarks(body, JointSet.BODY_25B)
    columns = [landmarks.names.index(name) for name in POINTS]
    out = torch.empty((len(local), len(POINTS), 3, 1 + SHAPES), dtype=torch.float16)
    for first in range(0, len(local), _BLOCK):
        part = slice(first, first + _BLOCK)
        origin = torch.zeros(len(local[part]), 3)
        for shape in range(1 + SHAPES):
            betas = torch.zeros(NUM_BETAS)
            if shape:
                betas[shape - 1] = 1.0
            posed = pose_landmarks(body, landmarks, betas, root[part], local[part], origin)
            about = posed.points[:, columns] - posed.skeleton.joints[:, :1]
            out[part, ..., shape] = (about - out[part, ..., 0].float() if shape else about).half()
    return out


def _with_limbs_of_others(
    local: torch.Tensor, start: torch.Tensor, end: torch.Tensor, generator: torch.Generator
) -> torch.Tensor:
    """Replace limbs in recordings (N, 21, 3, 3) by limbs of other clips. Half of these are mirrored."""
    out = local.clone()
    for first in start.unique().tolist():
        length = int(end[first]) - first
        for limb in EXCHANGED_JOINTS:
            if torch.rand((), generator=generator, device="cpu") > 0.3:
                continue
            donor = int(torch.randint(max(1, len(local) - length), (), generator=generator, device="cpu"))
            donor = min(donor, max(0, int(end[donor]) - length))
            theirs = local[donor : donor + length]
            if torch.rand((), generator=generator, device="cpu") < 0.5:
                theirs = mirrored(theirs)
            columns = [joint - 1 for joint in limb]
            out[first : first + length, columns] = theirs[:, columns]
    return out


DISTANCE_M = (1.8, 12.0)  # Range of the distance between camera and pelvis, uniform in the logarithm.
PITCH_DEG = (6.0, 11.0)  # Mean and standard deviation of the angle at which a camera looks down.
STEEP = 0.2  # Fraction of cameras that look from 25 degrees below to 65 degrees above.
ROLL_DEG = 12.0  # Standard deviation of the camera's roll, as for hand-held telephones.
TUMBLED = 0.15
"""Fraction of windows with a rotation about a level axis by up to 180 degrees (somersaults, handstands)."""
TURNED_OVER = 0.5  # Fraction of windows with raised hands that are inverted, so that the person stands on the hands.
TURNED_OVER_DEG = 60.0  # Largest angle between an inverted person and the vertical.
TURNING_DEG_S = 360.0  # Largest rotation rate of inverted people. Half of them do not rotate.
OFF_AXIS = 0.45  # Largest distance between the person and the principal point, in focal lengths.
NOISE_M = (0.004, 0.03)  # Range of a point's noise per axis, measured at the person's distance.
BIAS_M = 0.018  # Standard deviation of a point's bias per axis. The bias hardly changes in a window.
THROWN = 0.03  # Fraction of points that are outliers.
KNOWN_UP = 0.5  # Fraction of windows whose up direction is known.
UP_DEG = 1.5  # Error of the up direction per axis.
CUT = 0.12  # Fraction of windows with a person who is partly outside the picture.
LOST = 0.25  # Fraction of windows with points that are missing for a time.
EXCHANGED = 0.06  # Fraction of windows with left and right limbs exchanged for a time.
SHORT = 0.08  # Fraction of windows that are at the end of a take.
FLAT = 0.1  # Fraction of windows without confidences. All visible points then have 1.
_OTHER = {"left": "right", "right": "left"}
_SWAPPED = [POINTS.index("_".join([_OTHER.get(n.split("_")[0], n.split("_")[0]), *n.split("_")[1:]])) for n in POINTS]
_LOST_TOGETHER = (
    ("elbow", "wrist"),
    ("knee", "ankle", "big_toe", "heel"),
    ("wrist",),
    ("ankle", "big_toe", "heel"),
    ("ear",),
    ("big_toe", "heel"),
)
_GROUPS = [
    [name in [f"{side}_{part}" for part in parts] for name in POINTS] for side in SIDES for parts in _LOST_TOGETHER
]
_TRUNK = (0, 1, 2, 3)
_LIMBS = tuple(
    (POINTS.index(f"{side}_{first}"), POINTS.index(f"{side}_{last}"), radius)
    for side in SIDES
    for first, last, radius in (("hip", "knee", 0.07), ("shoulder", "elbow", 0.05))
)
_OWN = [[point in part for point in range(len(POINTS))] for part in (_TRUNK, *((a, b) for a, b, _ in _LIMBS))]
TRUNK_M, BEHIND_M = 0.14, 0.1
"""Half the width of the trunk, and the smallest distance of a hidden point behind the body part, in metres."""
_TOES = [POINTS.index(f"{side}_{part}") for side in SIDES for part in ("big_toe", "heel")]
NO_TOES = 0.2
"""Fraction of windows that come from detectors without toes and heels."""


@dataclass(frozen=True)
class FilmedWindows:
    """B windows of detections, and the truth in the middle frame."""

    points: torch.Tensor  # (B, 27, 19, 2) image points, in focal lengths from the principal point.
    confidence: torch.Tensor  # (B, 27, 19) confidences.
    up: torch.Tensor  # (B, 3) up direction in the camera's axes, or zero if unknown.
    local: torch.Tensor  # (B, 21, 3, 3) local rotations in the middle frame.
    root: torch.Tensor  # (B, 3, 3) rotations from body to camera.
    true_up: torch.Tensor  # (B, 3) true up direction in the camera's axes.

    def to(self, device: torch.device) -> FilmedWindows:
        """Move the windows to a device."""
        return FilmedWindows(*(getattr(self, part.name).to(device) for part in fields(self)))


def film(recordings: Recordings, centres: torch.Tensor, generator: torch.Generator) -> FilmedWindows:
    """Film windows around the frames ``centres`` (B,), each with a random camera, on the recordings' device."""
    with recordings.points.device:
        return _filmed(recordings, centres, generator)


def _filmed(recordings: Recordings, centres: torch.Tensor, generator: torch.Generator) -> FilmedWindows:
    count = len(centres)
    frames = centres[:, None] + torch.arange(WINDOW) - MIDDLE
    start, end = recordings.clip_start[centres, None], recordings.clip_end[centres, None]
    inside = (frames >= start) & (frames < end)
    chosen = torch.minimum(torch.maximum(frames, start), end - 1)
    shape = torch.cat([torch.ones(count, 1), torch.randn(count, SHAPES, generator=generator)], dim=1)
    points = recordings.points[chosen].float()
    place = recordings.place[chosen] - recordings.place[centres][:, None]
    local, root = recordings.local[centres], recordings.root[centres]
    flip = torch.rand(count, generator=generator) < 0.5
    side = torch.tensor((-1.0, 1.0, 1.0))
    points = torch.where(flip[:, None, None, None, None], mirrored_points(points), points)
    place = torch.where(flip[:, None, None], place * side, place)
    local = torch.where(flip[:, None, None, None], mirrored(local), local)
    root = torch.where(flip[:, None, None], side[:, None] * root * side, root)
    points = torch.matmul(points.flatten(1, 3), shape[:, :, None]).unflatten(1, points.shape[1:4])[..., 0]
    tumble = _tumbles(recordings.raised[centres], generator)
    points = torch.matmul(points, tumble.mT) + place[:, :, None]
    root = torch.matmul(tumble[:, MIDDLE], root)
    turn, up = _cameras(count, generator)
    distance = _log_uniform(DISTANCE_M, (count,), generator)
    aside = OFF_AXIS * (2.0 * torch.rand(count, 2, generator=generator) - 1.0)
    origin = distance[:, None] * torch.cat([aside, torch.ones(count, 1)], dim=1)
    seen = torch.matmul(points.flatten(1, 2), turn.mT).unflatten(1, points.shape[1:3]) + origin[:, None, None]
    depth = seen[..., 2].clamp_min(0.4)
    image = seen[..., :2] / depth[..., None]
    image, confidence = _detected(image, seen[..., 2], distance, inside, generator)
    shaken = torch.matmul(exp_so3(torch.deg2rad(UP_DEG * torch.randn(count, 3, generator=generator))), up[..., None])[
        ..., 0
    ]
    known = torch.rand(count, 1, generator=generator) < KNOWN_UP
    return FilmedWindows(
        image, confidence, torch.where(known, shaken, torch.zeros_like(up)), local, torch.matmul(turn, root), up
    )


def _tumbles(raised: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Return rotations (B, 27, 3, 3) about horizontal axes. Most windows have none. In some, the angle changes."""
    count = len(raised)
    heading, turn, chance, rate, turning = torch.rand(5, count, generator=generator)
    over = raised & (chance < TURNED_OVER)
    start = torch.where(
        over, torch.pi + TURNED_OVER_DEG * torch.pi / 180.0 * (2.0 * turn - 1.0), torch.pi * (2.0 * turn - 1.0)
    )
    rate = torch.where(turning < 0.5, TURNING_DEG_S * torch.pi / 180.0 * (2.0 * rate - 1.0), torch.zeros(count))
    seconds = (torch.arange(WINDOW) - MIDDLE) / WINDOW_FPS
    angle = start[:, None] + rate[:, None] * seconds
    angle = torch.where((over | (chance > 1.0 - TUMBLED))[:, None], angle, torch.zeros_like(angle))
    heading = 2.0 * torch.pi * heading
    axis = torch.stack([torch.cos(heading), torch.zeros(count), torch.sin(heading)], dim=1)
    return exp_so3(angle[..., None] * axis[:, None])


def _cameras(count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Return rotations (B, 3, 3) from the world (Y up) to cameras, and up directions (B, 3) in the cameras' axes."""
    yaw = 2.0 * torch.pi * torch.rand(count, generator=generator)
    mean, spread = PITCH_DEG
    pitch = mean + spread * torch.randn(count, generator=generator)
    steep = torch.rand(count, generator=generator) < STEEP
    pitch = torch.where(steep, -25.0 + 90.0 * torch.rand(count, generator=generator), pitch)
    roll = ROLL_DEG * torch.randn(count, generator=generator)
    zero = torch.zeros(count)
    turns = [
        exp_so3(torch.stack(axis, dim=1))
        for axis in ((zero, zero, torch.deg2rad(roll)), (torch.deg2rad(pitch), zero, zero), (zero, yaw, zero))
    ]
    opencv = torch.diag(torch.tensor((1.0, -1.0, -1.0)))
    turn = torch.matmul(turns[0], torch.matmul(opencv, torch.matmul(turns[1], turns[2])))
    return turn, turn[:, :, 1]


def _detected(
    image: torch.Tensor,
    depth: torch.Tensor,
    distance: torch.Tensor,
    inside: torch.Tensor,
    generator: torch.Generator,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return image points (B, 27, 19, 2) of a simulated detector, and their confidences."""
    count, metre = len(image), (1.0 / distance)[:, None, None]
    noise = _log_uniform(NOISE_M, (count, 1, 1), generator)
    behind = _behind_body(image, depth, distance)
    spread = noise * torch.where(behind, 3.0, 1.0)
    drift, steady = (torch.randn(count, 1, len(POINTS), 2, generator=generator) for _ in range(2))
    bias = BIAS_M * (steady + 0.5 * torch.linspace(-1.0, 1.0, WINDOW)[:, None, None] * drift)
    thrown = torch.rand(count, WINDOW, len(POINTS), generator=generator) < THROWN
    far = torch.where(thrown, 0.25, 0.0)[..., None] * torch.randn(image.shape, generator=generator)
    # Errors of a detector are smooth. Half of the noise is constant over three frames.
    white = torch.randn(image.shape, generator=generator)
    smooth = torch.nn.functional.avg_pool1d(white.permute(0, 2, 3, 1).flatten(0, 2)[:, None], 3, 1, 1)[:, 0]
    smooth = 1.7 * smooth.unflatten(0, (count, len(POINTS), 2)).permute(0, 3, 1, 2)
    error = spread[..., None] * 0.7 * (white + smooth) + bias + far
    image = _exchanged(image, generator) + error * metre[..., None]
    doubtful = behind | thrown
    sure = 1.0 - 0.45 * torch.rand(count, WINDOW, len(POINTS), generator=generator)
    unsure = 0.05 + 0.7 * torch.rand(count, WINDOW, len(POINTS), generator=generator)
    confidence = torch.where(doubtful, unsure, sure)
    flat = torch.rand(count, 1, 1, generator=generator) < FLAT
    confidence = torch.where(flat, torch.ones_like(confidence), confidence)
    lost = _lost(image, behind, generator)
    return image, torch.where(inside[..., None] & ~lost, confidence, torch.zeros_like(confidence))


def _behind_body(image: torch.Tensor, depth: torch.Tensor, distance: torch.Tensor) -> torch.Tensor:
    """Return a mask (B, 27, 19) of points behind the trunk, a thigh or an upper arm, and close to its axis."""
    first, last = (torch.tensor(ends) for ends in zip(*((a, b) for a, b, _ in _LIMBS), strict=True))
    start = torch.cat([image[:, :, 0:2].mean(2, keepdim=True), image[:, :, first]], dim=2)
    end = torch.cat([image[:, :, 2:4].mean(2, keepdim=True), image[:, :, last]], dim=2)
    middle = torch.cat([depth[:, :, :4].mean(2, keepdim=True), 0.5 * (depth[:, :, first] + depth[:, :, last])], dim=2)
    axis = (end - start)[:, :, :, None]
    apart = image[:, :, None] - start[:, :, :, None]
    along = (apart * axis).sum(-1) / (axis * axis).sum(-1).clamp_min(1e-8)
    aside = torch.linalg.vector_norm(apart - along.clamp(0.0, 1.0)[..., None] * axis, dim=-1)
    near = (
        aside * distance[:, None, None, None] < torch.tensor([TRUNK_M, *(radius for _, _, radius in _LIMBS)])[:, None]
    )
    behind = near & (depth[:, :, None] > middle[..., None] + BEHIND_M) & ~torch.tensor(_OWN)
    return behind.any(dim=2)


def _exchanged(image: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Exchange left and right legs or arms in some windows for a range of frames."""
    count = len(image)
    chosen = (torch.rand(count, 1, 1, generator=generator) < EXCHANGED) & _for_a_time(count, generator)[..., None]
    legs = torch.rand(count, 1, 1, generator=generator) < 0.5
    leg = torch.tensor([any(part in name for part in ("knee", "ankle", "toe", "heel")) for name in POINTS])
    arm = torch.tensor([any(part in name for part in ("elbow", "wrist")) for name in POINTS])
    swap = chosen & torch.where(legs, leg, arm)
    return torch.where(swap[..., None], image[:, :, _SWAPPED], image)


def _lost(image: torch.Tensor, behind: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Return a mask (B, 27, 19) of the points that the detector misses."""
    count = len(image)
    lost = torch.rand(behind.shape, generator=generator) < torch.where(behind, 0.35, 0.01)
    gone = (torch.rand(count, len(_GROUPS), generator=generator) < 0.2).float()
    groups = torch.matmul(gone, torch.tensor(_GROUPS, dtype=torch.float32))[:, None] > 0
    some = torch.rand(count, 1, 1, generator=generator) < LOST
    lost |= some & groups & _for_a_time(count, generator)[..., None]
    no_toes = torch.rand(count, 1, generator=generator) < NO_TOES
    lost[:, :, _TOES] |= no_toes[:, None]
    short = torch.rand(count, 1, generator=generator) < SHORT
    edge = torch.randint(WINDOW, (count, 1), generator=generator)
    frame = torch.arange(WINDOW)
    outside = torch.where(edge > MIDDLE, frame > edge, frame < edge.clamp_max(MIDDLE))
    lost |= (short & outside)[..., None]
    return lost | _cut(image, generator)


def _cut(image: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Return a mask (B, 27, 19) of points outside the image. In some windows, an image edge cuts off the person."""
    count = len(image)
    angle = torch.where(
        torch.rand(count, generator=generator) < 0.6,
        torch.full((count,), 0.5 * torch.pi),
        2.0 * torch.pi * torch.rand(count, generator=generator),
    )
    along = image[..., 0] * torch.cos(angle)[:, None, None] + image[..., 1] * torch.sin(angle)[:, None, None]
    middle = along[:, MIDDLE]
    low, high = middle.min(dim=1).values, middle.max(dim=1).values
    edge = low + (0.45 + 0.55 * torch.rand(count, generator=generator)) * (high - low)
    cut = torch.rand(count, generator=generator) < CUT
    return cut[:, None, None] & (along > edge[:, None, None])


def _for_a_time(count: int, generator: torch.Generator) -> torch.Tensor:
    """Return a mask (B, 27) of a range of frames or of all frames."""
    first, last = (torch.randint(-WINDOW, 2 * WINDOW, (count, 1), generator=generator) for _ in range(2))
    frame = torch.arange(WINDOW)
    return (frame >= torch.minimum(first, last)) & (frame <= torch.maximum(first, last))


def _log_uniform(bounds: tuple[float, float], shape: tuple[int, ...], generator: torch.Generator) -> torch.Tensor:
    low, high = bounds
    return low * (high / low) ** torch.rand(shape, generator=generator)
