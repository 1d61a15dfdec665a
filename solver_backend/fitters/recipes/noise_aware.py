"""Estimate the reliability of each landmark together with the pose, frame by frame (thesis ch. 5)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.state_layout import CODE, RESIDUAL, ROOT, TRANSL, StateLayout
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.optimise import Stretches, in_turn
from solver_backend.fitters.model.subject import FrameStates, PosedFrames, Subject, pose
from solver_backend.fitters.problem import Convergence, MethodResult, Problem, SolvedFrames
from solver_backend.fitters.single_frame import BLOCK_FRAMES, bridged_states, fit_to_points, posed, sample_frames
from solver_backend.geometry.arrays import constant, to_numpy
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3
from solver_backend.priors.choose import load_gaussian
from solver_backend.priors.gaussian_vae import GaussianVAE
from solver_backend.residuals.landmark_loss import FixedVariances, LandmarkLoss, LearnedVariances
from solver_backend.solver.independent_lbfgs import QuasiNewtonResult, QuasiNewtonSettings, independent_lbfgs

SIGMA_M = 0.01  # σ0, fixed standard deviation in the first stage per axis, metres. Log-variances are relative to it.
POSE_WEIGHT, SHAPE_WEIGHT = 0.5, 0.5  # λ_pose for ``|z|²`` and λ_β for ``|β|²`` (thesis 5.4, half for unit variance).


ACCEL_M_S2 = 8.0
"""Standard deviation of a landmark's acceleration per axis in m/s². Chosen by hand."""


