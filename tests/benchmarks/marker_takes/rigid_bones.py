"""How near any rigid bones can come to a recording's own skeleton: its joints in the frames of its own markers.

A joint of a rigid body is a fixed point of both bones that meet in it. A cluster of markers on a bone is the bone's
frame as recorded, without any model; a reference joint that moves in both neighbouring frames is out of reach of every
skeleton whose bones carry those markers.
"""

from __future__ import annotations

import itertools

import numpy as np

from solver_backend.geometry.alignment import umeyama
from tests.support.open_sim import flexion_deg

CLUSTERS: dict[str, tuple[tuple[str, ...], ...]] = {
    "hip": (("LFWT", "RFWT", "LBWT", "RBWT"), ("{s}FWT", "{s}THI", "{s}KNE")),
    "knee": (("{s}FWT", "{s}THI", "{s}KNE"), ("{s}KNE", "{s}SHN", "{s}ANK"), ("{s}KNE", "{s}SHN", "{s}ANK", "{s}HEE")),
    "ankle": (("{s}KNE", "{s}SHN", "{s}ANK"), ("{s}ANK", "{s}HEE", "{s}TOE", "{s}MT5")),
    "shoulder": (("C7", "T10", "CLAV", "STRN"), ("{s}SHO", "{s}UPA", "{s}ELB")),
    "elbow": (("{s}SHO", "{s}UPA", "{s}ELB"), ("{s}ELB", "{s}FRM", "{s}WRA", "{s}WRB")),
    "wrist": (("{s}ELB", "{s}FRM", "{s}WRA", "{s}WRB"),),
}
"""Markers of the bones that meet in each joint; {s} is the side."""
HINGES = {"knee": ("hip", "knee", "ankle"), "elbow": ("shoulder", "elbow", "wrist")}
"""Joints between which a hinge's flexion is told."""


def motion_in_bones(labels: tuple[str, ...], markers: np.ndarray, joints: dict[str, np.ndarray]) -> dict[str, float]:
    """Return how far each reference joint moves in the steadiest of its bones' frames, mean millimetres."""
    found = {}
    for name, positions in joints.items():
        side, _, joint = name.partition("_")
        carried = [_fixed(_cluster(labels, markers, cluster, side), positions) for cluster in CLUSTERS[joint]]
        found[name] = 1000 * min(float(np.linalg.norm(where - positions, axis=-1).mean()) for where in carried)
    return found


def flexion_in_bones(
    labels: tuple[str, ...], markers: np.ndarray, joints: dict[str, np.ndarray]
) -> dict[str, tuple[float, float]]:
    """Return how far each hinge's angle is from the reference's where each of its joints stays in one of its bones.

    The offset and the RMS around it, degrees, of the choice of bones that is nearest, by ``left_knee`` and so on.
    """
    found = {}
    for hinge, parts in HINGES.items():
        for side in ("left", "right"):
            reference = [joints[f"{side}_{part}"] for part in parts]
            choices = [
                [_fixed(_cluster(labels, markers, cluster, side), joint) for cluster in CLUSTERS[part]]
                for part, joint in zip(parts, reference, strict=True)
            ]
            errors = [flexion_deg(*joints_) - flexion_deg(*reference) for joints_ in itertools.product(*choices)]
            nearest = min(errors, key=lambda error: float(error.std()))
            found[f"{side}_{hinge}"] = (float(nearest.mean()), float(nearest.std()))
    return found


def _cluster(labels: tuple[str, ...], markers: np.ndarray, names: tuple[str, ...], side: str) -> np.ndarray:
    """Return the (F, n, 3) markers of a cluster."""
    return markers[:, [labels.index(name.format(s=side[0].upper())) for name in names]]


def _fixed(cluster: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Return where a (F, 3) joint would be that stayed at its mean in the frame of a (F, n, 3) cluster."""
    shape = cluster[:1]
    for _ in range(5):
        _, R, t = umeyama(np.broadcast_to(shape, cluster.shape), cluster)
        shape = (np.swapaxes(R, 1, 2)[:, None] @ (cluster - t[:, None])[..., None])[..., 0].mean(axis=0, keepdims=True)
    local = (np.swapaxes(R, 1, 2) @ (joint - t)[..., None])[..., 0]
    return (R @ local.mean(axis=0)[:, None])[..., 0] + t
