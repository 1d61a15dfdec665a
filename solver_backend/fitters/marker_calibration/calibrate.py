"""Calibrate a subject from markers: body shape and marker positions, from frames with varied poses.

Poses are eliminated frame by frame (Triggs et al. 2000). The result is stored as a plain record.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.marker_layouts import label_key
from solver_backend.body.marker_names import least_markers
from solver_backend.body.markers import MARKER_OFFSET_M, ON_BONE, marker_landmarks, placement_precision, skin_normals
from solver_backend.exchange.errors import SubjectInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.version import VERSION
from solver_backend.fitters.marker_calibration.unknown_markers import Attachment
from solver_backend.fitters.measurements.markers import SIGMA_M
from solver_backend.fitters.model.keyframe_curve import turns_of
from solver_backend.fitters.model.subject import (
    FrameObjective,
    FrameStates,
    PosedFrames,
    Subject,
    d_pose_d_key,
    pose,
    state_layout,
)
from solver_backend.fitters.person_shape import PersonState
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.rest_parts import uninformed_parts
from solver_backend.fitters.single_frame import fit_frames, fit_to_points, posed
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, quantile, to_numpy, zeros
from solver_backend.geometry.small_matrices import inverse_symmetric_3x3
from solver_backend.priors.base import AutoencodingPrior, PosePrior
from solver_backend.residuals.terms import DataTerm, PointEvidence, geman_mcclure, graduated_scales
from solver_backend.solver.levenberg_marquardt import Arrowhead, LMSettings, levenberg_marquardt
from solver_backend.types import MarkerSubject, Motion

FLOOR = 1e-2  # Smallest precision of every unknown in a pose.


@dataclass(frozen=True)
class PlacementPrior:
    """Prior for a person's body shape and marker positions."""

    shape: Array  # (10,) precision of the shape around ``shape_mean``.
    shape_mean: Array  # (10,) shape of the average person, or a known one.
    places: Array  # (L, 3, 3) precision of each marker's offset from its default position in the rest pose, 1/m².
    pose_weight: float = 1.0  # Weight of the pose terms.


def person_state(subject: Subject, prior: PosePrior, frames: FrameStates) -> PersonState:
    """Create the calibration's state. Its poses may leave the prior's manifold."""
    if frames.residual is None:
        frames = replace(frames, residual=zeros((frames.z.shape[0], len(prior.joints), 3), frames.z))
    return PersonState(subject, frames, state_layout(prior))


def calibration_equations(
    prior: AutoencodingPrior, objective: FrameObjective, known: PlacementPrior, state: PersonState, scale: float
) -> tuple[Array, Arrowhead]:
    """Return the cost (1,) and Gauss-Newton equations of poses, shape and marker offsets."""
    xp, residual = array_namespace(state.frames.z), state.frames.residual
    assert residual is not None
    frames, turns = posed(prior, state.frames), state.layout.turns
    by_state = d_pose_d_key(state.layout, prior, state.frames.z, residual)
    placed = pose(state.subject, frames, jacobian=True)
    count, num = placed.points.shape[:2]
    eye = xp.broadcast_to(identity(3, placed.points), (count, num, 3, 3))
    by_pose = xp.matmul(xp.concat([placed.by_rotations, eye], axis=-1), by_state[:, None])
    evidence = objective.of_points(placed.points, scale)
    shared, g_shared, coupling = _shared(evidence, by_pose, placed.by_betas, placed.by_offsets)
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
        blocks = blocks + known.pose_weight * xp.matmul(by_joints_T, xp.matmul(term.hessian(found.factors), by_joints))
        g_blocks = g_blocks + known.pose_weight * xp.matmul(by_joints_T, found.gradient[..., None])[..., 0]
        cost = cost + known.pose_weight * xp.sum(found.cost)
    off = turns_of(xp.reshape(residual, (count, -1)), state.layout)
    sigma = prior.residual_sigma[list(state.layout.turned)]
    stiff = constant(known.pose_weight * sigma.reshape(-1) ** -2.0, off)
    blocks[:, turns, turns] += stiff * identity(off.shape[1], off)
    g_blocks[:, turns] += stiff * off
    cost = cost + 0.5 * xp.sum(stiff * off * off) + _add_known(known, state.subject, shared, g_shared)
    return cost[None], Arrowhead(blocks, coupling, shared, g_blocks, g_shared)


