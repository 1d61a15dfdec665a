"""Estimate the distance from a pose to plausible poses with a neural field over quaternions (Tiwari et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.joint_limits import JOINT_LIMITS, MARGIN_DEG, from_swing_and_twist, swing_and_twist
from solver_backend.body.kinematics import subtree_matrix
from solver_backend.exchange.errors import PoseInvalid, WeightsInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, SMPL_PARENTS
from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.rotations import (
    exp_so3,
    log_so3,
    matrix_from_quat,
    quat_from_matrix,
    quat_left_tangent,
    upper_hemisphere,
)
from solver_backend.priors.base import (
    CodeJacobian,
    Codes,
    Energies,
    PosePrior,
    Poses,
    check_codes,
    check_rotations,
    in_own_columns,
)
from solver_backend.priors.weights import ASSETS, PriorWeights, read_weights

WIDENED = 1.75  # Factor applied to the recorded spread, because the projection moves joints closer together again.
_INSIDE = 0.08  # Fraction of a joint's range that is kept clear at both ends, so that the projection can move.
_LEAST_RAD = 0.01  # Standard deviation in radians that is added to every axis. Chosen by hand.


@dataclass(frozen=True)
class JointSpread:
    """Independent normal distributions of joint rotation vectors, from recorded poses."""

    mean: np.ndarray  # (21, 3) rad.
    factor: np.ndarray  # (21, 3, 3) rad: lower Cholesky factors of the covariances.

    @classmethod
    def of(cls, rotations: np.ndarray) -> JointSpread:
        """Estimate the distributions from (N, 21, 3, 3) poses."""
        vectors = log_so3(rotations)
        mean = vectors.mean(axis=0)
        centred = np.moveaxis(vectors - mean, 0, -1)
        covariance = centred @ np.swapaxes(centred, -1, -2) / len(vectors)
        return cls(mean, np.linalg.cholesky(covariance + _LEAST_RAD**2 * np.eye(3)))

    def draw(self, count: int, seed: int) -> np.ndarray:
        """Draw random poses (count, 21, 3, 3). They vary more than the recorded poses, within the joints' ranges."""
        noise = np.random.default_rng(seed).standard_normal((count, *self.mean.shape, 1))
        angles = swing_and_twist(exp_so3(self.mean + WIDENED * (self.factor @ noise)[..., 0]))
        low, high = JOINT_LIMITS[..., 0] + np.radians(MARGIN_DEG), JOINT_LIMITS[..., 1] - np.radians(MARGIN_DEG)
        clear = _INSIDE * (high - low)
        return from_swing_and_twist(np.clip(angles, low + clear, high - clear))


SHARPNESS = 20.0  # Factor β in ``softplus(x) = log(1 + exp(β x)) / β``.


@dataclass(frozen=True)
class SoftplusStack:
    """Dense network ``x -> W_n s(... s(W_1 x + b_1) ...) + b_n`` with softplus s, and optionally a final softplus."""

    weights: tuple[Array, ...]  # (out, in) each.
    biases: tuple[Array, ...]  # (out,) each.
    last_is_positive: bool = False

    def like(self, x: Array) -> SoftplusStack:
        """Convert the network to the array type, precision and device of ``x``."""
        weights = tuple(constant(w, x) for w in self.weights)
        return SoftplusStack(weights, tuple(constant(b, x) for b in self.biases), self.last_is_positive)

    def forward(self, x: Array) -> tuple[Array, list[Array]]:
        """Return the output (N, out), and the softplus derivatives that ``backward`` needs."""
        slopes: list[Array] = []
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = array_namespace(x).matmul(x, weight.T) + bias
            if number < len(self.weights) - 1 or self.last_is_positive:
                x, slope = softplus(x)
                slopes.append(slope)
        return x, slopes

    def backward(self, slopes: list[Array], by_output: Array) -> Array:
        """Convert derivatives w.r.t. the output (N, out) to derivatives w.r.t. the input (N, in)."""
        xp = array_namespace(by_output)
        for number in range(len(self.weights) - 1, -1, -1):
            if number < len(slopes):
                by_output = by_output * slopes[number]
            by_output = xp.matmul(by_output, self.weights[number])
        return by_output


