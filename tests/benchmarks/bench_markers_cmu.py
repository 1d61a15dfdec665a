"""41 optical markers of a real walk (CMU 02_01), fitted by plain least squares: pose, shape and marker offsets.

Distances of the body's joints to those of the recording's own skeleton, in mm, with nothing aligned. That skeleton is
itself an estimate with other joint centres: the "steady" figure takes out each joint's constant offset in the frame of
its bone and so shows the error of the motion alone. Needs ezc3d and the recordings kept beside the repository (or
MOCAP_SHARED_DATA).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.io.motions.bvh import read_bvh
from solver_backend.priors.sposer import load_sposer
from solver_backend.training.data.sources.marker_fit import fit_markers
from solver_backend.types import SMPL_JOINTS, MarkerCloud
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.recordings import ABSENT, recordings_folder

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


def run() -> list[Metric]:
    """Fit and compare."""
    take = read_take(recordings_folder())
    fitted = fit_markers(MarkerCloud(take.markers, 120.0, take.labels), load_body(), load_sposer())
    subject, frames, residual = fitted.subject, fitted.frames, fitted.residual_m
    skeleton = forward_kinematics(subject.body, subject.betas, frames.root, frames.local, frames.transl)
    distance, steady = {}, {}
    for name, reference in take.joints.items():
        j = SMPL_JOINTS.index(name)
        error = skeleton.joints[:, j] - reference
        bone = skeleton.G[:, subject.body.parents[j]]
        local = (np.swapaxes(bone, 1, 2) @ error[..., None])[..., 0]
        distance[name] = 1e3 * float(np.linalg.norm(error, axis=-1).mean())
        steady[name] = 1e3 * float(np.linalg.norm(local - local.mean(0), axis=-1).mean())
    return [
        Metric("mean_mm", float(np.mean([*distance.values()])), "mm"),
        Metric("steady_mean_mm", float(np.mean([*steady.values()])), "mm"),
        Metric("marker_residual_mm", 1e3 * float(residual.mean()), "mm"),
        *(Metric(f"{name}_mm", value, "mm", rel_tol=0.1) for name, value in distance.items()),
        *(Metric(f"{name}_steady_mm", value, "mm", rel_tol=0.1) for name, value in steady.items()),
    ]


def read_take(data: Path) -> Take:
    """Read markers and reference.

    Raises:
        BenchmarkSkipped: the recording or ezc3d is missing.
    """
    c3d, bvh = data / "markers" / "cmu_pairs" / "02_01.c3d", data / "bvh_samples" / "cmu_mb2_02_01.bvh"
    if not (c3d.is_file() and bvh.is_file()):
        raise BenchmarkSkipped("The recording is not here.", hint=ABSENT)
    try:
        import ezc3d
    except ImportError:
        raise BenchmarkSkipped("ezc3d is not installed.", hint="pip install ezc3d") from None
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
