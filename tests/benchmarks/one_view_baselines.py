"""Other methods for a take of one camera: separate frames, and Pose-NDF's image fitting, both from the lifter.

MediaPipe's world points are in none of the recordings.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.exchange.progress import silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.pipeline import first_subject, prepare
from solver_backend.fitters.pose_ndf.complete import fit_keypoints
from solver_backend.fitters.problem import Measurements, Problem, RoughMotion
from solver_backend.fitters.single_frame import fit_frames, posed
from solver_backend.metrics.positions import pa_mpjpe_mm
from solver_backend.priors.pose_ndf import load_pose_ndf
from solver_backend.solver.levenberg_marquardt import LMSettings
from tests.benchmarks.one_view_takes import OneViewTake
from tests.support.limb_errors import LIMBS

SCALES = (8.0, 4.0)  # Robust scales of single frames, as in solves of one camera.
EVERY = 10  # Step in frames of Pose-NDF's fits, which take a second per dozen.


def frame_pa_mm(take: OneViewTake) -> float:
    """Return the error in mm after the best similarity, for separate solves of each frame from the lifter's poses."""
    problem, subject = _problem(take)
    measured = problem.measurements
    rough = _rough(measured)
    objective = problem.objective
    fitted = fit_frames(
        subject, problem.prior, objective.select(rough.frames), rough.states, SCALES, LMSettings(20, 1e-3)
    )  # fmt: skip
    return _pa_mm(pose(subject, posed(problem.prior, fitted.state)).skeleton.joints, take.joints[rough.frames])


def manifold_pa_mm(take: OneViewTake) -> float:
    """Return the error in mm of Pose-NDF's image fitting (Tiwari et al. 2022, eq. 10) from the lifter's poses."""
    problem, subject = _problem(take)
    rough = _rough(problem.measurements)
    chosen = np.arange(0, len(rough.frames), EVERY)
    frames = rough.frames[chosen]
    start = posed(problem.prior, rough.states.select(chosen))
    found = fit_keypoints(subject, load_pose_ndf(), problem.measurements.term.select(frames), start)
    joints = pose(replace(subject, betas=found.betas), found.frames).skeleton.joints
    return _pa_mm(joints, take.joints[frames])


def _problem(take: OneViewTake) -> tuple[Problem, Subject]:
    settings = SolveSettings()
    problem = prepare(take.capture, settings, silent)
    return problem, first_subject(problem, settings)


def _rough(measured: Measurements) -> RoughMotion:
    assert measured.rough is not None
    return measured.rough


def _pa_mm(joints: np.ndarray, truth: np.ndarray) -> float:
    return pa_mpjpe_mm(np.asarray(joints)[:, LIMBS], truth[:, LIMBS])