def softplus(x: Array) -> tuple[Array, Array]:
    """Return the softplus ``log(1 + exp(β x)) / β`` and its derivative, without overflow."""
    xp = array_namespace(x)
    scaled = SHARPNESS * x
    magnitude = xp.abs(scaled)
    value = 0.5 * (scaled + magnitude) + xp.log1p(xp.exp(-magnitude))
    return value / SHARPNESS, 0.5 * (1.0 + xp.tanh(0.5 * scaled))


def _joint_weights() -> np.ndarray:
    below = subtree_matrix(SMPL_PARENTS).sum(axis=1)[1 : 1 + NUM_BODY_JOINTS]
    return np.sqrt(below) / np.sqrt(below).mean()


JOINT_WEIGHTS: np.ndarray = _joint_weights()
"""(21,) weights ``w`` of joints 1..21 with mean 1: the square root of the number of joints that a joint moves,
including itself. The paper states only that joints early in the chain have more weight."""
TURN_METRIC: np.ndarray = JOINT_WEIGHTS / 8.0  # (21,) metric for small rotations ω: ``d² = Σ_k w_k/8 |ω_k|²``.


def pose_distance(a: Array, b: Array) -> Array:
    """Return pose distances ``sqrt(Σ_k w_k/2 arccos²|a_k · b_k|)`` in radians (Tiwari et al. 2022, eq. 2)."""
    xp = array_namespace(a, b)
    angle = half_angles(a, b)
    return xp.sqrt(xp.sum(0.5 * constant(JOINT_WEIGHTS, a) * angle * angle, axis=-1))


def half_angles(a: Array, b: Array) -> Array:
    """Return half the angles (...) between quaternions in radians: ``2 arcsin(min|a ∓ b|/2)``."""
    xp = array_namespace(a, b)
    near, far = xp.sum((a - b) ** 2, axis=-1), xp.sum((a + b) ** 2, axis=-1)
    return 2.0 * xp.asin(0.5 * xp.sqrt(xp.where(near < far, near, far)))


@dataclass(frozen=True)
class _FieldLevel:
    """Joints at the same depth of the joint tree, which are encoded together."""

    joints: tuple[int, ...]  # Columns 0..20 of joints 1..21.
    parents: np.ndarray  # (n, m) one if a joint's parent is the m-th joint in the level above (excluding the pelvis).


def _levels() -> tuple[_FieldLevel, ...]:
    levels: list[_FieldLevel] = []
    above: tuple[int, ...] = (-1,)
    while above:
        joints = tuple(j for j in range(NUM_BODY_JOINTS) if SMPL_PARENTS[j + 1] - 1 in above)
        if joints:
            parents = np.array([[float(SMPL_PARENTS[j + 1] - 1 == p) for p in above if p >= 0] for j in joints])
            levels.append(_FieldLevel(joints, parents))
        above = joints
    return tuple(levels)


LEVELS = _levels()
_ORDER = tuple(joint for level in LEVELS for joint in level.joints)


