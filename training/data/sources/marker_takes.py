"""UI-PRMD's marker takes (rehabilitation movements of eight people) as body rotations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.npz import write_npz
from solver_backend.exchange.progress import Progress, silent
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import MarkerCloud
from training.data.sources.marker_fit import MarkerFit, fit_markers

FIT_FPS = 10.0
"""Rate of the fit: the movements last seconds."""
FIT = MarkerFit(robust_scale=5.0, sample=80)
"""How takes are fitted; chosen by hand."""
_UNIT_M = 1e-4
"""Metres in a unit of these files, a tenth of a millimetre."""
_CACHE = "ui_prmd_poses.npz"


@dataclass(frozen=True)
class FittedTake:
    """One take after the fit."""

    name: str
    """As the file: movement, subject, episode."""
    subject: str
    """s01 to s08."""
    rotations: np.ndarray
    """(F, 21, 3, 3) local, at ``FIT_FPS``."""
    residual_mm: np.ndarray
    """(F,) mean distance of the markers to the body's."""


def fitted_takes(folder: Path, cache: Path | None = None, progress: Progress = silent) -> list[FittedTake]:
    """Fit every take, one body a person; kept in ``cache`` (a folder), as it takes minutes.

    Raises:
        FileDamaged: a take cannot be read.
    """
    paths = sorted(folder.glob("m*_s*_e*.npz"))
    by_subject: dict[str, list[Path]] = {}
    for path in paths:
        by_subject.setdefault(path.stem.split("_")[1], []).append(path)
    takes: list[FittedTake] = []
    for number, (subject, files) in enumerate(sorted(by_subject.items())):
        kept = cache / f"{subject}_{_CACHE}" if cache else None
        takes += _read(kept, subject) if kept and kept.is_file() else _fit(subject, files, kept)
        progress("Fitting marker takes", number + 1, len(by_subject))
    return takes


def read_markers(path: Path) -> tuple[tuple[str, ...], np.ndarray]:
    """Return labels and (F, 39, 3) metres at ``FIT_FPS``; missing markers, which the files put at the origin, are NaN.

    Raises:
        FileDamaged: the take cannot be read.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            labels, positions, fps = data["labels"], data["positions_01mm"], float(data["fps"])
    except (OSError, ValueError, KeyError) as error:
        raise FileDamaged("The marker take cannot be read.", where=path.name, hint=str(error)) from error
    every = max(1, round(fps / FIT_FPS))
    markers = positions[::every].astype(np.float64) * _UNIT_M
    return tuple(str(label) for label in labels), np.where((markers == 0).all(-1, keepdims=True), np.nan, markers)


def _fit(subject: str, files: list[Path], kept: Path | None) -> list[FittedTake]:
    read = [read_markers(path) for path in files]
    ends = np.cumsum([len(markers) for _, markers in read])
    cloud = MarkerCloud(np.concatenate([m for _, m in read]), FIT_FPS, read[0][0])
    fit = fit_markers(cloud, load_body(), load_sposer(), FIT)
    rotations = np.split(fit.frames.local.astype(np.float32), ends[:-1])
    residual = np.split(1000 * np.nanmean(fit.residual_m, axis=1), ends[:-1])
    names = [path.stem for path in files]
    if kept:
        arrays = {"names": np.array(names), "ends": ends, "rotations": np.concatenate(rotations)}
        write_npz(kept, {**arrays, "residual_mm": np.concatenate(residual)}, overwrite=True)
    return [FittedTake(n, subject, R, r) for n, R, r in zip(names, rotations, residual, strict=True)]


def _read(kept: Path, subject: str) -> list[FittedTake]:
    with kept.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
        ends = data["ends"][:-1]
        rotations, residual = np.split(data["rotations"], ends), np.split(data["residual_mm"], ends)
        names = [str(name) for name in data["names"]]
    return [FittedTake(n, subject, R, r) for n, R, r in zip(names, rotations, residual, strict=True)]
