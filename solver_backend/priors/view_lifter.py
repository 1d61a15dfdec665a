"""Estimate pose code, root, up direction and errors from 27 frames of one camera's keypoints.

Distance and size are not visible in one image and are not estimated. Windows are rotated towards the person and divided
by the angular size, so that the position in the image does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.geometry.arrays import Array, array_namespace, constant, times_transposed
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import cross, matrix_from_6d
from solver_backend.priors.autoencoder import DenseStack
from solver_backend.priors.lifter import POINTS, read_lifter_weights
from solver_backend.priors.sposer import LATENT_DIM
from solver_backend.priors.weights import ASSETS, read_stack, read_weights

Arrays = dict[str, np.ndarray]  # Parameters by name.
_EPSILON = np.float32(1e-5)  # Keeps a root mean square from being zero, as in training.


def layer(arrays: Arrays, x: np.ndarray, name: str, heads: int, bias: np.ndarray | None = None) -> np.ndarray:
    """Apply normalised attention and two dense layers to (B, N, d) features.

    ``x + W_o softmax(Q Kᵀ / √d_h + B) V``, then ``x + W_2 relu(W_1 x)`` (Vaswani et al. 2017, with the norm first).

    Args:
        name: prefix of the layer's parameters.
        heads: number of heads, d_h = d / heads.
        bias: (B, heads, N, N) bias added to the scores.
    """
    qkv = dense(arrays, layer_norm(arrays, x, name + "first"), name + "qkv")
    q, k, v = (split_heads(part, heads) for part in np.split(qkv, 3, axis=-1))
    x = x + dense(arrays, attention(q, k, v, bias), name + "out")
    inner = dense(arrays, layer_norm(arrays, x, name + "second"), name + "up")
    np.maximum(inner, 0.0, out=inner)
    return x + dense(arrays, inner, name + "down")


def dense(arrays: Arrays, x: np.ndarray, name: str) -> np.ndarray:
    """Apply ``W x + b`` to the last axis. Omit b if the network has none."""
    product = times_transposed(x.reshape(-1, x.shape[-1]), arrays[name + ".weight"])
    bias = arrays.get(name + ".bias")
    if bias is not None:
        product += bias
    return product.reshape(*x.shape[:-1], -1)


def layer_norm(arrays: Arrays, x: np.ndarray, name: str) -> np.ndarray:
    """Centre the last axis, divide it by its standard deviation, then scale and shift it."""
    x = x - x.mean(-1, keepdims=True)
    scale = np.sqrt(np.einsum("...d,...d->...", x, x)[..., None] / x.shape[-1] + _EPSILON)
    x /= scale
    x *= arrays[name + ".weight"]
    x += arrays[name + ".bias"]
    return x


def attention(q: np.ndarray, k: np.ndarray, v: np.ndarray, bias: np.ndarray | None = None) -> np.ndarray:
    """Return the softmax attention (B, N, d) of queries, keys and values (B, heads, N, d_h)."""
    scores = q @ np.swapaxes(k, -1, -2)
    scores *= np.float32(q.shape[-1] ** -0.5)
    if bias is not None:
        scores += bias
    out = softmax(scores) @ v
    return np.swapaxes(out, 1, 2).reshape(len(out), out.shape[2], -1)


def split_heads(x: np.ndarray, heads: int) -> np.ndarray:
    """Reshape (B, N, d) to (B, heads, N, d_h)."""
    return np.swapaxes(x.reshape(*x.shape[:2], heads, -1), 1, 2)


def softmax(x: np.ndarray) -> np.ndarray:
    """Return the softmax over the last axis. The input is overwritten."""
    x -= x.max(-1, keepdims=True)
    np.exp(x, out=x)
    x /= x.sum(-1, keepdims=True)
    return x


DEFAULT_WEIGHTS: Path = ASSETS / "view_lifter.npz"
WINDOW, MIDDLE = 27, 13
"""Frames in a window at ``WINDOW_FPS``, and index of the frame that is lifted."""
WINDOW_FPS = 30.0
TOKEN = 3 * len(POINTS) + 5
"""Number of network inputs per frame."""
OUTPUTS = LATENT_DIM + 6 + 3 + 2 * NUM_JOINTS
FACE = ("left_ear", "right_ear", "nose")
"""Head points among the network's inputs."""
NECKS = ("neck", "upper_neck", "thorax")
HEAD_SHARE = {"head_top": 0.55, "head": 1.0}
"""Position of the head's centre, as a fraction of the way from the neck to the first of these points that a detector
provides. On four takes of subjects 01, 08 and 60 with MPII's points, it reduces limb errors from 44.2 to 34.8 mm.
Fractions of 0.5 and 0.62 give the same result."""
_CENTRE_FRAMES = 2.0  # Standard deviation, in frames, of the weights that locate the person around the middle frame.
_FAINT = 1e-6  # Weight added to all frames, which matters if the person is lost in the middle.
_SMALLEST = 1e-6
_LOG_SIGMA = (-4.6, 0.7)
"""Logarithms of the smallest and largest standard deviation in metres: 1 cm and 2 m."""
_BLOCK = 256  # Windows per batch, which limits memory to 0.1 GB. Chosen by hand.
_START_LOG_SIGMA = -2.5  # Log standard deviation for zero network output: 8 cm.