@dataclass(frozen=True)
class PoseField:
    """Neural distance field ``f(θ) = f_df([v_1 .. v_21])`` over poses θ (Pose-NDF, eq. 3).

    The features of joint k are ``v_k = W1_k s(W0_k [θ_k, v_parent] + b0_k) + b1_k`` with the softplus s. The pelvis has
    no features, so its children receive zeros.
    """

    w0: Array  # (21, H, 4 + l).
    b0: Array  # (21, H).
    w1: Array  # (21, l, H).
    b1: Array  # (21, l).
    distance: SoftplusStack  # 21 l -> 1, positive. Its inputs are the features in the order of the tree's levels.

    def like(self, x: Array) -> PoseField:
        """Convert the network to the array type, precision and device of ``x``."""
        w0, b0, w1, b1 = (constant(value, x) for value in (self.w0, self.b0, self.w1, self.b1))
        return PoseField(w0, b0, w1, b1, self.distance.like(x))

    def __call__(self, quats: Array) -> Array:
        """Return the (N,) distances f for poses of (N, 21, 4) quaternions."""
        xp = array_namespace(quats)
        features, _ = self._encode(xp.permute_dims(quats, (1, 0, 2)))
        return self.distance.forward(_side_by_side(features))[0][:, 0]

    def with_gradient(self, quats: Array) -> tuple[Array, Array]:
        """Return distances f (N,), and derivatives (N, 21, 4) w.r.t. quaternions."""
        xp = array_namespace(quats)
        count = quats.shape[0]
        features, slopes = self._encode(xp.permute_dims(quats, (1, 0, 2)))
        distance, tape = self.distance.forward(_side_by_side(features))
        by_stacked = self.distance.backward(tape, xp.ones_like(distance))
        by_feature = xp.permute_dims(xp.reshape(by_stacked, (count, NUM_BODY_JOINTS, -1)), (1, 0, 2))
        return distance[:, 0], xp.permute_dims(self._by_quats(slopes, by_feature), (1, 0, 2))

    def _encode(self, quats: Array) -> tuple[list[Array], list[Array]]:
        """Return each level's features (n, N, l) and softplus derivatives (n, N, H) for n joints, H hidden units."""
        xp = array_namespace(quats)
        features, slopes = list[Array](), list[Array]()
        for level in LEVELS:
            joints = list(level.joints)
            own = quats[joints]
            if features:
                above = _mixed(constant(level.parents, quats), features[-1])
            else:
                above = xp.zeros_like(quats[joints][..., :1]) * self.b1[0]
            x = xp.concat((own, above), axis=-1)
            x = xp.matmul(x, xp.matrix_transpose(self.w0[joints])) + self.b0[joints][:, None, :]
            x, slope = softplus(x)
            features.append(xp.matmul(x, xp.matrix_transpose(self.w1[joints])) + self.b1[joints][:, None, :])
            slopes.append(slope)
        return features, slopes

    def _by_quats(self, slopes: list[Array], by_feature: Array) -> Array:
        """Convert derivatives w.r.t. features to derivatives w.r.t. the quaternions (21, N, 4)."""
        xp = array_namespace(by_feature)
        parts: list[Array] = []
        last, from_below = NUM_BODY_JOINTS, None
        for level, slope in zip(reversed(LEVELS), reversed(slopes), strict=True):
            joints, first = list(level.joints), last - len(level.joints)
            own = by_feature[first:last]
            own = own if from_below is None else own + from_below
            by_input = xp.matmul(xp.matmul(own, self.w1[joints]) * slope, self.w0[joints])
            parts.append(by_input[..., :4])
            if first:
                from_below = _mixed(constant(level.parents.T, by_input), by_input[..., 4:])
            last = first
        by_quats = xp.concat(parts[::-1], axis=0)
        return by_quats[[_ORDER.index(j) for j in range(NUM_BODY_JOINTS)]]


def _side_by_side(features: list[Array]) -> Array:
    xp = array_namespace(features[0])
    return xp.reshape(xp.permute_dims(xp.concat(features, axis=0), (1, 0, 2)), (features[0].shape[1], -1))


def _mixed(shares: Array, values: Array) -> Array:
    """Mix features: ``Σ_m shares[n, m] values[m]`` maps (n, m) and (m, N, l) to (n, N, l)."""
    xp = array_namespace(values)
    flat = xp.matmul(shares, xp.reshape(values, (values.shape[0], -1)))
    return xp.reshape(flat, (shares.shape[0], *values.shape[1:]))


_DIM = 4 * NUM_BODY_JOINTS
_UNIT_WITHIN = 1e-3
"""Largest deviation from 1 allowed for the length of a unit quaternion."""


RECORDED_RAD = 0.4  # Median distance in radians between one person's recorded poses and everyone else's poses.
_ARRIVED = 1e-3  # Distance in radians that counts as zero.


@dataclass(frozen=True)
class ProjectionSettings:
    """Settings of the gradient descent towards plausible poses (Tiwari et al. 2022, eqs. 5 and 6)."""

    steps: int = 60
    step_size: float = 0.3  # Initial factor α. 1 would reach zero in one step if the field is a distance.
    reach: float = 0.9  # Largest movement relative to the initial distance. The mean pose is farther away.
    level: float = 0.0  # Distance on the manifold, rad. At ``RECORDED_RAD``, recorded poses stay unchanged.


