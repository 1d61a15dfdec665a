"""Own points of a user: placed on their bones by a first solve, and measured with the body in a second.

The place of a point is found as that of a marker of no known layout is: ``o = median_f G_bᵀ (x - p_b)`` with the turn G
and the joint p of its bone b (see ``attach_unknown``). Where the first solve guessed a bone's turn, the place shares
that error, so places, shape and the poses of a sample of frames are then fitted together (see ``fit_shape``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.landmark_set import Landmarks
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.marker_calibration.unknown_markers import LEAST_FRAMES_OF_BONE as LEAST_FRAMES
from solver_backend.fitters.marker_calibration.unknown_markers import REACH_M, bone_offsets
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.measurements.own_views import OwnViews
from solver_backend.fitters.measurements.reprojection_report import ReprojectionReport
from solver_backend.fitters.model.states import FrameStates
from solver_backend.fitters.model.subject import points_of
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import sample_frames
from solver_backend.fitters.solution import MethodResult, SolvedFrames
from solver_backend.fitters.subject_calibration.shape import ShapePrior, fit_shape
from solver_backend.geometry.arrays import Array, constant, index, to_numpy
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.solver.levenberg_marquardt import LMSettings
from solver_backend.types import BONES, OwnPoint

LOOSE_M = 0.06
"""A point that its bone leaves by more in half of the frames is on another. Twice as far as for markers: without the
point the bone's turn about itself is the prior's guess. Chosen by hand."""
PLACE_SIGMA_M = 0.05
"""How far the first place may lie from the true one, per axis: as far as a turn of 45° moves a point on the skin of a
limb. Chosen by hand."""
SAMPLE_FRAMES = 48
"""Frames from which places are fitted."""
_STEPS = LMSettings(40, 1e-4)
"""Of that fit."""


@dataclass(frozen=True)
class PlacedPoints:
    """N own points at places on their bones."""

    points: tuple[OwnPoint, ...]
    """Those that are placed."""
    offsets: np.ndarray
    """(N, 3) metres from the bone's joint, in its rest frame."""
    found: tuple[Diagnostic, ...]
    """Those that are not, and why."""

    def landmarks(self, body: Body) -> Landmarks:
        """Return the points as landmarks of a body."""
        joints = [body.layout.joints.index(BONES[point.bone]) for point in self.points]
        rest = body.joints_template[joints] + self.offsets
        names, weights = tuple(point.name for point in self.points), np.eye(body.layout.num_joints)[joints]
        return Landmarks.of_points(names, rest, body.joints_shapedirs[joints], weights)


def solve_with_points(
    problem: Problem, first: MethodResult, again: Callable[[Problem], MethodResult], settings: SolveSettings,
    like: Array,
) -> tuple[Problem, MethodResult]:  # fmt: skip
    """Return the problem with the own points that could be placed, and its solution; as they are where there are none.

    Args:
        problem: with measurements of the keypoints alone.
        first: its solution.
        again: solves a problem.
        settings: of both solves.
        like: array that sets kind, type and device.
    """
    own = problem.measurements.own
    if own is None:
        return problem, first
    placed = place_points(own, first[0])
    if not placed.points:
        return problem, (_with(first[0], placed.found), first[1])

    def measured(placed: PlacedPoints) -> Problem:
        return replace(problem, measurements=with_points(problem.measurements, own, placed, problem.body, like))

    placed = fit_places(measured(placed), first[0], placed, settings)
    full = measured(placed)
    solved, convergence = again(full)
    return full, (_with(solved, (*placed.found, *_report(full.measurements, placed, solved))), convergence)


def place_points(own: OwnViews, solved: SolvedFrames) -> PlacedPoints:
    """Return where own points are on their bones by solved poses of the same frames."""
    body, frames = solved.subject.body, solved.frames
    parts = [to_numpy(part) for part in (solved.subject.betas, frames.root, frames.local, frames.transl)]
    posed = forward_kinematics(body, *parts)
    placed, offsets, found = list[OwnPoint](), list[np.ndarray](), list[Diagnostic]()
    for point in own.keypoints.own:
        at, where = own.points[:, own.column(point)], {"joints": [point.name], "bone": point.bone}
        seen = int(np.isfinite(at).all(-1).sum())
        if seen < LEAST_FRAMES or BONES[point.bone] not in body.layout.joints:
            found.append(diagnostic("own_point_unused", reason="unseen", **where, count=seen))
            continue
        joint = [body.layout.joints.index(BONES[point.bone])]
        offset, spread, reach = (values[0] for values in bone_offsets(at, posed.joints[:, joint], posed.G[:, joint]))
        if spread > LOOSE_M or reach > REACH_M:
            found.append(diagnostic("own_point_unused", reason="loose", **where, size=100 * spread, reach=100 * reach))
            continue
        placed.append(point)
        offsets.append(offset)
    return PlacedPoints(tuple(placed), np.array(offsets).reshape(-1, 3), tuple(found))


