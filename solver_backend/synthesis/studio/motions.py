"""Read the motions of shots: the built-in choreography, solved motions, AMASS files and BVH files."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.body.body import Body
from solver_backend.exchange.errors import FileMissing, MotionInvalid
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.load import load_motion
from solver_backend.io.motions.bvh import BvhClip, read_bvh
from solver_backend.io.motions.recorded_clip import body_rotations, recorded_from_bvh
from solver_backend.synthesis.embedded.demo import author_motion
from solver_backend.synthesis.simulation.cast import Person, Take, cast_person
from solver_backend.types import NUM_BODY_JOINTS

CHOREOGRAPHY = "choreography"  # Name of the built-in motion.
_SUFFIXES = (".npz", ".bvh")
_CHOREOGRAPHY_S = 6.0  # Duration of the choreography in seconds.


@dataclass(frozen=True)
class MotionSource:
    """A motion file, or the built-in choreography."""

    name: str  # Name of the motion, which becomes part of the shot's name.
    path: Path | None  # The file, or None for the choreography.

    def play(self, body: Body, betas: np.ndarray, fps: float, frames: int) -> Person:
        """Create a person with betas (10,) who performs the motion at ``fps``, for at most ``frames`` frames.

        Raises:
            MocapError: the file cannot be read.
            MotionInvalid: its joints do not match any known skeleton.
        """
        if self.path is None:
            count = min(frames, round(_CHOREOGRAPHY_S * fps))
            root, local, transl = author_motion(body, betas, count, fps)
            return Person(body, betas, exp_so3(root), exp_so3(local), transl)
        person, rate = (_of_bvh if self.path.suffix.lower() == ".bvh" else _of_file)(self.path, body, betas)
        return _at_rate(person, rate, fps, frames)


def find_motions(names: list[str], folder: Path = Path()) -> tuple[MotionSource, ...]:
    """Find motions by file, folder or ``choreography``. Repeated names are numbered.

    Raises:
        FileMissing: a path does not exist, or a folder contains no motion.
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
                "The motion does not exist." if not path.is_dir() else "The folder contains no motions (.npz, .bvh).",
                where=str(path),
                hint=f"Specify a file, a folder, or '{CHOREOGRAPHY}'.",
            )
        sources += [MotionSource(p.stem, p) for p in found]
    seen, unique = Counter[str](), []
    for source in sources:
        seen[source.name] += 1
        number = f"~{seen[source.name]}" if seen[source.name] > 1 else ""
        unique.append(MotionSource(source.name + number, source.path))
    return tuple(unique)


def _of_file(path: Path, body: Body, betas: np.ndarray) -> tuple[Person, float]:
    """Apply a file's joint rotations and floor path to another body shape. Also return the frame rate."""
    motion = load_motion(path)
    if isinstance(motion, BvhClip):
        raise MotionInvalid("The skeleton is not the program's body. Use `motion convert` first.", where=str(path))
    local = exp_so3(motion.body_pose[:, : 3 * NUM_BODY_JOINTS].reshape(-1, NUM_BODY_JOINTS, 3))
    person = Person(body, betas, exp_so3(motion.global_orient), local, motion.transl.copy())
    return person.on_the_floor(motion.fps), motion.fps


def _of_bvh(path: Path, body: Body, betas: np.ndarray) -> tuple[Person, float]:
    clip = read_bvh(path)
    if len(clip.rotations) < 5:
        raise MotionInvalid(f"The clip has {len(clip.rotations)} frames, but 5 are needed.", where=str(path))
    rotations = body_rotations(recorded_from_bvh(clip, path.stem))
    root = clip.root_positions[1:] @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    take = Take(path.stem, rotations, root, clip.fps)
    person = cast_person(take, np.random.default_rng(0), body)
    return replace(person, betas=betas).on_the_floor(clip.fps), clip.fps


def _at_rate(person: Person, rate: float, fps: float, frames: int) -> Person:
    """Resample a motion. Rotations are interpolated along geodesics and translations linearly."""
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
    """Return the rotations (..., 3, 3) at the fraction ``share`` of the geodesic between two rotations."""
    return before @ exp_so3(share * log_so3(np.swapaxes(before, -1, -2) @ after))
