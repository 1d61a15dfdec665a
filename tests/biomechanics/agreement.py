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

from solver_backend.biomechanics.gait import find_gait, in_ground
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
MAKERS = Path("markers", "ezc3d_momentum", "resources", "manufacture")
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
STEPS = PIG | {
    "type-2a": SAMPLES / "c3d.org" / "sample10" / "type-2a.c3d",
    "MAC": MAKERS / "manufacture_test_motion_analysis_corporation.c3d",
    "walking2": Path("markers", "opensim", "walking2.c3d"),
    "walking5": Path("markers", "opensim", "walking5.c3d"),
}  # fmt: skip
"""All walks over force plates. ``PlugInC3D``, ``type-2a`` and ``MAC`` have 60 Hz."""
TUNED = (
    "PiG_Motion-FlatFoot-Hole",
    "PiG_Motion3_FF",
    "type-2a",
    "MAC",
)  # Takes on which the steps' constants were chosen.
GOAL = (
    "PiG_Motion-FlatFoot-Full",
    "PiG_Motion-FlatFoot-Hole",
    "PiG_Motion-FlatFoot-One",
    "PiG_Motion3_FF",
    "PlugInC3D",
)
HEEL_M = 0.1  # Length of the heel in front of its marker, at most.
NEAR_S, FAR_S = 0.05, 0.3  # A step within NEAR_S of a plate's event is right. Others within FAR_S are wrong.
Steps = dict[str, list[tuple[float, str]]]  # Times and sides, by name.
SUBJECT4 = Path("markers", "nimble", "Subject4")
SCALINGS = ("", "_manual_scaling")  # OpenSim's angles with models scaled by AddBiomechanics and by hand.
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
    """Return time and name of every crossing of 20 N of a file's force plates by a foot that is on the plate alone.

    A crossing with a centre of pressure outside the plate, after 20 ms of load, belongs to a foot on the plate's edge.
    So does a strike whose recorded heel marker is more than ``HEEL_M`` beside the plate.
    """
    import ezc3d

    file: Any = ezc3d.c3d(str(path), extract_forceplat_data=True)
    rate, found = file["header"]["analogs"]["frame_rate"], []
    labels, unit = file["parameters"]["POINT"]["LABELS"]["value"], file["parameters"]["POINT"]["UNITS"]["value"][0]
    heels = file["data"]["points"][:2, [k for k, label in enumerate(labels) if label.endswith(("HEE", "CAL"))]]
    beside = HEEL_M * {"mm": 1000.0, "m": 1.0}[unit]
    for plate in file["data"]["platform"]:
        load, wait = np.abs(plate["force"][2]), round(0.02 * rate)
        load = load - np.median(load[load < 20.0])
        low, high = (side(plate["corners"][:2], axis=1) for side in (np.min, np.max))
        edges = np.flatnonzero(np.diff(np.r_[0, load > 20.0, 0])).reshape(-1, 2)
        for first, last in edges:
            if last - first > 0.15 * rate and load[first:last].max() > 150.0:
                for frame, loaded, name in ((first, first + wait, "Foot Strike"), (last, last - wait, "Foot Off")):
                    place = plate["center_of_pressure"][:2, loaded]
                    heel = heels[..., int(frame / rate * file["header"]["points"]["frame_rate"])].T
                    off = np.maximum(low - heel, heel - high).max(axis=1).min() if name == "Foot Strike" else 0.0
                    if 0 < frame < len(load) and (low < place).all() and (place < high).all() and off < beside:
                        found.append((frame / rate, name))
    return found


def steps(motion: Motion) -> Steps:
    """Return our steps."""
    posed, found = posed_segments(motion, load_body()), {"Foot Strike": [], "Foot Off": []}
    for time, side, name in find_gait(posed, virtual_markers(motion, load_body(), posed), motion.flags).events():
        found[name].append((time, side))
    return found


