"""The training corpus: recorded clips as body rotations at 30 Hz, split by subject, without near-repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.errors import FileMissing
from solver_backend.exchange.joint_sets import NUM_JOINTS
from training.data.points import rotation_points
from training.data.sources.clips import KEYED, UNKNOWN, Clip

HELD_OUT = frozenset({"03", "08", "13", "60_61", "ui_prmd_s07", "ui_prmd_s08"})
"""Subjects nothing is trained on."""
NEAR_REPEAT_M = 0.012
"""Poses closer than this to a kept one (root mean square over the joints) are repeats."""
KEYED_REPEATS = 4
"""How often each pose of a hand-keyed animation counts, as they are few and hold what recordings lack."""
SIMPLIFIED = "jump"
"""Source whose skeleton has neither hands, toes nor a head of its own."""
SIMPLIFIED_EVERY = 4
"""Of its distinct poses one in so many counts."""
_SAME_TAKE_M = 0.004
"""Distance of poses that are the same frame, metres; chosen by hand."""


@dataclass(frozen=True)
class Corpus:
    """Clips of one side of the split, laid end to end."""

    rotations: np.ndarray
    """(N, 21, 3, 3) float32."""
    clip_start: np.ndarray
    """(N,) first frame of the clip each frame belongs to."""
    clip_end: np.ndarray
    """(N,) one past its last frame."""
    distinct: np.ndarray
    """(D,) frames that are no near-repeats of one another; hand-keyed ones several times."""
    names: tuple[str, ...]
    subjects: tuple[str, ...]
    """Of the same clips."""
    root: np.ndarray
    """(N, 3, 3) float32, the pelvis since the T-pose, Y up; NaN where it was not kept."""

    @property
    def num_frames(self) -> int:
        """Frames with repeats."""
        return len(self.rotations)

    def some_distinct(self, most: int) -> np.ndarray:
        """Return about ``most`` of the distinct poses (n, 21, 3, 3), evenly from all of them."""
        return self.rotations[self.distinct[:: max(1, len(self.distinct) // most)]]

    @property
    def sources(self) -> np.ndarray:
        """(N,) source of each frame: what stands before the slash of its clip's name."""
        return np.array([name.split("/")[0] for name in self.names])[self._clip]

    @property
    def people(self) -> np.ndarray:
        """(N,) who moves in each frame, numbered; every hand-keyed clip is somebody else, all unknown of a source one.

        What was keyed has no subject that would repeat itself from clip to clip.
        """
        named = zip(self.names, self.subjects, strict=True)
        who = [
            name if who == KEYED else name.split("/")[0] if who == UNKNOWN else who for name, who in named
        ]  # fmt: skip
        return np.unique(who, return_inverse=True)[1][self._clip]

    @property
    def _clip(self) -> np.ndarray:
        """(N,) number of each frame's clip."""
        starts, clip = np.unique(self.clip_start, return_inverse=True)
        assert len(starts) == len(self.names)
        return clip


def split_corpus(clips: list[Clip], held_out_subjects: frozenset[str] = HELD_OUT) -> tuple[Corpus, Corpus]:
    """Return (training, validation); takes of the held-out subjects under another name are in neither.

    Raises:
        FileMissing: there are no recordings of one side.
    """
    held_out = [clip for clip in clips if clip.subject in held_out_subjects]
    rest = [clip for clip in clips if clip.subject not in held_out_subjects]
    check_sides(rest, held_out, held_out_subjects)
    known = _features(np.concatenate([clip.rotations for clip in held_out]))
    kept = [clip for clip in rest if clip.subject != UNKNOWN or not _repeats(clip, known)]
    return build_corpus(kept), build_corpus(held_out)


def absent_subjects(clips: list[Clip], held_out_subjects: frozenset[str] = HELD_OUT) -> tuple[str, ...]:
    """Return the held-out subjects that no clip is of: figures are without them then."""
    return tuple(sorted(held_out_subjects - {clip.subject for clip in clips}))


