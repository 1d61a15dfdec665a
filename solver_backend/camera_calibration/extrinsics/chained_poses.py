"""Camera poses from what pairs of cameras saw together, chained along the best pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.geometry.rotations import log_so3

Pose = tuple[np.ndarray, np.ndarray]
"""Rotation (3, 3) and translation (3,)."""
BOARD_REACH_M = 0.5
"""Metres by which a turn is weighed against a shift: one radian is worth so much."""


def composed(a: Pose, b: Pose) -> Pose:
    """Return the pose that first applies b, then a."""
    return a[0] @ b[0], a[0] @ b[1] + a[1]


def inverted(a: Pose) -> Pose:
    """Return the pose that undoes a."""
    return a[0].T, -a[0].T @ a[1]


def relative_pose(first: Sequence[Pose], second: Sequence[Pose]) -> Pose:
    """Return the pose first camera to second camera that agrees best with all moments both saw the board.

    Each moment proposes ``T_second T_first⁻¹``; the proposal whose median distance to all others is least is taken, so
    that the false of a flat board's two poses does not win.

    Args:
        first: board to first camera, at N moments.
        second: board to second camera, at the same moments.
    """
    proposals = [composed(b, inverted(a)) for a, b in zip(first, second, strict=True)]
    R, t = np.stack([p[0] for p in proposals]), np.stack([p[1] for p in proposals])
    turn = np.linalg.norm(log_so3(np.swapaxes(R, 1, 2)[:, None] @ R[None]), axis=-1)
    distance = BOARD_REACH_M * turn + np.linalg.norm(t[:, None] - t[None], axis=-1)
    return proposals[int(np.argmin(np.median(distance, axis=1)))]


def chained(
    names: Sequence[str], together: Mapping[tuple[int, int], int], relative: Mapping[tuple[int, int], Pose]
) -> list[Pose]:
    """Return each camera's pose, first camera's axes to its own, along the tree of pairs that saw most together.

    Args:
        names: of the C cameras, for messages.
        together: how much each pair (i < j) saw together.
        relative: pose i to j of each pair.

    Raises:
        CalibrationInvalid: some cameras saw nothing together with the others; names the groups.

    Reference: Prim 1957 (maximum spanning tree).
    """
    poses: dict[int, Pose] = {0: (np.eye(3), np.zeros(3))}
    while len(poses) < len(names):
        edges = [(n, i, j) for (i, j), n in together.items() if (i in poses) != (j in poses)]
        if not edges:
            raise CalibrationInvalid(_apart(names, poses), hint="Film it where both groups see it at once.")
        _, i, j = max(edges)
        if i in poses:
            poses[j] = composed(relative[i, j], poses[i])
        else:
            poses[i] = composed(inverted(relative[i, j]), poses[j])
    return [poses[c] for c in range(len(names))]


def _apart(names: Sequence[str], joined: Mapping[int, Pose]) -> str:
    inside = ", ".join(names[c] for c in sorted(joined))
    outside = ", ".join(name for c, name in enumerate(names) if c not in joined)
    return f"No camera of {inside} ever sees the same at the same moment as {outside}."
