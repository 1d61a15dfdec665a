"""Find props (rigid groups of markers that are not on the person), and solve the motion of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.label_places import places_given
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.props import Prop
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.build_motion import PosedTake
from solver_backend.fitters.marker_calibration.unknown_markers import FRAMES, LEAST_MARKERS, BonePoses, loose_groups
from solver_backend.fitters.problem import Layer, Problem, SolvedFrames, SolvedLayer
from solver_backend.geometry.alignment import nearest_rotation, umeyama
from solver_backend.geometry.arrays import quantile, true_runs
from solver_backend.geometry.rotations import (
    cross,
    exp_so3,
    left_jacobian_inverse_so3,
    log_so3,
    matrix_from_quat,
    quat_from_matrix,
    skew,
)
from solver_backend.geometry.small_matrices import mean_sigma, packed
from solver_backend.residuals.terms import geman_mcclure, graduated_scales
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.solver.levenberg_marquardt import LMSettings, minimise
from solver_backend.types import MarkerCloud, Motion

SIZE = 12  # Unknowns per frame in world axes: rotation θ (``R ← exp(θ) R``), shift, angular velocity, velocity. SI.


@dataclass(frozen=True)
class PropState:
    """Motion of a rigid body in F frames: poses ``x_world = R x + t``, angular and linear velocities."""

    R: np.ndarray
    t: np.ndarray
    spin: np.ndarray
    velocity: np.ndarray

    @classmethod
    def of_poses(cls, R: np.ndarray, t: np.ndarray, dt: float) -> PropState:
        """Create the state from poses. Velocities are differences over two frames."""
        before, after = np.maximum(np.arange(len(t)) - 1, 0), np.minimum(np.arange(len(t)) + 1, len(t) - 1)
        step = dt * np.maximum(after - before, 1)[:, None]
        return cls(R, t, turns(R[before], R[after]) / step, (t[after] - t[before]) / step)

    def retract(self, step: np.ndarray) -> PropState:
        """Move the state by a (1, 12 F) tangent step."""
        turn, shift, spin, velocity = np.split(step.reshape(-1, SIZE), 4, axis=1)
        R = exp_so3(turn) @ self.R
        return replace(self, R=R, t=self.t + shift, spin=self.spin + spin, velocity=self.velocity + velocity)


def turns(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the rotation vectors φ (..., 3) between rotations: ``exp(φ) before = after``."""
    return log_so3(after @ np.swapaxes(before, -1, -2))


RELAXES_S = 0.5  # Time constant with which an unmeasured velocity decays. A hand's strokes last 0.2 to 1 s.
TURN_PRECISION = 3.0 / np.pi**2  # Precision of an unknown rotation: an angle between -π and π has the variance π² / 3.


