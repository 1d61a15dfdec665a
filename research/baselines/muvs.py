"""Implement MuVS (Huang et al. 2017) as in the thesis (6.3.5): staged fits with VPoser, and a DCT stage."""

from __future__ import annotations

from dataclasses import dataclass

from research.baselines.base import BaselineResult
from research.baselines.links import JointTargets, low_frequencies
from research.baselines.person import ROBUST_SCALE, BodyBaseline, Prepared
from research.baselines.sequence import (
    PosedJoints,
    Sequence,
    States,
    initial_states,
    pose_prior,
    with_weight,
)

STAGES = ((4.0, 4.0), (2.0, 2.0), (1.0, 1.0))  # Factors of robust scale and latent weight for each stage.
_START = "start and shape from triangulated points in place of HMR"


@dataclass(frozen=True)
class MuVS(BodyBaseline):
    """Fits each frame separately with a robust data term and VPoser's density, in three stages."""

    latent_weight: float = 3.0  # Weight of ``|z|²/2`` in the last stage, chosen by ``tune_baselines``.
    iterations: int = 10  # Largest number of linearisations per stage.
    name: str = "MuVS"
    simplified: str = f"Levenberg-Marquardt in place of L-BFGS, no silhouettes, {_START}."

    def fit(self, prepared: Prepared) -> BaselineResult:
        """Fit each frame separately in stages."""
        sequence, states = by_frame(prepared, self.latent_weight, self.iterations)
        return prepared.result(self.name, sequence.poses(states))


@dataclass(frozen=True)
class DCT(BodyBaseline):
    """MuVS, followed by a fit to the slowest cosines of each joint's path over half a second."""

    latent_weight: float = 3.0  # As in MuVS, chosen by ``tune_baselines``.
    sigma_m: float = 0.003  # Deviation of joints from their low frequencies, chosen by ``tune_baselines``.
    segment: int = 30  # Frames per segment (Huang et al. 2017).
    kept: int = 10  # Cosines per segment (Huang et al. 2017).
    rounds: int = 4  # Number of times that coefficients and poses are fitted in turn.
    name: str = "DCT"
    simplified: str = f"As MuVS. Coefficients and poses are found in turn instead of together, {_START}."

    def fit(self, prepared: Prepared) -> BaselineResult:
        """Fit each frame, and then fit poses and low joint frequencies in turn."""
        sequence, states = by_frame(prepared, self.latent_weight, MuVS.iterations)
        for _ in range(self.rounds):
            joints = PosedJoints.of(prepared.subject, sequence.poses(states), sequence.d_pose_d_state(states)).joints
            slow = low_frequencies(joints, self.segment, self.kept)
            link = JointTargets(prepared.subject, slow, self.sigma_m)
            states = sequence.solve(states, ROBUST_SCALE, 3, link)
        return prepared.result(self.name, sequence.poses(states))


def by_frame(prepared: Prepared, latent_weight: float, iterations: int) -> tuple[Sequence, States]:
    """Fit visible frames separately in stages, and return all frames."""
    prior = pose_prior()
    sequence = Sequence(prepared.subject, prior, prepared.problem.objective, latent_weight)
    states = initial_states(prepared, prior)
    part = Sequence(prepared.subject, prior, prepared.problem.objective.select(prepared.seen), latent_weight)
    fitted = states.select(prepared.seen)
    for scale, weight in STAGES:
        fitted = with_weight(part, weight * latent_weight).solve(fitted, scale * ROBUST_SCALE, iterations)
    return sequence, states.replaced(prepared.seen, fitted)
