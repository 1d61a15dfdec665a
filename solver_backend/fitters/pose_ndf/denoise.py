"""Motion denoising: poses near the observation, near the manifold, and smooth (Tiwari et al. 2022, sec. 4.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from array_api_compat import array_namespace

from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.pose_ndf.sequence_equations import ManifoldWeights, PoseSequence
from solver_backend.fitters.pose_ndf.sequence_solver import solve_sequence
from solver_backend.priors.pose_ndf.pose_ndf import PoseNDF

WEIGHTS = ManifoldWeights(data=1.0, manifold=0.03, smoothness=2.0, level=0.5)
"""Chosen on takes of training subjects, clean and with noise of 6.5 degrees, at 30 frames a second."""


@dataclass(frozen=True)
class DenoiseSettings:
    """Weights of (7) and how long to search."""

    weights: ManifoldWeights = WEIGHTS
    """At 30 frames a second."""
    iterations: int = 20
    """Linearisations at most for each chunk of frames."""
    move_root: bool = True
    """Whether the root's rotation and translation may move too, which only smoothness and data hold."""


def denoise(
    subject: Subject,
    prior: PoseNDF,
    frames: PosedFrames,
    fps: float,
    settings: DenoiseSettings = DenoiseSettings(),
    progress: Progress = silent,
) -> PosedFrames:
    """Return the poses that minimise ``λ_v L_v + λ_θ L_θ + λ_t L_t`` (7), from the noisy ones.

    Args:
        subject: body, shape and the landmarks that stand for its skin, in ``L_v`` and in ``L_t``.
        prior: whose distance f makes ``L_θ``, here ``max(f - level, 0)²``.
        frames: F noisy poses; their own landmarks are the observation.
        fps: frames per second; ``λ_t`` grows with its square, so that a speed costs the same at every rate.
        settings: weights.
        progress: called as chunks of frames are done.

    Raises:
        PoseInvalid: poses that are NaN or off SO(3).
    """
    xp = array_namespace(frames.local)
    observed = pose(subject, frames).points
    w = settings.weights
    weights = replace(w, smoothness=w.smoothness * (fps / 30.0) ** 2)
    columns = range(frames.layout.dof)
    free = columns if settings.move_root else columns[frames.layout.joints]
    sequence = PoseSequence(subject, prior, weights, observed, xp.ones_like(observed[..., 0]), tuple(free))
    return solve_sequence(sequence, frames, settings.iterations, "Denoising", progress)[0]