def _shared(evidence: PointEvidence, by_pose: Array, by_betas: Array, by_offsets: Array) -> tuple[Array, Array, Array]:
    """Return the Hessian and gradient of shape and offsets, and their coupling with poses."""
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
    by_offsets_T = xp.matrix_transpose(by_offsets)
    own = xp.sum(xp.matmul(by_offsets_T, weighted_offsets), axis=0)
    for i in range(num):
        shared[10 + 3 * i : 13 + 3 * i, 10 + 3 * i : 13 + 3 * i] = own[i]
    gradient = evidence.gradient[..., None]
    by_place = xp.sum(xp.matmul(by_offsets_T, gradient), axis=0)
    by_shape = xp.sum(xp.matmul(xp.matrix_transpose(by_betas), gradient), axis=(0, 1))
    g_shared = xp.concat([by_shape[:, 0], xp.reshape(by_place, (-1,))])
    by_pose_T = xp.matrix_transpose(by_pose)
    with_betas = xp.sum(xp.matmul(by_pose_T, weighted_betas), axis=1)
    with_places = xp.permute_dims(xp.matmul(by_pose_T, weighted_offsets), (0, 2, 1, 3))
    coupling = xp.concat([with_betas, xp.reshape(with_places, (count, by_pose.shape[-1], -1))], axis=-1)
    return shared, g_shared, coupling


def _add_known(known: PlacementPrior, subject: Subject, shared: Array, g_shared: Array) -> Array:
    """Add the prior for shape and offsets to the shared equations in place. Return its cost."""
    xp = array_namespace(shared)
    shape, places = subject.betas - known.shape_mean, subject.offsets
    pulled = xp.matmul(known.places, places[..., None])[..., 0]
    shared[:10, :10] += known.shape * identity(10, shape)
    for i in range(len(places)):
        part = slice(10 + 3 * i, 13 + 3 * i)
        shared[part, part] += known.places[i]
    g_shared[:10] += known.shape * shape
    g_shared[10:] += xp.reshape(pulled, (-1,))
    return 0.5 * (xp.sum(known.shape * shape * shape) + xp.sum(pulled * places))


OTHER_SIZE = 0.12
"""Smallest absolute logarithm of a body size that is used: below 1.50 m and above 1.91 m. For a walker of 1.36 m, a fit
from the average body ends with errors of 42 mm."""
LEAST_M, LEAST_SUM_M = 0.12, 0.6  # Smallest distance of a pair at rest, and smallest sum of all pairs (two shanks).
AT_JOINT_M = 0.07  # A marker this close to a joint keeps its distance from markers on both bones.
SPREAD_M = 0.03  # Deviation of joints from the scaled average body, weighed against one unit of a coefficient.