@dataclass(frozen=True)
class SteadyLandmarks:
    """Temporal term that limits the accelerations of landmarks. It is not part of the thesis.

    ``E_t = 1/2 sum_l |y_{l,t-1} - 2 y_{l,t} + y_{l,t+1}|² / (a dt²)²`` with ``a = ACCEL_M_S2``. Section 5.4 names the
    lack of temporal correlation as the method's limitation.
    """

    fps: float  # Frames per second.
    before: np.ndarray  # (n, L, 3) fixed landmarks in the preceding frames, two or none.
    inside: np.ndarray  # (n + F,) bool: both neighbours of a frame are the adjacent frames in the take.

    @classmethod
    def of(cls, frames: np.ndarray, fps: float, before: np.ndarray, frames_before: np.ndarray) -> SteadyLandmarks:
        """Create the term for F frames that follow n earlier frames with known landmarks."""
        follows = np.r_[False, np.diff(np.r_[frames_before, frames]) == 1, False]
        return cls(fps, before, follows[:-1] & follows[1:])

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return costs (F,) and their gradient (F, L, 3) at landmarks (F, L, 3)."""
        y, n = np.concatenate([self.before, points]), len(self.before)
        bend, gradient = np.zeros((2, *y.shape))
        if len(y) > 2:
            bend[1:-1] = (y[:-2] - 2.0 * y[1:-1] + y[2:]) * self.inside[1:-1, None, None]
            gradient = -2.0 * bend
            gradient[:-1] += bend[1:]
            gradient[1:] += bend[:-1]
        weight, cost = (self.fps**2 / ACCEL_M_S2) ** 2, np.zeros(len(y))
        cost += 0.5 * weight * (bend * bend).sum((1, 2))
        cost[n : n + 1] += cost[:n].sum()  # The bend at the last preceding frame depends on the first frame here.
        return cost[n:], weight * gradient[n:]


@dataclass(frozen=True)
class LandmarkFit:
    """Person, prior and measurements for fitting F poses. Landmarks are at the standard positions of their layout."""

    subject: Subject
    prior: GaussianVAE
    start: FrameStates
    points: np.ndarray  # (F, L, 3) measured landmarks, metres, finite.
    seen: np.ndarray  # (F, L) bool.

    @property
    def layout(self) -> StateLayout:
        """Layout of a frame's unknowns. Codes are points in flat space."""
        return StateLayout.of(self.prior.latent_dim, len(self.prior.joints)).without(RESIDUAL)

    def select(self, frames: np.ndarray | slice) -> LandmarkFit:
        """Return the fit restricted to the selected frames."""
        return replace(self, start=self.start.select(frames), points=self.points[frames], seen=self.seen[frames])

    def unknowns(self, loss: LandmarkLoss) -> np.ndarray:
        """Return the initial unknowns (F, 38 + n). The last n are unknowns of the loss, such as log-variances."""
        unknowns = np.zeros((len(self.seen), self.layout.dof + loss.unknowns(self.seen.shape[1])))
        unknowns[:, self.layout[CODE]], unknowns[:, self.layout[TRANSL]] = self.start.z, self.start.transl
        return unknowns

    def states(self, x: np.ndarray) -> FrameStates:
        """Convert unknowns (F, 38 or more) to states."""
        code, root, transl = (x[:, self.layout[name]] for name in (CODE, ROOT, TRANSL))
        return FrameStates(code, exp_so3(root) @ self.start.root, transl)

    def evaluate(
        self, x: np.ndarray, loss: LandmarkLoss, steady: SteadyLandmarks | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return costs (F,) without the shape prior, and gradients w.r.t. unknowns and shape.

        ``steady`` limits the landmarks' accelerations in these frames.
        """
        states = self.states(x)
        local, decoder_vjp = self.prior.decode_with_vjp(states.z)
        placed = pose(self.subject, PosedFrames(states.root, local, states.transl), jacobian=True)
        assert placed.by_rotations is not None and placed.by_betas is not None
        error = placed.points - self.points
        found = loss((error * error).sum(-1) / SIGMA_M**2, self.seen, x[:, self.layout.dof :])
        by_points = 2.0 / SIGMA_M**2 * found.by_squared[..., None] * error
        cost = found.cost + POSE_WEIGHT * (states.z**2).sum(-1)
        if steady is not None:
            bent, pull = steady(placed.points)
            cost, by_points = cost + bent, by_points + pull
        by_points = by_points.reshape(len(x), 1, -1)
        by_turns = (by_points @ placed.by_rotations.reshape(len(x), by_points.shape[-1], -1)).reshape(len(x), -1, 3)
        by_code = decoder_vjp(by_turns[:, 1:]) + 2.0 * POSE_WEIGHT * states.z
        by_root = (by_turns[:, :1] @ left_jacobian_so3(x[:, self.layout[ROOT]]))[:, 0]
        by_transl = by_points.reshape(error.shape).sum(axis=1)
        by_betas = (by_points @ placed.by_betas.reshape(len(x), by_points.shape[-1], -1))[:, 0]
        return cost, np.concatenate([by_code, by_root, by_transl, found.by_own], axis=1), by_betas

    def scale(self, loss: LandmarkLoss) -> np.ndarray:
        """Estimate the inverse second derivatives (F, 38 + n) of the cost at the initial unknowns."""
        local, by_code = self.prior.decode_with_jacobian(self.start.z)
        placed = pose(self.subject, PosedFrames(self.start.root, local, self.start.transl), jacobian=True)
        assert placed.by_rotations is not None
        count, weight = len(self.seen), self.seen[..., None, None] / SIGMA_M**2
        by_latent = placed.by_rotations[..., 3:] @ by_code.reshape(count, 1, -1, by_code.shape[-1])
        second = [(weight * part**2).sum((1, 2)) for part in (by_latent, placed.by_rotations[..., :3])]
        own = np.full((count, loss.unknowns(self.seen.shape[1])), 0.5)
        by_transl = np.repeat(weight.sum((1, 2)), 3, axis=1)
        by_latent, by_root = second[0] + 2.0 * POSE_WEIGHT, second[1] + 1.0
        return 1.0 / np.concatenate([by_latent, by_root, by_transl + 1.0, own], axis=1)

    def fit_poses(self, loss: LandmarkLoss, settings: QuasiNewtonSettings) -> tuple[FrameStates, QuasiNewtonResult]:
        """Fit the pose in every frame independently, with a fixed body shape."""

        def objective(x: np.ndarray, problems: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return self.select(problems).evaluate(x, loss)[:2]

        found = independent_lbfgs(objective, self.unknowns(loss), self.scale(loss), settings)
        return self.states(found.x), found

    def fit_motion(
        self, loss: LandmarkLoss, steady: SteadyLandmarks, settings: QuasiNewtonSettings
    ) -> tuple[FrameStates, QuasiNewtonResult]:
        """Fit all poses together, with a fixed body shape and limited landmark accelerations."""
        shape = self.unknowns(loss).shape

        def objective(x: np.ndarray, problems: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            found = [self.evaluate(row.reshape(shape), loss, steady)[:2] for row in x]
            return np.array([cost.sum() for cost, _ in found]), np.stack([gradient.ravel() for _, gradient in found])

        start, scale = (values.reshape(1, -1) for values in (self.unknowns(loss), self.scale(loss)))
        found = independent_lbfgs(objective, start, scale, settings)
        return self.states(found.x.reshape(shape)), found

    def fit_shape(self, loss: LandmarkLoss, settings: QuasiNewtonSettings) -> tuple[Subject, FrameStates]:
        """Fit body shape and poses in all frames together. The loss must not have unknowns."""
        frames, betas = len(self.seen), self.subject.betas
        parts = frames * self.layout.dof

        def at(x: np.ndarray) -> LandmarkFit:
            return replace(self, subject=replace(self.subject, betas=x[parts:]))

        def objective(x: np.ndarray, problems: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            fits = [at(row).evaluate(row[:parts].reshape(frames, -1), loss) for row in x]
            own = x[:, parts:]
            cost = np.array([part[0].sum() for part in fits]) + SHAPE_WEIGHT * (own * own).sum(-1)
            by_betas = np.stack([part[2].sum(axis=0) for part in fits]) + 2.0 * SHAPE_WEIGHT * own
            return cost, np.concatenate([np.stack([part[1].ravel() for part in fits]), by_betas], axis=1)

        placed = pose(self.subject, posed(self.prior, self.start), jacobian=True)
        assert placed.by_betas is not None
        by_betas = (self.seen[..., None, None] * placed.by_betas**2).sum((0, 1, 2)) / SIGMA_M**2
        scale = np.concatenate([self.scale(loss).ravel(), 1.0 / (by_betas + 2.0 * SHAPE_WEIGHT)])[None]
        start = np.concatenate([self.unknowns(loss).ravel(), betas])[None]
        best = independent_lbfgs(objective, start, scale, settings).x[0]
        return at(best).subject, self.states(best[:parts].reshape(frames, -1))


SHAPE_FRAMES = 12  # Number of frames from which the shape is estimated, as in MoSh++ (Mahmood et al. 2019).
STEPS = QuasiNewtonSettings()  # Settings of both stages.
TOGETHER = QuasiNewtonSettings(tolerance=1e-5)
"""Settings for all frames together. The tolerance is low, because a few moving frames barely change the total cost."""


def solve_noise_aware(
    problem: Problem,
    subject: Subject,
    settings: SolveSettings,
    progress: Progress,
    each: Stretches = in_turn,
    *,
    loss: LandmarkLoss = LearnedVariances(),
) -> MethodResult:
    """Minimise thesis eq. 5.8 in two stages (5.2.3), and interpolate unobserved frames.

    First, shape, poses and translations are fitted with fixed variances. The shape uses only ``SHAPE_FRAMES`` frames.
    Then the shape is kept, and poses, translations and log-variances of each landmark and frame (``loss``) are fitted.
    """
    like, measured = subject.betas, problem.measurements
    person = replace(subject, betas=to_numpy(subject.betas), offsets=to_numpy(subject.offsets))
    prior, seen = load_gaussian(settings.prior), np.flatnonzero(measured.seen)
    progress("Noise-aware fit", 0, 3)

    def fit_of(person: Subject, frames: np.ndarray) -> LandmarkFit:
        states = fit_to_points(problem, person, frames)
        start = FrameStates(prior.encode(posed(problem.prior, states).local), states.root, states.transl)
        located = measured.located[frames]
        points = np.where(located[..., None], measured.points[frames], 0.0)
        return LandmarkFit(person, prior, start, points, located)

    if settings.betas is None and not measured.knows_person:
        person, _ = fit_of(person, sample_frames(measured, SHAPE_FRAMES)).fit_shape(FixedVariances(), STEPS)
    progress("Noise-aware fit", 1, 3)
    found, ends = [], []
    around, frames_before = np.empty((0, *measured.points.shape[1:])), np.empty(0, dtype=int)
    blocks = [seen[i : i + BLOCK_FRAMES] for i in range(0, len(seen), BLOCK_FRAMES)]
    for number, block in enumerate(blocks):
        fit = fit_of(person, block)
        coarse, _ = fit.fit_poses(FixedVariances(), STEPS)
        fit = replace(fit, start=coarse)
        if settings.temporal:
            steady = SteadyLandmarks.of(block, problem.fps, around, frames_before)
            fine, end = fit.fit_motion(loss, steady, TOGETHER)
            around, frames_before = pose(person, posed(prior, fine.select(slice(-2, None)))).points, block[-2:]
        else:
            fine, end = fit.fit_poses(loss, STEPS)
        found.append(fine)
        ends.append(Convergence(len(block), round(len(block) * end.converged.mean()), end.iterations))
        progress("Noise-aware fit", len(blocks) + 2 * (number + 1), 3 * len(blocks))
    whole = FrameStates.concatenate(found)
    between = bridged_states(replace(whole, z=spherical_normalisation(whole.z)), seen, problem.num_frames)
    codes = np.stack([np.interp(np.arange(problem.num_frames), seen, column) for column in whole.z.T], axis=1)
    frames = posed(prior, replace(between, z=codes))
    frames = PosedFrames(*(constant(part, like) for part in (frames.root, frames.local, frames.transl)))
    return SolvedFrames(replace(subject, betas=constant(person.betas, like)), frames), Convergence.joined(ends)
