"""How joint angles and steps of solved recordings agree with other programs and with force plates.

Run ``python -m tests.biomechanics.agreement`` with ``MOCAP_SHARED_DATA``. It prints the root mean square difference of
each take, its mean (the constant part, which follows from the definition of the joint) and the deviation around it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.biomechanics.gait import find_gait
from solver_backend.biomechanics.joint_angles import isb_angles
from solver_backend.biomechanics.open_sim import coordinates, virtual_markers
from solver_backend.biomechanics.segments import posed_segments
from solver_backend.body.body import load_body
from solver_backend.fitters.pipeline import solve
from solver_backend.io.load import load_capture
from solver_backend.types import FLAG_UNSEEN, Motion
from tests.support.open_sim import read_mot
from tests.support.recordings import recordings_folder

SAMPLES = Path("markers", "btkdata", "Input", "C3DSamples")
PIG = {
    "PiG_Motion-FlatFoot-Full": SAMPLES / "PiG" / "PiG_Motion-FlatFoot-Full.c3d",
    "PiG_Motion-FlatFoot-Hole": SAMPLES / "PiG" / "PiG_Motion-FlatFoot-Hole.c3d",
    "PiG_Motion-FlatFoot-One": SAMPLES / "PiG" / "PiG_Motion-FlatFoot-One.c3d",
    "PiG_Motion3_FF": SAMPLES / "PiG" / "PiG_Motion3_FF.c3d",
    "PlugInC3D": SAMPLES / "c3d.org" / "sample09" / "PlugInC3D.c3d",
    "FunctionalWalk": SAMPLES / "others" / "FunctionalWalk.c3d",
    "Gait": SAMPLES / "others" / "Gait.c3d",
}
"""Takes over force plates. Gait has no angles."""
TUNED = ("PiG_Motion-FlatFoot-Hole", "PiG_Motion3_FF")  # Takes on which the steps' constants were chosen.
SUBJECT4 = Path("markers", "nimble", "Subject4")
IK = ("walking1", "walkingTO1", "squats1", "STS1")
PIG_ANGLES = {
    "HipAngles": ("hip_flexion", "hip_adduction", "hip_internal_rotation"),
    "KneeAngles": ("knee_flexion", "knee_adduction", "knee_internal_rotation"),
    "AnkleAngles": ("ankle_dorsiflexion",), "ElbowAngles": ("elbow_flexion",),
}  # fmt: skip
Difference = tuple[str, float, float, float]  # Angle, root mean square, mean and deviation in degrees.


def plug_in_gait(motion: Motion, path: Path) -> Iterator[Difference]:
    """Yield the differences from the angles that a file keeps, over the frames that both have."""
    import ezc3d

    file = ezc3d.c3d(str(path))
    labels, points = file["parameters"]["POINT"]["LABELS"]["value"], file["data"]["points"][:3]
    angles = isb_angles(posed_segments(motion, load_body()))
    for label, names in PIG_ANGLES.items():
        for side in ("left", "right"):
            found = [k for k, name in enumerate(labels) if name.endswith(side[0].upper() + label)]
            for row, name in enumerate(names if found else ()):
                theirs, ours = points[:, found[0]], angles.column(f"{side}_{name}")
                kept = np.isfinite(theirs).all(axis=0) & (np.abs(theirs).sum(axis=0) > 0) & seen(motion)
                if kept.any():
                    yield difference(f"{side}_{name}", (ours - theirs[row])[kept])


def inverse_kinematics(motion: Motion, path: Path) -> Iterator[Difference]:
    """Yield the differences from OpenSim's coordinates of a motion file."""
    theirs, ours = read_mot(path), coordinates(posed_segments(motion, load_body()))
    for k, name in enumerate(ours.names):
        if name in theirs and name not in ("pelvis_tx", "pelvis_ty", "pelvis_tz"):
            count = min(len(theirs[name]), motion.num_frames)
            yield difference(name, (ours.values[:count, k] - theirs[name][:count] + 180.0) % 360.0 - 180.0)


def difference(name: str, off: np.ndarray) -> Difference:
    """Return the figures of (F,) differences."""
    return name, float(np.sqrt((off**2).mean())), float(off.mean()), float(off.std())


def seen(motion: Motion) -> np.ndarray:
    """Return (F,) bool: the frame is not interpolated."""
    return np.ones(motion.num_frames, bool) if motion.flags is None else motion.flags & FLAG_UNSEEN == 0


def plate_events(path: Path) -> list[tuple[float, str]]:
    """Return time and name of every crossing of 20 N of a file's force plates."""
    import ezc3d

    file: Any = ezc3d.c3d(str(path), extract_forceplat_data=True)
    rate, found = file["header"]["analogs"]["frame_rate"], []
    for plate in file["data"]["platform"]:
        load = np.abs(plate["force"][2])
        edges = np.flatnonzero(np.diff(np.r_[0, load > 20.0, 0]))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            if last - first > 0.15 * rate and load[first:last].max() > 150.0 and first > 0 and last < len(load):
                found += [(first / rate, "Foot Strike"), (last / rate, "Foot Off")]
    return found


def step_errors(motion: Motion, path: Path) -> list[tuple[str, float]]:
    """Return name and seconds from each event of the force plates to the nearest step of this name."""
    posed = posed_segments(motion, load_body())
    events = find_gait(posed, virtual_markers(motion, load_body(), posed), motion.flags).events()
    return [(name, min(abs(t - time) for t, _, n in events if n == name)) for time, name in plate_events(path)]


def main() -> int:
    """Print all tables."""
    folder, errors = recordings_folder(), {name: [] for name in ("Foot Strike", "Foot Off")}
    for take, where in PIG.items():
        motion = solve(load_capture(folder / where)).motion
        _print(take, plug_in_gait(motion, folder / where))
        found = step_errors(motion, folder / where)
        sys.stdout.write(f"  steps, ms: {[f'{name} {1000 * off:.0f}' for name, off in found]}\n")
        for name, off in found:
            errors[name] += [off] if take not in TUNED else []
    for name, offs in errors.items():
        sys.stdout.write(f"{name}, takes not tuned on: median {1000 * np.median(offs):.1f} ms of {len(offs)}\n")
    for take in IK:
        motion = solve(load_capture(folder / SUBJECT4 / "MarkerData" / f"{take}.trc")).motion
        _print(take, inverse_kinematics(motion, folder / SUBJECT4 / "IK" / f"{take}_ik.mot"))
    return 0


def _print(take: str, differences: Iterator[Difference]) -> None:
    sys.stdout.write(f"{take}\n")
    for name, rms, mean, deviation in differences:
        sys.stdout.write(f"  {name:30s} rms {rms:5.1f}  mean {mean:6.1f}  deviation {deviation:5.1f}\n")


if __name__ == "__main__":
    raise SystemExit(main())
