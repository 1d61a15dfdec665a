"""A body as solids that hands can touch: rods along its bones, and how far the skin is from each in all directions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..._exchange.rigs.rest_frames import FORWARD, UP
from ..._exchange.rigs.roles import SIDES

CHEST, BASE, TOP = "chest", "base", "top"
"""Places beside those of roles: the topmost bone of the spine, the middle of the hips, and where the trunk ends."""
_SHARES, _ANGLES = 8, 12
"""Cells of a table of radii along the rod and around it: of a thigh 5 cm long and as wide."""
_OUTER = 0.75
"""Quantile of a cell's distances that is its radius: clothing counts, single hairs do not."""
_LEAST_FILLED = 0.4
"""Share of the cells with skin from which a part is known."""


@dataclass(frozen=True)
class Part:
    """A part of a body: the role that turns it, the places its rod joins, and which shares of the rod are its own."""

    skin: str
    """Name of the skin around it."""
    turned_by: str
    start: str
    end: str
    """"" for the highest point of the skin above the start."""
    span: tuple[float, float] = (0.0, 1.0)
    table: tuple[float, float] = (0.0, 1.0)
    """Shares that the table of radii covers."""


_WHOLE_TRUNK = (-0.1, 1.0)
"""By the way from hips to neck: from the lowest of the seat up."""
PARTS = {
    "hips": Part("trunk", "pelvis", BASE, TOP, (-0.1, 0.5), _WHOLE_TRUNK),
    CHEST: Part("trunk", CHEST, BASE, TOP, (0.5, 1.0), _WHOLE_TRUNK),
    "head": Part("head", "head", "head", ""),
    **{
        f"{side}_{part}": Part(f"{side}_{part}", f"{side}_{part}", f"{side}_{part}", f"{side}_{after}")
        for side in SIDES
        for part, after in (("thigh", "shin"), ("shin", "foot"), ("upper_arm", "forearm"), ("forearm", "hand"))
    },
}
"""Parts that hands are kept on."""


@dataclass(frozen=True)
class Solid:
    """A part around its rod, in the axes that the joint which turns it has when our body is at rest."""

    origin: np.ndarray
    """(3,) metres from the joint to where the rod begins."""
    axes: np.ndarray
    """(3, 3) unit vectors, one a column: along the rod, to the front, square to both."""
    length: float
    table: tuple[float, float]
    radii: np.ndarray
    """(K, M) metres from the rod to the skin, by share of the rod and angle from the front."""

    def coordinates(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return share of the rod, angle and distance from the rod, (F,) each, of points (F, 3)."""
        x = (points - self.origin) @ self.axes
        return x[..., 0] / self.length, np.arctan2(x[..., 2], x[..., 1]), np.hypot(x[..., 1], x[..., 2])

    def place(self, share: np.ndarray, angle: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Return the points (F, 3) with these coordinates."""
        x = np.stack([share * self.length, distance * np.cos(angle), distance * np.sin(angle)], axis=-1)
        return self.origin + x @ self.axes.T

    def radius(self, share: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the distance (F,) from the rod to the skin, linear between the middles of the table's cells."""
        low, high = self.table
        rows, columns = self.radii.shape
        k = np.clip((share - low) / (high - low) * rows - 0.5, 0.0, rows - 1.0)
        m = (angle / (2 * np.pi) * columns - 0.5) % columns
        k0, m0 = np.minimum(k.astype(int), rows - 2), m.astype(int)
        k1, m1, dk, dm = k0 + 1, (m0 + 1) % columns, k - k0, m - m0
        m0 = m0 % columns
        below = (1 - dm) * self.radii[k0, m0] + dm * self.radii[k0, m1]
        above = (1 - dm) * self.radii[k1, m0] + dm * self.radii[k1, m1]
        return (1 - dk) * below + dk * above


def solids_of(
    heads: Mapping[str, np.ndarray], turns: Mapping[str, np.ndarray], skin: Mapping[str, np.ndarray]
) -> dict[str, Solid]:
    """Return the parts whose skin is known.

    Args:
        heads: (3,) place at rest by role, and of ``CHEST``, ``BASE`` and ``TOP``.
        turns: (3, 3) rotation by the same from the figure's rest to our body's; the identity where left out.
        skin: (V, 3) points at rest by name of the skin.
    """
    found = {}
    for name, part in PARTS.items():
        if not {part.turned_by, part.start, part.end or part.start} <= heads.keys() or part.skin not in skin:
            continue
        points, start = skin[part.skin], heads[part.start]
        end = heads[part.end] if part.end else start + UP * max(float(((points - start) @ UP).max()), 0.0)
        solid = _solid(part, points, start, end, heads[part.turned_by], turns.get(part.turned_by, np.eye(3)))
        if solid is not None:
            found[name] = solid
    return found


def _solid(
    part: Part, points: np.ndarray, start: np.ndarray, end: np.ndarray, joint: np.ndarray, turn: np.ndarray
) -> Solid | None:
    """Return a part, None where its skin leaves too much open."""
    length = float(np.linalg.norm(end - start))
    if length < 1e-6:
        return None
    along = turn @ (end - start) / length
    front = FORWARD - (FORWARD @ along) * along
    if np.linalg.norm(front) < 1e-3:
        return None
    front = front / np.linalg.norm(front)
    axes = np.stack([along, front, np.cross(along, front)], axis=1)
    empty = Solid(turn @ (start - joint), axes, length, part.table, np.zeros((_SHARES, _ANGLES)))
    share, angle, distance = empty.coordinates((points - joint) @ turn.T)
    radii = _radii(share, angle, distance, part.table)
    return None if radii is None else Solid(empty.origin, axes, length, part.table, radii)


def _radii(share: np.ndarray, angle: np.ndarray, distance: np.ndarray, table: tuple[float, float]) -> np.ndarray | None:
    """Return the radius of each cell of the table, that of the nearest known one where a cell has no skin."""
    low, high = table
    k = np.floor((share - low) / (high - low) * _SHARES).astype(int)
    m = np.floor(angle / (2 * np.pi) * _ANGLES).astype(int) % _ANGLES
    inside = (k >= 0) & (k < _SHARES)
    cell, distance = (k * _ANGLES + m)[inside], distance[inside]
    order = np.lexsort((distance, cell))
    cells, first, count = np.unique(cell[order], return_index=True, return_counts=True)
    if len(cells) < _LEAST_FILLED * _SHARES * _ANGLES:
        return None
    known = distance[order][first + np.floor(_OUTER * (count - 1)).astype(int)]
    rows, columns = np.divmod(np.arange(_SHARES * _ANGLES), _ANGLES)
    around = np.abs(columns[:, None] - columns[cells])
    far = np.hypot(rows[:, None] - rows[cells], np.minimum(around, _ANGLES - around))
    return known[far.argmin(axis=1)].reshape(_SHARES, _ANGLES)