def published_steps(motion: Motion) -> dict[str, Steps]:
    """Return the steps of the same solved feet by Zeni et al. 2008 and Ghoussayni et al. 2004 (0.5 m/s)."""
    posed, fps = posed_segments(motion, load_body()), motion.fps
    cloud = virtual_markers(motion, load_body(), posed)
    forward = posed.rotations["pelvis"][:, :, 0] * (1.0, 0.0, 1.0)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    pelvis = posed.joints["pelvis"] @ posed.ground.T
    found: dict[str, Steps] = {name: {"Foot Strike": [], "Foot Off": []} for name in ("Zeni", "Ghoussayni")}
    for side in "RL":
        heel, toe, fifth = (in_ground(cloud.positions[:, cloud.labels.index(side + p)]) for p in ("CAL", "TOE", "MT5"))
        toe = 0.5 * (toe + fifth)
        for name, point, sign in (("Foot Strike", heel, 1.0), ("Foot Off", toe, -1.0)):
            front = sign * ((point - pelvis) * forward).sum(axis=1)
            turns = np.flatnonzero((front[1:-1] >= front[:-2]) & (front[1:-1] > front[2:])) + 1
            found["Zeni"][name] += [(k / fps, side) for k in turns if front[k] > 0.1]
            speed = np.gradient(point, 1.0 / fps, axis=0)
            slow = sign * (np.hypot((speed * forward).sum(axis=1), speed[:, 1]) - 0.5) < 0.0
            found["Ghoussayni"][name] += [(k / fps, side) for k in np.flatnonzero(slow[1:] & ~slow[:-1]) + 1]
    return found


def step_errors(found: Steps, path: Path) -> list[tuple[str, float, int]]:
    """Return for each event of the plates its name, the seconds to the nearest step, and the wrong steps near it."""
    errors = []
    for time, name in plate_events(path):
        nearest, side = min(((t - time, side) for t, side in found[name]), key=lambda step: abs(step[0]))
        near = sum(abs(t - time) < FAR_S for t, of in found[name] if of == side)
        errors.append((name, nearest, near - (abs(nearest) <= NEAR_S)))
    return errors


def print_steps() -> None:
    """Print the differences from force plates of our steps and of published methods."""
    folder, rows = recordings_folder(), {}
    for take, where in STEPS.items():
        motion = solve(load_capture(folder / where)).motion
        for method, found in {"ours": steps(motion), **published_steps(motion)}.items():
            rows |= {(method, take, k): row for k, row in enumerate(step_errors(found, folder / where))}
            text = [
                f"{name[5:]} {1000 * off:.0f}" for (m, t, _), (name, off, _) in rows.items() if (m, t) == (method, take)
            ]
            sys.stdout.write(f"{take:26s} {method:10s} ms: {', '.join(text)}\n")
    for method in ("ours", "Zeni", "Ghoussayni"):
        for title, takes in (
            ("goal", GOAL),
            ("tuned", TUNED),
            ("held out", set(STEPS) - set(TUNED)),
            ("PlugInC3D", ("PlugInC3D",)),
        ):
            own = [row for (m, take, _), row in rows.items() if m == method and take in takes]
            right, wrong = sum(abs(off) <= NEAR_S for _, off, _ in own), sum(extra for *_, extra in own)
            medians = [
                1000 * np.median([abs(off) for n, off, _ in own if n == name]) for name in ("Foot Strike", "Foot Off")
            ]
            sys.stdout.write(
                f"{method:10s} {title:9s} strike {medians[0]:.1f} ms, off {medians[1]:.1f} ms, both "
                f"{1000 * np.median([abs(off) for _, off, _ in own]):.1f} ms of {len(own)}, "
                f"F1 {2 * right / (len(own) + right + wrong):.3f}\n"
            )


def main() -> int:
    """Print all tables."""
    folder = recordings_folder()
    print_steps()
    for take, where in PIG.items():
        _print(take, plug_in_gait(solve(load_capture(folder / where)).motion, folder / where))
    for take in IK:
        motion = solve(load_capture(folder / SUBJECT4 / "MarkerData" / f"{take}.trc")).motion
        paths = [folder / SUBJECT4 / "IK" / f"{take}{scaling}_ik.mot" for scaling in SCALINGS]
        for path in paths:
            _print(path.stem, inverse_kinematics(motion, path))
        first, other = map(read_mot, paths)
        shared = [name for name in first if name in other and name[:8] not in ("time", "pelvis_t")]
        _print(f"{take}, OpenSim by both scalings", (difference(name, first[name] - other[name]) for name in shared))
    return 0


def _print(take: str, differences: Iterator[Difference]) -> None:
    sys.stdout.write(f"{take}\n")
    for name, rms, mean, deviation in differences:
        sys.stdout.write(f"  {name:30s} rms {rms:5.1f}  mean {mean:6.1f}  deviation {deviation:5.1f}\n")


if __name__ == "__main__":
    raise SystemExit(main())
