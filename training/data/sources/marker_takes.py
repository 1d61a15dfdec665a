"""Fit body rotations to the marker takes of UI-PRMD (rehabilitation exercises by eight people)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.npz import write_npz
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.measurements.markers import measure_markers
from solver_backend.fitters.model.subject import FrameObjective, PosedFrames, Subject, frame_equations, pose
from solver_backend.fitters.person_shape import ShapePrior, fit_shape, refit_shape
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import fit_frames, fit_to_points, posed
from solver_backend.geometry.rotations import left_jacobian_inverse_so3, log_so3
from solver_backend.priors.sposer import SPoser, load_sposer
from solver_backend.solver.levenberg_marquardt import DenseBlocks, LMSettings, levenberg_marquardt
from solver_backend.types import MarkerCloud


@dataclass(frozen=True)
class MarkerFit:
    """Settings for fitting a body to one person's markers."""

    sigma_m: float = 0.004  # Standard deviation of skin movement and marker noise.
    coarse_sigma_m: float = 0.015  # Standard deviation while the shape is unknown.
    robust_scale: float = 1000.0  # Geman-McClure scale in sigmas. 1000 is practically least squares.
    sample: int = 40  # Number of frames from which shape and offsets are estimated.
    shape: ShapePrior = field(default_factory=ShapePrior)  # Prior for shape and offsets.


@dataclass(frozen=True)
class FittedMarkers:
    """Person, poses and residuals of a marker fit."""

    subject: Subject
    frames: PosedFrames
    residual_m: np.ndarray  # (F, L) distance between each marker and its point on the body, NaN if unseen.


def fit_markers(cloud: MarkerCloud, body: Body, prior: SPoser, settings: MarkerFit = MarkerFit()) -> FittedMarkers:
    """Fit shape and marker offsets to sampled frames, then the poses of all frames, then each joint's rotation.

    Args:
        cloud: F frames of L named markers.
        body: body to fit.
        prior: prior that initialises the fit and regularises joints that have no visible markers.
        settings: noise and priors.

    Raises:
        MarkersUnknown, NoDetections: as in ``measure_markers``.
    """
    fine = Problem.of(body, prior, measure_markers(cloud, body, np.zeros(1), settings.sigma_m))
    coarse = measure_markers(cloud, body, np.zeros(1), settings.coarse_sigma_m).term
    subject = Subject.average(body, fine.measurements.landmarks, np.zeros(1))
    count, scales = fine.num_frames, (settings.robust_scale,)
    sample = np.unique(np.linspace(0, count - 1, settings.sample).astype(int))
    start, coarse = fit_to_points(fine, subject, sample), FrameObjective((coarse.select(sample),), fine.pose_terms)
    subject, start = fit_shape(subject, prior, coarse, start, scales, LMSettings(15), settings.shape)
    frames, objective = posed(prior, start), fine.objective.select(sample)
    for _ in range(4):
        frames = free_joints(subject, frames, objective, prior, scale=scales[0])
        subject = refit_shape(subject, frames, objective, scales[0], settings.shape)
    everywhere = fit_to_points(fine, subject, np.arange(count))
    everywhere = fit_frames(subject, prior, fine.objective, everywhere, scales, LMSettings(12)).state
    frames = free_joints(subject, posed(prior, everywhere), fine.objective, prior, scale=scales[0])
    distance = np.linalg.norm(pose(subject, frames).points - fine.measurements.points, axis=-1)
    return FittedMarkers(subject, frames, distance)


def free_joints(
    subject: Subject,
    start: PosedFrames,
    objective: FrameObjective,
    prior: SPoser,
    *,
    scale: float,
    iterations: int = 12,
    block: int = 512,
) -> PosedFrames:
    """Fit joint rotations instead of codes. The prior's reconstruction error limits their change from the start."""
    parts = [slice(i, i + block) for i in range(0, len(start.transl), block)]
    fitted = [_free(subject, start.select(p), objective.select(p), prior, scale, iterations) for p in parts]
    return PosedFrames.concatenate(fitted)


def _free(
    subject: Subject, start: PosedFrames, objective: FrameObjective, prior: SPoser, scale: float, iterations: int
) -> PosedFrames:
    precision = 1.0 / np.asarray(prior.residual_sigma) ** 2

    def linearise(frames: PosedFrames) -> tuple[np.ndarray, DenseBlocks]:
        equations = frame_equations(subject, frames, objective, scale)
        away = log_so3(frames.local @ np.swapaxes(start.local, -1, -2))
        back = left_jacobian_inverse_so3(away)
        by_joints = np.swapaxes(back, -1, -2) @ (precision * away)[..., None]
        hessian, gradient = equations.hessian.copy(), equations.gradient.copy()
        gradient[:, frames.layout.joints] += by_joints.reshape(len(away), -1)
        for j in range(away.shape[1]):
            block = frames.layout.joint(j)
            hessian[:, block, block] += np.swapaxes(back[:, j], -1, -2) @ (precision[j, :, None] * back[:, j])
        cost = equations.cost + 0.5 * (precision * away * away).sum((1, 2))
        return cost, DenseBlocks(hessian + 1e-3 * np.eye(hessian.shape[-1]), gradient)

    return levenberg_marquardt(
        start,
        linearise,
        PosedFrames.retract,
        LMSettings(max_iterations=iterations),
        lambda mask, new, old: new.where(mask, old),
    ).state


FIT_FPS = 10.0  # Frame rate of the fit, which is enough for movements that take seconds.
FIT = MarkerFit(robust_scale=5.0, sample=80)  # Settings of the fit. Chosen by hand.
_UNIT_M = 1e-4  # Metres per unit of these files, a tenth of a millimetre.
_CACHE = "ui_prmd_poses.npz"


@dataclass(frozen=True)
class FittedTake:
    """Body rotations fitted to one marker take, and their residuals."""

    name: str  # File name: movement, subject, episode.
    subject: str  # Subject, s01 to s08.
    rotations: np.ndarray  # (F, 21, 3, 3) local rotations at ``FIT_FPS``.
    residual_mm: np.ndarray  # (F,) mean distance in mm between markers and their points on the body.


def fitted_takes(folder: Path, cache: Path | None = None, progress: Progress = silent) -> list[FittedTake]:
    """Fit every take, with one body per person. The results are stored in ``cache``, because fitting takes minutes.

    Raises:
        FileDamaged: a take is damaged.
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
    """Return labels and positions (F, 39, 3) in metres at ``FIT_FPS``. Missing markers (zeros in the files) are NaN.

    Raises:
        FileDamaged: the take is damaged.
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