@dataclass(frozen=True)
class LookAt:
    """Rotation and scale that normalise the image points of N windows."""

    R: Array  # (N, 3, 3) from the camera to a camera that looks at the person.
    size: Array  # (N,) root mean square angle of the points around the person's centre, in focal lengths.


@dataclass(frozen=True)
class LiftedView:
    """Network results for N windows, in camera axes (x right, y down, z forward)."""

    z: Array  # (N, 32) unit zero-mean codes of SPoser.
    root: Array  # (N, 3, 3) body to camera.
    up: Array  # (N, 3) unit vectors against gravity.
    sigma_m: Array
    """(N, 24, 2) standard deviations of each joint relative to the body's centre, on a skeleton of 1.70 m: per axis
    across the image, and along the line of sight."""
    sight: Array  # (N, 3, 3) rows: right, down and forward of a camera that looks at the person.
    hidden: np.ndarray | None = None  # (N, d) features before the last layer, None during training.


def look_at(points: Array, confidence: Array) -> LookAt:
    """Return the camera that looks at the person in the middle of each window.

    ``points`` (N, 27, 19, 2) are in focal lengths from the principal point. ``confidence`` (N, 27, 19) is 0 if missing.
    """
    xp = array_namespace(points)
    weight = _weights(confidence)
    centre = xp.sum(weight[..., None] * points, axis=(1, 2))
    ray = _unit(xp.concat([centre, xp.ones_like(centre[:, :1])], axis=-1))
    right = _unit(constant((1.0, 0.0, 0.0), ray)[None] - ray[:, :1] * ray)
    R = xp.stack([right, cross(ray, right), ray], axis=1)
    turned = _turned(points, R)
    size = xp.sqrt(xp.sum(weight * xp.sum(turned * turned, axis=-1), axis=(1, 2)))
    return LookAt(R, xp.where(size > _SMALLEST, size, xp.full_like(size, _SMALLEST)))


def features(points: Array, confidence: Array, up: Array, view: LookAt) -> Array:
    """Return (N, 27, 62) inputs: normalised points (0 if missing), confidences, size and up.

    The last five inputs, size and up, are the same in all frames of a window. ``up`` (N, 3) is a unit vector against
    gravity in camera axes, or zero if unknown. For the other arguments, see ``look_at``.
    """
    xp = array_namespace(points)
    count = points.shape[0]
    scaled = _turned(points, view.R) / view.size[:, None, None, None]
    there = confidence[..., None]
    near = xp.where(there > 0, xp.clip(scaled, -6.0, 6.0), xp.zeros_like(scaled))
    turned_up = xp.matmul(view.R, up[..., None])[..., 0]
    known = xp.sum(up * up, axis=-1, keepdims=True)
    flat = xp.reshape(xp.concat([near, there], axis=-1), (count, WINDOW, -1))
    shared = xp.concat([xp.log(view.size)[:, None], turned_up, known], axis=-1)
    return xp.concat([flat, xp.broadcast_to(shared[:, None], (count, WINDOW, shared.shape[-1]))], axis=-1)


