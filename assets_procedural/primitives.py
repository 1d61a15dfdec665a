"""Implicit surface of the body: a sum F of mirrored anisotropic Gaussians, with the skin at F = 1."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from assets_procedural.arrays import FLIP, NUMBERS
from solver_backend.exchange.errors import FileDamaged

_KEYS = ("mean", "log_scale", "rotation", "log_weight")
_FLOOR = 1e-9  # Lower limit of a sum of weights.


@dataclass(frozen=True)
class Primitives:
    """The body as a field F: a sum of Gaussians for both halves. F > 1 inside the body."""

    mean: np.ndarray  # (K, 3) metres, with the floor at y = 0.
    whiten: np.ndarray  # (K, 3, 3): diag(1 / scale) times the transposed rotation.
    log_weight: np.ndarray  # (K,) logarithms of the weights.

    @classmethod
    def from_half(
        cls, mean: np.ndarray, log_scale: np.ndarray, rotation: np.ndarray, log_weight: np.ndarray
    ) -> Primitives:
        """Build both halves from the parameters of the left half. ``rotation`` contains rotation vectors."""
        turn = Rotation.from_rotvec(rotation).as_matrix()
        whiten = np.exp(-log_scale)[:, :, None] * np.swapaxes(turn, 1, 2)
        parts = (mean, mean * FLIP), (whiten, whiten * FLIP), (log_weight, log_weight)
        return cls(*(np.concatenate(halves) for halves in parts))

    def log_field(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ``log F`` (N,) at (N, 3) points in metres, and its gradient (N, 3) in 1/m."""
        values, gradients = np.empty(len(points)), np.empty((len(points), 3))
        reach = self._reach()
        cells = np.floor(points / 0.08).astype(np.int64)
        order = np.lexsort(cells.T)
        for part in np.array_split(order, max(1, len(order) // 256)):
            near = points[part]
            close = np.all((self.mean + reach > near.min(axis=0)) & (self.mean - reach < near.max(axis=0)), axis=1)
            values[part], gradients[part] = self._log_field_of(near, close)
        return values, gradients

    def _log_field_of(self, points: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        whiten = self.whiten[chosen]
        flat, origin = whiten.reshape(-1, 3), np.einsum("kab,kb->ka", whiten, self.mean[chosen]).reshape(-1)
        y = (points @ flat.T - origin).reshape(len(points), -1, 3)
        share = np.exp(self.log_weight[chosen] - 0.5 * np.sum(y * y, axis=2))
        total = share.sum(axis=1) + _FLOOR
        gradient = -((share[:, :, None] * y).reshape(len(points), -1) @ flat) / total[:, None]
        return np.log(total), gradient

    def _reach(self) -> np.ndarray:
        covariance = np.linalg.inv(np.swapaxes(self.whiten, 1, 2) @ self.whiten)
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        return np.sqrt(variance * 2.0 * np.maximum(9.0 + self.log_weight, 1.0)[:, None])

    def grid(self, low: np.ndarray, cell: float, shape: tuple[int, int, int]) -> np.ndarray:
        """Return F on a regular grid. Each Gaussian is evaluated only inside its own box."""
        field = np.zeros(shape)
        for mean, whiten, log_weight, radius in zip(
            self.mean, self.whiten, self.log_weight, self._reach(), strict=True
        ):
            a = whiten.T @ whiten
            first = np.maximum(np.floor((mean - radius - low) / cell).astype(int), 0)
            last = np.minimum(np.ceil((mean + radius - low) / cell).astype(int) + 1, shape)
            if np.any(last <= first):
                continue
            offsets = [low[k] + cell * np.arange(first[k], last[k]) - mean[k] for k in range(3)]
            x, y, z = np.ix_(*offsets)
            form = a[0, 0] * x * x + a[1, 1] * y * y + a[2, 2] * z * z
            form = form + 2 * (a[0, 1] * x * y + a[0, 2] * x * z + a[1, 2] * y * z)
            box = tuple(slice(int(i), int(j)) for i, j in zip(first, last, strict=True))
            field[box] += np.exp(log_weight - 0.5 * form)
        return field

    def project(self, points: np.ndarray, *, steps: int = 4, on_plane: np.ndarray | None = None) -> np.ndarray:
        """Move points that are near the skin onto it, by Newton steps of at most 4 mm.

        Points marked in ``on_plane`` (N,) stay on x = 0.
        """
        moved = points.copy()
        for _ in range(steps):
            value, gradient = self.log_field(moved)
            if on_plane is not None:
                gradient[on_plane, 0] = 0.0
            step = -value / (np.einsum("na,na->n", gradient, gradient) + 1e-12)
            length = np.abs(step) * np.linalg.norm(gradient, axis=1)
            moved += (step * np.minimum(1.0, 0.004 / np.maximum(length, 1e-12)))[:, None] * gradient
        return moved

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Return the outward unit normals (N, 3) of F's level sets through the points (N, 3)."""
        _, gradient = self.log_field(points)
        return -gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)


def load_primitives(path: Path = NUMBERS / "primitives.npz") -> Primitives:
    """Read the committed primitives (Gaussians) of the body's left half, and mirror them.

    Raises:
        FileDamaged: the file lacks an array, or arrays differ in length.
    """
    with np.load(path, allow_pickle=False) as data:
        missing = [key for key in _KEYS if key not in data.files]
        if missing:
            raise FileDamaged(f"The primitives lack {', '.join(missing)}.", where=str(path))
        arrays = [data[key].astype(np.float64) for key in _KEYS]
    if len({len(a) for a in arrays}) != 1:
        raise FileDamaged(f"The primitives' arrays have lengths {[len(a) for a in arrays]}.", where=str(path))
    return Primitives.from_half(*arrays)
