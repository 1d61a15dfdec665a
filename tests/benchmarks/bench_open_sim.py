"""A real recording of four cameras compared with the recording tool's OpenSim result: knee and elbow flexion.

Inverse kinematics of a skeleton with its own joint axes, from triangulated and filtered points, is compared with the
angles hip-knee-ankle and shoulder-elbow-wrist of each method. Definitions differ by a constant, so the mean difference
and the remaining difference are given separately. The tool has two results (with and without marker augmentation).
Their difference shows the accuracy of the reference. Needs the recordings (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from solver_backend.io.load import load_capture
from solver_backend.types import Capture
from tests.benchmarks.comparison.methods import FILTER, OURS, PUBLISHED, Method
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.open_sim import flexion_deg, read_mot
from tests.support.recordings import ABSENT, BALANCING_TRIAL, recordings_folder

RESULTS = Path("multiview", "pose2sim", "S00_P00_SingleParticipant", "S00_P00_OpenSim")
STEM = "S00_P00_T01_BalancingTrial_filt_butterworth_0-100"
REFERENCES = ("LSTM", "body25b")
ANGLES = {
    "knee": (("hip", "knee", "ankle"), "knee_angle"),
    "elbow": (("shoulder", "elbow", "wrist"), "elbow_flex"),
}
"""Points of each hinge, and OpenSim's coordinate."""
Angles = dict[str, np.ndarray]


def run() -> list[Metric]:
    """Print the table. Return our figures relative to the augmented result."""
    found, references = measured()
    sys.stdout.write(table(found, references) + "\n")
    differences = compare(found["ours"], references[REFERENCES[0]])
    return [Metric(f"{angle}_deg", values[1], "°", rel_tol=0.15) for angle, values in differences.items()]


def measured() -> tuple[dict[str, Angles], dict[str, Angles]]:
    """Return the angles of every method and of both references.

    Raises:
        BenchmarkSkipped: the recording is missing.
    """
    data = recordings_folder()
    if not (data / BALANCING_TRIAL).is_dir():
        raise BenchmarkSkipped("The recording is not here.", hint=ABSENT)
    capture = load_capture(data / BALANCING_TRIAL)
    methods = {"ours": Method(OURS), PUBLISHED: Method(PUBLISHED), "MuVS": Method("MuVS"), FILTER: Method(FILTER)}
    found = {name: solved_angles(method, capture) for name, method in methods.items()}
    return found, {kind: reference_angles(data / RESULTS / f"{STEM}_{kind}.mot") for kind in REFERENCES}


def solved_angles(method: Method, capture: Capture) -> Angles:
    """Return (F,) flexion in degrees by angle and side, from the solved keypoints."""
    points = method.solver()(capture).keypoints3d
    names = capture.require_multiview()[1].joint_set.keypoints
    return {
        f"{side} {angle}": flexion_deg(*(points[:, names.index(f"{side}_{part}")] for part in parts))
        for angle, (parts, _) in ANGLES.items()
        for side in ("left", "right")
    }


def reference_angles(path: Path) -> Angles:
    """Return OpenSim's coordinates under the same names."""
    columns = read_mot(path)
    return {
        f"{side} {angle}": columns[f"{coordinate}_{side[0]}"]
        for angle, (_, coordinate) in ANGLES.items()
        for side in ("left", "right")
    }


def compare(found: Angles, reference: Angles) -> dict[str, tuple[float, float]]:
    """Return the mean absolute offset and the RMS around the offset in degrees for each angle, over both sides."""
    figures = {}
    for angle in ANGLES:
        pairs = [(found[name], reference[name]) for name in found if name.endswith(angle)]
        difference = [a[: len(b)] - b[: len(a)] for a, b in pairs]
        offset = float(np.mean([abs(d.mean()) for d in difference]))
        figures[angle] = (offset, float(np.sqrt(np.mean([np.var(d) for d in difference]))))
    return figures


def table(found: dict[str, Angles], references: dict[str, Angles]) -> str:
    """Return offsets and remaining differences of every method from both references, as text."""
    rows = {**found, f"OpenSim, {REFERENCES[1]}": references[REFERENCES[1]]}
    heads = [f"{angle} {figure} ({kind})" for kind in REFERENCES for angle in ANGLES for figure in ("offset", "rms")]
    lines = [f"{'':<28}" + "".join(f"{head:>24}" for head in heads)]
    for name, angles in rows.items():
        cells = [value for kind in REFERENCES for pair in compare(angles, references[kind]).values() for value in pair]
        lines.append(f"{name:<28}" + "".join(f"{cell:24.1f}" for cell in cells))
    return "\n".join(lines)