def first_shape(body: Body, landmarks: Landmarks, points: np.ndarray) -> np.ndarray:
    """Estimate the initial body shape (10,) from marker distances, or return zeros if the average body's size fits.

    The size s is the median of ``d / r``, weighted by r, over marker pairs with the same distance in all poses. d is
    the recorded distance, and r the distance on the average body. The shape is the b that minimises
    ``|D b - (s - 1) J|² / SPREAD_M² + |b|²``. J are the average body's joints relative to the pelvis, and D their
    derivatives w.r.t. the shape. ``points`` (F, L, 3) are in metres, NaN where missing.
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
    """Return an (L, L) mask of marker pairs at a nearly constant distance in all poses."""
    joints = np.arange(len(body.parents))
    at_joint = np.linalg.norm(rest[:, None] - body.joints_template, axis=-1) < AT_JOINT_M
    above = joints[:, None] == np.maximum(body.parents, 0)  # (bone, joint that it leads to)
    carried = (landmarks.weights.argmax(axis=1)[:, None] == joints) | at_joint | (at_joint @ above.T)
    placed = np.array([not name.startswith(ON_BONE) for name in landmarks.names])
    return (carried @ carried.T) & placed[:, None] & placed


CANDIDATES = 600  # Frames, spread over the takes, from which to choose.
LEAST_SEEN = 0.6  # A chosen frame shows at least this share of the largest number of markers visible at once.


def varied_frames(points: np.ndarray, count: int) -> np.ndarray:
    """Select up to ``count`` frames with the most different poses.

    Distances between markers describe a pose without its position and heading. The frame farthest from all selected
    frames is added next (Gonzalez 1985, "Clustering to minimize the maximum intercluster distance"). ``points`` are
    (F, L, 3).
    """
    seen = np.isfinite(points).all(-1).sum(-1)
    candidates = np.unique(np.linspace(0, len(points) - 1, min(CANDIDATES, len(points))).astype(int))
    candidates = candidates[seen[candidates] >= max(4, LEAST_SEEN * seen.max())]
    if len(candidates) <= count:
        return candidates
    one, other = np.triu_indices(points.shape[1], 1)
    features = np.linalg.norm(points[candidates][:, one] - points[candidates][:, other], axis=-1)
    features = features[:, np.isfinite(features).any(axis=0)]
    features = np.where(np.isfinite(features), features, np.nanmedian(features, axis=0))
    chosen = [int(np.argmax(seen[candidates] - 1e-6 * ((features - np.median(features, axis=0)) ** 2).sum(-1)))]
    nearest = np.full(len(candidates), np.inf)
    while len(chosen) < count:
        nearest = np.minimum(nearest, ((features - features[chosen[-1]]) ** 2).sum(-1))
        chosen.append(int(np.argmax(nearest)))
    return np.sort(candidates[np.unique(chosen)])


FRAMES = 64  # Number of frames used to calibrate a person.
STAGE = "Calibrating the person"
PRIOR_FRAMES = 4.0
"""Weight of the assumed marker deviation, in frames."""
POSE_FRAMES = 24.0
"""Largest total weight of the pose terms in frames, because people repeat postures. A weight of 64 moves markers by a
centimetre. A weight of one predicts hidden markers less accurately (docs/research-log/sensors.md)."""
SIGMA_RANGE_M = (0.003, 0.03)  # Limits of a marker's standard deviation.
SCORING_STEPS, ROBUST_SCALE = 4, 4.0  # Fisher scoring steps and robust scale for estimating a marker's deviation.
SHAPE_LIMIT = 3.5  # Largest shape coefficient if body parts have no markers, so that coefficients are undetermined.
BEYOND_START = 0.5  # Allowed deviations beyond a larger starting shape (a child's legs alone). Chosen by hand.
HELD, KNOWN = 1e6, 1e12  # Precision of a coefficient at its limit (64 frames of 14 markers: 4,000), and of a given one.


@dataclass(frozen=True)
class SubjectCalibration:
    """Calibrated person, and the frames that the calibration used."""

    subject: Subject  # The person, with the markers as landmarks.
    sigma_m: np.ndarray  # (L,) standard deviation per axis of each marker around its position on the body, in metres.
    frames: np.ndarray  # Numbers of the frames used.
    poses: PosedFrames  # Their poses.


def calibrate(problem: Problem, like: Array, settings: SolveSettings, progress: Progress) -> SubjectCalibration:
    """Estimate body shape, marker positions and marker deviations from varied frames of a take.

    The settings provide the robust scale, the number of iterations, and the shape if it is known.
    """
    measured = problem.measurements
    subject = Subject.average(problem.body, measured.landmarks, like)
    start = first_shape(problem.body, measured.landmarks, measured.points)
    subject = replace(subject, betas=constant(start if settings.betas is None else settings.betas, subject.betas))
    frames = varied_frames(measured.points, FRAMES)
    progress(STAGE, 0, 3)
    states = fit_to_points(problem, subject, frames)
    progress(STAGE, 1, 3)
    objective, steps = problem.objective.select(frames), LMSettings(settings.iterations)
    states = fit_frames(subject, problem.prior, objective, states, (4 * settings.robust_scale,), steps).state
    progress(STAGE, 2, 3)

    def fit(state: PersonState, known: PlacementPrior, scale: float) -> PersonState:
        def linearise(s: PersonState) -> tuple[Array, Arrowhead]:
            return calibration_equations(problem.prior, objective, known, s, scale)

        return levenberg_marquardt(state, linearise, PersonState.retract, steps).state

    known = replace(placement_prior(subject, settings), pose_weight=min(1.0, POSE_FRAMES / len(frames)))
    state = person_state(subject, problem.prior, states)
    for scale in graduated_scales(settings.robust_scale, 4 * settings.robust_scale, 3):
        state = fit(state, known, scale)
    if settings.betas is None and uninformed_parts(problem.body, measured):
        # Use an active set, because a penalty within the fit would stop its steps too early.
        limit = np.maximum(SHAPE_LIMIT, np.abs(start) + BEYOND_START)
        while (held := held_at_limit(known, to_numpy(state.subject.betas), limit)) is not None:
            known = held
            state = fit(state, known, settings.robust_scale)
    progress(STAGE, 3, 3)
    poses = posed(problem.prior, state.frames)
    placed = pose(state.subject, poses).points
    sigma = marker_sigma(measured.term.select(frames), placed, measured.covariance[frames])
    return SubjectCalibration(state.subject, sigma, frames, poses)


def marker_sigma(term: DataTerm, points: Array, noise: np.ndarray) -> np.ndarray:
    """Estimate the standard deviations (L,) in metres of marker positions, excluding the tracker noise Σ.

    ``s² = (Σ_f w s⁴ (|P r|² - tr P Σ P) / 3 + n s₀²) / (Σ_f w s⁴ tr P² / 3 + n)`` with ``P = (s² 1 + Σ)⁻¹``, computed
    with a few steps of Fisher scoring. For Σ = 0 it simplifies to ``(Σ_f w |r|² / 3 + n s₀²) / (Σ_f w + n)``. r is the
    residual, w the Geman-McClure weight, and s₀ the assumed deviation with a weight of n frames.

    Args:
        term: data term of the markers in the chosen frames.
        points: (F, L, 3) markers on the body in metres.
        noise: (F, L, 3, 3) the tracker's covariance of each marker in m².

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
    """Return the prior for body shape and marker offsets, from their spread among people."""
    like, known = subject.betas, settings.betas is not None
    mean = np.asarray(settings.betas, dtype=np.float64) if known else np.zeros(10)
    places = placement_precision(subject.body, subject.landmarks.names)
    return PlacementPrior(*(constant(a, like) for a in (np.full(10, KNOWN if known else 1.0), mean, places)))


