"""From a capture to a motion: the one entry that the command line, the job file and the add-on use."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend import __version__
from solver_backend.body.files.choices import load_chosen_body, resolve_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.exchange.errors import BackendMissing, NoDetections, TakeTooShort
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.keyframes.frame_range import Stretch
from solver_backend.fitters.keyframes.global_method import BundleSolution, solve_by_bundle, solve_by_sliding
from solver_backend.fitters.keyframes.resolve_range import solve_stretch
from solver_backend.fitters.measurements.sanitise import check_capture
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.output.build_motion import build_motion
from solver_backend.fitters.problem import Problem, learn_subject
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.single_frame.method import solve_by_frame
from solver_backend.fitters.single_frame.start import observe
from solver_backend.geometry.arrays import Array, constant
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import Capture, Motion


def solve(
    capture: Capture, settings: SolveSettings = SolveSettings(), progress: Progress = silent, *,
    prior: AutoencodingPrior | None = None,
) -> Motion:  # fmt: skip
    """Solve the motion of the person in a multi-view capture.

    Args:
        capture: calibrated cameras and 2D keypoints.
        settings: method, backend and the rest.
        progress: called as stages advance.
        prior: decoder of poses from codes on SPoser's sphere; SPoser as it ships if None.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
        TakeTooShort: the bundle was asked for on fewer than 4 frames.
        BackendMissing: torch was asked for and is not installed.
        BodyUnknown, BodyInvalid, UnsafePickle: there is no such body, or its file is none.
    """
    problem, subject = prepare(capture, settings, progress)
    problem = problem if prior is None else replace(problem, prior=prior)
    subject = learn_subject(problem, subject, settings, progress)
    if settings.method == "frame":
        frames = solve_by_frame(problem, subject, settings, progress)
        solution = BundleSolution(subject, frames, np.arange(0), None)
    else:
        run = solve_by_sliding if settings.method == "sliding" else solve_by_bundle
        solution = run(problem, subject, settings, progress)
    return build_motion(
        problem.capture,
        solution.subject,
        solution.frames,
        problem.observations,
        key_times=solution.key_times,
        covariance=solution.covariance,
        contacts=solution.contacts,
        scale=settings.robust_scale,
        provenance=_provenance(capture, settings, problem),
    )


def resolve(
    capture: Capture, motion: Motion, stretch: Stretch, settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
) -> Motion:  # fmt: skip
    """Solve a stretch of an earlier motion again, through poses that a person pinned; see ``solve_stretch``.

    Raises:
        JobInvalid: the stretch is none of this take.
        MotionInvalid: the motion belongs to another take or body.
        TooFewViews, NoDetections, BackendMissing: as in ``solve``.
    """
    problem, subject = prepare(capture, settings, progress)
    return solve_stretch(problem, subject, motion, stretch, settings, progress)


def prepare(capture: Capture, settings: SolveSettings, progress: Progress) -> tuple[Problem, Subject]:
    """Return the capture made ready for a solver, and the average person.

    Raises:
        TooFewViews, NoDetections, TakeTooShort, BackendMissing, BodyUnknown, BodyInvalid: as in ``solve``.
    """
    cameras, keypoints = capture.require_multiview()
    if settings.method != "frame" and keypoints.num_frames < 4:
        raise TakeTooShort(
            f"The bundle needs 4 frames, the take has {keypoints.num_frames}.", where=capture.name,
            hint="Use the method 'frame' for single images.",
        )  # fmt: skip
    progress("Triangulating", 0, 1)
    observations = observe(cameras, keypoints)
    progress("Triangulating", 1, 1)
    checked = check_capture(capture, observations, progress, estimate_sync=settings.estimate_sync)
    capture, observations = checked.capture, checked.observations
    cameras, keypoints = capture.require_multiview()
    if not observations.seen.any():
        raise NoDetections(
            "In no frame do two cameras agree on enough keypoints to place a body.", where=capture.name,
            hint="Check that the calibration belongs to this recording and that the cameras are synchronised.",
        )  # fmt: skip
    body, prior = load_chosen_body(settings.body), load_sposer()
    like = _origin(settings.backend)
    term = ReprojectionTerm.of(cameras, keypoints, observations.sigma_px, like)
    problem = Problem(body, prior, observations, term, keypoints.fps, keypoints.num_frames, capture, checked.faults)
    subject = Subject(
        body, keypoint_landmarks(body, keypoints.joint_set), constant(settings.betas or np.zeros(10), like),
        constant(np.zeros((keypoints.joint_set.num_keypoints, 3)), like),
    )  # fmt: skip
    return problem, subject


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


def _provenance(capture: Capture, settings: SolveSettings, problem: Problem) -> dict[str, Any]:
    return {
        "solver": __version__,
        "settings": asdict(settings),
        "body": problem.body.id,
        "body_file": _fingerprint(resolve_body(settings.body)),
        "prior": {"name": problem.prior.name, "weights": problem.prior.metadata.get("sha256")},
        "capture": capture.name,
        "sources": list(capture.sources),
        "findings": [fault.as_dict() for fault in problem.faults],
        "sigma_px": [round(float(s), 3) for s in problem.observations.sigma_px],
    }


def _fingerprint(path: Path) -> dict[str, str]:
    return {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
