"""Motion in from segments' rotations in C3D files (Theia3D, Visual3D), as a skeleton with a pose of rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileDamaged, MotionInvalid
from solver_backend.geometry.runs import true_runs
from solver_backend.io.markers.c3d import read_segments
from solver_backend.types import SkeletonMotion

_ROLES = {
    "pelvis": "pelvis", "abdomen": "spine_1", "thorax": "spine_2", "neck": "neck_1", "head": "head",
    **{f"{side}_{part}": f"{side}_{role}" for side in ("left", "right")
       for part, role in (("upper_arm", "upper_arm"), ("lower_arm", "forearm"), ("hand", "hand"), ("thigh", "thigh"),
                          ("shank", "shin"), ("foot", "foot"), ("toes", "toe"))},
}  # fmt: skip
"""Segments as ``c3d_rotations`` names them, parents first."""
_PARENTS = {
    "abdomen": "pelvis", "thorax": "abdomen", "neck": "thorax", "head": "neck",
    **{f"{side}_{part}": above if above in ("pelvis", "thorax") else f"{side}_{above}" for side in ("left", "right")
       for part, above in (("upper_arm", "thorax"), ("lower_arm", "upper_arm"), ("hand", "lower_arm"),
                           ("thigh", "pelvis"), ("shank", "thigh"), ("foot", "shank"), ("toes", "foot"))},
}  # fmt: skip
_LEAST_SEEN = 0.5
"""Share of the frames in which a segment is seen, at least."""


def read_c3d_segments(path: Path) -> tuple[SkeletonMotion, dict[str, str], list[Diagnostic]]:
    """Read the segments of a C3D file, the segment of each role, and what was found.

    The files keep no rest pose. Segments' axes are alike when a person stands with hanging arms (Z from the far joint
    to the near one): with all rotations zero the skeleton does. A joint's place in its parent's axes is the median.

    Raises:
        FileMissing, FileDamaged: see ``read_segments``, or it holds no rotations of segments.
        MotionInvalid: pelvis or legs are not among them.
    """
    segments = read_segments(path)
    where = str(path)
    if segments is None:
        hint = "Markers are solved: use 'solve' for them."
        raise FileDamaged("The C3D file holds no rotations of segments.", where=where, hint=hint)
    at = {label: s for s, label in enumerate(segments.labels)}
    seen = np.isfinite(segments.positions).all(-1).mean(0)
    names = tuple(name for name in _ROLES if name in at and seen[at[name]] > _LEAST_SEEN)
    needed = ("pelvis", *(f"{side}_{part}" for side in ("left", "right") for part in ("thigh", "shank", "foot")))
    if missing := [name for name in needed if name not in names]:
        raise MotionInvalid(f"The file has no segments {', '.join(missing)}.", where=where)
    index = [at[name] for name in names]
    places, G = _filled(segments.positions[:, index], segments.turns[:, index])
    unseen = true_runs(~np.isfinite(segments.positions[:, index]).all((1, 2)))
    found = [diagnostic("motion_segments_unseen", frames=unseen)] if unseen else []
    parents = tuple(names.index(_near(name, names)) if name != "pelvis" else -1 for name in names)
    rest = np.zeros((len(names), 3))
    for j, parent in enumerate(parents):
        if parent >= 0:
            local = np.swapaxes(G[:, parent], -1, -2) @ (places[:, j] - places[:, parent])[..., None]
            rest[j] = rest[parent] + np.median(local[..., 0], axis=0)
    if segments.rate is None or not segments.rate > 0:
        raise FileDamaged("The file states no frame rate.", where=where)
    motion = SkeletonMotion(path.stem, names, parents, rest, places, G, segments.rate)
    return motion, {_ROLES[name]: name for name in names}, found


def _near(name: str, names: tuple[str, ...]) -> str:
    """Return the next segment above that the file has."""
    above = _PARENTS[name]
    while above not in names:
        above = _PARENTS[above]
    return above


def _filled(places: np.ndarray, G: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places and rotations in which a segment that is not seen stays as it was, or will be."""
    known = np.isfinite(places).all(-1)
    frames = np.arange(len(places))[:, None]
    last = np.maximum.accumulate(np.where(known, frames, -1), axis=0)
    last = np.where(last < 0, known.argmax(0), last)
    columns = np.arange(places.shape[1])
    return places[last, columns], G[last, columns]
