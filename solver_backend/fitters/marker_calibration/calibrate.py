"""Subject calibration from markers: shape, every marker's place and the poses of varied frames, in one problem."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.markers import placement_precision
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.marker_calibration.calibration_equations import PlacementPrior, calibration_equations
from solver_backend.fitters.marker_calibration.calibration_state import CalibrationState
from solver_backend.fitters.marker_calibration.first_size import first_shape
from solver_backend.fitters.marker_calibration.frame_choice import varied_frames
from solver_backend.fitters.measurements.markers import SIGMA_M
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.partial_body.informed_parts import uninformed_parts
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.single_frame.fit import fit_frames
from solver_backend.fitters.single_frame.start import fit_to_points
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.geometry.symmetric import inverse_symmetric_3x3
from solver_backend.residuals.point_term import DataTerm
from solver_backend.residuals.robust import geman_mcclure, graduated_scales
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import Arrowhead

FRAMES = 64
"""Frames from which a person is learned."""
STAGE = "Calibrating the person"
PRIOR_FRAMES = 4.0
"""Frames' worth of evidence that a marker strays as far as all are first taken to."""
POSE_FRAMES = 24.0
"""What is known of poses counts, for all frames together, as much as for so many at most: what the prior finds unlikely
in one pose of a person, by posture or by how their bones differ, it finds in others. Of 64 frames counted one by one it
moves markers that sit on their places by a centimetre; counted for one alone, real people's hidden markers are
predicted worse (docs/research-log/sensors.md)."""
SIGMA_RANGE_M = (0.003, 0.03)
"""Least and largest standard deviation of a marker."""
SCORING_STEPS = 4
ROBUST_SCALE = 4.0
"""Of a marker's frames when its deviation is learned."""
SHAPE_LIMIT = 3.5
"""Deviations that a shape coefficient reaches where parts of the body have no markers: markers
on the rest do not separate all coefficients, and those that they leave open run away."""
BEYOND_START = 0.5
"""Deviations beyond the shape of the markers' size, where that is larger: a child's legs alone. Chosen by hand."""
HELD = 1e6
"""Precision of a coefficient held at its limit: 64 frames of 14 markers give about 4,000."""
KNOWN = 1e12
"""Precision of a shape that is given."""


@dataclass(frozen=True)
class SubjectCalibration:
    """What a calibration finds."""

    subject: Subject
    """The person, their markers as landmarks."""
    sigma_m: np.ndarray
    """(L,) standard deviation of each marker around where the body has it, per axis, metres."""
    frames: np.ndarray
    """Numbers of the frames that were looked at."""
    poses: PosedFrames
    """Their poses."""


def calibrate(problem: Problem, like: Array, settings: SolveSettings, progress: Progress) -> SubjectCalibration:
    """Return the person that varied frames of a take determine: shape, places of the markers, and how far these stray.

    Args:
        problem: markers made ready.
        like: array that sets kind, type and device.
        settings: robust scale, iterations, and the shape where it is known.
        progress: called as stages advance.
    """
    subject = Subject.average(problem.body, problem.measurements.landmarks, like)
    points = problem.measurements.points
    start = first_shape(problem.body, problem.measurements.landmarks, points)
    subject = replace(subject, betas=constant(start if settings.betas is None else settings.betas, subject.betas))
    frames = varied_frames(points, FRAMES)
    progress(STAGE, 0, 3)
    states = fit_to_points(problem, subject, frames)
    progress(STAGE, 1, 3)
    objective, steps = problem.objective.select(frames), LMSettings(settings.iterations)
    states = fit_frames(subject, problem.prior, objective, states, (4 * settings.robust_scale,), steps).state
    progress(STAGE, 2, 3)
    weight = min(1.0, POSE_FRAMES / len(frames))

    def fit(state: CalibrationState, placement: PlacementPrior, scale: float) -> CalibrationState:
        def linearise(s: CalibrationState) -> tuple[Array, Arrowhead]:
            return calibration_equations(problem.prior, objective, placement, s, scale, weight)

        return levenberg_marquardt(state, linearise, CalibrationState.retract, steps).state

    placement, state = placement_prior(subject, settings), CalibrationState.of(subject, problem.prior, states)
    for scale in graduated_scales(settings.robust_scale, 4 * settings.robust_scale, 3):
        state = fit(state, placement, scale)
    if settings.betas is None and uninformed_parts(problem.body, problem.measurements):
        # An active set: a wall inside the fit stops its steps short, poses and places included.
        limit = np.maximum(SHAPE_LIMIT, np.abs(start) + BEYOND_START)
        while (held := held_at_limit(placement, to_numpy(state.subject.betas), limit)) is not None:
            placement = held
            state = fit(state, placement, settings.robust_scale)
    progress(STAGE, 3, 3)
    poses = state.poses(problem.prior)
    measured = problem.measurements
    sigma = marker_sigma(
        measured.term.select(frames), pose(state.subject, poses).points, measured.covariance[frames]
    )  # fmt: skip
    return SubjectCalibration(state.subject, sigma, frames, poses)


