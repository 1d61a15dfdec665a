"""Table of poses with pelvis rotation for training and evaluating landmark networks, stored in one file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import NonFiniteData
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.exchange.npz import read_npz, write_npz
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.base import AutoencodingPrior
from training.data.balance import (
    CodeStatistics,
    exponential_relevance,
    reconstruction_error,
    sample_tail,
    sigmoid_relevance,
)
from training.data.corpus import HELD_OUT, NEAR_REPEAT_M, absent_subjects, check_sides, distinct_poses
from training.data.points import rotation_points
from training.data.sources.clips import FAR, Clip
from training.landmarks.cloud_stream import Clouds, CloudStream

GROUPS: tuple[str, ...] = ("crossed legs", "crossed arms", "kicks", "crouching")
CROSSED_M = 0.06
"""Smallest overlap in metres of crossed ankles or wrists, along the line through hips or shoulders."""
KICK_M = -0.25  # Smallest height of a kicking ankle, relative to the pelvis.
CROUCH_M = 0.5  # Largest height of the pelvis above the lower ankle in a crouch, for legs of 0.78 m.
LEANING_DEG = 55.0  # Largest lean of the trunk of a person who is neither on the floor nor in the air.
_PAIR = {part: SMPL.both(part) for part in ("hip", "ankle", "shoulder", "wrist")}
"""Left and right joint of each body part."""
(_CHEST,) = SMPL.numbers("spine3")


def groups_of(rotations: np.ndarray) -> np.ndarray:
    """Return a mask (N, 4) of the poses (N, 22, 3, 3) in each group of ``GROUPS``. Pelvis first, Y up."""
    joints = _joints(rotations)
    upright = _lean_deg(rotations) < LEANING_DEG
    ankles = joints[:, _PAIR["ankle"], 1]
    height = joints[:, 0, 1] - ankles.min(1)
    legs = _order(joints, "hip", "ankle") < -CROSSED_M
    wrists = joints[:, _PAIR["wrist"]]
    chest = joints[:, _CHEST]
    near = (np.linalg.norm(wrists - chest[:, None], axis=-1) < 0.42).all(1)
    arms = (_order(joints, "shoulder", "wrist") < -CROSSED_M) & near
    foot = ankles.max(1) - joints[:, 0, 1]
    kick = (foot > KICK_M) & (height > CROUCH_M)
    crouch = height < CROUCH_M
    return np.stack([legs, arms, kick, crouch], axis=1) & upright[:, None]


def on_the_floor(rotations: np.ndarray) -> np.ndarray:
    """Return a mask (N,) of people who lie, or who kneel so far forward that their hands reach the floor."""
    joints = _joints(rotations)
    return (_lean_deg(rotations) >= LEANING_DEG) | (np.ptp(joints[:, :, 1], axis=1) < 0.85)


def _joints(rotations: np.ndarray) -> np.ndarray:
    """Return joints (N, 24, 3) relative to the pelvis in metres, along the axes of the world."""
    joints = rotation_points(rotations[:, 1:].astype(np.float32))[:, :NUM_JOINTS]
    return np.einsum("nij,nkj->nki", rotations[:, 0].astype(np.float32), joints)


def _lean_deg(rotations: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(rotations[:, 0, 1, 1], -1.0, 1.0)))


def _order(joints: np.ndarray, base: str, end: str) -> np.ndarray:
    """Return how far the left ``end`` is to the left of the right ``end`` in metres, along hips or shoulders."""
    (left, right), (left_end, right_end) = _PAIR[base], _PAIR[end]
    across = joints[:, left] - joints[:, right]
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return ((joints[:, left_end] - joints[:, right_end]) * across).sum(-1)


HELD_TAKES = ("asfamc/02_01", "asfamc/135_02", "mb2/02_01", "jump/140_", "keyed/Fixing_Kneeling", "keyed/Death01")
"""Takes to exclude in addition to the held-out subjects: takes for evaluating labels, and floor poses."""
SAMPLERS = ("random", "lerp", "slerp", "squad", "bezier", "bspline")
TAIL_SHARE = 0.03
"""Fraction of the training poses that are anchors: those with the largest Mahalanobis distances."""
SAMPLED = 8000  # Number of poses drawn by each sampling operator.
_ORDINARY, _TAIL = 3000, 1500


@dataclass(frozen=True)
class PoseTable:
    """Named sets of poses as rotation vectors (N, 22, 3), pelvis first, Y up, and further data of the training poses.

    ``absent`` lists the held-out subjects that are missing in the recordings.
    """

    arrays: Mapping[str, np.ndarray]

    @classmethod
    def read(cls, path: Path) -> PoseTable:
        """Read a pose table from a file.

        Raises:
            FileMissing, FileDamaged: the file is missing or damaged.
        """
        return cls(read_npz(path))

    def write(self, path: Path) -> None:
        """Write the pose table to a file."""
        write_npz(path, dict(self.arrays), overwrite=True)

    def poses(self, name: str) -> np.ndarray:
        """Return float32 rotation vectors (N, 22, 3) of the set ``name``: recorded poses, or poses of a sampler."""
        return self.arrays[name].astype(np.float32)

    def check_finite(self) -> None:
        """Check that all poses in the table are finite.

        Raises:
            NonFiniteData: rotation vectors are NaN or infinite.
        """
        for name, array in self.arrays.items():
            if array.ndim == 3 and not (sound := np.isfinite(array).all(axis=(1, 2))).all():
                raise NonFiniteData(
                    f"{(~sound).sum()} of {len(sound)} {name} poses of the table are not numbers.",
                    hint="Make the table again from the recordings (--data FOLDER).",
                )


def pose_table(clips: Iterable[Clip], far: Iterable[Clip], prior: AutoencodingPrior, seed: int = 0) -> PoseTable:
    """Make the pose table from all clips that include the pelvis' rotation.

    Anchors (the rarest poses, by Mahalanobis distance of their codes) are not in training or validation.

    Args:
        clips: clips returned by ``load_clips``.
        far: motions that differ from the corpus. Only their rare poses are used, for evaluation.
        prior: autoencoder that measures the rarity of poses (RVPoser).
        seed: seed of all draws.
    """
    rooted = [clip for clip in clips if clip.root is not None]
    held = [clip for clip in rooted if clip.subject in HELD_OUT or clip.name.startswith(HELD_TAKES)]
    kept = [clip for clip in rooted if clip.subject not in HELD_OUT and not clip.name.startswith(HELD_TAKES)]
    check_sides(kept, held)
    training = _distinct(kept)
    arrays: dict[str, np.ndarray] = {}
    local = training[:, 1:]
    codes = np.concatenate([np.asarray(prior.encode(part)) for part in _parts(local)])
    decoded = np.concatenate([np.asarray(prior.decode(part)) for part in _parts(codes)])
    distance = CodeStatistics.of(codes).mahalanobis(codes)
    error = reconstruction_error(*(rotation_points(R.astype(np.float32))[:, :NUM_JOINTS] for R in (local, decoded)))
    anchor = distance > np.quantile(distance, 1.0 - TAIL_SHARE)
    rng = np.random.default_rng(seed)
    for name in SAMPLERS:
        z = _sampled(codes[anchor], codes, name, seed)
        roots = training[anchor][rng.integers(int(anchor.sum()), size=len(z)), :1]
        arrays[name] = _packed(np.concatenate([roots, np.asarray(prior.decode(z))], axis=1))
    arrays |= {
        "training": _packed(training[~anchor]),
        "mahalanobis": distance[~anchor].astype(np.float32),
        "reconstruction": error[~anchor].astype(np.float32),
    }
    arrays["absent"] = np.array(absent_subjects(held), dtype=np.str_)
    return PoseTable(arrays | held_out_poses(held, list(far), rng))


def held_out_poses(held: list[Clip], far: list[Clip], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return poses of held-out takes: ``ordinary``, ``floor``, and ``tail`` with its groups. Frames are listed too."""
    rotations, names, frames = _laid_out([*held, *far])
    tail = groups_of(rotations)
    lying = on_the_floor(rotations) & ~np.char.startswith(names, f"{FAR}/")
    plain = np.flatnonzero(~tail.any(1) & ~lying & ~np.char.startswith(names, f"{FAR}/"))
    rows: list[np.ndarray] = []
    for group in range(len(GROUPS)):
        mine = np.flatnonzero(tail[:, group] & ~lying)
        rows.append(_spread_out(rotations, mine, _TAIL // len(GROUPS), rng))
    chosen = np.concatenate(rows)
    floor = _spread_out(rotations, np.flatnonzero(lying), _TAIL, rng)
    ordinary = _spread_out(rotations, plain, _ORDINARY, rng)
    return {
        "tail": _packed(rotations[chosen]),
        "tail_group": np.repeat(np.arange(len(GROUPS)), [len(r) for r in rows]),
        "tail_frames": np.array([f"{names[i]}:{frames[i]}" for i in chosen]),
        "floor": _packed(rotations[floor]),
        "ordinary": _packed(rotations[ordinary]),
        "floor_frames": np.array([f"{names[i]}:{frames[i]}" for i in floor]),
    }


def _sampled(anchors: np.ndarray, codes: np.ndarray, name: str, seed: int) -> np.ndarray:
    """Return codes drawn by a sampling operator. ``random`` draws from the Gaussian of all codes."""
    if name != "random":
        return sample_tail(anchors, SAMPLED, seed, blend=name)  # pyrefly: ignore[bad-argument-type]
    rng = np.random.default_rng(seed)
    return rng.multivariate_normal(codes.mean(axis=0), np.cov(codes, rowvar=False), SAMPLED)


def _laid_out(clips: list[Clip]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the concatenated rotations (N, 22, 3, 3), the clip names and the frame numbers."""
    rotations = np.concatenate([_rooted(clip) for clip in clips])
    names = np.repeat([clip.name for clip in clips], [len(clip.rotations) for clip in clips])
    return rotations, names, np.concatenate([np.arange(len(clip.rotations)) for clip in clips])


def _rooted(clip: Clip) -> np.ndarray:
    assert clip.root is not None
    return np.concatenate([clip.root[:, None], clip.rotations], axis=1)


def _distinct(clips: list[Clip]) -> np.ndarray:
    """Return the rotations of poses without near-duplicates. The heading of the pelvis is ignored."""
    rotations, _, _ = _laid_out(clips)
    points = rotation_points(rotations[:, 1:])[:, 1:NUM_JOINTS]
    features = points.reshape(len(points), -1) / np.sqrt(NUM_JOINTS - 1.0)
    # Here the lean of the pelvis is part of the pose, but its heading is not.
    features = np.concatenate([features, 0.1 * rotations[:, 0, 1]], axis=1)
    return rotations[np.sort(distinct_poses(features.astype(np.float32), NEAR_REPEAT_M))]


def _spread_out(rotations: np.ndarray, rows: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """Draw up to ``most`` of the given rows of poses, without near-duplicates."""
    if not len(rows):
        return rows
    features = rotation_points(rotations[rows, 1:])[:, 1:NUM_JOINTS].reshape(len(rows), -1) / np.sqrt(NUM_JOINTS - 1.0)
    rows = rows[np.sort(distinct_poses(features.astype(np.float32), 2 * NEAR_REPEAT_M))]
    return np.sort(rng.permutation(rows)[:most])


def _packed(rotations: np.ndarray) -> np.ndarray:
    return log_so3(rotations.astype(np.float64)).astype(np.float16)


def _parts(array: np.ndarray, size: int = 8192) -> list[np.ndarray]:
    return [array[i : i + size].astype(np.float64) for i in range(0, len(array), size)]


RELEVANCE = {"e(R)": "reconstruction", "σ(R)": "reconstruction", "e(D)": "mahalanobis", "σ(D)": "mahalanobis"}
"""Rarity measure that each kind of relevance is based on."""
FADES = (0.45, 0.75)
"""Completed fractions of a training: the balance starts to fade out at the first, and has ended at the second."""
EXPONENTIAL_SCALE = 1.5
"""φ of the exponential kernel relative to the median error, so that not every pose reaches the limit. The sigmoid uses
1 instead."""

Draw = Callable[[torch.Tensor], Clouds]  # Draws a batch, given the completed fraction of the training.


@dataclass(frozen=True)
class Balance:
    """Settings that balance the training towards rare poses. By default it is not balanced."""

    relevance: str = ""  # One of ``RELEVANCE``, or "" for none.
    sampler: str = ""  # One of ``SAMPLERS``, or "" for none.
    blended: float = 0.25
    """Blended poses that are added to a batch per recorded pose. No recorded pose is removed."""
    fades: bool = False
    """Remove the balance late in training, when rare poses have been learned, to improve ordinary poses."""


def relevance_of(table: PoseTable, kind: str) -> np.ndarray:
    """Return the relevance (N,) of the training poses, which is larger for rare poses."""
    error = table.arrays[RELEVANCE[kind]].astype(np.float64)
    median = float(np.median(error))
    if kind.startswith("e"):
        return exponential_relevance(error, EXPONENTIAL_SCALE * median)
    return sigmoid_relevance(error, median)


def drawer(stream: CloudStream, table: PoseTable, batch: int, balance: Balance = Balance()) -> Draw:
    """Return a function that draws a batch of clouds on the stream's device, given the completed training fraction.

    Args:
        stream: stream that makes clouds from poses.
        table: recorded poses, and poses blended by the operators.
        batch: number of recorded poses in a batch. Blended poses are added.
        balance: weighting of the poses, and poses to add.
    """
    device = stream.device
    recorded = torch.as_tensor(table.poses("training"), device=device)
    weight = torch.ones(len(recorded), device=device)
    if balance.relevance:
        weight = torch.as_tensor(relevance_of(table, balance.relevance), dtype=torch.float32, device=device)
    drawn = round(balance.blended * batch) if balance.sampler else 0
    rare = torch.as_tensor(table.poses(balance.sampler), device=device) if balance.sampler else recorded[:1]
    # Blended anchors get the weight of the rarest recorded poses.
    rare_weight = torch.quantile(weight[:: max(1, len(weight) // 10000)], 0.99).expand(drawn).clone()

    added = torch.arange(batch + drawn, device=device) >= batch

    def draw(done: torch.Tensor) -> Clouds:
        rows = (torch.rand(batch, device=device) * len(recorded)).long().clamp(max=len(recorded) - 1)
        blended = rare[torch.randint(len(rare), (drawn,), device=device)]
        poses, weights = torch.cat((recorded[rows], blended)), torch.cat((weight[rows], rare_weight))
        if balance.fades:
            left = ((FADES[1] - done) / (FADES[1] - FADES[0])).clamp(0.0, 1.0)
            weights = (1.0 + (weights - 1.0) * left) * torch.where(added, left, 1.0)
            if device == "cpu" and not left:  # on a GPU a step is one graph, so poses of weight 0 are computed too
                poses, weights = poses[:batch], weights[:batch]
        return stream.draw(poses, weights)

    return draw
