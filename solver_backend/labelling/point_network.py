"""Run the landmark network in NumPy. It labels points, and estimates marker and joint positions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from solver_backend.exchange.errors import CaptureInvalid, NoDetections, WeightsInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.labelling.outputs import GHOST, LANDMARKS, MARKERS
from solver_backend.priors.view_lifter import Arrays, attention, dense, layer, layer_norm, softmax, split_heads
from solver_backend.priors.weights import ASSETS, read_weights
from solver_backend.types.shapes import Float

FREQUENCIES: tuple[float, ...] = tuple(math.pi * 2.0**k for k in range(5))
"""Angular frequencies in 1/m of sines and cosines of the coordinates, for wavelengths from 2 m to 0.125 m."""
NEARNESS: tuple[float, ...] = tuple(0.2 + 0.13 * k for k in range(8))
"""Square roots of the distances at the centres of an attention bias, denser where markers are close (4 cm to 1.2 m)."""
NEARNESS_WIDTH = 0.13  # Width of a bump in square roots of metres.
FREEDOM = 4.0  # Degrees of freedom of Student's t-distribution for position errors, as in training.
_DM = 0.1  # Metres per decimetre, which is the unit of the network's positions and spreads.


@dataclass(frozen=True)
class CloudReading:
    """Network outputs for B clouds of N points: scores of 53 markers and no marker (ghost), and 77 landmarks."""

    scores: Float[np.ndarray, "clouds points labels"]  # (B, N, 54) score of each label, ghost last.
    missing: Float[np.ndarray, " markers"]  # (53,) score of a marker without a point.
    positions: Float[np.ndarray, "clouds landmarks 3"]  # (B, 77, 3) positions in metres.
    spread: Float[np.ndarray, "clouds landmarks 6"]
    """(B, 77, 6) log diagonal and lower entries of the Cholesky factor of each position's inverse scatter, in 1/dm."""

    @property
    def log_probability(self) -> np.ndarray:
        """(B, N, 54) log probability of each label per point."""
        shifted = self.scores - self.scores.max(-1, keepdims=True)
        return shifted - np.log(np.exp(shifted).sum(-1, keepdims=True))

    @property
    def covariance(self) -> np.ndarray:
        """(B, 77, 3, 3) covariances in m², ``ν / (ν - 2) (L Lᵀ)⁻¹`` of Student's t with ν = 4 and L from ``spread``."""
        log_diagonal, lower = np.clip(self.spread[..., :3], -4.0, 5.0).astype(float), self.spread[..., 3:].astype(float)
        L = np.zeros((*self.spread.shape[:-1], 3, 3))
        L[..., range(3), range(3)] = np.exp(log_diagonal)
        L[..., 1, 0], L[..., 2, 0], L[..., 2, 1] = lower[..., 0], lower[..., 1], lower[..., 2]
        inverse = np.linalg.inv(L)
        return FREEDOM / (FREEDOM - 2.0) * _DM**2 * (np.swapaxes(inverse, -1, -2) @ inverse)


class LandmarkNetwork(Protocol):
    """Network that labels point clouds and estimates landmark positions."""

    @property
    def sha256(self) -> str:
        """SHA-256 hash of the weights."""
        ...

    def __call__(self, points: np.ndarray, seen: np.ndarray | None = None) -> CloudReading:
        """Label the points and estimate landmarks in (B, N, 3) clouds (metres, Z up) with a mask ``seen`` (B, N)."""
        ...


NAME = "landmarks"
_HIDDEN = np.float32(-30000.0)
"""Value added to the attention scores of missing points. Its exponential is 0 in single precision."""
_FREQUENCIES, _NEARNESS = np.array(FREQUENCIES, np.float32), np.array(NEARNESS, np.float32)


