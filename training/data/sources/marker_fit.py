"""Markers of a person fitted by plain least squares: shape, marker offsets, and every joint's rotation by itself."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solver_backend.body.body import Body
from solver_backend.fitters.measurements.markers import measure_markers
from solver_backend.fitters.model.states import PosedFrames
from solver_backend.fitters.model.subject import FrameObjective, Subject, frame_equations, pose
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import fit_frames, fit_to_points, posed
from solver_backend.fitters.subject_calibration.shape import ShapePrior, fit_shape, refit_shape
from solver_backend.geometry.rotations import left_jacobian_inverse_so3, log_so3
from solver_backend.priors.sposer import SPoser
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import DenseBlocks
from solver_backend.types import MarkerCloud


@dataclass(frozen=True)
class MarkerFit:
    """How a person is fitted."""

    sigma_m: float = 0.004
    """Skin and marker noise."""
    coarse_sigma_m: float = 0.015
    """The same while the shape is unknown."""
    robust_scale: float = 1000.0
    """Geman-McClure's scale in sigmas; 1000 is plain least squares."""
    sample: int = 40
    """Frames that shape and offsets are found from."""
    shape: ShapePrior = field(default_factory=ShapePrior)
    """How far shape and offsets may go."""


@dataclass(frozen=True)
class FittedMarkers:
    """A person and their poses."""

    subject: Subject
    frames: PosedFrames
    residual_m: np.ndarray
    """(F, L) distance of every marker to the body's; NaN where it was not seen."""


def fit_markers(cloud: MarkerCloud, body: Body, prior: SPoser, settings: MarkerFit = MarkerFit()) -> FittedMarkers:
    """Fit shape and offsets on a sample of frames, all frames with the prior, then every joint by itself.

    Args:
        cloud: F frames of L named markers.
        body: the body.
        prior: where the fit starts, and what steadies joints that no marker sees.
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
    """Fit every joint's rotation by itself, drawn to where it starts by the prior's own reconstruction error."""
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
        start, linearise, PosedFrames.retract, LMSettings(max_iterations=iterations),
        lambda mask, new, old: new.where(mask, old),
    ).state  # fmt: skip
