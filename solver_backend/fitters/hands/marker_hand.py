"""A hand of known wrists from its markers: offsets and size calibrated on the take, fingers by the prior."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.hand_markers import HandMarkers, hand_markers
from solver_backend.body.hand_skeleton import HandSkeleton, site_frames
from solver_backend.fitters.hands.hand_keys import DOF, FINGERS
from solver_backend.fitters.hands.hand_problem import HandProblem, KeyModel, WristPath
from solver_backend.fitters.hands.hand_size import SIZES
from solver_backend.fitters.hands.solve_hand import hand_window
from solver_backend.fitters.hands.solve_keys import frame_states, solve_keys
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.settings import SolveSettings
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.residuals.positions import PositionTerm
from solver_backend.types.shapes import Float

MARKER_SIGMA_M = 0.002
"""Standard deviation per axis of a marker around where a rigid bone has it: skin slides over knuckles."""
PLACE_SIGMA_M = 0.006
"""The same of a marker's place around its rule, before it is calibrated."""
ROUNDS = 3
"""Solves between which offsets are calibrated."""
SAMPLE = 150
"""Frames at most on which offsets are calibrated."""


@dataclass(frozen=True)
class MarkerHand:
    """A hand solved from markers."""

    markers: HandMarkers
    """Labels, and sites as they were calibrated."""
    problem: HandProblem
    """What it was solved from."""
    states: Float[np.ndarray, "frames d"]
    """(F, D), see ``hand_keys``."""

    @property
    def angles(self) -> Float[np.ndarray, "frames a"]:
        """(F, A) radians."""
        return self.states[:, FINGERS]


def calibrated_hand(
    positions: Float[np.ndarray, "frames markers 3"], markers: HandMarkers, skeleton: HandSkeleton, path: WristPath,
    fps: float, settings: SolveSettings,
) -> MarkerHand:  # fmt: skip
    """Return a hand of known size, its markers' offsets calibrated between the solves.

    Args:
        positions: (F, L, 3) metres of the hand's markers, NaN where missing.
        markers: these.
        skeleton: of the hand.
        path: where a body has the wrist.
        fps: frames per second.
        settings: robust scale and iterations.
    """
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
    """Return (L, 3) offsets between what the frames show and the rule, each as sure as it is.

    ``o = (Σ_f G_fᵀ (m_f - p_f) / σ² n' + o⁰ / σ⁰²) / (n' / σ² + 1 / σ⁰²)`` with n' frames whose errors are independent.
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
    # Errors of neighbouring frames are correlated: a take holds as much information as a dozen of its frames.
    precision = np.minimum(count, 12) / (2 * MARKER_SIGMA_M) ** 2
    return (precision * mean + place / PLACE_SIGMA_M**2) / (precision + 1 / PLACE_SIGMA_M**2)


def marker_size(skeleton: HandSkeleton, labels: tuple[str, ...], positions: np.ndarray) -> float:
    """Return how many times the skeleton's a hand is, by distances of markers on the same segment or the palm."""
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