def held_at_limit(
    known: PlacementPrior, betas: np.ndarray, limit: float | np.ndarray = SHAPE_LIMIT
) -> PlacementPrior | None:
    """Fix the free shape coefficients beyond ``limit`` at the limit.

    Return the new prior, or None if no free coefficient is beyond the limit.
    """
    precision, mean = to_numpy(known.shape), to_numpy(known.shape_mean)
    beyond = (np.abs(betas) > limit) & (precision < HELD)
    if not beyond.any():
        return None
    precision, mean = np.where(beyond, HELD, precision), np.where(beyond, np.sign(betas) * limit, mean)
    return replace(known, shape=constant(precision, known.shape), shape_mean=constant(mean, known.shape_mean))


def record_of(
    subject: Subject, labels: tuple[str, ...], sigma_m: np.ndarray, provenance: dict[str, Any]
) -> MarkerSubject:
    """Return a calibrated person as a record that can be stored. The subject's landmarks are the markers."""
    places, offsets = subject.landmarks.names, to_numpy(subject.offsets)
    skin = MARKER_OFFSET_M + (skin_normals(subject.body, places) * offsets).sum(-1)
    skin[[place.startswith(ON_BONE) or is_joint_centre(place) for place in places]] = np.nan
    record = {"solver": VERSION, **provenance}
    return MarkerSubject(subject.body.id, to_numpy(subject.betas), labels, places, offsets, sigma_m, skin, record)