def fit_places(full: Problem, solved: SolvedFrames, placed: PlacedPoints, settings: SolveSettings) -> PlacedPoints:
    """Return points at the places that fit their detections best, with shape and poses of a sample of frames.

    Args:
        full: with measurements of keypoints and placed points.
        solved: poses of all frames, by the keypoints alone.
        placed: where the points are by these.
        settings: of the solve.
    """
    count, subject = len(placed.points), solved.subject
    frames = sample_frames(full.measurements, SAMPLE_FRAMES)
    poses = solved.frames.select(index(frames, solved.frames.transl))
    codes = full.prior.encode(to_numpy(poses.local)[:, : len(full.prior.joints)])
    start = FrameStates(constant(codes, poses.transl), poses.root, poses.transl)
    offsets = np.concatenate([to_numpy(subject.offsets), np.zeros((count, 3))])
    subject = replace(
        subject, landmarks=full.measurements.landmarks, offsets=constant(offsets, subject.offsets)
    )  # fmt: skip
    sigma = np.r_[np.full(len(offsets) - count, ShapePrior.offset_sigma_m), np.full(count, PLACE_SIGMA_M)]
    known = ShapePrior(offset_sigma_m=sigma, free_betas=settings.betas is None)
    objective = full.objective.select(frames)
    fitted, _ = fit_shape(subject, full.prior, objective, start, (settings.robust_scale,), _STEPS, known)
    return replace(placed, offsets=placed.offsets + to_numpy(fitted.offsets)[-count:])


def with_points(
    measurements: Measurements, own: OwnViews, placed: PlacedPoints, body: Body, like: Array
) -> Measurements:
    """Return what views measure of the keypoints and of the placed points behind them."""
    columns = [*range(own.keypoints.joint_set.num_keypoints), *(own.column(point) for point in placed.points)]
    xy, confidence = own.keypoints.xy[:, :, columns], own.keypoints.confidence[:, :, columns]
    keypoints = replace(own.keypoints, xy=xy, confidence=confidence, own=placed.points)
    return replace(
        measurements,
        landmarks=Landmarks.joined([measurements.landmarks, placed.landmarks(body)]),
        points=own.points[:, columns],
        covariance=own.covariance[:, columns],
        term=ReprojectionTerm.of(own.cameras, keypoints, own.sigma_px[..., columns], like),
        report=ReprojectionReport(own.cameras, keypoints),
    )


def without_points(measurements: Measurements, solved: SolvedFrames) -> SolvedFrames:
    """Return the solution with the landmarks of the keypoints alone, as a motion holds them."""
    subject, count = solved.subject, len(measurements.landmarks)
    if len(subject.landmarks) == count:
        return solved
    kept = subject.landmarks.part(slice(0, count))
    return replace(solved, subject=replace(subject, landmarks=kept, offsets=subject.offsets[:count]))


def _report(measurements: Measurements, placed: PlacedPoints, solved: SolvedFrames) -> tuple[Diagnostic, ...]:
    """Return where each point is on its bone, and how far it is from its detections."""
    count = len(placed.points)
    error, _ = measurements.report(to_numpy(points_of(solved.subject, solved.frames)))
    assert error is not None
    residuals = np.moveaxis(error[:, :, -count:], -1, 0)
    offsets = placed.offsets + to_numpy(solved.subject.offsets)[-count:]
    return tuple(
        diagnostic(
            "own_point_placed", joints=[point.name], bone=point.bone, offset_mm=[f"{1000 * v:.0f}" for v in offset],
            size=float(np.nanmedian(residual)),
        )
        for point, offset, residual in zip(placed.points, offsets, residuals, strict=True)
    )  # fmt: skip


def _with(solved: SolvedFrames, found: tuple[Diagnostic, ...]) -> SolvedFrames:
    return replace(solved, diagnostics=(*solved.diagnostics, *found))