def marker_sigma(term: DataTerm, points: Array, noise: np.ndarray) -> np.ndarray:
    """Return (L,) standard deviations per axis, metres, of markers around their places, without the tracker's noise Σ.

    ``s² = (Σ_f w s⁴ (|P r|² - tr P Σ P) / 3 + n s₀²) / (Σ_f w s⁴ tr P² / 3 + n)`` with ``P = (s² 1 + Σ)⁻¹``, a few
    steps of Fisher scoring; where Σ = 0 that is ``(Σ_f w |r|² / 3 + n s₀²) / (Σ_f w + n)`` at once. w is
    Geman-McClure's weight and s₀ what was assumed, worth n frames.

    Args:
        term: markers of the frames that were looked at.
        points: (F, L, 3) where the body has them.
        noise: (F, L, 3, 3) m², what the tracker reports of each marker's error.

    Reference: Rao 1971, "Estimation of variance and covariance components — MINQUE theory".
    """
    found = term.residuals(points)
    error, squared = to_numpy(found.error)[0], to_numpy(found.squared)[0]
    share = to_numpy(found.measured)[0] * geman_mcclure(squared, ROBUST_SCALE)[1] / 3
    variance = np.full(share.shape[1], SIGMA_M**2)
    for _ in range(SCORING_STEPS):
        P = inverse_symmetric_3x3(variance[:, None, None] * np.eye(3) + noise, smallest=0.0) * variance[:, None, None]
        own = ((P @ error[..., None])[..., 0] ** 2).sum(-1) - np.einsum("flij,fljk,flki->fl", P, noise, P)
        square = (share * own).sum(0) + PRIOR_FRAMES * SIGMA_M**2
        freedom = (share * (P * P).sum((-2, -1))).sum(0) + PRIOR_FRAMES
        variance = np.clip(square / freedom, SIGMA_RANGE_M[0] ** 2, SIGMA_RANGE_M[1] ** 2)
    return np.sqrt(variance)


def placement_prior(subject: Subject, settings: SolveSettings) -> PlacementPrior:
    """Return what is known of shape and places: people's spread, and how far each kind of marker strays."""
    like = subject.betas
    shape = np.full(10, 1.0 if settings.betas is None else KNOWN)
    mean = np.zeros(10) if settings.betas is None else np.asarray(settings.betas, dtype=np.float64)
    places = placement_precision(subject.body, subject.landmarks.names)
    return PlacementPrior(constant(shape, like), constant(mean, like), constant(places, like))


def held_at_limit(
    placement: PlacementPrior, betas: np.ndarray, limit: float | np.ndarray = SHAPE_LIMIT
) -> PlacementPrior | None:
    """Return the prior that holds coefficients at a limit which are beyond it; None where no other one is."""
    precision, mean = to_numpy(placement.shape), to_numpy(placement.shape_mean)
    beyond = (np.abs(betas) > limit) & (precision < HELD)
    if not beyond.any():
        return None
    precision = np.where(beyond, HELD, precision)
    mean = np.where(beyond, np.sign(betas) * limit, mean)
    return replace(
        placement, shape=constant(precision, placement.shape), shape_mean=constant(mean, placement.shape_mean)
    )
