"""Limit for rigid bones: the joints of a recording's skeleton in the frames of its markers.

A joint of a rigid body is a fixed point of both adjacent bones. A marker cluster on a bone gives the bone's frame
without any model. If a reference joint moves in both adjacent frames, no skeleton with these markers can match it.
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
"""Markers of the adjacent bones of each joint. {s} is the side."""
HINGES = {"knee": ("hip", "knee", "ankle"), "elbow": ("shoulder", "elbow", "wrist")}
"""Joints that define a hinge's flexion."""


def motion_in_bones(labels: tuple[str, ...], markers: np.ndarray, joints: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the mean movement in millimetres of each reference joint in the frame of its steadiest bone."""
    found = {}
    for name, positions in joints.items():
        side, _, joint = name.partition("_")
        carried = [_fixed(_cluster(labels, markers, cluster, side), positions) for cluster in CLUSTERS[joint]]
        found[name] = 1000 * min(float(np.linalg.norm(where - positions, axis=-1).mean()) for where in carried)
    return found


def flexion_in_bones(
    labels: tuple[str, ...], markers: np.ndarray, joints: dict[str, np.ndarray]
) -> dict[str, tuple[float, float]]:
    """Return the error of each hinge's angle if each joint is fixed in one of its bones.

    It has the offset and the RMS around it in degrees for the best choice of bones, by ``left_knee`` and so on.
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
    """Return the (F, 3) joint positions if the joint kept its mean position in the frame of an (F, n, 3) cluster."""
    shape = cluster[:1]
    for _ in range(5):
        _, R, t = umeyama(np.broadcast_to(shape, cluster.shape), cluster)
        shape = (np.swapaxes(R, 1, 2)[:, None] @ (cluster - t[:, None])[..., None])[..., 0].mean(axis=0, keepdims=True)
    local = (np.swapaxes(R, 1, 2) @ (joint - t)[..., None])[..., 0]
    return (R @ local.mean(axis=0)[:, None])[..., 0] + t