def check_sides(training: list[Clip], validation: list[Clip], held_out_subjects: frozenset[str] = HELD_OUT) -> None:
    """Raise where a side of the split is empty.

    Raises:
        FileMissing: there is nobody to train on, or nobody to validate on.
    """
    if not validation:
        raise FileMissing(
            f"The recordings hold none of the subjects to validate on ({', '.join(sorted(held_out_subjects))}).",
            hint="--data takes the folder that holds motion_cmu with all of its subjects.",
        )  # fmt: skip
    if not training:
        raise FileMissing(
            f"The recordings hold no subject to train on besides {', '.join(sorted({c.subject for c in validation}))}.",
            hint="--data takes the folder that holds motion_cmu with all of its subjects.",
        )  # fmt: skip


def build_corpus(clips: list[Clip]) -> Corpus:
    """Lay clips end to end and find the distinct poses."""
    rotations = np.concatenate([clip.rotations for clip in clips])
    ends = np.cumsum([len(clip.rotations) for clip in clips])
    lengths = [len(clip.rotations) for clip in clips]
    starts = np.repeat(ends - lengths, lengths)
    distinct = distinct_poses(_features(rotations), NEAR_REPEAT_M)
    keyed = np.repeat([clip.subject == KEYED for clip in clips], lengths)
    simplified = np.repeat([clip.name.startswith(f"{SIMPLIFIED}/") for clip in clips], lengths)[distinct]
    distinct = distinct[~simplified | (np.cumsum(simplified) % SIMPLIFIED_EVERY == 0)]
    distinct = np.repeat(distinct, np.where(keyed[distinct], KEYED_REPEATS, 1))
    names, subjects = zip(*((clip.name, clip.subject) for clip in clips), strict=True)
    root = np.concatenate([_root(clip) for clip in clips])
    return Corpus(rotations, starts, np.repeat(ends, lengths), distinct, names, subjects, root)


def _root(clip: Clip) -> np.ndarray:
    return np.full((len(clip.rotations), 3, 3), np.nan, np.float32) if clip.root is None else clip.root


def distinct_poses(features: np.ndarray, radius: float, block: int = 1024) -> np.ndarray:
    """Return indices of poses that cover all others within ``radius`` (leader clustering, in order of time).

    Args:
        features: (N, d), Euclidean.
        radius: largest distance of any pose to a kept one.
        block: poses compared at a time.
    """
    kept: list[np.ndarray] = []
    leaders = np.zeros((0, features.shape[1]), dtype=features.dtype)
    for first in range(0, len(features), block):
        part = np.arange(first, min(first + block, len(features)))
        for chunk in range(0, len(leaders), 16384):
            part = part[_nearest(features[part], leaders[chunk : chunk + 16384]) > radius]
        near = _squared(features[part], features[part]) <= radius**2
        alive = np.ones(len(part), dtype=bool)
        for i in range(len(part)):
            if alive[i]:
                alive[i + 1 :] &= ~near[i, i + 1 :]
        kept.append(part[alive])
        leaders = np.concatenate((leaders, features[part[alive]]))
    return np.concatenate(kept)


def _features(rotations: np.ndarray) -> np.ndarray:
    """Return (N, 69) joint positions whose Euclidean distance is the root mean square over 23 joints, m."""
    joints = rotation_points(rotations.astype(np.float32))[:, 1:NUM_JOINTS]
    return (joints / np.sqrt(joints.shape[1])).reshape(len(joints), -1)


def _repeats(clip: Clip, known: np.ndarray) -> bool:
    """Whether most of a clip's frames are frames of ``known``."""
    return bool(np.mean(_nearest(_features(clip.rotations[::5]), known) < _SAME_TAKE_M) > 0.5)


def _nearest(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    if not len(a) or not len(b):
        return np.full(len(a), np.inf)
    return np.sqrt(np.maximum(_squared(a, b).min(axis=1), 0.0))


def _squared(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * a).sum(1)[:, None] - 2.0 * a @ b.T + (b * b).sum(1)[None, :]
