"""Subject calibration from markers: shape, every marker's place and the poses of varied frames, in one problem.

Reference: Triggs et al. 2000 (poses eliminated frame by frame).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.markers import ON_BONE, placement_precision
from solver_backend.body.state_layout import StateLayout
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.measurements.markers import SIGMA_M
from solver_backend.fitters.model.keyframe_curve import turns_of
from solver_backend.fitters.model.states import (
    FrameStates,
    PosedFrames,
    d_pose_d_key,
    decoded,
    rotations_of,
    state_layout,
)
from solver_backend.fitters.model.subject import FrameObjective, Subject, pose
from solver_backend.fitters.partial_body.rest_parts import uninformed_parts
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import fit_frames, fit_to_points
from solver_backend.fitters.subject_calibration.shape import moved
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, to_numpy, zeros
from solver_backend.geometry.quantiles import quantile
from solver_backend.geometry.small_matrices import inverse_symmetric_3x3
from solver_backend.priors.base import AutoencodingPrior, PosePrior
from solver_backend.residuals.robust import geman_mcclure, graduated_scales
from solver_backend.residuals.terms import DataTerm, PointEvidence
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import Arrowhead


@dataclass(frozen=True)
class CalibrationState:
    """A person and F poses, which may leave the prior's manifold as they may in the bundle."""

    subject: Subject
    """The person."""
    frames: FrameStates
    """Codes, roots and translations."""
    residual: Array
    """(F, J, 3) rotation vectors by which joints leave the manifold."""
    layout: StateLayout
    """Of the unknowns of a frame."""

    @classmethod
    def of(cls, subject: Subject, prior: PosePrior, frames: FrameStates) -> CalibrationState:
        """Return the state of poses on the manifold."""
        still = zeros((frames.z.shape[0], len(prior.joints), 3), frames.z)
        residual = still if frames.residual is None else frames.residual
        return cls(subject, replace(frames, residual=None), residual, state_layout(prior))

    def poses(self, prior: PosePrior) -> PosedFrames:
        """Return the poses that the states decode to."""
        return PosedFrames(self.frames.root, decoded(prior, self.frames.z, self.residual), self.frames.transl)

    def retract(self, step: Array) -> CalibrationState:
        """Return the state moved by a (1, 10 + 3 L + n F) step: shape, places, and the frames one after the other."""
        xp, count = array_namespace(step), self.frames.z.shape[0]
        shared = 10 + 3 * len(self.subject.landmarks)
        by_frame = xp.reshape(step[0, shared:], (count, -1))
        return replace(
            self,
            subject=moved(self.subject, step[0, :shared]),
            frames=self.frames.retract(by_frame, self.layout),
            residual=self.residual + rotations_of(by_frame, self.layout, self.residual.shape[1]),
        )


FLOOR = 1e-2
"""Precision that every unknown of a pose has."""


@dataclass(frozen=True)
class PlacementPrior:
    """What is known of a person before the calibration."""

    shape: Array
    """(10,) precision of the shape around the mean person's, or around a known one."""
    shape_mean: Array
    """(10,)."""
    places: Array
    """(L, 3, 3) precision of each marker's offset from its rule in the rest frame, 1/m²."""


def calibration_equations(
    prior: AutoencodingPrior, objective: FrameObjective, placement: PlacementPrior, state: CalibrationState,
    scale: float, pose_weight: float = 1.0,
) -> tuple[Array, Arrowhead]:  # fmt: skip
    """Return the cost (1,) and the Gauss-Newton equations at a state.

    Args:
        prior: decoder of the codes.
        objective: of the frames.
        placement: what is known of shape and places.
        state: where.
        scale: of Geman-McClure's penalty.
        pose_weight: w, of what is known of poses.
    """
    xp = array_namespace(state.residual)
    frames, turns = state.poses(prior), state.layout.turns
    by_state = d_pose_d_key(state.layout, prior, state.frames.z, state.residual)
    posed = pose(state.subject, frames, jacobian=True)
    count, num = posed.points.shape[:2]
    eye = xp.broadcast_to(identity(3, posed.points), (count, num, 3, 3))
    by_pose = xp.matmul(xp.concat([posed.by_rotations, eye], axis=-1), by_state[:, None])
    evidence = objective.of_points(posed.points, scale)
    shared, g_shared, coupling = _shared(evidence, by_pose, posed.by_betas, posed.by_offsets)
    weighted = xp.matmul(evidence.information, by_pose)
    tall = (count, 3 * num, by_pose.shape[-1])
    flat_T = xp.matrix_transpose(xp.reshape(by_pose, tall))
    blocks = xp.matmul(flat_T, xp.reshape(weighted, tall)) + FLOOR * identity(tall[-1], by_pose)
    g_blocks = xp.matmul(flat_T, xp.reshape(evidence.gradient, (count, -1, 1)))[..., 0]
    cost = xp.sum(evidence.cost)
    by_joints = by_state[:, frames.layout.joints]
    by_joints_T = xp.matrix_transpose(by_joints)
    for term in objective.poses:
        found = term(frames.local)
        blocks = blocks + pose_weight * xp.matmul(by_joints_T, xp.matmul(term.hessian(found.factors), by_joints))
        g_blocks = g_blocks + pose_weight * xp.matmul(by_joints_T, found.gradient[..., None])[..., 0]
        cost = cost + pose_weight * xp.sum(found.cost)
    off = turns_of(xp.reshape(state.residual, (count, -1)), state.layout)
    sigma = prior.residual_sigma[list(state.layout.turned)]
    stiff = constant(pose_weight * sigma.reshape(-1) ** -2.0, off)
    blocks[:, turns, turns] += stiff * identity(off.shape[1], off)
    g_blocks[:, turns] += stiff * off
    known, system = _with_placement(placement, state, Arrowhead(blocks, coupling, shared, g_blocks, g_shared))
    return (cost + 0.5 * xp.sum(stiff * off * off) + known)[None], system


