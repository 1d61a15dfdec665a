"""Poses to train and evaluate landmark networks on: with the pelvis' rotation, split, and as one small file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import NonFiniteData
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.exchange.npz import read_npz, write_npz
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.balance import CodeStatistics, reconstruction_error, sample_tail
from solver_backend.priors.base import AutoencodingPrior
from training.data.corpus import HELD_OUT, NEAR_REPEAT_M, absent_subjects, check_sides, distinct_poses
from training.data.points import rotation_points
from training.data.sources.clips import FAR, Clip
from training.landmarks.tail_poses import GROUPS, groups_of, on_the_floor

HELD_TAKES = ("asfamc/02_01", "asfamc/135_02", "mb2/02_01", "jump/140_", "keyed/Fixing_Kneeling", "keyed/Death01")
"""Takes left out besides the held-out subjects: those whose markers the labels are evaluated on, and floor poses."""
SAMPLERS = ("random", "lerp", "slerp", "squad", "bezier", "bspline")
TAIL_SHARE = 0.03
"""Share of the training poses, by Mahalanobis distance, that are anchors."""
SAMPLED = 8000
"""Poses drawn by each sampling operator."""
_ORDINARY, _TAIL = 3000, 1500


@dataclass(frozen=True)
class PoseTable:
    """Poses by name, (N, 22, 3) rotation vectors each, the pelvis first, Y up; and what is known of the training's.

    ``absent`` names the held-out subjects that the recordings lacked.
    """

    arrays: Mapping[str, np.ndarray]

    @classmethod
    def read(cls, path: Path) -> PoseTable:
        """Read a table.

        Raises:
            FileMissing, FileDamaged: it cannot be read.
        """
        return cls(read_npz(path))

    def write(self, path: Path) -> None:
        """Write the table."""
        write_npz(path, dict(self.arrays), overwrite=True)

    def poses(self, name: str) -> np.ndarray:
        """Return (N, 22, 3) float32 rotation vectors: ``training``, ``ordinary``, ``tail``, ``floor``, a sampler's."""
        return self.arrays[name].astype(np.float32)

    def check_finite(self) -> None:
        """Raise where poses are no numbers.

        Raises:
            NonFiniteData: rotation vectors are NaN or infinite.
        """
        for name, array in self.arrays.items():
            if array.ndim == 3 and not (sound := np.isfinite(array).all(axis=(1, 2))).all():
                raise NonFiniteData(
                    f"{(~sound).sum()} of {len(sound)} {name} poses of the table are not numbers.",
                    hint="Make the table again from the recordings (--data FOLDER).",
                )  # fmt: skip


def pose_table(clips: Iterable[Clip], far: Iterable[Clip], prior: AutoencodingPrior, seed: int = 0) -> PoseTable:
    """Return the poses of clips that kept their pelvis' rotation.

    Anchors, the rarest poses by Mahalanobis distance of their codes, are in neither training nor validation.

    Args:
        clips: of ``load_clips``.
        far: motions unlike the corpus: only their rare poses are evaluated on.
        prior: autoencoder that measures how rare a pose is (RVPoser).
        seed: of all draws.
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
        "training": _packed(training[~anchor]), "mahalanobis": distance[~anchor].astype(np.float32),
        "reconstruction": error[~anchor].astype(np.float32),
    }  # fmt: skip
    arrays["absent"] = np.array(absent_subjects(held), dtype=np.str_)
    return PoseTable(arrays | held_out_poses(held, list(far), rng))


def held_out_poses(held: list[Clip], far: list[Clip], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the poses of the held-out takes: ``ordinary``, ``tail`` with ``tail_group`` and frames, ``floor``."""
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
        "floor": _packed(rotations[floor]), "ordinary": _packed(rotations[ordinary]),
        "floor_frames": np.array([f"{names[i]}:{frames[i]}" for i in floor]),
    }  # fmt: skip


def _sampled(anchors: np.ndarray, codes: np.ndarray, name: str, seed: int) -> np.ndarray:
    """Return codes drawn by an operator; RANDOM draws from the Gaussian of all codes."""
    if name != "random":
        return sample_tail(anchors, SAMPLED, seed, blend=name)  # pyright: ignore[reportArgumentType]
    rng = np.random.default_rng(seed)
    return rng.multivariate_normal(codes.mean(axis=0), np.cov(codes, rowvar=False), SAMPLED)


def _laid_out(clips: list[Clip]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (N, 22, 3, 3) rotations, the clip's name and the frame of each."""
    rotations = np.concatenate([_rooted(clip) for clip in clips])
    names = np.repeat([clip.name for clip in clips], [len(clip.rotations) for clip in clips])
    return rotations, names, np.concatenate([np.arange(len(clip.rotations)) for clip in clips])


def _rooted(clip: Clip) -> np.ndarray:
    assert clip.root is not None
    return np.concatenate([clip.root[:, None], clip.rotations], axis=1)


def _distinct(clips: list[Clip]) -> np.ndarray:
    """Return the rotations of poses that are no near-repeats, whichever way the pelvis is turned."""
    rotations, _, _ = _laid_out(clips)
    points = rotation_points(rotations[:, 1:])[:, 1:NUM_JOINTS]
    features = points.reshape(len(points), -1) / np.sqrt(NUM_JOINTS - 1.0)
    # Where the pelvis leans to is part of the pose here; which way it heads is not.
    features = np.concatenate([features, 0.1 * rotations[:, 0, 1]], axis=1)
    return rotations[np.sort(distinct_poses(features.astype(np.float32), NEAR_REPEAT_M))]


def _spread_out(rotations: np.ndarray, rows: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """Return up to ``most`` of the rows, near-repeats left out."""
    if not len(rows):
        return rows
    features = rotation_points(rotations[rows, 1:])[:, 1:NUM_JOINTS].reshape(len(rows), -1) / np.sqrt(NUM_JOINTS - 1.0)
    rows = rows[np.sort(distinct_poses(features.astype(np.float32), 2 * NEAR_REPEAT_M))]
    return np.sort(rng.permutation(rows)[:most])


def _packed(rotations: np.ndarray) -> np.ndarray:
    return log_so3(rotations.astype(np.float64)).astype(np.float16)


def _parts(array: np.ndarray, size: int = 8192) -> list[np.ndarray]:
    return [array[i : i + size].astype(np.float64) for i in range(0, len(array), size)]
