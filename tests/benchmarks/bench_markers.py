"""Optical markers: filled gaps, a corrupted take, and joints compared with a recording's own skeleton.

Gaps: 15 % of the real samples are hidden in bursts of half a second. A rigid cluster of neighbours fills them, as is
common practice, and so does the body with the marker's position among its neighbours, also for four other laboratories
with two further seeds. Corruption: 4 mm of noise, 10 % missing, 3 ghosts and 6 exchanged labels. "steady" skeleton
joints lack each joint's constant offset in its bone. For comparison, their movement in the frames of the recording's
markers is given, which is a lower limit for skeletons of rigid bones. Angles are compared with OpenSim's from the same
markers. Needs the recordings (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import sys
from functools import partial

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.fitters import solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import SMPL_JOINTS, Capture, MarkerCloud, Motion
from tests.benchmarks.kept_parts import kept, kept_metrics
from tests.benchmarks.marker_takes import coverage, joint_angles
from tests.benchmarks.marker_takes.held_out import held_out, pooled, report
from tests.benchmarks.marker_takes.rigid_bones import HINGES, flexion_in_bones, motion_in_bones
from tests.benchmarks.marker_takes.spoiled import moved_mm
from tests.benchmarks.marker_takes.takes import cmu, folder, held_out_takes, takes_of_other_labs, ui_prmd
from tests.benchmarks.metric import Metric
from tests.support.cmu_marker_take import read_take
from tests.support.open_sim import flexion_deg
from tests.support.recordings import recordings_folder


def run() -> list[Metric]:
    """Measure and print the tables. Each part is kept, so that an interrupted run resumes."""
    folder()
    parts = {
        "held out": _held_out, "other labs": _other_labs, "spoiled": _spoiled,
        "skeleton": _skeleton, "angles": _angles, "coverage": _coverage,
    }  # fmt: skip
    found = (kept_metrics("tests.benchmarks.bench_markers", name, measure) for name, measure in parts.items())
    return [metric for metrics in found for metric in metrics]


def _held_out() -> list[Metric]:
    found = {layout: pooled([held_out(take) for take in takes]) for layout, takes in held_out_takes().items()}
    text, metrics = report(found)
    sys.stdout.write(text + "\n")
    return metrics


def _other_labs() -> list[Metric]:
    """Return the mean filling errors of our method and of the rigid method, over takes and two further seeds."""
    takes, name = takes_of_other_labs(), "tests.benchmarks.bench_markers"
    shares = [
        kept(name, f"other labs {number} seed {seed}", partial(_errors_mm, take, seed), quiet=True)
        for seed in (1, 2)
        for number, take in enumerate(takes)
    ]
    ours, rigid = np.array(shares).T
    return [
        Metric("other_labs_mean_share", float((ours / rigid).mean()), "", rel_tol=0.1),
        Metric("other_labs_worst_share", float((ours / rigid).max()), "", rel_tol=0.15),
        Metric("other_labs_mm", float(ours.mean()), "mm", rel_tol=0.1),
    ]


def _errors_mm(take: MarkerCloud, seed: int) -> list[float]:
    found = held_out(take, seed)
    return [found.figures(which)[0] for which in ("ours", "rigid")]


def _spoiled() -> list[Metric]:
    takes = {"cmu": cmu("02_01"), "plug_in_gait": ui_prmd(folder() / "ui_prmd" / "m03_s05_e02.npz")}
    return [
        Metric(f"spoiled_{name}_mm", float(moved_mm(take).mean()), "mm", rel_tol=0.2) for name, take in takes.items()
    ]


def _skeleton() -> list[Metric]:
    take = read_take(recordings_folder())
    motion = solve(Capture("02_01", markers=MarkerCloud(take.markers, 120.0, take.labels))).motion
    steady = _steady_mm(motion, take.joints)
    bones = motion_in_bones(take.labels, take.markers, take.joints)
    for name in steady:
        sys.stdout.write(
            f"  {name:<16} steady {steady[name]:6.1f} mm   in the markers' own frames {bones[name]:6.1f}\n"
        )
    hinges = flexion_in_bones(take.labels, take.markers, take.joints)
    angles: dict[str, list[float]] = {hinge: [] for hinge in HINGES}
    for name, (_, floor) in hinges.items():
        side, _, hinge = name.partition("_")
        parts = [f"{side}_{part}" for part in HINGES[hinge]]
        ours = flexion_deg(*(motion.joints[:, SMPL_JOINTS.index(part)] for part in parts))
        off = ours - flexion_deg(*(take.joints[part] for part in parts))
        angles[hinge].append(float(off.var()))
        sys.stdout.write(f"  {name:<16} RMS {off.std():4.1f}°   in the markers' own frames {floor:4.1f}°\n")
    return [
        Metric("skeleton_steady_mm", float(np.mean([*steady.values()])), "mm"),
        Metric("skeleton_in_markers_mm", float(np.mean([*bones.values()])), "mm"),
        *(Metric(f"skeleton_{hinge}_deg", float(np.mean(found) ** 0.5), "°") for hinge, found in angles.items()),
    ]


def _steady_mm(motion: Motion, joints: dict[str, np.ndarray]) -> dict[str, float]:
    """Return each joint's mean distance to the reference in mm, without its constant offset in its parent's frame."""
    body, count = load_body(), motion.num_frames
    local = exp_so3(motion.body_pose.reshape(count, -1, 3))[:, :21]
    skeleton = forward_kinematics(body, motion.betas, exp_so3(motion.global_orient), local, motion.transl)
    steady = {}
    for name, reference in joints.items():
        j = SMPL_JOINTS.index(name)
        bone = skeleton.G[:, body.parents[j]]
        error = (np.swapaxes(bone, 1, 2) @ (skeleton.joints[:, j] - reference)[..., None])[..., 0]
        steady[name] = 1000 * float(np.linalg.norm(error - error.mean(0), axis=-1).mean())
    return steady


def _angles() -> list[Metric]:
    metrics = []
    for trial, angles in joint_angles.differences().items():
        for angle, (offset, rms) in angles.items():
            sys.stdout.write(f"  {trial:<18} {angle:<6} offset {offset:+6.1f}°  RMS around it {rms:5.1f}°\n")
            metrics.append(Metric(f"{trial} {angle}".replace(" ", "_").replace("/", "_"), rms, "°", rel_tol=0.15))
    for trial, angles in joint_angles.apart().items():
        told = ", ".join(f"{angle} {rms:.1f}°" for angle, rms in angles.items())
        sys.stdout.write(f"  {trial:<18} OpenSim's two results are apart by {told} RMS around the offset\n")
    return metrics


def _coverage() -> list[Metric]:
    return [Metric(key, value, "%", "higher", abs_tol=4.0) for key, value in coverage.held().items()]