@dataclass(frozen=True)
class PointNetwork:
    """Landmark network with float32 weights, which have the parameter names of the trained torch module."""

    arrays: Arrays
    layers: int
    heads: int
    sha256: str = ""

    def __call__(self, points: np.ndarray, seen: np.ndarray | None = None) -> CloudReading:
        """Label the points and estimate landmarks in (B, N, 3) clouds (metres, Z up) with a mask ``seen`` (B, N)."""
        points = np.asarray(points)
        seen = np.ones(points.shape[:2], bool) if seen is None else seen
        centre = lower_median(points, seen)
        local = np.where(seen[..., None], points - centre, 0.0).astype(np.float32)
        gone = np.where(seen, np.float32(0.0), _HIDDEN)[:, None, None]
        x, bias = self._embedded(local), self._bias(local, gone)
        for number in range(self.layers):
            of_layer = bias[:, number * self.heads : (number + 1) * self.heads]
            x = layer(self.arrays, x, f"layers.{number}.", self.heads, of_layer)
        x = layer_norm(self.arrays, x, "norm")
        asked = self._asked(x, gone)
        aim = self._dense(asked, "point_at") @ np.swapaxes(self._dense(x, "pointed"), 1, 2)
        aim *= np.float32(x.shape[-1] ** -0.5)
        aim += gone[:, 0]
        positions = softmax(aim) @ local + self._dense(asked, "offset")
        labels, spread = self._dense(x, "labels"), self._dense(asked, "spread")
        return CloudReading(labels, self.arrays["missing"], positions + centre, spread)

    def _embedded(self, points: np.ndarray) -> np.ndarray:
        waves = (points[..., None] * _FREQUENCIES).reshape(*points.shape[:2], -1)
        return self._dense(np.concatenate((points, np.sin(waves), np.cos(waves)), axis=-1), "embed")

    def _bias(self, points: np.ndarray, gone: np.ndarray) -> np.ndarray:
        apart = points[:, :, None] - points[:, None]
        apart = np.einsum("bnmi,bnmi->bnm", apart, apart)
        apart = np.sqrt(np.sqrt(np.maximum(apart, np.float32(1e-8))))
        steps = (apart[..., None] - _NEARNESS) * np.float32(1.0 / NEARNESS_WIDTH)
        np.multiply(steps, steps, out=steps)
        np.negative(steps, out=steps)
        np.exp(steps, out=steps)
        bias = steps @ self.arrays["by_distance.weight"].T
        return np.moveaxis(bias, -1, 1) + gone

    def _asked(self, x: np.ndarray, gone: np.ndarray) -> np.ndarray:
        asking = self.arrays["queries"][None]
        k, v = (split_heads(part, self.heads) for part in np.split(self._dense(x, "asking.kv"), 2, axis=-1))
        q = split_heads(self._dense(asking, "asking.q"), self.heads)
        asking = asking + self._dense(attention(q, k, v, gone), "asking.out")
        return layer(self.arrays, asking, "asking.among.", self.heads)

    def _dense(self, x: np.ndarray, name: str) -> np.ndarray:
        return dense(self.arrays, x, name)


