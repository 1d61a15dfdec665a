"""Knee and elbow flexion of running, walking, squats and jumps, compared with OpenSim's from the same markers.

Some trials have two OpenSim results, one of them scaled by a person. Their difference shows OpenSim's accuracy.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.fitters import solve
from solver_backend.io.load import load_capture
from solver_backend.types import SMPL_JOINTS, Motion
from tests.benchmarks.marker_takes.takes import folder
from tests.support.open_sim import flexion_deg, read_mot

TRIALS: dict[str, tuple[str, str]] = {
    "running 3.5 m/s": ("Sprinter/run0350cms.trc", "Sprinter/run0350cms.mot"),
    "running 7 m/s": ("Sprinter/run0700cms.trc", "Sprinter/run0700cms.mot"),
    "walking": ("Subject4/MarkerData/walking1.trc", "Subject4/IK/walking1_ik.mot"),
    "squats": ("Subject4/MarkerData/squats1.trc", "Subject4/IK/squats1_ik.mot"),
    "drop jump": ("Subject4/MarkerData/DJ1.trc", "Subject4/IK/DJ1_ik.mot"),
}
MANUAL = "_manual_scaling_ik.mot"
"""Ending of the second result's file."""
HINGES = {"knee": ("hip", "knee", "ankle", "knee_angle"), "elbow": ("shoulder", "elbow", "wrist", "elbow_flex")}


def flexion_of(motion: Motion, side: str, parts: tuple[str, str, str]) -> np.ndarray:
    """Return the (F,) flexion of a hinge of the solved body in degrees, 0 when straight."""
    return flexion_deg(*(motion.joints[:, SMPL_JOINTS.index(f"{side}_{part}")] for part in parts))


def differences() -> dict[str, dict[str, tuple[float, float]]]:
    """Return the mean offset and the RMS around it in degrees for each trial and angle, over both sides."""
    root = folder() / "nimble"
    return {name: _trial(root / take, root / angles) for name, (take, angles) in TRIALS.items()}


def apart() -> dict[str, dict[str, float]]:
    """Return the RMS around the offset in degrees between two OpenSim results, for each trial that has both."""
    root, found = folder() / "nimble", {}
    for name, (_, angles) in TRIALS.items():
        again = root / angles.replace("_ik.mot", MANUAL)
        if again.is_file() and angles.endswith("_ik.mot"):
            found[name] = _between(read_mot(root / angles), read_mot(again))
    return found


def _between(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the RMS by angle, over both sides, at the common times of two results."""
    times = [np.round(columns["time"], 4) for columns in (one, other)]
    shared = [np.isin(mine, theirs) for mine, theirs in (times, times[::-1])]
    found = {}
    for angle, (*_, coordinate) in HINGES.items():
        names = [f"{coordinate}_{side}" for side in "lr"]
        offs = [one[name][shared[0]] - other[name][shared[1]] for name in names if name in one and name in other]
        found[angle] = float(np.sqrt(np.mean([off.var() for off in offs])))
    return found


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
                # The model chooses the sign of a coordinate.
                theirs, ours = np.abs(reference[name]), flexion_of(motion, side, tuple(parts))[frames]
                pairs.append(ours - theirs)
        if pairs:
            offset = float(np.mean([pair.mean() for pair in pairs]))
            found[angle] = (offset, float(np.sqrt(np.mean([pair.var() for pair in pairs]))))
    return found