def _shared(
    evidence: PointEvidence, by_pose: Array, by_betas: Array, by_offsets: Array
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return what the frames contribute to shape and places: (m, m), (m,), and how poses meet them, (F, n, m)."""
    xp = array_namespace(by_pose)
    count, num = by_pose.shape[:2]
    size = 10 + 3 * num
    weighted_betas = xp.matmul(evidence.information, by_betas)
    weighted_offsets = xp.matmul(evidence.information, by_offsets)
    flat = (count * num * 3, 10)
    shared = zeros((size, size), by_pose)
    shared[:10, :10] = xp.matmul(xp.reshape(by_betas, flat).T, xp.reshape(weighted_betas, flat))
    crossed = xp.sum(xp.matmul(xp.matrix_transpose(by_betas), weighted_offsets), axis=0)
    shared[:10, 10:] = xp.reshape(xp.permute_dims(crossed, (1, 0, 2)), (10, -1))
    shared[10:, :10] = shared[:10, 10:].T
    own = xp.sum(xp.matmul(xp.matrix_transpose(by_offsets), weighted_offsets), axis=0)
    for i in range(num):
        shared[10 + 3 * i : 13 + 3 * i, 10 + 3 * i : 13 + 3 * i] = own[i]
    gradient = evidence.gradient[..., None]
    by_place = xp.sum(xp.matmul(xp.matrix_transpose(by_offsets), gradient), axis=0)
    by_shape = xp.sum(xp.matmul(xp.matrix_transpose(by_betas), gradient), axis=(0, 1))
    g_shared = xp.concat([by_shape[:, 0], xp.reshape(by_place, (-1,))])
    by_pose_T = xp.matrix_transpose(by_pose)
    with_betas = xp.sum(xp.matmul(by_pose_T, weighted_betas), axis=1)
    with_places = xp.permute_dims(xp.matmul(by_pose_T, weighted_offsets), (0, 2, 1, 3))
    coupling = xp.concat([with_betas, xp.reshape(with_places, (count, by_pose.shape[-1], -1))], axis=-1)
    return shared, g_shared, coupling


def _with_placement(
    placement: PlacementPrior, state: CalibrationState, system: Arrowhead
) -> tuple[Array, Arrowhead]:  # fmt: skip
    """Return the cost of shape and places, and the equations with what was known of them added in place."""
    xp = array_namespace(system.shared)
    shape = state.subject.betas - placement.shape_mean
    places = state.subject.offsets
    pulled = xp.matmul(placement.places, places[..., None])[..., 0]
    system.shared[:10, :10] += placement.shape * identity(10, shape)
    for i in range(len(places)):
        part = slice(10 + 3 * i, 13 + 3 * i)
        system.shared[part, part] += placement.places[i]
    system.g_shared[:10] += placement.shape * shape
    system.g_shared[10:] += xp.reshape(pulled, (-1,))
    return 0.5 * (xp.sum(placement.shape * shape * shape) + xp.sum(pulled * places)), system


OTHER_SIZE = 0.12
"""Logarithm of the size from which it counts: below 1.50 and above 1.91 m for a mean stature of 1.69 m. A walk of
somebody of 1.36 m ends 42 mm off from the mean body, and of 1.09 m 61 mm."""
LEAST_M, LEAST_SUM_M = 0.12, 0.6
"""Distance at rest of a pair that shows size, as markers are centimetres beside their places, and of all together: two
shanks are enough."""
AT_JOINT_M = 0.07
"""A marker so near a joint keeps its distance from those of both bones that meet there."""
SPREAD_M = 0.03
"""How far joints are from those of the mean body at another size, against a deviation of each shape coefficient."""


def first_shape(body: Body, landmarks: Landmarks, points: np.ndarray) -> np.ndarray:
    """Return (10,) the shape to start at: that of the mean body at the markers' size, 0 where they show no other.

    The size is the median of ``d / r``, weighed by r, over pairs of markers that keep their distance in any pose: d as
    recorded, r of the mean body. The shape is ``argmin |D b - (s - 1) J|² / SPREAD_M² + |b|²`` with joints J and their
    derivatives D, both from the pelvis.

    Args:
        body: whose shapes count.
        landmarks: L places of the markers.
        points: (F, L, 3) metres, NaN where missing.
    """
    nothing = np.zeros(body.joints_shapedirs.shape[-1])
    rest = landmarks.anchors.sum(axis=1)
    one, other = np.nonzero(np.triu(_keeps_distance(body, landmarks, rest), 1))
    at_rest = np.linalg.norm(rest[one] - rest[other], axis=-1)
    apart = quantile(np.linalg.norm(points[:, one] - points[:, other], axis=-1), 0.5, axis=0)
    shown = (at_rest >= LEAST_M) & np.isfinite(apart)
    if at_rest[shown].sum() < LEAST_SUM_M:
        return nothing
    ratio, weight = (apart / np.maximum(at_rest, 1e-9))[shown], at_rest[shown]
    order = np.argsort(ratio)
    size = ratio[order][np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)]
    if not abs(np.log(max(size, 1e-6))) >= OTHER_SIZE:
        return nothing
    J = (body.joints_template - body.joints_template[0]).ravel()
    D = (body.joints_shapedirs - body.joints_shapedirs[0]).reshape(len(J), -1)
    return np.linalg.solve(D.T @ D + SPREAD_M**2 * np.eye(len(nothing)), D.T @ ((size - 1) * J))


def _keeps_distance(body: Body, landmarks: Landmarks, rest: np.ndarray) -> np.ndarray:
    """Return (L, L) whether two markers are on one bone: their own, or both that meet at a joint beside them."""
    joints = np.arange(len(body.parents))
    at_joint = np.linalg.norm(rest[:, None] - body.joints_template, axis=-1) < AT_JOINT_M
    above = joints[:, None] == np.maximum(body.parents, 0)  # (bone, joint that it leads to)
    carried = (landmarks.weights.argmax(axis=1)[:, None] == joints) | at_joint | (at_joint @ above.T)
    placed = np.array([not name.startswith(ON_BONE) for name in landmarks.names])
    return (carried @ carried.T) & placed[:, None] & placed


CANDIDATES = 600
"""Frames, spread over the takes, that are chosen from."""
LEAST_SEEN = 0.6
"""Share of the most markers seen at once that a chosen frame shows, at least."""


def varied_frames(points: np.ndarray, count: int) -> np.ndarray:
    """Return up to ``count`` frame numbers whose poses differ most, ascending.

    Poses are distinguished by the distances between markers, which neither place nor heading change; the next frame is
    the one that is farthest from all that are chosen (Gonzalez 1985, "Clustering to minimize the maximum intercluster
    distance").

    Args:
        points: (F, L, 3) metres, NaN where missing.
        count: frames at most.
    """
    seen = np.isfinite(points).all(-1).sum(-1)
    candidates = np.unique(np.linspace(0, len(points) - 1, min(CANDIDATES, len(points))).astype(int))
    candidates = candidates[seen[candidates] >= max(4, LEAST_SEEN * seen.max())]
    if len(candidates) <= count:
        return candidates
    features = _distances(points[candidates])
    chosen = [int(np.argmax(seen[candidates] - 1e-6 * ((features - np.median(features, axis=0)) ** 2).sum(-1)))]
    nearest = np.full(len(candidates), np.inf)
    while len(chosen) < count:
        nearest = np.minimum(nearest, ((features - features[chosen[-1]]) ** 2).sum(-1))
        chosen.append(int(np.argmax(nearest)))
    return np.sort(candidates[np.unique(chosen)])


def _distances(points: np.ndarray) -> np.ndarray:
    """Return (F, L (L - 1) / 2) distances between markers; a pair that is not seen has its median distance."""
    upper = np.triu_indices(points.shape[1], 1)
    distances = np.linalg.norm(points[:, upper[0]] - points[:, upper[1]], axis=-1)
    known = np.isfinite(distances)
    distances = distances[:, known.any(axis=0)]
    return np.where(np.isfinite(distances), distances, np.nanmedian(distances, axis=0))


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
