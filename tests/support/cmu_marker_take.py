"""CMU 02_01: 41 markers of a real walk and the joints of the recording's own skeleton, in the same frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.io.motions.bvh import read_bvh

_METRES_PER_UNIT, _THORAX_M, _WRIST_BONE = 0.0564444, 0.119, 0.5
"""Bones that this conversion of the skeleton lacks: the thorax's, and the wrist's, half as long as the radius's."""
_REFERENCE = {
    "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand",
}  # fmt: skip


@dataclass(frozen=True)
class Take:
    """Markers and reference joints of the same frames, metres, Z up."""

    labels: tuple[str, ...]
    markers: np.ndarray
    """(F, L, 3)."""
    joints: dict[str, np.ndarray]
    """(F, 3) by SMPL's joint name."""


def read_take(data: Path) -> Take:
    """Read markers and reference.

    Raises:
        FileNotFoundError, ImportError: the recording or ezc3d is missing.
    """
    c3d, bvh = data / "markers" / "cmu_pairs" / "02_01.c3d", data / "bvh_samples" / "cmu_mb2_02_01.bvh"
    if not (c3d.is_file() and bvh.is_file()):
        raise FileNotFoundError("The recording is not here.")
    import ezc3d

    content: Any = ezc3d.c3d(str(c3d))
    labels = tuple(label.split(":")[-1] for label in content["parameters"]["POINT"]["LABELS"]["value"])
    markers = 1e-3 * np.moveaxis(content["data"]["points"][:3], 0, -1).swapaxes(0, 1)
    clip = read_bvh(bvh, metres_per_unit=_METRES_PER_UNIT)
    offsets = clip.offsets.copy()
    for joint in ("Neck", "LeftShoulder", "RightShoulder"):
        offsets[clip.names.index(joint)] = (0.0, _THORAX_M, 0.0)
    positions = replace(clip, offsets=offsets, translations=None).positions()[1 : len(markers) + 1]
    joints = {
        f"{side}_{ours}": positions[:, clip.names.index(side.capitalize() + theirs)]
        for ours, theirs in _REFERENCE.items()
        for side in ("left", "right")
    }
    for side in ("left", "right"):
        elbow, hand = joints[f"{side}_elbow"], joints[f"{side}_wrist"]
        joints[f"{side}_wrist"] = hand + _WRIST_BONE * (hand - elbow)
    # Both have Z up; the skeleton's file has its axes a quarter turn about it.
    return Take(labels, np.stack([markers[..., 1], -markers[..., 0], markers[..., 2]], -1), joints)
