"""Takes without prior training, for benchmark captures: CMU subjects 03, 08, 13, the salsa couple, Indian dances."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.io.motions.recorded_clip import body_rotations
from solver_backend.synthesis.simulation.cast import Take
from tests.benchmarks.metric import BenchmarkSkipped
from tests.support.recordings import recordings_folder
from training.data.corpus import HELD_OUT
from training.data.sources.clips import FAR, read_clip, subject_of, with_shoulder_rhythm

FOLDERS = ("mb2", "daz")  # Folders of the recordings for every benchmark, at 60 Hz.
MORE_FOLDERS = (*FOLDERS, "daz_more", FAR)  # These and exercises and Indian dances at 30 Hz.
TRAINING_FOLDERS = ("mb2", "asfamc")


def clip_paths(data: Path | None = None, folders: tuple[str, ...] = FOLDERS) -> list[Path]:
    """Return the held-out clips in some folders of a data folder.

    Raises:
        BenchmarkSkipped: there are none.
    """
    folder = (data or recordings_folder()) / "motion_cmu"
    clips = [path for part in folders for path in sorted((folder / part).glob("*.npz"))]
    paths = [path for path in clips if subject_of(path) in HELD_OUT or path.parent.name == FAR]
    if not paths:
        raise BenchmarkSkipped("The validation motions are not here.", hint="Set MOCAP_SHARED_DATA to their folder.")
    return paths


def read_take(path: Path, num_frames: int | None = None, start: int = 0) -> Take:
    """Return a clip's frames ``start .. start + num_frames - 1`` at its own frame rate."""
    clip = read_clip(path)
    rotations = body_rotations(clip)
    rotations = np.concatenate([rotations[:, :1], with_shoulder_rhythm(rotations[:, 1:])], axis=1)
    with np.load(path, allow_pickle=False) as stored:
        root = np.asarray(stored["root"], dtype=np.float64)[-len(rotations) :]
    part = slice(start, None if num_frames is None else start + num_frames)
    return Take(path.stem, rotations[part], root[part], float(round(clip.fps)))


def training_take(name: str, num_frames: int | None = None, start: int = 0) -> Take:
    """Return a take that priors were trained on, for tuning methods without the benchmark's takes.

    Raises:
        BenchmarkSkipped: it is missing or held out.
    """
    for folder in TRAINING_FOLDERS:
        path = recordings_folder() / "motion_cmu" / folder / f"{name}.npz"
        if path.is_file() and subject_of(path) not in HELD_OUT:
            return read_take(path, num_frames, start)
    raise BenchmarkSkipped(f"The take {name} is not among the training motions.")


def take_named(name: str, num_frames: int | None = None, start: int = 0, data: Path | None = None) -> Take:
    """Return the held-out take of this name.

    Raises:
        BenchmarkSkipped: it is missing.
    """
    for path in clip_paths(data, MORE_FOLDERS):
        if path.stem == name:
            return read_take(path, num_frames, start)
    raise BenchmarkSkipped(f"The take {name} is not among the validation motions.")
