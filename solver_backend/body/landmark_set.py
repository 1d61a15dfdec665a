"""Points that hang on the body: which bones carry them, where they rest, how shape and pose move them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.types.shapes import Float


@dataclass(frozen=True, eq=False)
class Landmarks:
    """L named points: ``y_l = sum_b w_lb p_b + G_b (a_lb - w_lb J_b)`` with the bones b they hang on."""

    names: tuple[str, ...]
    weights: Float[np.ndarray, "landmarks joints"]  # (L, J) share of each bone, rows sum to 1.
    anchors: Float[np.ndarray, "landmarks joints 3"]  # (L, J, 3) mean rest position times the bone's share, m.
    shapedirs: Float[np.ndarray, "landmarks joints 3 10"]  # (L, J, 3, 10) derivative of the anchors by the shape.
    posedirs: Float[np.ndarray, "landmarks 3 features"] | None = None  # (L, 3, 9 (J - 1)) correctives, None if rigid.

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def of_points(
        cls,
        names: tuple[str, ...],
        rest: np.ndarray,
        shapedirs: np.ndarray,
        weights: np.ndarray,
        mix: np.ndarray | None = None,
        posedirs: np.ndarray | None = None,
    ) -> Landmarks:
        """Return landmarks from P skinned points.

        Args:
            rest: (P, 3) rest positions of the mean shape, metres.
            shapedirs: (P, 3, 10) metres per unit of shape.
            weights: (P, J) skinning weights, rows sum to 1.
            mix: (L, P) share of each point, rows sum to 1; None makes each point a landmark.
            posedirs: (P, 3, 9 (J - 1)) pose correctives of unmixed points.
        """
        if mix is None:
            mix = np.eye(len(rest))
        elif posedirs is not None:
            raise ValueError("Pose correctives belong to points of the skin; mixed points are rigid.")
        anchors = np.tensordot(mix, weights[:, :, None] * rest[:, None], axes=1)
        directions = np.tensordot(mix, weights[:, :, None, None] * shapedirs[:, None], axes=1)
        return cls(names, mix @ weights, anchors, directions, posedirs)

    def part(self, which: slice) -> Landmarks:
        """Return some of the landmarks."""
        posedirs = None if self.posedirs is None else self.posedirs[which]
        return Landmarks(self.names[which], self.weights[which], self.anchors[which], self.shapedirs[which], posedirs)

    @classmethod
    def joined(cls, parts: Sequence[Landmarks]) -> Landmarks:
        """Return the landmarks of all parts, one part after the other; rigid ones get correctives of zero."""
        names = tuple(name for part in parts for name in part.names)
        shared = (np.concatenate([getattr(p, key) for p in parts]) for key in ("weights", "anchors", "shapedirs"))
        skinned = next((part.posedirs for part in parts if part.posedirs is not None), None)
        if skinned is None:
            return cls(names, *shared)
        rigid = [np.zeros((len(part), *skinned.shape[1:])) for part in parts]
        posedirs = [zero if part.posedirs is None else part.posedirs for part, zero in zip(parts, rigid, strict=True)]
        return cls(names, *shared, posedirs=np.concatenate(posedirs))
