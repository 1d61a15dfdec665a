"""Solve a hand from its markers, given the wrist. Marker offsets and hand size are estimated too."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.hand_markers import HandMarkers, hand_markers
from solver_backend.body.hand_skeleton import HandSites, HandSkeleton, site_frames
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.hands.shown_hands import HandClouds
from solver_backend.fitters.hands.solve_hand import (
    DOF,
    FINGERS,
    SIZES,
    HandProblem,
    KeyModel,
    WristPath,
    frame_states,
    hand_window,
    solve_keys,
)
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.residuals.positions import PositionTerm
from solver_backend.types.shapes import Float

MARKER_SIGMA_M, PLACE_SIGMA_M = 0.002, 0.006  # Deviations per axis of a marker and of its initial position.
ROUNDS, SAMPLE = 3, 150  # Solves, with offsets calibrated between them, and most frames used for that.


@dataclass(frozen=True)
class MarkerHand:
    """Hand that was solved from markers, with calibrated marker offsets."""

    markers: HandMarkers  # Labels and calibrated sites.
    problem: HandProblem
    states: Float[np.ndarray, "frames d"]  # (F, D) states, see ``solve_hand.KEY``.

    @property
    def angles(self) -> Float[np.ndarray, "frames a"]:
        """(F, A) finger angles in radians."""
        return self.states[:, FINGERS]


def calibrated_hand(
    positions: Float[np.ndarray, "frames markers 3"],
    markers: HandMarkers,
    skeleton: HandSkeleton,
    path: WristPath,
    fps: float,
    settings: SolveSettings,
) -> MarkerHand:
    """Solve a hand of known size in several rounds, and calibrate its marker offsets between the rounds."""
    layout = KeyframeLayout.even(len(positions), hand_window(fps))
    keys = np.zeros((layout.num_keys, DOF))
    prior, place = load_hand_prior(), markers.sites.offset
    keys[:, FINGERS] = prior.mean
    seen = np.isfinite(positions).all(-1)
    filled = np.where(seen[..., None], positions, 0.0)
    sigma = np.hypot(MARKER_SIGMA_M, PLACE_SIGMA_M)
    problem = HandProblem(skeleton, markers.sites, path, PositionTerm(filled, seen / sigma**2), prior, fps)
    model, scale = KeyModel(problem, layout), settings.robust_scale
    for number in range(ROUNDS):
        scales = (4 * scale, 2 * scale, scale) if number == 0 else (scale,)
        keys = solve_keys(model, keys, scales, settings.iterations, lambda: None).keys
        if number < ROUNDS - 1:
            offsets = calibrated_offsets(model.problem, frame_states(model, keys), positions, place)
            markers = replace(markers, sites=replace(markers.sites, offset=offsets))
            term = PositionTerm(filled, seen / MARKER_SIGMA_M**2)
            model = replace(model, problem=replace(problem, sites=markers.sites, term=term))
    return MarkerHand(markers, model.problem, frame_states(model, keys))


def calibrated_offsets(
    problem: HandProblem, states: np.ndarray, positions: np.ndarray, place: np.ndarray
) -> Float[np.ndarray, "markers 3"]:
    """Return marker offsets (L, 3) in metres: the weighted mean of observed and initial offsets.

    ``o = (n' / σ² mean_f(G_fᵀ (m_f - p_f)) + o⁰ / σ⁰²) / (n' / σ² + 1 / σ⁰²)``. m_f is the marker in frame f. G_f and
    p_f are the rotation and origin of its hand segment. o⁰ is the initial offset (``place``). σ and σ⁰ are the standard
    deviations of observed and initial offsets. n' is the number of frames with independent errors.
    """
    frames = np.unique(np.linspace(0, len(positions) - 1, min(len(positions), SAMPLE)).astype(int))
    posed = problem.skeleton.pose(states[frames][:, FINGERS])
    R = exp_so3(states[frames][:, :3]) @ problem.wrist.rotations[frames]
    G = R[:, None] @ site_frames(posed, problem.sites)
    left = positions[frames] - problem.points(states[frames], frames)
    shown = np.isfinite(left).all(-1)
    own = problem.sites.offset + (np.swapaxes(G, -1, -2) @ np.where(shown[..., None], left, 0.0)[..., None])[..., 0]
    count = shown.sum(0)[:, None]
    mean = np.where(shown[..., None], own, 0.0).sum(0) / np.maximum(count, 1)
    # Errors in neighbouring frames are correlated. A take contains about as much information as 12 independent frames.
    precision = np.minimum(count, 12) / (2 * MARKER_SIGMA_M) ** 2
    return (precision * mean + place / PLACE_SIGMA_M**2) / (precision + 1 / PLACE_SIGMA_M**2)


def marker_size(skeleton: HandSkeleton, labels: tuple[str, ...], positions: np.ndarray) -> float:
    """Estimate a hand's size relative to the skeleton from the distances between palm markers."""
    sites = hand_markers(skeleton, labels).sites
    one, other = np.triu_indices(len(labels), 1)
    rigid = (sites.segment[one] == 0) & (sites.segment[other] == 0)
    rigid &= np.linalg.norm(sites.offset[one] - sites.offset[other], axis=-1) > 0.02
    if not rigid.any():
        return 1.0
    found = np.linalg.norm(positions[:, one[rigid]] - positions[:, other[rigid]], axis=-1)
    ratios = found / np.linalg.norm(sites.offset[one[rigid]] - sites.offset[other[rigid]], axis=-1)
    known = ratios[np.isfinite(ratios)]
    return float(np.clip(np.median(known), *SIZES)) if len(known) else 1.0


