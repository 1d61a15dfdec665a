"""Locate user-defined points on their bones, and use them in a second solve.

The position on a bone b is found as for unknown markers: ``o = median_f G_bᵀ (x - p_b)``, where G is the bone's
rotation and p its joint (see ``attach``). If the first solve guessed a bone's rotation, the position has the same
error. Positions, shape and the poses in a sample of frames are therefore fitted together (see ``fit_shape``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.landmarks import Landmarks
from solver_backend.cameras.robust_triangulation import Triangulation
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.marker_calibration.unknown_markers import LEAST_FRAMES_OF_BONE as LEAST_FRAMES
from solver_backend.fitters.marker_calibration.unknown_markers import REACH_M, bone_offsets
from solver_backend.fitters.model.subject import FrameStates, points_of
from solver_backend.fitters.person_shape import ShapePrior, fit_shape
from solver_backend.fitters.problem import Layer, Problem, SolvedFrames, SolvedLayer
from solver_backend.fitters.single_frame import sample_frames
from solver_backend.geometry.arrays import Array, constant, index, to_numpy
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.solver.levenberg_marquardt import LMSettings
from solver_backend.types import BONES, Cameras, Keypoints2D, OwnPoint

LOOSE_M = 0.06
"""Largest median distance in metres from a point to its position on the bone: twice a marker's, because twist is
uncertain."""
PLACE_SIGMA_M = 0.05  # Error per axis of the first position: a rotation of 45° moves a limb's skin this far. By hand.
SAMPLE_FRAMES = 48  # Number of frames used to fit positions.
_STEPS = LMSettings(40, 1e-4)  # Settings for that fit.


@dataclass(frozen=True)
class OwnPoints(Layer):
    """Layer of a solve: K keypoints and N user-defined points in C views over F frames."""

    cameras: Cameras
    keypoints: Keypoints2D
    points: np.ndarray  # (F, K + N, 3) metres, NaN where a point was not triangulated.
    covariance: np.ndarray  # (F, K + N, 3, 3) m².
    sigma_px: np.ndarray  # (C, F, K + N) standard deviation of each detection.

    @classmethod
    def of(cls, cameras: Cameras, keypoints: Keypoints2D, located: Triangulation, sigma_px: np.ndarray) -> OwnPoints:
        """Create the layer from triangulated points. ``sigma_px`` is broadcast to (C, F, K + N)."""
        sigma_px = np.broadcast_to(sigma_px, keypoints.confidence.shape)
        return cls(cameras, keypoints, np.asarray(located.points), np.asarray(located.covariance), sigma_px)

    def column(self, point: OwnPoint) -> int:
        """Return the column of a user-defined point in the keypoint arrays."""
        return self.keypoints.joint_set.num_keypoints + self.keypoints.own.index(point)

    def blocks(self, problem: Problem, solved: SolvedFrames, settings: SolveSettings) -> Problem:
        """Add landmarks for the user-defined points that the solved keypoints can locate."""
        placed, like = place_points(self, solved), solved.subject.betas
        if placed.points:
            placed = fit_places(_measure(problem, self, placed, like), solved, placed, settings)
        return _measure(problem, self, placed, like)


@dataclass(frozen=True)
class PlacedPoints(Layer):
    """Layer of a solve: N user-defined points at fixed positions on their bones."""

    points: tuple[OwnPoint, ...]
    offsets: np.ndarray  # (N, 3) metres from the bone's joint, in its axes at rest.
    found: tuple[Diagnostic, ...]  # Reasons why points are not placed.

    def landmarks(self, body: Body) -> Landmarks:
        """Return the points as landmarks on a body."""
        joints = [body.layout.joints.index(BONES[point.bone]) for point in self.points]
        rest = body.joints_template[joints] + self.offsets
        names, weights = tuple(point.name for point in self.points), np.eye(body.layout.num_joints)[joints]
        return Landmarks.of_points(names, rest, body.joints_shapedirs[joints], weights)

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Report the points' positions, and remove their landmarks, which are not part of the motion."""
        found, subject = (*self.found, *self._report(problem, solved)), solved.subject
        count = len(subject.landmarks) - len(self.points)
        subject = replace(subject, landmarks=subject.landmarks.part(slice(0, count)), offsets=subject.offsets[:count])
        return replace(solved, subject=subject).noting(found), self

    def _report(self, problem: Problem, solved: SolvedFrames) -> Iterator[Diagnostic]:
        if not self.points:
            return
        count, poses = len(self.points), solved.frames if solved.fitted is None else solved.fitted
        error, _ = problem.measurements.source.report(to_numpy(points_of(solved.subject, poses)))
        assert error is not None
        offsets = self.offsets + to_numpy(solved.subject.offsets)[-count:]
        residuals = np.moveaxis(error[:, :, -count:], -1, 0)
        for point, offset, residual in zip(self.points, offsets, residuals, strict=True):
            place = [f"{1000 * v:.0f}" for v in offset]
            size = float(np.nanmedian(residual))
            yield diagnostic("own_point_placed", joints=[point.name], bone=point.bone, offset_mm=place, size=size)


def place_points(own: OwnPoints, solved: SolvedFrames) -> PlacedPoints:
    """Locate user-defined points on their bones, using the solved poses of the same frames."""
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
    """Fit the points' positions, body shape and sample poses to the detections."""
    count, subject = len(placed.points), solved.subject
    frames = sample_frames(full.measurements, SAMPLE_FRAMES)
    poses = solved.frames.select(index(frames, solved.frames.transl))
    codes = full.prior.encode(to_numpy(poses.local)[:, : len(full.prior.joints)])
    start = FrameStates(constant(codes, poses.transl), poses.root, poses.transl)
    offsets = np.concatenate([to_numpy(subject.offsets), np.zeros((count, 3))])
    subject = replace(subject, landmarks=full.measurements.landmarks, offsets=constant(offsets, subject.offsets))
    sigma = np.r_[np.full(len(offsets) - count, ShapePrior.offset_sigma_m), np.full(count, PLACE_SIGMA_M)]
    known = ShapePrior(sigma, free_betas=settings.betas is None, stature_m=full.stature_m)
    objective = full.objective.select(frames)
    fitted, _ = fit_shape(subject, full.prior, objective, start, (settings.robust_scale,), _STEPS, known)
    return replace(placed, offsets=placed.offsets + to_numpy(fitted.offsets)[-count:])


def _measure(problem: Problem, own: OwnPoints, placed: PlacedPoints, like: Array) -> Problem:
    measured = problem.measurements
    columns = [*range(own.keypoints.joint_set.num_keypoints), *(own.column(point) for point in placed.points)]
    xy, confidence = own.keypoints.xy[:, :, columns], own.keypoints.confidence[:, :, columns]
    keypoints = replace(own.keypoints, xy=xy, confidence=confidence, own=placed.points)
    layers = tuple(placed if layer is own else layer for layer in measured.layers)
    if not placed.points:
        return replace(problem, measurements=replace(measured, layers=layers))
    source: Any = measured.source
    measured = replace(
        measured,
        landmarks=Landmarks.joined([measured.landmarks, placed.landmarks(problem.body)]),
        points=own.points[:, columns],
        covariance=own.covariance[:, columns],
        term=ReprojectionTerm.of(own.cameras, keypoints, own.sigma_px[..., columns], like),
        source=replace(source, keypoints=keypoints),
        layers=layers,
    )
    return replace(problem, measurements=measured)