class PoseNDF(PosePrior):
    """Prior that measures the distance in radians between a pose and the manifold of plausible poses.

    The distance is zero on the manifold (Tiwari et al. 2022, eq. 1). Quaternions have ``w >= 0``, so q and -q are the
    same pose.
    """

    def __init__(self, field: PoseField, spread: JointSpread, metadata: dict[str, Any]) -> None:
        self._field, self._spread, self.metadata = field, spread, metadata

    name = "pose_ndf"

    @property
    def latent_dim(self) -> int:
        """Number of entries in a code: 84, for 21 unit quaternions."""
        return _DIM

    def encode(self, rotations: Poses) -> Codes:
        """Convert poses to (N, 84) unit quaternions, wxyz with ``w >= 0``. Raises the errors of ``check_rotations``."""
        check_rotations(rotations)
        xp = array_namespace(rotations)
        return xp.reshape(upper_hemisphere(quat_from_matrix(rotations)), (rotations.shape[0], _DIM))

    def decode(self, z: Codes) -> Poses:
        """Convert (N, 84) quaternions of any non-zero length to (N, 21, 3, 3) rotations."""
        check_codes(z, _DIM)
        return matrix_from_quat(_unit(array_namespace(z).reshape(z, (z.shape[0], NUM_BODY_JOINTS, 4))))

    def decode_with_jacobian(self, z: Codes) -> tuple[Poses, CodeJacobian]:
        """Return decoded poses and their Jacobian (N, 21, 3, 84), from ``dω = 2 (dq q⁻¹)``."""
        xp = array_namespace(z)
        rotations = self.decode(z)
        quats = xp.reshape(z, (z.shape[0], NUM_BODY_JOINTS, 4))
        square = xp.sum(quats * quats, axis=-1)[..., None, None]
        blocks = 4.0 * xp.permute_dims(quat_left_tangent(quats), (0, 1, 3, 2)) / square
        return rotations, in_own_columns(blocks)

    def energy(self, rotations: Poses) -> Energies:
        """Return the predicted distances (N,) in radians from poses (N, 21, 3, 3) to the nearest plausible poses."""
        return self.distance_with_gradient(self.encode(rotations))[0]

    def distance_with_gradient(self, z: Array) -> tuple[Array, Array]:
        """Return distances f (N,) and derivatives (N, 84) for quaternions (N, 84).

        Raises:
            PoseInvalid: a value is NaN, the width is wrong, or a quaternion is not a unit quaternion.
        """
        check_codes(z, _DIM)
        xp = array_namespace(z)
        quats = xp.reshape(z, (z.shape[0], NUM_BODY_JOINTS, 4))
        if bool(xp.any(xp.abs(xp.sum(quats * quats, axis=-1) - 1.0) > 2.0 * _UNIT_WITHIN)):
            raise PoseInvalid("A code has quaternions that are not of unit length.", hint="Divide each by its length.")
        distance, gradient = self._signed(quats)
        return distance, xp.reshape(gradient, (z.shape[0], _DIM))

    def distance_with_tangents(self, rotations: Array) -> tuple[Array, Array]:
        """Return the distances f (N,) of poses (N, 21, 3, 3), and their derivatives (N, 21, 3) w.r.t. left tangents.

        ``f(exp([ω_k]x) R_k) ≈ f + Σ_k g_k · ω_k``. Raises the errors of ``check_rotations``.
        """
        check_rotations(rotations)
        xp = array_namespace(rotations)
        quats = quat_from_matrix(rotations)
        distance, gradient = self._signed(quats)
        return distance, xp.matmul(xp.matrix_transpose(quat_left_tangent(quats)), gradient[..., None])[..., 0]

    def _signed(self, quats: Array) -> tuple[Array, Array]:
        """Return distances (N,) and gradients (N, 21, 4) for quaternions of either sign."""
        xp = array_namespace(quats)
        sign = xp.where(quats[..., :1] < 0, -xp.ones_like(quats[..., :1]), xp.ones_like(quats[..., :1]))
        distance, gradient = self._field.like(quats).with_gradient(sign * quats)
        return distance, sign * gradient

    def project(self, rotations: Array, settings: ProjectionSettings = ProjectionSettings()) -> Array:
        """Move (N, 21, 3, 3) poses towards plausible ones: descend the field by ``θ - α f ∇f`` and normalise.

        The gradient is taken in the metric: ``2/w_k`` times the part tangent to each joint's sphere. With α = 1, one
        step reaches zero if the field is a distance. A step that would increase a pose's distance is halved, then α
        grows again. No pose moves farther than ``reach`` times its first distance (Tiwari et al. 2022, eqs. 5 and 6).
        """
        xp = array_namespace(rotations)
        check_rotations(rotations)
        quats = quat_from_matrix(rotations)
        distance, gradient = self._signed(quats)
        alpha, left = settings.step_size * xp.ones_like(distance), settings.reach * distance
        for _ in range(settings.steps):
            excess = distance - settings.level
            if bool(xp.all((excess < _ARRIVED) | (left < _ARRIVED) | (alpha < 1e-6))):
                break
            steepest = in_metric(quats, gradient)
            slope = metric_length(steepest)
            way = xp.minimum(alpha * xp.clip(excess, 0.0, None) * slope, left)
            trial = _unit(quats - (way / xp.clip(slope, 1e-9, None))[:, None, None] * steepest)
            trial_distance, trial_gradient = self._signed(trial)
            better = trial_distance < distance
            quats = xp.where(better[:, None, None], trial, quats)
            gradient = xp.where(better[:, None, None], trial_gradient, gradient)
            distance = xp.where(better, trial_distance, distance)
            left = xp.where(better, left - way, left)
            alpha = xp.where(better, xp.clip(1.5 * alpha, None, settings.step_size), 0.5 * alpha)
        return matrix_from_quat(quats)

    def sample(self, count: int, seed: int) -> Poses:
        """Draw random poses with independent joints, and project them to plausible poses."""
        return self.project(self._spread.draw(count, seed))