def interpreted(output: Array, view: LookAt) -> LiftedView:
    """Convert the network's (N, 89) output to a lifted view."""
    xp = array_namespace(output)
    back = xp.matrix_transpose(view.R)
    turn, end = output[:, LATENT_DIM : LATENT_DIM + 6], LATENT_DIM + 9
    up = xp.matmul(back, output[:, LATENT_DIM + 6 : end, None])[..., 0]
    log_sigma = xp.clip(output[:, end:] + _START_LOG_SIGMA, *_LOG_SIGMA)
    codes, root = spherical_normalisation(output[:, :LATENT_DIM]), xp.matmul(back, matrix_from_6d(turn))
    return LiftedView(codes, root, _unit(up), xp.exp(xp.reshape(log_sigma, (-1, NUM_JOINTS, 2))), view.R)


@dataclass(frozen=True)
class ViewLifter:
    """Network that lifts the middle frame of a window, with attention between the window's frames."""

    arrays: Arrays  # Float32 weights, by the names of the trained module's parameters.
    heads: int
    metadata: dict[str, Any]  # Training command, data and evaluation.

    @property
    def layers(self) -> int:
        """Number of attention layers."""
        return len({name.split(".")[1] for name in self.arrays if name.startswith("layers.")})

    @property
    def width(self) -> int:
        """Number of features per frame."""
        return int(self.arrays["place"].shape[-1])

    def output(self, hidden: np.ndarray) -> np.ndarray:
        """Return the network's (N, 89) output for the (N, d) features before the last layer."""
        return np.asarray(dense(self.arrays, hidden, "out"), dtype=float)

    def hidden(self, tokens: np.ndarray) -> np.ndarray:
        """Convert (N, 27, 62) input tokens to the (N, d) float32 features before the last layer."""
        blocks = [self._hidden(tokens[first : first + _BLOCK]) for first in range(0, len(tokens), _BLOCK)]
        return np.concatenate(blocks) if blocks else np.zeros((0, self.width), np.float32)

    def _hidden(self, tokens: np.ndarray) -> np.ndarray:
        x: np.ndarray = dense(self.arrays, tokens.astype(np.float32), "embed") + self.arrays["place"]
        for number in range(self.layers):
            x = layer(self.arrays, x, f"layers.{number}.", self.heads)
        return layer_norm(self.arrays, x[:, MIDDLE], "norm")

    def __call__(
        self,
        points: np.ndarray,
        confidence: np.ndarray,
        names: tuple[str, ...],
        fps: float,
        up: np.ndarray | None = None,
    ) -> LiftedView:
        """Lift every frame of a take.

        Args:
            points: (F, L, 2) in focal lengths from the principal point, undistorted, NaN where missing.
            confidence: (F, L) in 0..1, 0 where missing.
            names: names of the L points. Points with unknown names are ignored.
            up: (3,) or (F, 3) unit vector against gravity in camera axes, or None if unknown.
        """
        points, confidence = known_points(points, confidence, names)
        frames = window_frames(len(points), fps)
        inside = (frames >= 0) & (frames < len(points))
        chosen = np.clip(frames, 0, len(points) - 1)
        windows, seen = points[chosen], np.where(inside[..., None], confidence[chosen], 0.0)
        ups = np.zeros((len(points), 3)) if up is None else np.broadcast_to(up, (len(points), 3))
        view = look_at(windows, seen)
        hidden = self.hidden(features(windows, seen, ups, view))
        return replace(interpreted(self.output(hidden), view), hidden=hidden)


