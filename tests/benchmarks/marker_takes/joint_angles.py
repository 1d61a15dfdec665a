"""Knee and elbow flexion of running, walking, squats and jumps beside OpenSim's angles from the same markers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.fitters import solve
from solver_backend.io.load import load_capture
from solver_backend.types import SMPL_JOINTS, Motion
from tests.benchmarks.marker_takes.takes import folder
from tests.benchmarks.open_sim import flexion_deg, read_mot

TRIALS: dict[str, tuple[str, str]] = {
    "running 3.5 m/s": ("Sprinter/run0350cms.trc", "Sprinter/run0350cms.mot"),
    "running 7 m/s": ("Sprinter/run0700cms.trc", "Sprinter/run0700cms.mot"),
    "walking": ("Subject4/MarkerData/walking1.trc", "Subject4/IK/walking1_ik.mot"),
    "squats": ("Subject4/MarkerData/squats1.trc", "Subject4/IK/squats1_ik.mot"),
    "drop jump": ("Subject4/MarkerData/DJ1.trc", "Subject4/IK/DJ1_ik.mot"),
}
BOUNDS_DEG = {"knee": 4.0, "elbow": 6.0}
HINGES = {"knee": ("hip", "knee", "ankle", "knee_angle"), "elbow": ("shoulder", "elbow", "wrist", "elbow_flex")}


def flexion_of(motion: Motion, side: str, parts: tuple[str, str, str]) -> np.ndarray:
    """Return (F,) degrees by which a hinge of the solved body is bent, 0 when straight."""
    return flexion_deg(*(motion.joints[:, SMPL_JOINTS.index(f"{side}_{part}")] for part in parts))


def differences() -> dict[str, dict[str, tuple[float, float]]]:
    """Return for each trial and angle, over both sides, the mean offset and the RMS around it, degrees."""
    root = folder() / "nimble"
    return {name: _trial(root / take, root / angles) for name, (take, angles) in TRIALS.items()}


def _trial(take: Path, angles: Path) -> dict[str, tuple[float, float]]:
    capture = load_capture(take)
    assert capture.markers is not None
    motion, reference = solve(capture).motion, read_mot(angles)
    times = reference["time"]
    frames = np.clip(np.round((times - times[0]) * motion.fps).astype(int), 0, motion.num_frames - 1)
    found = {}
    for angle, (*parts, coordinate) in HINGES.items():
        pairs = []
        for side in ("left", "right"):
            name = f"{coordinate}_{side[0]}"
            if name in reference:
                # The sign of a coordinate is the model's choice.
                theirs, ours = np.abs(reference[name]), flexion_of(motion, side, tuple(parts))[frames]
                pairs.append(ours - theirs)
        if pairs:
            offset = float(np.mean([pair.mean() for pair in pairs]))
            found[angle] = (offset, float(np.sqrt(np.mean([pair.var() for pair in pairs]))))
    return found
