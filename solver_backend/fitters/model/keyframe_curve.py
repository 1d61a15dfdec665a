"""Latent keyframes: where they stand in time, and the frames SIDER-2 makes between them (thesis 6.2.5)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from array_api_compat import array_namespace

from solver_backend.fitters.model.codes import CODES, DecodedPoses, decode_poses, decoded_only
from solver_backend.fitters.model.subject import FRAME_DOF, PosedFrames
from solver_backend.geometry.arrays import Array, constant, index, zeros
from solver_backend.geometry.interpolation import sider2, sider2_with_jacobian
from solver_backend.geometry.rotations import matrix_from_quat, quat_from_rotvec, quat_left_tangent, quat_multiply
from solver_backend.priors.base import PosePrior

KEY_DOF = 36
"""Tangent of a keyframe: latent 30, root rotation 3 (world), translation 3."""
RESIDUAL_DOF = 63
"""More, where joints may leave the manifold: one rotation vector a joint."""
BLOCK_POSES = 2000
"""Frames posed at a time."""


@dataclass(frozen=True)
class KeyframeLayout:
    """N windows over F frames; window w uses the keys 2w, 2w + 1, 2w + 2, its neighbours share the end keys."""

    bounds: np.ndarray
    """(N + 1,) frame numbers at which windows meet, rising; the first and the last are the take's or stretch's own."""

    @classmethod
    def even(cls, num_frames: int, window: int, first: int = 0) -> KeyframeLayout:
        """Cut F >= 2 frames from ``first`` on into windows of nearly ``window`` frames."""
        count = max(1, round((num_frames - 1) / window))
        return cls(first + np.round(np.linspace(0, num_frames - 1, count + 1)).astype(np.int64))

    @property
    def num_windows(self) -> int:
        """Number of windows N."""
        return len(self.bounds) - 1

    @property
    def num_keys(self) -> int:
        """Number of keys, 2N + 1."""
        return 2 * self.num_windows + 1

    @property
    def key_times(self) -> np.ndarray:
        """(2N + 1,) frame number of each key; a middle key may fall between two frames."""
        times = np.empty(self.num_keys)
        times[::2] = self.bounds
        times[1::2] = 0.5 * (self.bounds[:-1] + self.bounds[1:])
        return times

    @property
    def frames(self) -> np.ndarray:
        """(F,) numbers of the frames from the first bound to the last."""
        return np.arange(self.bounds[0], self.bounds[-1] + 1)

    def positions(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return window and position in it, 0..1, of frame numbers; a bound belongs to the earlier window."""
        window = np.clip(np.searchsorted(self.bounds, times, side="left") - 1, 0, self.num_windows - 1)
        return window, (times - self.bounds[window]) / np.diff(self.bounds)[window]

    def rows(self, stride: int = 1) -> WindowRows:
        """Return every ``stride``-th frame of each window, each frame standing for the ones left out."""
        first, last = self.bounds[:-1] + 1, self.bounds[1:]
        first[0] -= 1
        width = int((last - first).max()) // stride + 1
        frames = first[:, None] + stride * np.arange(width)
        inside = frames <= last[:, None]
        frames = np.where(inside, frames, last[:, None])
        time = (frames - self.bounds[:-1, None]) / np.diff(self.bounds)[:, None]
        return WindowRows(frames, time, float(stride) * inside)

    def gaps(self, seen: np.ndarray) -> np.ndarray:
        """Return (2N,) bool: none of the frames from one key to the next is ``seen``, (F,) of the whole take."""
        before = np.concatenate([[0], np.cumsum(seen)])
        times = self.key_times
        first, last = np.ceil(times[:-1]).astype(int), np.floor(times[1:]).astype(int)
        return before[last + 1] == before[first]

    def part(self, windows: slice) -> KeyframeLayout:
        """Return the layout of some windows."""
        return KeyframeLayout(self.bounds[windows.start : windows.stop + 1])