def with_marker(person: MarkerSubject, label: str, marker: Attachment) -> MarkerSubject:
    """Add a marker on a bone to a person's record."""
    return replace(
        person,
        labels=(*person.labels, label),
        places=(*person.places, marker.place),
        offsets=np.concatenate([person.offsets, [marker.offset]]),
        sigma_m=np.append(person.sigma_m, np.clip(marker.sigma_m, *SIGMA_RANGE_M)),
        skin_m=np.append(person.skin_m, np.nan),
    )


def person_of(motion: Motion) -> MarkerSubject | None:
    """Return the person's record from an earlier marker solve, or None if the motion was not solved from markers."""
    labels, places, offsets, sigma = motion.marker_labels, motion.layout, motion.offsets, motion.marker_sigma
    if offsets is None or labels is None or places is None or sigma is None:
        return None
    return MarkerSubject(motion.body, motion.betas, labels, places, offsets, sigma, np.full(len(labels), np.nan))


def subject_of(record: MarkerSubject, body: Body, like: Array) -> Subject:
    """Convert a person's record to a subject with the markers as landmarks.

    Raises:
        SubjectInvalid: the record is for another body, or has a marker at an unknown location.
    """
    if record.body != body.id:
        message = f"The subject was calibrated on the body {record.body!r}, but the solve uses {body.id!r}."
        hint = "Solve with the subject's body (--body), or calibrate the subject again on this body."
        raise SubjectInvalid(message, where="subject", hint=hint)
    try:
        landmarks = marker_landmarks(body, record.places)
    except (KeyError, ValueError) as error:
        raise SubjectInvalid(
            f"No known layout contains the subject's marker {error}.", where="subject", hint="Calibrate again."
        ) from error
    return Subject(body, landmarks, constant(record.betas, like), constant(record.offsets, like))


def matched(record: MarkerSubject, labels: tuple[str, ...]) -> tuple[MarkerSubject, list[int]]:
    """Reduce a person's record to the markers in a take, and return their columns in the take.

    Prefix, case and punctuation of labels are ignored.

    Raises:
        SubjectInvalid: fewer markers match than ``least_markers``.
    """
    # Exact labels take precedence, because several parts of one person may have a Marker1.
    columns = {key(label): i for key in (label_key, str) for i, label in reversed(list(enumerate(labels)))}
    keys = [label if label in columns else label_key(label) for label in record.labels]
    kept = [m for m, key in enumerate(keys) if key in columns]
    least = least_markers(record.places)
    if len(kept) < least:
        message = f"Only {len(kept)} of the subject's {len(keys)} markers are in the take, but {least} are needed."
        hint = "Choose the subject file for this person and layout, or calibrate from the take."
        raise SubjectInvalid(message, where="subject", hint=hint)
    found, places = [columns[keys[m]] for m in kept], tuple(record.places[m] for m in kept)
    own = {name: getattr(record, name)[kept] for name in ("offsets", "sigma_m", "skin_m")}
    return replace(record, labels=tuple(labels[i] for i in found), places=places, **own), found
