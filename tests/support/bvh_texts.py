"""BVH files of a known motion of our body: other rest poses, units, axes, orders of channels and names."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from solver_backend.body.body import Body
from solver_backend.body.kinematics import PosedSkeleton, forward_kinematics
from solver_backend.exchange.rigs.rest_frames import swing
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import author_motion

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # World (Z up) to a file's axes (Y up).
_DOWN = {16: (0, 0, -1), 17: (0, 0, 1), 1: (0, 0, 0.3), 2: (0, 0, -0.3)}
"""Axes by which arms hang and legs spread at rest."""


@dataclass(frozen=True)
class KnownMotion:
    """A motion of our body and its truth."""

    posed: PosedSkeleton
    rest: np.ndarray
    """(24, 3) joints at rest, Y up."""
    parents: tuple[int, ...]
    names: tuple[str, ...]
    fps: float


def known_motion(body: Body, betas: np.ndarray, frames: int = 90, fps: float = 30.0) -> KnownMotion:
    """Return the choreography on a body of a shape."""
    played = author_motion(body, betas, frames, fps)
    local = exp_so3(played.body_pose.reshape(frames, -1, 3))
    posed = forward_kinematics(body, betas, exp_so3(played.global_orient), local, played.transl)
    return KnownMotion(posed, body.rest_joints(betas), body.parents, body.layout.joints, fps)


_SPREAD = {
    "knee": 0.1, "ankle": 0.1, "elbow": 0.1, "wrist": 0.1, "hip": 0.12, "shoulder": 0.12, "collar": 0.1,
}  # fmt: skip
"""Largest change of a bone's length by its end, as a share. 0.06 elsewhere."""


def with_proportions(known: KnownMotion, seed: int) -> KnownMotion:
    """Return the motion on a skeleton of another size, with bones of other lengths, equal on both sides."""
    rng, parents, factors = np.random.default_rng(seed), known.parents, dict[str, float]()
    rest, joints, size = known.rest.copy(), known.posed.joints.copy(), rng.uniform(0.9, 1.1)
    rest[0], joints[:, 0] = size * rest[0], size * joints[:, 0]
    for j, (name, parent) in enumerate(zip(known.names, parents, strict=True)):
        if parent >= 0:
            part = name.rpartition("_")[2]
            spread = _SPREAD.get(part, 0.06)
            factor = factors.setdefault(part, size * (1 + rng.uniform(-spread, spread)))
            bone = factor * (known.rest[j] - known.rest[parent])
            rest[j], joints[:, j] = rest[parent] + bone, joints[:, parent] + known.posed.G[:, parent] @ bone
    return replace(known, rest=rest, posed=replace(known.posed, joints=joints))


def write_bvh(
    path: Path, known: KnownMotion, *, order: str = "ZXY", unit: float = 0.01, turn: np.ndarray = Y_UP,
    arms_down: float = 0.0, names: tuple[str, ...] | None = None, places: str = "", still_root: bool = False,
    along_x: bool = False,
) -> Path:  # fmt: skip
    """Write a motion as BVH.

    Args:
        path: the file.
        known: the motion.
        order: of the rotation channels.
        unit: metres of the file's unit.
        turn: rotation of the world to the file's axes.
        arms_down: radians by which the arms hang at rest.
        names: of the joints; the body's own if left out.
        places: position channels of all joints: ``offset`` for their offsets, ``shift`` for shifts that are added.
        along_x: all bones but those of hips and collars point along X at rest, as LAFAN1 and Bandai-Namco write them.
        still_root: the figure hangs from a root that never moves, and travels by its own position channels.
    """
    names = names or known.names
    count = len(names)
    B = np.tile(np.eye(3), (count, 1, 1))
    for j, parent in enumerate(known.parents):
        own = exp_so3(arms_down * np.array(_DOWN.get(j, (0, 0, 0)), float))
        B[j] = own if parent < 0 else B[parent] @ own
    if along_x:
        B = _along_x(known)
    offsets = np.zeros((count, 3))
    for j, parent in enumerate(known.parents):
        if parent >= 0:
            offsets[j] = B[parent] @ (known.rest[j] - known.rest[parent]) / unit
    G = turn @ known.posed.G[:, :count] @ B.swapaxes(1, 2)
    local = G.copy()
    for j, parent in enumerate(known.parents):
        if parent >= 0:
            local[:, j] = G[:, parent].swapaxes(1, 2) @ G[:, j]
    root = known.posed.joints[:, 0] @ turn.T / unit
    # Depth first, as the brackets have it: values follow the order in which joints are written.
    lines, columns = ["HIERARCHY"], []
    _write_joint(lines, columns, names, known.parents, offsets, order, 0, "", bool(places))
    angles = np.stack([Rotation.from_matrix(local[:, j]).as_euler(order, degrees=True) for j in columns], axis=1)
    values = np.concatenate([root, angles.reshape(len(root), -1)], axis=1)
    if places:
        shifts = np.tile(offsets[columns] if places == "offset" else 0.0 * offsets[columns], (len(root), 1, 1))
        shifts[:, 0] = root
        values = np.concatenate([shifts, angles], axis=-1).reshape(len(root), -1)
    if still_root:
        channels = "6 Xposition Yposition Zposition " + " ".join(f"{axis}rotation" for axis in order)
        lines[1:4] = [f"JOINT {names[0]}", "{", "OFFSET 0.0 427.0 0.0"]
        lines = [lines[0], "ROOT joint_Root", "{", "OFFSET 0 0 0", f"CHANNELS {channels}", *lines[1:], "}"]
        values = np.concatenate([np.zeros((len(values), 6)), values], axis=1)
    lines += ["MOTION", f"Frames: {len(values)}", f"Frame Time: {1 / known.fps:.7f}"]
    lines += [" ".join(f"{value:.6f}" for value in row) for row in values]
    path.write_text("\n".join(lines) + "\n")
    return path


def _along_x(known: KnownMotion) -> np.ndarray:
    """Return the rotations (J, 3, 3) that turn the bone from each joint to its main child from rest to X."""
    turns = np.empty((len(known.parents), 3, 3))
    for j, parent in enumerate(known.parents):
        below = [known.rest[c] - known.rest[j] for c, above in enumerate(known.parents) if above == j]
        way = max(below, key=lambda w: w[1] if len(below) > 2 else np.linalg.norm(w)) if below else None
        turns[j] = swing(way, np.eye(3)[0]) if way is not None else turns[parent]
    return turns


def _write_joint(
    lines: list[str], columns: list[int], names: tuple[str, ...], parents: tuple[int, ...], offsets: np.ndarray,
    order: str, joint: int, indent: str, placed: bool = False,
) -> None:  # fmt: skip
    columns.append(joint)
    kind = "ROOT" if parents[joint] < 0 else "JOINT"
    turns = " ".join(f"{axis}rotation" for axis in order)
    places = "6 Xposition Yposition Zposition" if kind == "ROOT" or placed else "3"
    lines += [f"{indent}{kind} {names[joint]}", f"{indent}{{"]
    lines.append(f"{indent} OFFSET " + " ".join(f"{value:.6f}" for value in offsets[joint]))
    lines.append(f"{indent} CHANNELS {places} {turns}")
    below = [j for j, parent in enumerate(parents) if parent == joint]
    for child in below:
        _write_joint(lines, columns, names, parents, offsets, order, child, indent + " ", placed)
    if not below:
        lines += [f"{indent} End Site", f"{indent} {{", f"{indent}  OFFSET 0 0 0", f"{indent} }}"]
    lines.append(f"{indent}}}")
