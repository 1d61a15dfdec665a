"""Implement ETC and DMMR, which solve a whole sequence of Gaussian codes at once (thesis 6.3.5)."""

from __future__ import annotations

from dataclasses import dataclass

from research.baselines.base import BaselineResult
from research.baselines.links import SlowCodes, SlowJoints
from research.baselines.muvs import by_frame
from research.baselines.person import ROBUST_SCALE, BodyBaseline, Prepared
from research.baselines.sequence import Link, Sequence, States, initial_states, pose_prior, with_weight

_START = "start and shape from triangulated points in place of HMR"


@dataclass(frozen=True)
class ETC(BodyBaseline):
    """Exploiting Temporal Context (Arnab et al. 2019) with several views: slow joints throughout the take."""

    latent_weight: float = 0.3  # Weight of ``|z|²/2``, chosen by ``tune_baselines``.
    speed_m_s: float = 1.0  # Standard deviation of a joint's speed per axis, chosen by ``tune_baselines``.
    iterations: int = 12  # Largest number of linearisations.
    name: str = "ETC"
    simplified: str = (
        "Gauss-Newton over all frames in place of L-BFGS, squared differences in place of Huber's, VPoser in place of "
        f"a Gaussian mixture, {_START}."
    )

    def fit(self, prepared: Prepared) -> BaselineResult:
        """Fit each frame separately, then fit all frames together."""
        sequence, states = by_frame(prepared, self.latent_weight, self.iterations)
        link = SlowJoints(prepared.subject, prepared.problem.fps, self.speed_m_s)
        states = sequence.solve(states, ROBUST_SCALE, self.iterations, link)
        return prepared.result(self.name, sequence.poses(states))


@dataclass(frozen=True)
class DMMR(BodyBaseline):
    """Dynamic Multi-person Mesh Recovery (Huang et al. 2021): slow latent codes, in four stages."""

    latent_weight: float = 12.0  # Weight of ``|z|²/2``, chosen by ``tune_baselines``.
    codes_per_s: float = 1.25  # Standard deviation of a code's speed, chosen by ``tune_baselines``.
    root_per_s: float = 2.0  # Standard deviation of the root's speed in rad/s and m/s, chosen by an earlier search.
    iterations: int = 8  # Largest number of linearisations per stage.
    name: str = "DMMR"
    simplified: str = (
        "VPoser's latents with a penalty on their speed in place of a recurrent motion autoencoder's, one person, "
        f"fixed cameras, Gauss-Newton in place of L-BFGS, {_START}."
    )

    def fit(self, prepared: Prepared) -> BaselineResult:
        """Fit all frames together in four stages."""
        prior = pose_prior()
        sequence = Sequence(prepared.subject, prior, prepared.problem.objective, self.latent_weight)
        states = initial_states(prepared, prior)
        link = SlowCodes(prepared.problem.fps, self.codes_per_s, self.root_per_s)
        return prepared.result(self.name, sequence.poses(self._staged(sequence, states, link)))

    def _staged(self, sequence: Sequence, states: States, link: Link) -> States:
        for factor in (8.0, 4.0, 2.0, 1.0):
            narrowed = with_weight(sequence, factor * self.latent_weight)
            states = narrowed.solve(states, factor * ROBUST_SCALE, self.iterations, link)
        return states
