"""From a capture to a motion: the one entry that the command line, the job file and the add-on use."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend import __version__
from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.errors import BackendMissing, NoDetections, TakeTooShort
from solver_backend.fitters.bundle import Schedule, solve_global, solve_sliding
from solver_backend.fitters.frame import FrameStates, bridged_states, fit_frames, posed
from solver_backend.fitters.initial import Observations, fit_to_points, observe, sample_frames
from solver_backend.fitters.keyframes import KeyframeLayout, Keyframes, bundle_frames, hemisphere_aligned, resampled
from solver_backend.fitters.motion_prior import MotionPrior
from solver_backend.fitters.result import build_motion
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.shape import ShapePrior, fit_shape, refit_shape
from solver_backend.fitters.subject import PosedFrames, Subject
from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.rotations import quat_from_matrix
from solver_backend.priors.sposer import DEFAULT_WEIGHTS, load_sposer
from solver_backend.progress import Progress, silent
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.robust import graduated_scales
from solver_backend.types import Capture, Motion

SAMPLE_FRAMES = 32
"""Frames from which shape and detector bias are learned."""


@dataclass(frozen=True)
class Problem:
    """A capture made ready for a solver."""

    body: Body
    prior: Any
    observations: Observations
    term: ReprojectionTerm
    fps: float
    num_frames: int


def solve(capture: Capture, settings: SolveSettings = SolveSettings(), progress: Progress = silent) -> Motion:
    """Solve the motion of the person in a multi-view capture.

    Args:
        capture: calibrated cameras and 2D keypoints.
        settings: method, backend and the rest.
        progress: called as stages advance.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
        TakeTooShort: the bundle was asked for on fewer than 4 frames.
        BackendMissing: torch was asked for and is not installed.
    """
    cameras, keypoints = capture.require_multiview()
    if settings.method == "bundle" and keypoints.num_frames < 4:
        raise TakeTooShort(
            f"The bundle needs 4 frames, the take has {keypoints.num_frames}.", where=capture.name,
            hint="Use the method 'frame' for single images.",
        )  # fmt: skip
    progress("Triangulating", 0, 1)
    observations = observe(cameras, keypoints)
    progress("Triangulating", 1, 1)
    if not observations.seen.any():
        raise NoDetections(
            "In no frame do two cameras agree on enough keypoints to place a body.", where=capture.name,
            hint="Check that the calibration belongs to this recording and that the cameras are synchronised.",
        )  # fmt: skip
    body, prior = load_body(), load_sposer()
    like = _origin(settings.backend)
    term = ReprojectionTerm.of(cameras, keypoints, observations.sigma_px, like)
    problem = Problem(body, prior, observations, term, keypoints.fps, keypoints.num_frames)
    subject = Subject(
        body, keypoint_landmarks(body, keypoints.joint_set), constant(settings.betas or np.zeros(10), like),
        constant(np.zeros((keypoints.joint_set.num_keypoints, 3)), like),
    )  # fmt: skip
    subject = learn_subject(problem, subject, settings, progress)
    if settings.method == "frame":
        subject, frames, key_times = _solve_frames(problem, subject, settings, progress)
    else:
        subject, frames, key_times = _solve_bundle(problem, subject, settings, progress)
    return build_motion(
        capture, subject, frames, observations,
        key_times=key_times, scale=settings.robust_scale, provenance=_provenance(capture, settings, body, observations),
    )  # fmt: skip


def learn_subject(problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress) -> Subject:
    """Return the subject with shape and detector bias learned from a sample of frames."""
    frames = sample_frames(problem.observations, SAMPLE_FRAMES)
    progress("Learning the body", 0, 3)
    states = fit_to_points(subject, problem.prior, problem.observations, frames)
    progress("Learning the body", 1, 3)
    term = problem.term.select(frames)
    states, _ = fit_frames(subject, problem.prior, term, states, (4 * settings.robust_scale,), settings.iterations)
    progress("Learning the body", 2, 3)
    scales = graduated_scales(settings.robust_scale, 3 * settings.robust_scale, 2)
    free = settings.betas is None
    subject, _ = fit_shape(
        subject, problem.prior, term, states, scales, settings.iterations, free_betas=free, free_offsets=False
    )
    progress("Learning the body", 3, 3)
    return subject


def _solve_frames(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress
) -> tuple[Subject, PosedFrames, np.ndarray]:
    """Fit every seen frame on its own; unseen frames are bridged between their neighbours."""
    seen = np.flatnonzero(problem.observations.seen)
    states = fit_to_points(subject, problem.prior, problem.observations, seen)
    scales = graduated_scales(settings.robust_scale, 4 * settings.robust_scale, 3)
    states, _ = fit_frames(
        subject, problem.prior, problem.term.select(seen), states, scales, settings.iterations, progress
    )  # fmt: skip
    return subject, posed(problem.prior, bridged_states(states, seen, problem.num_frames)), np.arange(0)


def _solve_bundle(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress
) -> tuple[Subject, PosedFrames, np.ndarray]:
    """Sliding pass, then all keyframes at once with shape, bias and residual rotations in turn."""
    layout = KeyframeLayout.even(problem.num_frames, settings.window)
    keys = initial_keys(problem, subject, layout)
    scales = graduated_scales(settings.robust_scale, 3 * settings.robust_scale, 2)
    keys = solve_sliding(
        subject, problem.prior, problem.term, layout, keys, Schedule(scales, settings.iterations), progress
    )  # fmt: skip
    residuals = settings.refine and settings.residual_rotations
    if settings.refine:
        finer = KeyframeLayout.even(problem.num_frames, settings.refine_window)
        keys, layout = resampled(keys, layout, finer), finer
        subject, keys = _refine(problem, subject, layout, keys, settings, residuals, progress)
    frames = bundle_frames(problem.prior, keys, layout.window, layout.time, residuals=residuals, jacobian=False)
    return subject, frames.poses, layout.key_times


def _refine(
    problem: Problem, subject: Subject, layout: KeyframeLayout, keys: Keyframes, settings: SolveSettings,
    residuals: bool, progress: Progress,
) -> tuple[Subject, Keyframes]:  # fmt: skip
    spacing = 0.5 * settings.refine_window
    motion_prior = MotionPrior(spacing / problem.fps, problem.prior.residual_sigma, frames_per_key=0.5 * spacing)
    steps = (
        (False, (2 * settings.robust_scale,)),
        (residuals, (settings.robust_scale,)),
        (residuals, (settings.robust_scale,)),
    )
    sample = np.unique(np.linspace(0, problem.num_frames - 1, min(problem.num_frames, 200)).astype(int))
    for number, (free, scales) in enumerate(steps):
        keys, _ = solve_global(
            subject, problem.prior, problem.term, layout, keys, Schedule(scales, settings.iterations), motion_prior,
            residuals=free,
        )  # fmt: skip
        if number < len(steps) - 1:
            frames = bundle_frames(
                problem.prior, keys, layout.window[sample], layout.time[sample], residuals=free, jacobian=False
            )
            subject = refit_shape(
                subject, frames.poses, problem.term.select(sample), settings.robust_scale, ShapePrior(),
                free_betas=settings.betas is None,
            )  # fmt: skip
        progress("Global bundle", number + 1, len(steps))
    return subject, keys


def initial_keys(problem: Problem, subject: Subject, layout: KeyframeLayout) -> Keyframes:
    """Return keyframes fitted to the triangulated points of the seen frames nearest to them."""
    seen = np.flatnonzero(problem.observations.seen)
    nearest = seen[np.abs(layout.key_times[:, None] - seen).argmin(axis=1)]
    unique, inverse = np.unique(nearest, return_inverse=True)
    states: FrameStates = fit_to_points(subject, problem.prior, problem.observations, unique)
    index = np.asarray(inverse).reshape(-1)
    residual = constant(np.zeros((layout.num_keys, 21, 3)), states.z)
    keys = Keyframes(states.z[index], quat_from_matrix(states.root)[index], states.transl[index], residual)
    return hemisphere_aligned(keys)


def _origin(backend: str) -> Array:
    """Return an array of the backend's kind that constants take after."""
    if backend == "numpy":
        return np.zeros(1)
    try:
        import torch
    except ImportError as error:
        raise BackendMissing(
            "The torch backend was asked for, and torch is not installed.",
            hint="Install torch in this Python, or use the backend 'numpy'.",
        ) from error
    return torch.zeros(1, dtype=torch.float64)


def _provenance(capture: Capture, settings: SolveSettings, body: Body, observations: Observations) -> dict[str, Any]:
    weights = Path(DEFAULT_WEIGHTS)
    return {
        "solver": __version__,
        "settings": asdict(settings),
        "body": body.id,
        "prior": {"file": weights.name, "sha256": hashlib.sha256(weights.read_bytes()).hexdigest()},
        "capture": capture.name,
        "sources": list(capture.sources),
        "sigma_px": [round(float(s), 3) for s in observations.sigma_px],
    }
