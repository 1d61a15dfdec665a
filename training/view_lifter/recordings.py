"""Recordings as points in space, formed once: what a window of them looks like is then a few products."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.priors.lifter import POINTS
from solver_backend.types import NUM_BETAS, JointSet
from training.data.augmentation import EXCHANGED_JOINTS, mirrored
from training.data.corpus import Corpus
from training.data.points import rotation_points

SHAPES = 4
"""Shape parameters that people differ by."""
TILTED_COSINE = 0.7
"""A pelvis whose axis is further from vertical (45 degrees) lies, crawls or turns over."""
TILTED_REPEATS = 4
"""How often each such pose counts: they are few, and a take on the floor has nothing else."""
INVERTED_COSINE = -0.3
"""A pelvis whose axis points further down than this is upside down."""
INVERTED_REPEATS = 20
"""How often each such pose counts: a few dozen frames of cartwheels and flips are all that is recorded."""
RAISED_M = 0.05
"""Hands that are so far above the head carry the body when it is turned over."""
RAISED_REPEATS = 2
"""How often each such pose counts, since half of them are turned over."""
_SUPPORTS = (*SMPL.both("ankle", "foot", "wrist", "knee"), *SMPL.numbers("pelvis"))
"""Joints that a body may stand on: ankles, toes, wrists, knees, pelvis."""
_BLOCK = 2048
"""Poses that are placed at a time, which bounds memory; chosen by hand."""


@dataclass(frozen=True)
class Recordings:
    """N frames of recordings, Y up."""

    local: torch.Tensor
    """(N, 21, 3, 3)."""
    root: torch.Tensor
    """(N, 3, 3) body to world."""
    place: torch.Tensor
    """(N, 3) pelvis, metres."""
    points: torch.Tensor
    """(N, 19, 3, 1 + SHAPES) half precision: points about the pelvis, and their change by each shape parameter."""
    raised: torch.Tensor
    """(N,) bool: upright, both hands above the head."""
    clip_start: torch.Tensor
    """(N,) first frame of each frame's clip."""
    clip_end: torch.Tensor
    """(N,) one past its last frame."""
    centres: torch.Tensor
    """(C,) frames that windows are drawn about."""

    @classmethod
    def of(
        cls, corpus: Corpus, body: Body, exchanged: int, seed: int, device: torch.device = torch.device("cpu")
    ) -> Recordings:  # fmt: skip
        """Return the recordings of a corpus, and copies of them with limbs of one another.

        Args:
            corpus: recordings; those that did not keep the pelvis' rotation are left out.
            body: whose points are seen.
            exchanged: number of copies.
            seed: of the exchange.
            device: where they are formed and stay.
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
    """Return the (N, 3) place of the pelvis of people whose lowest joint stays where it is from frame to frame."""
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
    """Return (N,) bool, which people stand upright with both hands above the head."""
    (head,), hands = SMPL.numbers("head"), list(SMPL.both("wrist"))
    above = []
    for part, turn in zip(local.split(_BLOCK), root.split(_BLOCK), strict=True):
        height = torch.matmul(rotation_points(part)[:, :NUM_JOINTS], turn.mT)[..., 1]
        above.append((height[:, hands] > height[:, head, None] + RAISED_M).all(dim=1))
    return torch.cat(above) & (root[:, 1, 1] > TILTED_COSINE)


def mirrored_points(points: torch.Tensor) -> torch.Tensor:
    """Return (..., 19, 3, k) points with left and right exchanged, x negated."""
    swap = [POINTS.index(_other_side(name)) for name in POINTS]
    return points[..., swap, :, :] * points.new_tensor((-1.0, 1.0, 1.0))[:, None]


def _other_side(name: str) -> str:
    side, _, part = name.partition("_")
    return {"left": f"right_{part}", "right": f"left_{part}"}.get(side, name)


def _points(body: Body, local: torch.Tensor, root: torch.Tensor) -> torch.Tensor:
    """Return (N, 19, 3, 1 + SHAPES) half precision points about the pelvis."""
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
) -> torch.Tensor:  # fmt: skip
    """Return (N, 21, 3, 3) recordings of which each clip has limbs of other clips, perhaps of the other side's."""
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