def known_points(points: np.ndarray, confidence: np.ndarray, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the network's finite (F, 19, 2) points, and their confidences, which are 0 where missing.

    If a detector has no ears or nose, the middle of the head replaces them (``HEAD_SHARE``).
    """
    points, confidence, names = _with_head(points, confidence, names)
    column = [names.index(name) if name in names else -1 for name in POINTS]
    there = np.array(column) >= 0
    chosen, sure = points[:, column], np.where(there, confidence[:, column], 0.0)
    seen = np.isfinite(chosen).all(axis=-1) & (sure > 0)
    return np.where(seen[..., None], chosen, 0.0), np.where(seen, np.clip(sure, 0.0, 1.0), 0.0)


def _with_head(
    points: np.ndarray, confidence: np.ndarray, names: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Append missing ears and nose at the middle of the head. Return points, confidences and names."""
    absent = tuple(name for name in FACE if name not in names)
    top, share = next(((name, share) for name, share in HEAD_SHARE.items() if name in names), ("", 0.0))
    neck = next((name for name in NECKS if name in names), "")
    if not absent or not top or not neck:
        return points, confidence, names
    ends = [names.index(neck), names.index(top)]
    middle = points[:, ends[0]] + share * (points[:, ends[1]] - points[:, ends[0]])
    sure = confidence[:, ends].min(axis=1)
    more = (np.repeat(part[:, None], len(absent), axis=1) for part in (middle, sure))
    points, confidence = (np.concatenate(both, axis=1) for both in zip((points, confidence), more, strict=True))
    return points, confidence, (*names, *absent)


def window_frames(count: int, fps: float) -> np.ndarray:
    """Return the (F, 27) frame numbers of the window around each frame. They may be outside the take."""
    offsets = np.round((np.arange(WINDOW) - MIDDLE) * fps / WINDOW_FPS).astype(int)
    return np.arange(count)[:, None] + offsets


@cache
def load_view_lifter(path: Path = DEFAULT_WEIGHTS) -> ViewLifter:
    """Load the view lifter's weights. Raises the errors of ``read_lifter_weights``."""
    weights = read_lifter_weights(path, "view_lifter")
    heads = weights.metadata.get("heads")
    arrays = {name: np.asarray(array, dtype=np.float32) for name, array in weights.arrays.items()}
    shapes = {name: arrays[name].shape for name in ("embed.weight", "place", "out.weight") if name in arrays}
    width = shapes.get("place", (0, 0))[-1]
    wanted = {"embed.weight": (width, TOKEN), "place": (WINDOW, width), "out.weight": (OUTPUTS, width)}
    if shapes != wanted or type(heads) is not int or heads < 1 or width % heads:
        message = "The file contains a different kind of view lifter."
        raise WeightsInvalid(message, where=path.name, hint="Train the network again, or reinstall the program.")
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise WeightsInvalid("The view lifter's weights are not all finite.", where=path.name, hint="Reinstall them.")
    return ViewLifter(arrays, heads, weights.metadata)


def _weights(confidence: Array) -> Array:
    """Return point weights (N, 27, 19) for the person's centre. They sum to 1, mostly near the middle frame."""
    xp = array_namespace(confidence)
    frame = np.arange(WINDOW) - MIDDLE
    share = constant(np.exp(-0.5 * (frame / _CENTRE_FRAMES) ** 2) + _FAINT, confidence)
    weight = confidence * share[None, :, None]
    total = xp.sum(weight, axis=(1, 2), keepdims=True)
    return weight / xp.where(total > 0, total, xp.ones_like(total))


def _turned(points: Array, R: Array) -> Array:
    """Return (N, 27, 19, 2) image points as seen by a camera rotated by R."""
    xp = array_namespace(points)
    rays = xp.concat([points, xp.ones_like(points[..., :1])], axis=-1)
    rays = xp.matmul(rays, xp.matrix_transpose(R)[:, None])
    depth = rays[..., 2:]
    depth = xp.where(depth > 0.1, depth, xp.full_like(depth, 0.1))
    return rays[..., :2] / depth


def _unit(vectors: Array) -> Array:
    xp = array_namespace(vectors)
    return vectors / xp.sqrt(xp.sum(vectors * vectors, axis=-1, keepdims=True) + _SMALLEST**2)


SLANT_WEIGHTS: Path = ASSETS / "limb_slants.npz"
PARTS = {"left arm": "left", "left leg": "left", "right arm": "right", "right leg": "right"}  # Sides of limbs.
_CHAINS = {"arm": ("shoulder", "elbow", "wrist"), "leg": ("hip", "knee", "ankle")}
BONES: tuple[tuple[int, int], ...] = tuple(
    (SMPL.joints.index(f"{side}_{first}"), SMPL.joints.index(f"{side}_{last}"))
    for part, side in PARTS.items()
    for first, last in zip(_CHAINS[part.split()[1]][:-1], _CHAINS[part.split()[1]][1:], strict=True)
)
"""Joints at the ends of the eight bones, upper before lower."""
SLANT = float(np.sin(np.radians(20.0)))  # Sine of the smallest angle between a slanted bone and the image plane.
CLASSES = 3  # Towards the camera, across, away from it.


@dataclass(frozen=True)
class LimbSlants:
    """Network that estimates whether limb bones point towards the camera, across the view, or away from the camera."""

    stack: DenseStack  # From the lifter's features to 8 x 3 logits.
    metadata: dict[str, Any]  # Training command, data and evaluation.

    def __call__(self, hidden: np.ndarray) -> np.ndarray:
        """Return (N, 8, 3) probabilities that bones point towards the camera, across or away."""
        logits = np.asarray(self.stack(np.asarray(hidden, dtype=float)))
        return softmax(logits.reshape(len(hidden), len(BONES), CLASSES).copy())


def bone_slants(joints: np.ndarray, sight: np.ndarray) -> np.ndarray:
    """Return the sine (F, 8) of each bone's angle to the image plane, positive away from the camera."""
    first, last = np.array(BONES).T
    bones = joints[:, last] - joints[:, first]
    length = np.maximum(np.linalg.norm(bones, axis=-1), 1e-9)
    return np.einsum("fba,fa->fb", bones, sight) / length


def slant_classes(slants: np.ndarray) -> np.ndarray:
    """Return each bone's class: 0 if it points towards the camera, 1 if across the view, and 2 if away."""
    return np.where(slants < -SLANT, 0, np.where(slants > SLANT, 2, 1))


def flip_chances(chances: np.ndarray, slants: np.ndarray) -> np.ndarray:
    """Return the (F, 4) probabilities that the solve has the wrong depth direction for a bone of each limb.

    The probability is ``1 - Π_b (1 - p_b)`` over the limb's two bones. p is the network's probability of the opposite
    direction, or 0 for a bone that the solve places across the view. ``chances`` (F, 8, 3) are from ``LimbSlants``, and
    ``slants`` (F, 8) from ``bone_slants``.
    """
    opposite = np.where(slants > SLANT, chances[..., 0], np.where(slants < -SLANT, chances[..., 2], 0.0))
    return 1.0 - (1.0 - opposite[:, 0::2]) * (1.0 - opposite[:, 1::2])


@cache
def load_limb_slants(path: Path = SLANT_WEIGHTS) -> LimbSlants:
    """Load the network's weights. Raises the errors of ``read_weights``."""
    weights = read_weights(path, "limb_slants")
    lifter = load_view_lifter()
    if weights.metadata.get("view_lifter_sha256") != lifter.metadata["sha256"]:
        raise WeightsInvalid("The limb slants are for another view lifter.", where=path.name, hint="Train them again.")
    return LimbSlants(read_stack(weights, "network", lifter.width, len(BONES) * CLASSES), weights.metadata)
