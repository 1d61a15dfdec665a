"""Select a hard passage, in which the published methods have the largest errors, from truth and solved motions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.io.native.motion_file import read_motion
from solver_backend.types import Capture, Motion
from tests.benchmarks.comparison.captures import filmed
from tests.benchmarks.comparison.methods import PUBLISHED
from tests.benchmarks.comparison.sections import Found, Section

SECONDS = 2.0
SHOWN = ("MuVS", PUBLISHED, "ours, global")


@dataclass(frozen=True)
class Passage:
    """A frame range of a take, in the truth and in several methods' motions."""

    take: str
    first: int
    """First frame in the take."""
    motions: dict[str, Motion]
    """Motions of exactly the passage's frames by label, the truth first."""

    def errors_mm(self) -> dict[str, float]:
        """Return each motion's mean joint distance from the truth in millimetres."""
        truth = next(iter(self.motions.values())).joints
        return {
            label: 1000 * float(np.linalg.norm(motion.joints - truth, axis=-1).mean())
            for label, motion in self.motions.items()
        }


def hardest(section: Section, found: Found) -> Passage:
    """Return the passage with the largest combined error of MuVS and BundleMoCap++."""
    best: tuple[float, Passage] | None = None
    for runs in zip(*(section.rows[label] for label in SHOWN), strict=True):
        capture = filmed(runs[0].take, runs[0].settings)
        solved = {label: _read(found[run].motion) for label, run in zip(SHOWN, runs, strict=True)}
        length = min(round(SECONDS * capture.fps), capture.num_frames)
        error = sum(np.linalg.norm(solved[label].joints - capture.truth["joints"], axis=-1) for label in SHOWN[:2])
        sums = np.convolve(np.asarray(error).mean(axis=1), np.ones(length) / length, mode="valid")
        first = int(sums.argmax())
        if best is None or sums[first] > best[0]:
            motions = {"truth": true_motion(capture), **solved}
            cut = {label: frames_of(motion, first, first + length) for label, motion in motions.items()}
            best = (float(sums[first]), Passage(runs[0].take, first, cut))
    assert best is not None
    return best[1]


def true_motion(capture: Capture) -> Motion:
    """Return the truth of a capture as a motion of our body."""
    truth = capture.truth
    parts = (truth[name] for name in ("betas", "global_orient", "body_pose", "transl"))
    return Motion(*parts, capture.fps, load_body().id, truth["joints"])


def frames_of(motion: Motion, first: int, stop: int) -> Motion:
    """Return the poses of some frames, without other contents of a motion."""
    part = slice(first, stop)
    return Motion(
        motion.betas, motion.global_orient[part], motion.body_pose[part], motion.transl[part], motion.fps, motion.body,
        motion.joints[part],
    )  # fmt: skip


def _read(path: Path | None) -> Motion:
    assert path is not None
    return read_motion(path)
