"""Takes that no prior was trained on, for the benchmark captures: CMU subjects 03, 08, 13 and the salsa couple."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.io.motions.recorded_clip import body_rotations
from solver_backend.synthesis.simulation.cast import Take
from tests.benchmarks.metric import BenchmarkSkipped
from tests.support.recordings import recordings_folder
from training.data.corpus import HELD_OUT
from training.data.sources.clips import read_clip, subject_of, with_shoulder_rhythm


def clip_paths(data: Path | None = None) -> list[Path]:
    """Return the held-out clips under a data folder.

    Raises:
        BenchmarkSkipped: there are none.
    """
    folder = (data or recordings_folder()) / "motion_cmu"
    paths = [p for part in ("mb2", "daz") for p in sorted((folder / part).glob("*.npz")) if subject_of(p) in HELD_OUT]
    if not paths:
        raise BenchmarkSkipped("The validation motions are not here.", hint="Set MOCAP_SHARED_DATA to their folder.")
    return paths


def read_take(path: Path, num_frames: int | None = None, start: int = 0) -> Take:
    """Return a clip's frames ``start .. start + num_frames - 1`` at its own rate."""
    clip = read_clip(path)
    rotations = body_rotations(clip)
    rotations = np.concatenate([rotations[:, :1], with_shoulder_rhythm(rotations[:, 1:])], axis=1)
    with np.load(path, allow_pickle=False) as stored:
        root = np.asarray(stored["root"], dtype=np.float64)[-len(rotations) :]
    part = slice(start, None if num_frames is None else start + num_frames)
    return Take(path.stem, rotations[part], root[part], float(round(clip.fps)))


def training_take(name: str, num_frames: int | None = None, start: int = 0) -> Take:
    """Return a take that priors were trained on, for tuning methods without touching the benchmark's takes.

    Raises:
        BenchmarkSkipped: it is not here, or is held out.
    """
    path = recordings_folder() / "motion_cmu" / "mb2" / f"{name}.npz"
    if not path.is_file() or subject_of(path) in HELD_OUT:
        raise BenchmarkSkipped(f"The take {name} is not among the training motions.")
    return read_take(path, num_frames, start)


def take_named(name: str, num_frames: int | None = None, start: int = 0, data: Path | None = None) -> Take:
    """Return the held-out take of this name.

    Raises:
        BenchmarkSkipped: it is not here.
    """
    for path in clip_paths(data):
        if path.stem == name:
            return read_take(path, num_frames, start)
    raise BenchmarkSkipped(f"The take {name} is not among the validation motions.")