def load_pose_ndf(path: Path | str = ASSETS / "pose_ndf.npz") -> PoseNDF:
    """Load the weights of Pose-NDF. Raises the errors of ``read_weights``."""
    stored = read_weights(Path(path), "pose_ndf")
    size = stored.metadata.get("field_size", {})
    try:
        features, hidden = int(size["features"]), int(size["encoder_hidden"])
        widths = (NUM_BODY_JOINTS * features, *(int(n) for n in size["field_hidden"]), 1)
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsInvalid("The weights of pose_ndf do not state the network's size.") from error
    shapes = {
        "w0": (NUM_BODY_JOINTS, hidden, 4 + features),
        "b0": (NUM_BODY_JOINTS, hidden),
        "w1": (NUM_BODY_JOINTS, features, hidden),
        "b1": (NUM_BODY_JOINTS, features),
    }
    encoders = {name: stored.array(f"encoder_{name}", shape) for name, shape in shapes.items()}
    field = PoseField(**encoders, distance=_stack(stored, "field", widths))
    spread = JointSpread(
        stored.array("joint_mean", (NUM_BODY_JOINTS, 3)), stored.array("joint_factor", (NUM_BODY_JOINTS, 3, 3))
    )
    return PoseNDF(field, spread, {**stored.metadata, "sha256": stored.sha256})


def in_metric(quats: Array, gradient: Array) -> Array:
    """Convert a gradient (N, 21, 4) to the metric of ``pose_distance``: its tangent part times ``2/w_k``.

    Where the field is an exact distance, the result has length 1 in this metric.
    """
    xp = array_namespace(quats)
    tangent = gradient - xp.sum(gradient * quats, axis=-1, keepdims=True) * quats
    return constant(2.0 / JOINT_WEIGHTS[:, None], quats) * tangent


def metric_length(tangents: Array) -> Array:
    """Return the (N,) lengths ``sqrt(Σ_k (w_k/2) |·|²)`` of tangent vectors (N, 21, 4) in the metric of the field."""
    xp = array_namespace(tangents)
    weights = constant(0.5 * JOINT_WEIGHTS[:, None], tangents)
    return xp.sqrt(xp.sum(weights * tangents * tangents, axis=(1, 2)) + 1e-24)


def _stack(stored: PriorWeights, part: str, widths: tuple[int, ...]) -> SoftplusStack:
    pairs = list(pairwise(widths))
    matrices = tuple(stored.array(f"{part}_w{i}", (b, a)) for i, (a, b) in enumerate(pairs))
    biases = tuple(stored.array(f"{part}_b{i}", (b,)) for i, (_, b) in enumerate(pairs))
    return SoftplusStack(matrices, biases, last_is_positive=True)


def _unit(quats: Array) -> Array:
    xp = array_namespace(quats)
    return quats / xp.sqrt(xp.sum(quats * quats, axis=-1, keepdims=True))