@dataclass(frozen=True)
class WindowRows:
    """Frames laid out window by window: N rows of n frames, the shorter rows padded with frames of no weight."""

    frames: np.ndarray
    """(N, n) frame numbers."""
    time: np.ndarray
    """(N, n) positions in the window, 0..1."""
    weight: np.ndarray
    """(N, n) how many frames each one stands for; 0 in the padding."""

    def blocks(self, num_frames: int) -> list[slice]:
        """Return ranges of windows, alike in length, even in number, with ``num_frames`` frames each at most."""
        count, width = self.frames.shape
        pairs = -(-count * width // (2 * num_frames))
        bounds = np.round(np.linspace(0, count, min(2 * pairs, count) + 1)).astype(int)
        return [slice(a, b) for a, b in itertools.pairwise(bounds.tolist())]

    def columns(self, count: int) -> np.ndarray:
        """Return about ``count`` columns spread over the rows; more where the shortest row would have fewer."""
        stride = max(1, int((self.weight > 0).sum(axis=1).min()) // count)
        return np.arange((stride - 1) // 2, self.frames.shape[1], stride)

    def sampled(self, columns: np.ndarray) -> WindowRows:
        """Return the frames of these columns, standing for those of the others."""
        weight = self.weight[:, columns]
        weight = weight * (self.weight.sum(axis=1) / weight.sum(axis=1))[:, None]
        return WindowRows(self.frames[:, columns], self.time[:, columns], weight)

    def select(self, windows: slice) -> WindowRows:
        """Return the rows of these windows."""
        return WindowRows(self.frames[windows], self.time[windows], self.weight[windows])


@dataclass(frozen=True)
class Keyframes:
    """K keyframes."""

    z: Array
    """(K, 32) unit zero-mean codes."""
    quat: Array
    """(K, 4) root rotations wxyz, neighbours in one hemisphere."""
    transl: Array
    """(K, 3) metres."""
    residual: Array
    """(K, 21, 3) rotations off the manifold, radians."""

    def select(self, keys: np.ndarray | slice) -> Keyframes:
        """Return the keys at these indices."""
        return Keyframes(self.z[keys], self.quat[keys], self.transl[keys], self.residual[keys])

    def replaced(self, keys: slice, new: Keyframes) -> Keyframes:
        """Return the keys with those of a range taken from ``new``."""
        xp = array_namespace(self.z)

        def spliced(name: str) -> Array:
            old = getattr(self, name)
            return xp.concat([old[: keys.start], getattr(new, name), old[keys.stop :]])

        return Keyframes(*(spliced(name) for name in ("z", "quat", "transl", "residual")))

    def retract(self, step: Array) -> Keyframes:
        """Move by (K, 36) or (K, 99) tangent steps."""
        xp = array_namespace(step)
        moved = self.z + xp.matmul(CODES.tangent_basis(self.z), step[:, :30, None])[..., 0]
        quat = quat_multiply(quat_from_rotvec(step[:, 30:33]), self.quat)
        quat = quat / xp.sqrt(xp.sum(quat * quat, axis=-1, keepdims=True))
        residual = self.residual
        if step.shape[1] > KEY_DOF:
            residual = residual + xp.reshape(step[:, KEY_DOF:], residual.shape)
        return Keyframes(CODES.nearest(moved), quat, self.transl + step[:, 33:36], residual)


def hemisphere_aligned(keys: Keyframes) -> Keyframes:
    """Return the keys with signs of the root quaternions chosen so that neighbours lie in one hemisphere."""
    xp = array_namespace(keys.quat)
    dots = xp.sum(keys.quat[1:] * keys.quat[:-1], axis=-1)
    signs = xp.where(dots < 0, -xp.ones_like(dots), xp.ones_like(dots))
    signs = xp.concat([xp.ones_like(keys.quat[:1, 0]), xp.cumulative_prod(signs)])
    return replace(keys, quat=keys.quat * signs[:, None])


def resampled(keys: Keyframes, layout: KeyframeLayout, finer: KeyframeLayout) -> Keyframes:
    """Return keys at another layout's times, on the curves through the given keys."""
    window, position = layout.positions(finer.key_times)
    xp = array_namespace(keys.z)
    triple = [xp.asarray(2 * window + i) for i in range(3)]
    t = constant(position, keys.z)
    weights = lagrange(t)
    transl = sum(w[:, None] * keys.transl[i] for w, i in zip(weights, triple, strict=True))
    residual = sum(w[:, None, None] * keys.residual[i] for w, i in zip(weights, triple, strict=True))
    first, middle, last = triple
    z = sider2(keys.z[first], keys.z[middle], keys.z[last], t)
    quat = sider2(keys.quat[first], keys.quat[middle], keys.quat[last], t)
    return hemisphere_aligned(Keyframes(z, quat, transl, residual))


def lagrange(time: Array) -> tuple[Array, Array, Array]:
    """Return the weights of three equally spaced keys on the polynomial through them, at time 0..1.

    With three keys the cubic of thesis eq. 6.10 has one degree too many; its minimal-curvature member is the parabola.
    """
    return (1 - time) * (1 - 2 * time), 4 * time * (1 - time), time * (2 * time - 1)


def key_poses(
    prior: PosePrior, keys: Keyframes, layout: KeyframeLayout, frames: np.ndarray | None = None, *, residuals: bool
) -> PosedFrames:
    """Return the poses of these frame numbers, or of all frames of the layout."""
    window, time = layout.positions(layout.frames if frames is None else frames)
    parts = [slice(i, i + BLOCK_POSES) for i in range(0, len(time), BLOCK_POSES)]
    blocks = [_poses_at(prior, keys, window[part], time[part], residuals=residuals) for part in parts]
    xp = array_namespace(keys.z)
    return PosedFrames(*(xp.concat([getattr(block, name) for block in blocks]) for name in ("root", "local", "transl")))


def _poses_at(
    prior: PosePrior, keys: Keyframes, window: np.ndarray, time: np.ndarray, *, residuals: bool
) -> PosedFrames:
    """Return the poses at (window, time): SIDER-2 on codes and root, a parabola on the rest (eqs. 6.9, 6.10)."""
    triple = [index(2 * window + i, keys.z) for i in range(3)]
    t = constant(time, keys.z)
    weights = lagrange(t)
    transl = sum(w[:, None] * keys.transl[i] for w, i in zip(weights, triple, strict=True))
    residual = None
    if residuals:
        residual = sum(w[:, None, None] * keys.residual[i] for w, i in zip(weights, triple, strict=True))
    first, middle, last = triple
    local = decoded_only(prior, sider2(keys.z[first], keys.z[middle], keys.z[last], t), residual)
    root = matrix_from_quat(sider2(keys.quat[first], keys.quat[middle], keys.quat[last], t))
    return PosedFrames(root, local, transl)


@dataclass(frozen=True)
class BundleFrames:
    """Frames made from keyframes and their derivative by the keys' tangents."""

    poses: PosedFrames
    """F poses."""
    by_keys: Array
    """(F, 69, 3·D) by the three keys of each frame's window, D = 36 or 99."""


def bundle_frames(
    prior: PosePrior, keys: Keyframes, window: np.ndarray, time: np.ndarray, *, residuals: bool
) -> BundleFrames:
    """Return the frames at (window, time) with their derivative by the keys.

    Args:
        prior: decoder of the codes.
        keys: 2N + 1 keyframes.
        window: (F,) window of each frame.
        time: (F,) position in it, 0..1.
        residuals: let the residual rotations act (and give them columns).
    """
    xp = array_namespace(keys.z)
    triple = [index(2 * window + i, keys.z) for i in range(3)]
    t = constant(time, keys.z)
    first, middle, last = triple
    z, z_by = sider2_with_jacobian(keys.z[first], keys.z[middle], keys.z[last], t)
    quat, quat_by = sider2_with_jacobian(keys.quat[first], keys.quat[middle], keys.quat[last], t)
    weights = lagrange(t)
    transl = sum(w[:, None] * keys.transl[i] for w, i in zip(weights, triple, strict=True))
    residual = sum(w[:, None, None] * keys.residual[i] for w, i in zip(weights, triple, strict=True))
    decoded = decode_poses(prior, z, residual if residuals else None)
    poses = PosedFrames(matrix_from_quat(quat), decoded.local, transl)
    dof = KEY_DOF + (RESIDUAL_DOF if residuals else 0)
    chain = zeros((len(time), FRAME_DOF, 3 * dof), t)
    for k, key in enumerate(triple):
        column = k * dof
        latent = xp.matmul(decoded.by_latent, xp.matmul(z_by[k], CODES.tangent_basis(keys.z)[key]))
        chain[:, 3:66, column : column + 30] = latent
        chain[:, 0:3, column + 30 : column + 33] = _root_jacobian(quat, quat_by[k], keys.quat[key])
        for i in range(3):
            chain[:, 66 + i, column + 33 + i] = weights[k]
        if residuals:
            _fill_residual(chain, decoded, weights[k], column + KEY_DOF)
    return BundleFrames(poses, chain)


def _fill_residual(chain: Array, decoded: DecodedPoses, weight: Array, first: int) -> None:
    """Write the 21 diagonal blocks of the residual rotations."""
    assert decoded.by_residual is not None
    for j in range(decoded.by_residual.shape[1]):
        block = weight[:, None, None] * decoded.by_residual[:, j]
        chain[:, 3 + 3 * j : 6 + 3 * j, first + 3 * j : first + 3 * j + 3] = block


def _root_jacobian(quat: Array, by_key: Array, key: Array) -> Array:
    """Return (F, 3, 3): the frame's turn by the key's, both left: ``4 G(q_f)ᵀ (dq_f/dq_k) G(q_k)``."""
    xp = array_namespace(quat)
    return 4.0 * xp.matmul(xp.matrix_transpose(quat_left_tangent(quat)), xp.matmul(by_key, quat_left_tangent(key)))