@dataclass(frozen=True)
class PropEquations:
    """Cost, gradient and Hessian of a prop's motion w.r.t. its poses and velocities.

    The cost is ``½ Σ ρ(|R_f p_m + t_f - x_fm|² / σ²) + ½ Σ eᵀ Q⁻¹ e + ½ Σ dt (|ω|² / q_R + |v|² / q_t) / τ²``. p_m is
    marker m on the prop, x_fm its measurement, and ω and v are the velocities. The errors between frames are
    ``e = (log(R_f+1 R_fᵀ) - dt ω_f, t_f+1 - t_f - dt v_f, ω_f+1 - ω_f, v_f+1 - v_f)`` with
    ``Q = [[dt³/3, dt²/2], [dt²/2, dt]] q`` for the densities q of rotation and translation. τ is ``RELAXES_S``.
    References: Barfoot 2017, "State Estimation for Robotics", section 11.2.3 (white noise on acceleration), and
    Uhlenbeck and Ornstein 1930 (decaying velocities).
    """

    points: np.ndarray  # (F, M, 3) recorded markers, metres, NaN where missing.
    rest: np.ndarray  # (M, 3) the markers relative to the prop, metres.
    sigma_m: float  # Standard deviation of a marker per axis.
    unrest: np.ndarray  # (F - 1, 2) power densities q of angular (rad²/s³) and linear acceleration (m²/s³).
    dt: float

    def linearise(self, state: PropState, scale: float) -> tuple[np.ndarray, BlockTridiagonal]:
        """Return the cost (1,) and the normal equations at a robust ``scale``."""
        cost, diagonal, g = self.of_markers(state, scale)
        e, before, after = self._between(state)
        weight = self._precision()
        weighted = (weight @ e[..., None])[..., 0]
        diagonal[:-1] += np.swapaxes(before, -1, -2) @ weight @ before
        diagonal[1:] += np.swapaxes(after, -1, -2) @ weight @ after
        g[:-1] += np.einsum("fij,fi->fj", before, weighted)
        g[1:] += np.einsum("fij,fi->fj", after, weighted)
        rates = np.concatenate([state.spin, state.velocity], axis=1)
        calm = self.dt / RELAXES_S**2 / np.repeat(np.append(self.unrest, self.unrest[-1:], axis=0), 3, axis=1)
        along = np.arange(SIZE // 2, SIZE)
        diagonal[:, along, along] += calm
        g[:, along] += calm * rates
        diagonal[0, :3, :3] += TURN_PRECISION * np.eye(3)
        upper = np.swapaxes(before, -1, -2) @ weight @ after
        cost += 0.5 * float((e * weighted).sum() + (calm * rates**2).sum())
        return np.array([cost]), BlockTridiagonal(diagonal, upper, g)

    def retract(self, state: PropState, step: np.ndarray) -> PropState:
        """Move the state by a (1, 12 F) tangent step."""
        return state.retract(step)

    def residuals(self, state: PropState) -> tuple[np.ndarray, np.ndarray]:
        """Return marker errors (F, M, 3) in metres, zero where unseen, and the rotated markers (F, M, 3)."""
        turned = self.rest @ np.swapaxes(state.R, -1, -2)
        return np.nan_to_num(turned + state.t[:, None] - self.points), turned

    def weights(self, error: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
        """Return robust costs and weights (F, M) of marker errors, zero where unseen."""
        seen = np.isfinite(self.points).all(-1)
        cost, weight = geman_mcclure((error**2).sum(-1) / self.sigma_m**2, scale)
        return np.where(seen, cost, 0.0), np.where(seen, weight, 0.0)

    def of_markers(self, state: PropState, scale: float) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the markers' cost, and their contributions to the Hessian blocks (F, 12, 12) and the gradient."""
        error, turned = self.residuals(state)
        cost, weight = self.weights(error, scale)
        weight = weight / self.sigma_m**2
        lever = skew(turned)
        H, g = np.zeros((len(error), SIZE, SIZE)), np.zeros((len(error), SIZE))
        H[:, :3, :3] = np.einsum("fm,fmki,fmkj->fij", weight, lever, lever)
        H[:, :3, 3:6] = np.einsum("fm,fmij->fij", weight, lever)
        H[:, 3:6, :3] = np.swapaxes(H[:, :3, 3:6], -1, -2)
        H[:, [3, 4, 5], [3, 4, 5]] = weight.sum(axis=1)[:, None]
        g[:, :3] = (weight[..., None] * cross(turned, error)).sum(axis=1)
        g[:, 3:6] = (weight[..., None] * error).sum(axis=1)
        return 0.5 * float(cost.sum()), H, g

    def _between(self, state: PropState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the errors (F - 1, 12) between neighbouring frames, and their Jacobians w.r.t. both frames."""
        turn = turns(state.R[:-1], state.R[1:])
        moved = np.diff(state.t, axis=0) - self.dt * state.velocity[:-1]
        changed = np.diff(np.concatenate([state.spin, state.velocity], axis=1), axis=0)
        e = np.concatenate([turn - self.dt * state.spin[:-1], moved, changed], axis=1)
        J = left_jacobian_inverse_so3(turn)
        after = np.tile(np.eye(SIZE), (len(e), 1, 1))
        before = -after
        after[:, :3, :3] = J
        # exp(φ) exp(-θ) changes φ by the inverse right Jacobian, which is the transposed inverse left one.
        before[:, :3, :3] = -np.swapaxes(J, -1, -2)
        half = np.arange(SIZE // 2)
        before[:, half, half + SIZE // 2] = -self.dt
        return e, before, after

    def _precision(self) -> np.ndarray:
        dt, half = self.dt, np.arange(SIZE // 2)
        share = 1.0 / np.repeat(self.unrest, 3, axis=1)
        weight = np.zeros((len(share), SIZE, SIZE))
        weight[:, half, half] = 12.0 / dt**3 * share
        weight[:, half, half + SIZE // 2] = weight[:, half + SIZE // 2, half] = -6.0 / dt**2 * share
        weight[:, half + SIZE // 2, half + SIZE // 2] = 4.0 / dt * share
        return weight


PASSES = 4  # Number of alternations between poses and shape.
ON_A_LINE_M = 0.01  # Markers with a smaller RMS distance from a line leave the rotation about it undetermined.
LEAST_SIGMA_M, MOST_SIGMA_M = 3e-4, 5e-3  # Limits of a marker's deviation. Optical systems reach 0.1 to 1 mm.


@dataclass(frozen=True)
class PropStart:
    """Initial shape and poses of a prop."""

    rest: np.ndarray  # (M, 3) markers relative to their centroid, metres.
    R: np.ndarray
    t: np.ndarray
    posed: np.ndarray  # (F,) bool: the frame shows at least three markers. Other frames are interpolated.
    sigma_m: float  # Standard deviation of a marker per axis.


def start_prop(points: np.ndarray) -> PropStart:
    """Estimate a prop's shape and poses from markers (F, M, 3) that move as one rigid body.

    The frame with the most markers gives the initial shape. Then two steps alternate: align the shape to each frame
    (``umeyama``), and set the shape to the median over all frames.
    """
    seen = np.isfinite(points).all(-1)
    best = int(seen.sum(axis=1).argmax())
    rest = points[best] - points[best][seen[best]].mean(axis=0)
    for _ in range(PASSES):
        R, t, posed = _poses(points, rest)
        own = (points - t[:, None]) @ R
        rest = quantile(np.where(posed[:, None, None], own, np.nan), 0.5, axis=0)
    rest -= rest.mean(axis=0)
    R, t, posed = _poses(points, rest)
    if np.linalg.svd(rest, compute_uv=False)[1] < ON_A_LINE_M * np.sqrt(len(rest)):
        R = _least_turned(np.linalg.svd(rest)[2], R)
    error = (points - (rest @ np.swapaxes(R, -1, -2) + t[:, None]))[posed]
    numbers = 3.0 * float(np.median(seen[posed].sum(axis=1)))
    freedom = (numbers - 6.0) / numbers if numbers > 6.0 else 1.0
    sigma = 1.4826 / np.sqrt(freedom) * float(quantile(np.abs(error), 0.5, axis=(0, 1, 2)))
    return PropStart(rest, *_between(R, t, posed), posed, min(max(sigma, LEAST_SIGMA_M), MOST_SIGMA_M))


def _poses(points: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    usable = np.isfinite(points).all(-1) & np.isfinite(rest).all(-1)
    posed = usable.sum(axis=1) >= 3
    R, t = np.tile(np.eye(3), (len(points), 1, 1)), np.zeros((len(points), 3))
    shape = np.broadcast_to(rest, points.shape)
    _, R[posed], t[posed] = umeyama(shape[posed], points[posed], usable[posed].astype(np.float64))
    return R, t, posed


def _least_turned(axes: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Return the smallest rotations that align the line ``axes[0]`` with its direction ``R axes[0]`` in each frame.

    For a half turn, the rotation axis is ``axes[1]``.
    """
    to = R @ axes[0]
    across = np.cross(axes[0], to)
    sine = np.linalg.norm(across, axis=-1)
    unit = np.where(sine[:, None] > 1e-9, across / np.maximum(sine, 1e-9)[:, None], axes[1])
    return exp_so3(np.arctan2(sine, to @ axes[0])[:, None] * unit)


def _between(R: np.ndarray, t: np.ndarray, posed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    at, frames = np.flatnonzero(posed), np.arange(len(t))
    quat = quat_from_matrix(R[at])
    flip = np.cumprod(np.where((quat[1:] * quat[:-1]).sum(-1) < 0, -1.0, 1.0))
    quat[1:] *= flip[:, None]
    full = np.stack([np.interp(frames, at, quat[:, k]) for k in range(4)], axis=1)
    full /= np.linalg.norm(full, axis=1, keepdims=True)
    return matrix_from_quat(full), np.stack([np.interp(frames, at, t[at, k]) for k in range(3)], axis=1)


LAG_S, AROUND_S, USUAL_S = 0.1, 1.0, 0.1
"""Time lag of accelerations, averaging window for ``unrest_of``, and weight of the take's mean, all in seconds."""
LEAST_SHARE, LEAST_M, LEAST_RAD = 0.02, 2e-4, 2e-3  # Smallest unrest relative to the take's, and of a still prop.


def unrest_of(start: PropStart, fps: float) -> np.ndarray:
    """Estimate the power densities (F - 1, 2) of a prop's angular and linear acceleration.

    With white-noise acceleration of density q, the displacements over two consecutive spans h differ with a variance of
    ``⅔ q h³``.
    """
    frames = len(start.t)
    lag = max(1, min(round(LAG_S * fps), (frames - 1) // 2))
    span, middle = lag / fps, slice(lag, frames - lag)
    known = start.posed[: frames - 2 * lag] & start.posed[middle] & start.posed[2 * lag :]
    R, t = start.R, start.t
    second = turns(R[middle], R[2 * lag :]) - turns(R[: frames - 2 * lag], R[middle])
    bend = t[2 * lag :] - 2 * t[middle] + t[: frames - 2 * lag]
    square = np.stack([(second**2).mean(-1), (bend**2).mean(-1)], axis=1)
    usual = square[known].mean(axis=0) if known.any() else np.zeros(2)
    width = max(1, round(AROUND_S * fps))
    count, total = _around(known, width), np.stack([_around(square[:, k] * known, width) for k in range(2)], axis=1)
    prior = max(1.0, USUAL_S * fps)
    local = (total + prior * usual) / (count + prior)[:, None]
    least = np.maximum(LEAST_SHARE * usual, np.square([LEAST_RAD, LEAST_M]))
    density = np.maximum(local, least) * 1.5 / span**3
    return density[np.clip(np.arange(frames - 1) - lag, 0, len(density) - 1)]


def _around(values: np.ndarray, width: int) -> np.ndarray:
    sums = np.concatenate([[0.0], np.cumsum(values, dtype=np.float64)])
    at = np.arange(len(values))
    return sums[np.minimum(at + width // 2 + 1, len(values))] - sums[np.maximum(at - width // 2, 0)]


@dataclass(frozen=True)
class Props(Layer):
    """Layer of a solve: recorded markers without a known location on the person."""

    loose: tuple[MarkerCloud, ...] = ()  # Markers with the person's prefix. Some of them are carried by bones.
    others: tuple[MarkerCloud, ...] = ()  # Markers with other prefixes.

    @classmethod
    def of(cls, cloud: MarkerCloud, worn: Sequence[str], layout: str, others: MarkerCloud | None) -> Props:
        """Create the layer from recorded markers that are neither the person's nor computed by a program.

        Args:
            worn: labels of the person's markers.
            layout: path of a file with label locations, see ``read_label_places``. Empty for none.
            others: markers whose label prefix is not the person's.
        """
        names = name_markers([label for label in cloud.names if not is_unnamed(label)], places_given(layout))
        used = {*worn, *names.virtual, *names.doubled}
        kept = [i for i, label in enumerate(cloud.names) if label not in used]
        return cls((cloud.columns(kept),) if kept else (), () if others is None else (others,))

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Find the rigid groups among the markers, and solve each of them."""
        props, found = solve_props(self, solved, progress)
        return solved.noting(found), SolvedProps(props)


@dataclass(frozen=True)
class SolvedProps(SolvedLayer):
    """Solved props of a take, in solving order."""

    props: tuple[Prop, ...]

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Store the props in the motion."""
        return replace(motion, props=self.props) if self.props else motion


FIRST_SCALE, SCALE, SCALES = 1000.0, 4.0, 5
"""First and last robust scale, and number of scales, because some frames start with errors of decimetres."""
WRONG_M = 0.018  # Smallest error of a wrong distance, three times a rigid body's. The robust kernel handles others.
STEPS = LMSettings(6, 1e-5)  # Most Gauss-Newton steps, and relative change of the cost at which they end. By hand.
LEAST_FRAMES = 4  # Smallest number of frames that locate a prop, chosen by hand.


def solve_prop(name: str, labels: Sequence[str], points: np.ndarray, fps: float) -> Prop | None:
    """Solve a prop with M labelled markers. Return None if too few frames show three of the markers.

    ``points`` are (F, M, 3) in world metres, NaN where missing.
    """
    if (np.isfinite(points).all(-1).sum(axis=1) >= LEAST_MARKERS).sum() < LEAST_FRAMES:
        return None
    points = _without_wrong_points(points)
    start = start_prop(points)
    known = np.flatnonzero(np.isfinite(start.rest).all(-1))
    if len(known) < len(labels):
        return solve_prop(name, [labels[int(m)] for m in known], points[:, known], fps)
    equations = PropEquations(points, start.rest, start.sigma_m, unrest_of(start, fps), 1.0 / fps)
    state = PropState.of_poses(start.R, start.t, 1.0 / fps)
    stages = [(scale, STEPS) for scale in graduated_scales(SCALE, FIRST_SCALE, SCALES)]
    state = minimise(equations, state, stages).state
    equations = _learned(equations, state)
    state = minimise(equations, state, stages[-1:]).state
    return _prop(name, labels, equations, state)


def _learned(equations: PropEquations, state: PropState) -> PropEquations:
    error, _ = equations.residuals(state)
    _, weight = equations.weights(error, SCALE)
    own = (np.nan_to_num(equations.points - state.t[:, None])) @ state.R
    total = weight.sum(axis=0)[:, None]
    mean = (weight[..., None] * own).sum(axis=0) / np.maximum(total, 1e-9)
    return replace(equations, rest=np.where(total > 0, mean, equations.rest))


def _of_true_spread(equations: PropEquations, state: PropState) -> PropEquations:
    """Set the marker deviation to the standard deviation of the residuals: ``σ² = Σ w |r|² / (3 Σ w - tr H C)``.

    w are robust weights. The trace is the number of degrees of freedom that the poses use, where C is their covariance
    and H the markers' Hessian (Hodges and Sargent 2001, "Counting degrees of freedom in hierarchical and other
    richly-parameterised models").
    """
    error, _ = equations.residuals(state)
    _, weight = equations.weights(error, SCALE)
    taken = float((equations.of_markers(state, SCALE)[1] * _covariance(equations, state)).sum())
    free = 3.0 * float(weight.sum()) - taken
    if free <= 0.0:
        return equations
    sigma = float(np.sqrt((weight * (error**2).sum(-1)).sum() / free))
    return replace(equations, sigma_m=min(max(sigma, LEAST_SIGMA_M), MOST_SIGMA_M))


def _covariance(equations: PropEquations, state: PropState) -> np.ndarray:
    return equations.linearise(state, SCALE)[1].marginals()[0]


def _prop(name: str, labels: Sequence[str], equations: PropEquations, state: PropState) -> Prop:
    equations = _of_true_spread(equations, state)
    blocks = _covariance(equations, state)
    turn, place = blocks[:, :3, :3], blocks[:, 3:6, 3:6]
    widest = np.sqrt(np.maximum(np.linalg.eigvalsh(turn)[:, -1], 0.0))
    sigma = np.stack([mean_sigma(packed(place[:, None]))[:, 0], np.minimum(widest, np.pi / np.sqrt(3.0))], axis=1)
    seen = np.isfinite(equations.points).all(-1).sum(axis=1)
    return Prop(name, tuple(labels), equations.rest, log_so3(state.R), state.t, sigma, seen.astype(np.uint8))


def _without_wrong_points(points: np.ndarray) -> np.ndarray:
    """Exclude points that contradict the largest group of agreeing markers in a frame.

    If several groups are equally large, labels may be swapped. Then every point that contradicts another is excluded.
    """
    away = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    off = np.abs(away - quantile(away, 0.5, axis=0))
    seen, others = np.isfinite(points).all(-1), ~np.eye(points.shape[1], dtype=bool)
    compared = seen[:, :, None] & seen[:, None] & others & np.isfinite(off)
    votes = (compared & (np.nan_to_num(off) < WRONG_M)).sum(axis=-1)
    contradicted = votes < compared.sum(axis=-1)
    most = np.where(seen, votes, 0).max(axis=1, keepdims=True)
    largest = seen & (votes == most)
    one_group = largest.sum(axis=1, keepdims=True) == most + 1
    wrong = contradicted & ~(largest & one_group)
    return np.where(wrong[..., None], np.nan, points)


STAGE = "Solving the props"
MOST = 12
"""Largest number of props per take. Those with the most markers are kept. Many stray points form groups by chance."""
FAR_M = 0.004  # A group is not rigid if its median marker error reaches this.
UNSURE_M, UNSURE_RAD = 0.02, np.radians(10.0)  # Standard deviations beyond which a prop's pose is unknown.


def solve_props(markers: Props, solved: SolvedFrames, progress: Progress) -> tuple[tuple[Prop, ...], list[Diagnostic]]:
    """Find and solve the props among markers that the person does not wear. Return the props and diagnostics."""
    found = [(cloud, group) for cloud in markers.others for group in loose_groups(cloud)]
    for cloud in markers.loose:
        frames = np.unique(np.linspace(0, len(cloud.positions) - 1, FRAMES).astype(int))
        some = MarkerCloud(cloud.positions[frames], cloud.fps, cloud.labels)
        bones = BonePoses.of(solved.subject, solved.frames.select(frames))
        found += [(cloud, group) for group in loose_groups(some, bones)]
    found = sorted(found, key=lambda item: -len(item[1].columns))[:MOST]
    props, diagnostics = list[Prop](), list[Diagnostic]()
    for n, (cloud, group) in enumerate(found):
        progress(STAGE, n, len(found))
        points, labels = cloud.positions[:, group.columns], [cloud.names[i] for i in group.columns]
        prop = solve_prop(group.name, labels, points, cloud.fps)
        if prop is None:
            continue
        kept = [labels.index(label) for label in prop.labels]
        off = float(quantile(np.linalg.norm(prop.markers - points[:, kept], axis=-1), 0.5, axis=(0, 1)))
        if off < FAR_M:
            if prop.is_of_poses:
                origin = prop.points[0]
                prop = prop.in_axes(origin, nearest_rotation((prop.points[1:] - origin).T))
            props.append(prop)
            diagnostics += _found(prop, off)
    if found:
        progress(STAGE, len(found), len(found))
    return tuple(props), diagnostics


def _found(prop: Prop, off: float) -> Iterator[Diagnostic]:
    source, named = "poses" if prop.is_of_poses else "markers", {"markers": prop.labels, "prop": prop.name}
    yield diagnostic("prop_found", source=source, count=len(prop.labels), size=1000 * off, **named)
    unsure = (prop.sigma[:, 0] > UNSURE_M) | (prop.sigma[:, 1] > UNSURE_RAD)
    if unsure.all():
        yield diagnostic("prop_pose_open", reason="line", **named)
    elif unsure.any():
        runs = true_runs(unsure)
        yield diagnostic("prop_pose_open", reason="hidden", frames=runs, remedy=Remedy.BRIDGED, **named)