LEAST_FRAMES = 8  # Smallest number of frames that must show a marker.
SPREAD_M, REACH_M = 0.008, 0.035
"""Largest median distances in metres: from a marker to its mean position on a segment, and from there to the bone."""
AS_GOOD, AS_GOOD_M = 1.5, 0.002  # Candidates have up to this factor times the smallest spread, plus these metres.
_SEGMENTS = HandSites(
    np.array([0, *np.repeat(np.arange(5), 3)]), np.array([0, *np.tile(np.arange(1, 4), 5)]), np.zeros((16, 3))
)  # The palm and three bones per finger, at their joints.


@dataclass(frozen=True)
class Extra:
    """Unlabelled points that were attached to a hand as markers, with their sites and their columns in the take."""

    sites: HandSites
    columns: tuple[int, ...]


def attach_markers(
    problem: HandProblem, states: Float[np.ndarray, "frames d"], positions: Float[np.ndarray, "frames n 3"]
) -> Extra:
    """Attach unknown markers to the hand segments that they move with.

    A marker x has the offset ``o_s = median_f G_sᵀ (x - p_s)`` from segment s with rotation G_s and origin p_s. Among
    the segments with nearly constant offsets, the function selects the nearest one. ``states`` (F, D) are the hand's
    states. ``positions`` (F, N, 3) are the unknown markers in metres.
    """
    posed = problem.skeleton.pose(states[:, FINGERS])
    R = exp_so3(states[:, :3]) @ problem.wrist.rotations
    G = R[:, None] @ site_frames(posed, _SEGMENTS)
    joints = problem.at(_SEGMENTS).points(states)
    found: list[tuple[int, int, np.ndarray]] = []
    for column in range(positions.shape[1]):
        seen = np.isfinite(positions[:, column]).all(-1)
        if seen.sum() < LEAST_FRAMES:
            continue
        away = positions[seen, column, None] - joints[seen]
        local = (np.swapaxes(G[seen], -1, -2) @ away[..., None])[..., 0]
        offset = np.median(local, axis=0)
        spread = np.median(np.linalg.norm(local - offset, axis=-1), axis=0)
        far = _from_bones(problem, offset)
        spread = np.where(far > REACH_M, np.inf, spread)
        if spread.min() > SPREAD_M:
            continue
        good = np.flatnonzero(spread <= AS_GOOD * spread.min() + AS_GOOD_M)
        found.append((column, int(good[far[good].argmin()]), offset))
    rows = [segment for _, segment, _ in found]
    offsets = np.array([offset[segment] for _, segment, offset in found]).reshape(-1, 3)
    sites = HandSites(_SEGMENTS.finger[rows], _SEGMENTS.segment[rows], offsets)
    return Extra(sites, tuple(column for column, *_ in found))


def with_extra(markers: HandMarkers, labels: tuple[str, ...], extra: Extra) -> HandMarkers:
    """Append the attached markers to the hand's markers."""
    one, other = markers.sites, extra.sites
    pairs = (one.finger, other.finger), (one.segment, other.segment), (one.offset, other.offset)
    sites = HandSites(*(np.concatenate(pair) for pair in pairs))
    return HandMarkers((*markers.labels, *(labels[c] for c in extra.columns)), sites)


def worn_hand(
    measured: HandClouds, side: int, skeleton: HandSkeleton, path: WristPath, fps: float, settings: SolveSettings
) -> tuple[HandProblem, tuple[Diagnostic, ...]]:
    """Calibrate the hand of one side (0 left, 1 right) from its markers.

    Return a problem that is ready to be solved, and diagnostics about markers that move with no segment of the hand.
    """
    markers, cloud = hand_markers(skeleton, measured.labels[side]), measured.positions[side]
    hand = calibrated_hand(cloud, markers, skeleton, path, fps, settings)
    if side not in measured.extra:
        return hand.problem, ()
    labels, positions = measured.extra_labels[side], measured.extra[side]
    extra = attach_markers(hand.problem, hand.states, positions)
    left = [label for column, label in enumerate(labels) if column not in extra.columns]
    doubts = (diagnostic("hand_markers_left_out", markers=left, side=SIDES[side]),) if left else ()
    if not extra.columns:
        return hand.problem, doubts
    cloud = np.concatenate([cloud, positions[:, list(extra.columns)]], axis=1)
    both = with_extra(markers, labels, extra)
    return calibrated_hand(cloud, both, skeleton, path, fps, settings).problem, doubts


def _from_bones(problem: HandProblem, offset: Float[np.ndarray, "16 3"]) -> Float[np.ndarray, " 16"]:
    """Return the distances (16,) in metres of a marker from the bones of the hand's segments.

    ``offset`` are the marker's positions relative to each segment. For the palm, the nearest metacarpal is used.
    """
    on_palm = min(_from_line(offset[0], root) for root in problem.skeleton.roots)
    ends = problem.skeleton.bones.reshape(15, 3)
    return np.array([on_palm, *(_from_line(place, end) for place, end in zip(offset[1:], ends, strict=True))])


def _from_line(place: np.ndarray, end: np.ndarray) -> float:
    share = float(np.clip(place @ end / max(float(end @ end), 1e-12), 0.0, 1.0))
    return float(np.linalg.norm(place - share * end))
