"""Fit 41 optical markers of a real walk (CMU 02_01) by plain least squares: pose, shape and marker offsets.

Figures are distances in mm between the body's joints and the recording's own skeleton, without alignment. That skeleton
is also an estimate, with other joint centres. The "steady" figure removes each joint's constant offset in the frame of
its bone, and so shows only the error of the motion. Needs ezc3d and the recordings next to the repository (or
MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import SMPL_JOINTS, MarkerCloud
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.cmu_marker_take import read_take
from tests.support.recordings import ABSENT, recordings_folder
from training.data.sources.marker_takes import fit_markers


def run() -> list[Metric]:
    """Fit and compare."""
    try:
        take = read_take(recordings_folder())
    except (FileNotFoundError, ImportError) as missing:
        raise BenchmarkSkipped(str(missing), hint=ABSENT) from None
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
