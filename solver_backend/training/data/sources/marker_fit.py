"""Markers of a person fitted by plain least squares: shape, marker offsets, and every joint's rotation by itself."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.markers import marker_landmarks
from solver_backend.cameras.triangulation.triangulate import Triangulation
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, frame_equations, pose
from solver_backend.fitters.model.tangent import PoseTangent
from solver_backend.fitters.single_frame.fit import fit_frames, posed
from solver_backend.fitters.single_frame.start import Observations, fit_to_points
from solver_backend.fitters.subject_calibration.shape import ShapePrior, fit_shape, refit_shape
from solver_backend.geometry.rotations import left_jacobian_inverse_so3, log_so3
from solver_backend.priors.sposer import SPoser
from solver_backend.residuals.positions import PositionTerm
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import DenseBlocks


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


def fit_markers(
    labels: tuple[str, ...], markers: np.ndarray, body: Body, prior: SPoser, settings: MarkerFit = MarkerFit()
) -> FittedMarkers:
    """Fit shape and offsets on a sample of frames, all frames with the prior, then every joint by itself.

    Args:
        labels: L marker names.
        markers: (F, L, 3) metres, Z up, NaN where a marker is missing.
        body: the body.
        prior: where the fit starts, and what holds joints that no marker sees.
        settings: noise and priors.
    """
    count, num = markers.shape[:2]
    scales, seen = (settings.robust_scale,), np.isfinite(markers).all(-1)
    subject = Subject(body, marker_landmarks(body, labels), np.zeros(10), np.zeros((num, 3)))
    filled = np.where(seen[..., None], markers, 0.0)
    term = PositionTerm(filled, seen * settings.sigma_m**-2)
    coarse = PositionTerm(filled, seen * settings.coarse_sigma_m**-2)
    sample = np.unique(np.linspace(0, count - 1, settings.sample).astype(int))
    observations = _as_observations(markers)
    start = fit_to_points(subject, prior, observations, sample)
    subject, start = fit_shape(subject, prior, coarse.select(sample), start, scales, 15, settings.shape)
    frames = posed(prior, start)
    for _ in range(4):
        frames = free_joints(subject, frames, term.select(sample), prior, scale=scales[0])
        subject = refit_shape(subject, frames, term.select(sample), scales[0], settings.shape)
    everywhere = fit_to_points(subject, prior, observations, np.arange(count))
    everywhere, _ = fit_frames(subject, prior, term, everywhere, scales, 12)
    frames = free_joints(subject, posed(prior, everywhere), term, prior, scale=scales[0])
    distance = np.linalg.norm(pose(subject, frames).points - filled, axis=-1)
    return FittedMarkers(subject, frames, np.where(seen, distance, np.nan))


def free_joints(
    subject: Subject,
    start: PosedFrames,
    term: PositionTerm,
    prior: SPoser,
    *,
    scale: float,
    iterations: int = 12,
    block: int = 512,
) -> PosedFrames:
    """Fit every joint's rotation by itself, held to where it starts by the prior's own reconstruction error."""
    parts = [slice(i, i + block) for i in range(0, len(start.transl), block)]
    fitted = [_free(subject, start.select(p), term.select(p), prior, scale, iterations) for p in parts]
    return PosedFrames.concatenate(fitted)


def _free(
    subject: Subject, start: PosedFrames, term: PositionTerm, prior: SPoser, scale: float, iterations: int
) -> PosedFrames:
    precision = 1.0 / np.asarray(prior.residual_sigma) ** 2

    def linearise(frames: PosedFrames) -> tuple[np.ndarray, DenseBlocks]:
        equations = frame_equations(subject, frames, term, scale)
        away = log_so3(frames.local @ np.swapaxes(start.local, -1, -2))
        back = left_jacobian_inverse_so3(away)
        by_joints = np.swapaxes(back, -1, -2) @ (precision * away)[..., None]
        hessian, gradient = equations.hessian.copy(), equations.gradient.copy()
        gradient[:, PoseTangent.JOINTS] += by_joints.reshape(len(away), -1)
        for j in range(away.shape[1]):
            block = PoseTangent.joint(j)
            hessian[:, block, block] += np.swapaxes(back[:, j], -1, -2) @ (precision[j, :, None] * back[:, j])
        cost = equations.cost + 0.5 * (precision * away * away).sum((1, 2))
        return cost, DenseBlocks(hessian + 1e-3 * np.eye(hessian.shape[-1]), gradient)

    return levenberg_marquardt(
        start, linearise, PosedFrames.retract, lambda mask, new, old: new.where(mask, old),
        LMSettings(max_iterations=iterations),
    ).state  # fmt: skip


def _as_observations(markers: np.ndarray) -> Observations:
    """Return markers as if they had been triangulated, without error."""
    count, num = markers.shape[:2]
    return Observations(
        Triangulation(
            markers, np.zeros((count, num, 3, 3)), np.ones((1, count, num), bool), np.zeros((1, count, num)),
            np.ones(num),
        ),
        np.ones(num), np.ones(count, bool),
    )  # fmt: skip