def lower_median(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the (B, 1, 3) lower medians of the points in the mask ``seen``, or 0 for clouds without points."""
    ordered = np.sort(np.where(seen[..., None], points, np.inf), axis=1)
    middle = np.maximum((seen.sum(1) - 1) // 2, 0)
    found = ordered[np.arange(len(points)), middle]
    return np.where(np.isfinite(found), found, 0.0)[:, None]


def network_of(arrays: Arrays, sha256: str = "") -> PointNetwork:
    """Build the network from the arrays of a trained module. Raise ``WeightsInvalid`` if they do not fit."""
    arrays = {name.removeprefix("net."): np.asarray(a, dtype=np.float32) for name, a in arrays.items()}
    try:
        layers = 1 + max(int(name.split(".")[1]) for name in arrays if name.startswith("layers."))
        heads = len(arrays["by_distance.weight"]) // layers
        fits = arrays["labels.bias"].shape == (GHOST + 1,) and arrays["missing"].shape == (len(MARKERS),)
        fits = fits and len(arrays["queries"]) == len(LANDMARKS)
        fits = fits and arrays["embed.weight"].shape[1] == 3 + 6 * len(FREQUENCIES)
    except (KeyError, ValueError) as error:
        raise WeightsInvalid("The weights are not for a landmark network.") from error
    if not fits or not all(np.isfinite(a).all() for a in arrays.values()):
        raise WeightsInvalid("The weights are damaged, or are for another landmark network.")
    return PointNetwork(arrays, layers, heads, sha256)


@lru_cache(maxsize=2)
def load_network(path: Path | None = None) -> PointNetwork:
    """Load the landmark network from a file, or the built-in one. Raise FileMissing or WeightsInvalid."""
    weights = read_weights(path or ASSETS / f"{NAME}.npz", NAME)
    return network_of(weights.arrays, weights.sha256)


FEWEST_POINTS, MOST_POINTS = 6, 2000
"""Smallest number of points that form a person, and largest per frame. Comparing all their pairs needs 0.6 GB."""
_PART, _PAIRS = 64, 64 * 100**2  # Largest numbers of frames and point pairs read at a time.


@dataclass(frozen=True)
class FramesRead:
    """Network outputs for B frames, with the take columns (B, N) of their points and a mask of existing points."""

    frames: np.ndarray
    columns: np.ndarray
    there: np.ndarray
    reading: CloudReading


def read_frames(
    positions: np.ndarray, seen: np.ndarray, frames: np.ndarray, network: LandmarkNetwork
) -> Iterator[FramesRead]:
    """Apply the network to the given frames of a take, in batches. ``seen`` (F, N) is a mask of existing points."""
    size = int(np.clip(_PAIRS // max(int(seen[frames].sum(1).max()), 1) ** 2, 1, _PART))
    for start in range(0, len(frames), size):
        part = frames[start : start + size]
        columns = np.argsort(~seen[part], axis=1, kind="stable")[:, : int(seen[part].sum(1).max())]
        there = np.take_along_axis(seen[part], columns, axis=1)
        points = np.take_along_axis(positions[part], columns[..., None], axis=1)
        yield FramesRead(part, columns, there, network(np.where(there[..., None], points, 0.0), there))


def require_points(seen: np.ndarray) -> None:
    """Check that a take has enough points, but not too many.

    Raises:
        NoDetections: no frame has enough points.
        CaptureInvalid: a frame has too many points to compare.
    """
    if not (seen.sum(1) >= FEWEST_POINTS).any():
        what = f"No frame has {FEWEST_POINTS} points, which are needed to distinguish markers."
        raise NoDetections(what, where="markers")
    require_at_most(MOST_POINTS, int(seen.sum(1).max()), f"points in frame {int(seen.sum(1).argmax())}")


def require_at_most(most: int, found: int, what: str) -> None:
    """Raise ``CaptureInvalid`` if there are more than ``most`` items, which are too many to compare in pairs."""
    if found > most:
        what = f"Labelling is not supported for {found} {what}. The limit is {most}."
        hint = "Remove stray points, or cut the take, in the recording program."
        raise CaptureInvalid(what, where="markers", hint=hint)


def frame_landmarks(positions: np.ndarray, network: LandmarkNetwork, progress: Progress = silent) -> np.ndarray:
    """Estimate marker and joint positions (F, 77, 3) in metres from points (F, N, 3). Frames with few points get NaN.

    Raises:
        NoDetections, CaptureInvalid: see ``require_points``.
    """
    seen = np.isfinite(positions).all(-1)
    require_points(seen)
    found = np.full((len(positions), len(LANDMARKS), 3), np.nan)
    frames, done = np.flatnonzero(seen.sum(1) >= FEWEST_POINTS), 0
    for part in read_frames(np.asarray(positions, dtype=np.float64), seen, frames, network):
        found[part.frames] = part.reading.positions
        done += len(part.frames)
        progress("Reading the points", done, len(frames))
    return found
