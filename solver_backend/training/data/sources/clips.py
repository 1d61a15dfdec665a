"""Every recording the priors learn from, as clips of body rotations at 30 Hz."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.body.joint_limits import excess_deg
from solver_backend.exchange.errors import FileMissing
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.runs import true_runs
from solver_backend.io.motions.bvh import read_bvh
from solver_backend.training.data.retarget import RecordedClip, body_rotations, read_clip, recorded_from_bvh, resample
from solver_backend.training.data.shoulder_rhythm import with_shoulder_rhythm
from solver_backend.training.data.sources.amc_clips import read_amc, read_asf
from solver_backend.training.data.sources.gltf_clips import read_archive_clips
from solver_backend.training.data.sources.marker_takes import FIT_FPS, fitted_takes

FPS = 30.0
KEYED = "keyed"
"""Subject of hand-keyed animations."""
UNKNOWN = "unknown"
"""Subject of conversions that do not keep it."""
KEYED_ARCHIVE = "mesh2motion_cc0.tar.xz"
FAULT_DEG = 30.0
"""A joint this far beyond its anatomical range was tracked wrongly."""
_FOLDERS = ("mb2", "expmap", "max", "daz")
_AMC = ("11_01", "13_30", "13_31", "14_14", "14_20")
"""Motions that no other conversion holds; all CMU skeletons share their axes, so one serves."""
_BVH = "makehuman_data_bvhs_10_01.bvh"
_MIN_FRAMES = 3


@dataclass(frozen=True)
class Clip:
    """A clip ready for training."""

    name: str
    """Source and file, with a slash between."""
    subject: str
    rotations: np.ndarray
    """(F, 21, 3, 3) float32, local, 30 Hz."""


def load_clips(data: Path, progress: Progress = silent, *, cache: Path | None = None) -> list[Clip]:
    """Read CMU's recordings under ``data``, and the marker takes and hand-keyed animations where they are there.

    Args:
        data: folder that holds ``motion_cmu``.
        progress: called after every file.
        cache: folder that keeps the fitted marker takes, as fitting takes minutes.

    Raises:
        FileMissing: the folder holds no clips.
    """
    paths = [path for folder in _FOLDERS for path in sorted((data / "motion_cmu" / folder).glob("*.npz"))]
    if not paths:
        raise FileMissing("No training clips were found.", where="motion_cmu", hint="--data takes the folder above it.")
    clips = []
    for number, path in enumerate(paths):
        clips.append(_recorded(read_clip(path), path.parent.name, subject_of(path)))
        progress("Reading clips", number + 1, len(paths))
    clips += _acclaim(data / "motion_cmu" / "amc") + _makehuman(data / "poses_makehuman_cc0" / _BVH)
    archive = data / KEYED_ARCHIVE
    keyed = read_archive_clips(archive) if archive.is_file() else []
    clips += [Clip(f"{KEYED}/{clip.name}", KEYED, _at_corpus_rate(clip).astype(np.float32)) for clip in keyed]
    clips += _marker_takes(data / "markers" / "ui_prmd", cache, progress)
    return [piece for clip in clips for piece in without_faults(clip)]


def without_faults(clip: Clip) -> list[Clip]:
    """Return the frame ranges of a clip in which every joint is near its anatomical range."""
    sound = (excess_deg(clip.rotations.astype(np.float64)) < FAULT_DEG).all(axis=1)
    long = [slice(first, last + 1) for first, last in true_runs(sound) if last - first + 1 >= _MIN_FRAMES]
    return [Clip(clip.name, clip.subject, clip.rotations[frames]) for frames in long]


def subject_of(path: Path) -> str:
    """Return the CMU subject of a clip's file; UNKNOWN for conversions that do not keep it."""
    folder, stem = path.parent.name, path.stem
    if folder in ("mb2", "amc") and stem[:2].isdigit():
        return stem[:2]
    if folder == "daz":
        return "60_61" if stem.startswith("salsa") else "135"
    return "131" if folder == "max" else UNKNOWN


def _recorded(clip: RecordedClip, source: str, subject: str) -> Clip:
    """Return a clip of CMU's, whose collars do not move."""
    rotations = with_shoulder_rhythm(_at_corpus_rate(clip))
    return Clip(f"{source}/{clip.name}", subject, rotations.astype(np.float32))


def _at_corpus_rate(clip: RecordedClip) -> np.ndarray:
    return resample(body_rotations(clip)[:, 1:], clip.fps, FPS)


def _acclaim(folder: Path) -> list[Clip]:
    motions = [folder / f"{name}.amc.gz" for name in _AMC]
    found = [path for path in motions if path.is_file()]
    skeleton = read_asf(folder / "11.asf") if found else None
    return [_recorded(read_amc(path, skeleton), "amc", subject_of(path)) for path in found if skeleton]


def _makehuman(path: Path) -> list[Clip]:
    return [_recorded(recorded_from_bvh(read_bvh(path), path.stem), "makehuman", "10")] if path.is_file() else []


def _marker_takes(folder: Path, cache: Path | None, progress: Progress) -> list[Clip]:
    takes = fitted_takes(folder, cache, progress) if folder.is_dir() else []
    return [
        Clip(f"ui_prmd/{t.name}", f"ui_prmd_{t.subject}", resample(t.rotations, FIT_FPS, FPS).astype(np.float32))
        for t in takes
    ]
