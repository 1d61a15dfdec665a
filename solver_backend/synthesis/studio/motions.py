"""Motions to film: the choreography that ships, solved takes, AMASS and BVH files, and folders of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.exchange.errors import FileMissing, MotionInvalid
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.load import load_motion
from solver_backend.io.motions.bvh import BvhClip, read_bvh
from solver_backend.io.motions.recorded_clip import body_rotations, recorded_from_bvh
from solver_backend.synthesis.embedded.choreography import author_motion
from solver_backend.synthesis.simulation.cast import FLOOR_S, Person, Take, cast_person, running_floor
from solver_backend.types import NUM_BODY_JOINTS, JointSet

CHOREOGRAPHY = "choreography"  # Name of the motion that ships.
_SUFFIXES = (".npz", ".bvh")
_CHOREOGRAPHY_S = 6.0  # Length of the choreography, seconds.


@dataclass(frozen=True)
class MotionSource:
    """Where a motion comes from."""

    name: str  # Name of the motion, part of a shot's name.
    path: Path | None  # File, None for the choreography.

    def play(self, body: Body, betas: np.ndarray, fps: float, frames: int) -> Person:
        """Return somebody of a shape who does the motion, on the floor, at a frame rate.

        Args:
            body: whose body.
            betas: (10,) shape.
            fps: frames per second.
            frames: at most so many, from the motion's beginning.

        Raises:
            MocapError: the file cannot be read.
            MotionInvalid: its joints belong to no skeleton that is known.
        """
        if self.path is None:
            count = min(frames, round(_CHOREOGRAPHY_S * fps))
            motion = author_motion(body, betas, count, fps)
            return Person(body, betas, exp_so3(motion.global_orient), exp_so3(motion.body_pose), motion.transl)
        person, rate = (_of_bvh if self.path.suffix.lower() == ".bvh" else _of_file)(self.path, body, betas)
        return _at_rate(person, rate, fps, frames)


def find_motions(names: list[str], folder: Path = Path()) -> tuple[MotionSource, ...]:
    """Return the motions of a list of files, folders and ``choreography``; names that meet twice are numbered.

    Raises:
        FileMissing: a path is not there, or a folder holds no motion.
    """
    sources: list[MotionSource] = []
    for name in names:
        if name == CHOREOGRAPHY:
            sources.append(MotionSource(CHOREOGRAPHY, None))
            continue
        path = folder / name
        found = sorted(p for p in path.rglob("*") if p.suffix.lower() in _SUFFIXES) if path.is_dir() else [path]
        if not found or not found[0].is_file():
            raise FileMissing(
                "The motion is not there." if not path.is_dir() else "The folder holds no motions (.npz, .bvh).",
                where=str(path),
                hint=f"Name a file, a folder, or '{CHOREOGRAPHY}'.",
            )
        sources += [MotionSource(p.stem, p) for p in found]
    seen: dict[str, int] = {}
    unique = []
    for source in sources:
        seen[source.name] = seen.get(source.name, 0) + 1
        number = seen[source.name]
        unique.append(MotionSource(source.name if number == 1 else f"{source.name}~{number}", source.path))
    return tuple(unique)


def _of_file(path: Path, body: Body, betas: np.ndarray) -> tuple[Person, float]:
    """Return a take or an AMASS clip on a body of another shape: same rotations, the path on the floor."""
    motion = load_motion(path)
    if isinstance(motion, BvhClip):
        raise MotionInvalid("The file holds a skeleton of other joints than our body's.", where=str(path))
    local = exp_so3(motion.body_pose[:, : 3 * NUM_BODY_JOINTS].reshape(-1, NUM_BODY_JOINTS, 3))
    person = Person(body, betas, exp_so3(motion.global_orient), local, motion.transl.copy())
    return _grounded(person, motion.fps), motion.fps


def _of_bvh(path: Path, body: Body, betas: np.ndarray) -> tuple[Person, float]:
    clip = read_bvh(path)
    if len(clip.rotations) < 5:
        raise MotionInvalid(f"The clip has {len(clip.rotations)} frames; 5 are needed.", where=str(path))
    rotations = body_rotations(recorded_from_bvh(clip, path.stem))
    root = clip.root_positions[1:] @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    take = Take(path.stem, rotations, root, clip.fps)
    person = cast_person(take, np.random.default_rng(0), body)
    return _grounded(Person(body, betas, person.orient, person.local, person.transl), clip.fps), clip.fps


def _grounded(person: Person, fps: float) -> Person:
    """Return the person moved up or down so that some sole stands on the floor within every second."""
    soles = keypoint_landmarks(person.body, JointSet.BODY_25)
    feet = [k for k, name in enumerate(JointSet.BODY_25.keypoints) if name.endswith(("_toe", "_heel"))]
    posed = pose_landmarks(person.body, soles, person.betas, person.orient, person.local, person.transl)
    transl = person.transl.copy()
    transl[:, 2] -= running_floor(posed.points[:, feet, 2].min(axis=1), max(1, round(FLOOR_S * fps))) - 0.01
    return Person(person.body, person.betas, person.orient, person.local, transl)


def _at_rate(person: Person, rate: float, fps: float, frames: int) -> Person:
    """Return the motion at another frame rate: geodesics of rotations, lines of the translation."""
    length = len(person.transl)
    count = min(frames, int((length - 1) * fps / rate + 1e-6) + 1)
    at = np.minimum(np.arange(count) * rate / fps, length - 1)
    first = np.minimum(at.astype(int), max(length - 2, 0))
    share, after = at - first, np.minimum(first + 1, length - 1)
    transl = (1 - share)[:, None] * person.transl[first] + share[:, None] * person.transl[after]
    orient = _between(person.orient[first], person.orient[after], share[:, None])
    local = _between(person.local[first], person.local[after], share[:, None, None])
    return Person(person.body, person.betas, orient, local, transl)


def _between(before: np.ndarray, after: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return rotations (..., 3, 3) a share of the geodesic on; equal neighbours in time give the first."""
    return before @ exp_so3(share * log_so3(np.swapaxes(before, -1, -2) @ after))
