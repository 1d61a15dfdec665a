"""Every recording the priors learn from, as clips of body rotations at 30 Hz."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.body.joint_limits import excess_deg
from solver_backend.exchange.errors import FileMissing
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.runs import true_runs
from solver_backend.io.motions.bvh import read_bvh
from solver_backend.io.motions.recorded_clip import RecordedClip, body_rotations, read_clip, recorded_from_bvh, resample
from training.data.shoulder_rhythm import with_shoulder_rhythm
from training.data.sources.amc_clips import read_amc, read_asf
from training.data.sources.gltf_clips import read_archive_clips
from training.data.sources.marker_takes import FIT_FPS, fitted_takes

FPS = 30.0
KEYED = "keyed"
"""Subject of hand-keyed animations."""
UNKNOWN = "unknown"
"""Subject of conversions that do not keep it."""
KEYED_ARCHIVE = "mesh2motion_cc0.tar.xz"
FAULT_DEG = 30.0
"""A joint this far beyond its anatomical range was tracked wrongly."""
FAR = "far"
"""Folder of motions unlike any that is trained on: priors are evaluated on them."""
_FOLDERS = ("asfamc", "amc", "mb2", "expmap", "max", "daz", "daz_more", "segments", "jump")
"""Conversions; a take that several of them hold is read from the first."""
_AMC = ("11_01", "13_30", "13_31", "14_14", "14_20")
"""Motions that no other conversion with hands and toes holds; all CMU skeletons share their axes, so one serves."""
_TAKE = re.compile(r"(?:[a-z]+_)?(\d+)_\d+")
"""CMU's subject and trial in a file's name, perhaps after a word."""
_NUMBERED = ("asfamc", "amc", "mb2", "daz_more", "segments", "jump", FAR)
"""Folders whose files are named by subject and trial."""
_BVH = "makehuman_data_bvhs_10_01.bvh"
_MIN_FRAMES = 3
"""Frames of a clip at least; chosen by hand."""


@dataclass(frozen=True)
class Clip:
    """A clip ready for training."""

    name: str
    """Source and file, with a slash between."""
    subject: str
    rotations: np.ndarray
    """(F, 21, 3, 3) float32, local, 30 Hz."""
    root: np.ndarray | None = None
    """(F, 3, 3) float32, the pelvis since the T-pose, Y up; None where it was not kept."""


def load_clips(
    data: Path, progress: Progress = silent, *, cache: Path | None = None, fitted: bool = True
) -> list[Clip]:
    """Read CMU's recordings under ``data``, and the marker takes and hand-keyed animations where they are there.

    Args:
        data: folder that holds ``motion_cmu``.
        progress: called after every file.
        cache: folder that keeps the fitted marker takes, as fitting takes minutes.
        fitted: read the marker takes, too.

    Raises:
        FileMissing: the folder holds no clips.
    """
    paths = _one_of_each_take(path for folder in _FOLDERS for path in _recordings(data / "motion_cmu" / folder))
    if not paths:
        raise FileMissing("No training clips were found.", where="motion_cmu", hint="--data takes the folder above it.")
    clips = []
    for number, path in enumerate(paths):
        clips.append(_recorded(_read(path), path.parent.name, subject_of(path)))
        progress("Reading clips", number + 1, len(paths))
    clips += _makehuman(data / "poses_makehuman_cc0" / _BVH)
    archive = data / KEYED_ARCHIVE
    keyed = read_archive_clips(archive) if archive.is_file() else []
    clips += [_clip(f"{KEYED}/{clip.name}", KEYED, _at_corpus_rate(clip)) for clip in keyed]
    if fitted:
        clips += _marker_takes(data / "markers" / "ui_prmd", cache, progress)
    return [piece for clip in clips for piece in without_faults(clip)]


def load_far_clips(data: Path) -> list[Clip]:
    """Read the motions under ``data`` that are unlike any that is trained on, without faults; none if not there."""
    clips = [_recorded(read_clip(path), FAR, subject_of(path)) for path in _recordings(data / "motion_cmu" / FAR)]
    return [piece for clip in clips for piece in without_faults(clip)]


def without_faults(clip: Clip) -> list[Clip]:
    """Return the frame ranges of a clip in which every joint is near its anatomical range."""
    sound = (excess_deg(clip.rotations.astype(np.float64)) < FAULT_DEG).all(axis=1)
    long = [slice(first, last + 1) for first, last in true_runs(sound) if last - first + 1 >= _MIN_FRAMES]
    root = clip.root
    return [
        Clip(clip.name, clip.subject, clip.rotations[frames], None if root is None else root[frames]) for frames in long
    ]


def subject_of(path: Path) -> str:
    """Return the CMU subject of a clip's file; UNKNOWN for conversions that do not keep it."""
    folder, take = path.parent.name, _TAKE.match(path.name)
    if folder in _NUMBERED and take:
        return take.group(1)
    if folder == "daz":
        return "60_61" if path.stem.startswith("salsa") else "135"
    return "131" if folder == "max" else UNKNOWN


def _recordings(folder: Path) -> list[Path]:
    """Return the files of a folder of CMU's recordings that the corpus takes."""
    if folder.name == "amc":
        return [path for name in _AMC if (path := folder / f"{name}.amc.gz").is_file()]
    return sorted(folder.glob("*.npz"))


def _one_of_each_take(paths: Iterable[Path]) -> list[Path]:
    """Return the first file of every numbered take, and all that are not numbered."""
    first: dict[str, Path] = {}
    for path in paths:
        name = path.name.split(".")[0]
        first.setdefault(name if name[:1].isdigit() else f"{path.parent.name}/{name}", path)
    return list(first.values())


def _read(path: Path) -> RecordedClip:
    return read_amc(path, read_asf(path.with_name("11.asf"))) if path.suffix == ".gz" else read_clip(path)


def _recorded(clip: RecordedClip, source: str, subject: str) -> Clip:
    """Return a clip of CMU's, whose collars do not move."""
    rotations = _at_corpus_rate(clip)
    rotations[:, 1:] = with_shoulder_rhythm(rotations[:, 1:])
    return _clip(f"{source}/{clip.name}", subject, rotations)


def _clip(name: str, subject: str, rotations: np.ndarray) -> Clip:
    """Return a clip of (F, 22, 3, 3) rotations, the pelvis first."""
    rotations = rotations.astype(np.float32)
    return Clip(name, subject, rotations[:, 1:], rotations[:, 0])


def _at_corpus_rate(clip: RecordedClip) -> np.ndarray:
    """Return the (F, 22, 3, 3) rotations of the pelvis and the body joints."""
    return resample(body_rotations(clip), clip.fps, FPS)


def _makehuman(path: Path) -> list[Clip]:
    return [_recorded(recorded_from_bvh(read_bvh(path), path.stem), "makehuman", "10")] if path.is_file() else []


def _marker_takes(folder: Path, cache: Path | None, progress: Progress) -> list[Clip]:
    takes = fitted_takes(folder, cache, progress) if folder.is_dir() else []
    return [
        Clip(f"ui_prmd/{t.name}", f"ui_prmd_{t.subject}", resample(t.rotations, FIT_FPS, FPS).astype(np.float32))
        for t in takes
    ]
