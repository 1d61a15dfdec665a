"""How near any rigid bones can come to a recording's own skeleton: its joints in the frames of its own markers.

A joint of a rigid body is a fixed point of both bones that meet in it. A cluster of markers on a bone is the bone's
frame as recorded, without any model; a reference joint that moves in both neighbouring frames is out of reach of every
skeleton whose bones carry those markers.
"""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.alignment import umeyama

CLUSTERS: dict[str, tuple[tuple[str, ...], ...]] = {
    "hip": (("LFWT", "RFWT", "LBWT", "RBWT"), ("{s}FWT", "{s}THI", "{s}KNE")),
    "knee": (("{s}FWT", "{s}THI", "{s}KNE"), ("{s}KNE", "{s}SHN", "{s}ANK"), ("{s}KNE", "{s}SHN", "{s}ANK", "{s}HEE")),
    "ankle": (("{s}KNE", "{s}SHN", "{s}ANK"), ("{s}ANK", "{s}HEE", "{s}TOE", "{s}MT5")),
    "shoulder": (("C7", "T10", "CLAV", "STRN"), ("{s}SHO", "{s}UPA", "{s}ELB")),
    "elbow": (("{s}SHO", "{s}UPA", "{s}ELB"), ("{s}ELB", "{s}FRM", "{s}WRA", "{s}WRB")),
    "wrist": (("{s}ELB", "{s}FRM", "{s}WRA", "{s}WRB"),),
}
"""Markers of the bones that meet in each joint; {s} is the side."""


def motion_in_bones(labels: tuple[str, ...], markers: np.ndarray, joints: dict[str, np.ndarray]) -> dict[str, float]:
    """Return how far each reference joint moves in the steadiest of its bones' frames, mean millimetres."""
    found = {}
    for name, positions in joints.items():
        side, _, joint = name.partition("_")
        moves = []
        for cluster in CLUSTERS[joint]:
            columns = [labels.index(marker.format(s=side[0].upper())) for marker in cluster]
            moves.append(_moves(markers[:, columns], positions))
        found[name] = min(moves)
    return found


def _moves(cluster: np.ndarray, joint: np.ndarray) -> float:
    """Return the mean distance of a (F, 3) joint to its mean in the frame of a (F, n, 3) cluster, millimetres."""
    shape = cluster[:1]
    for _ in range(5):
        _, R, t = umeyama(np.broadcast_to(shape, cluster.shape), cluster)
        shape = (np.swapaxes(R, 1, 2)[:, None] @ (cluster - t[:, None])[..., None])[..., 0].mean(axis=0, keepdims=True)
    local = (np.swapaxes(R, 1, 2) @ (joint - t)[..., None])[..., 0]
    return 1000 * float(np.linalg.norm(local - local.mean(axis=0), axis=-1).mean())
