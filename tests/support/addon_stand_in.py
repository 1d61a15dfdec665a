"""A crude body, a motion and a capture for the add-on's tests: boxes on bones, written with the product's keys."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from blender_addon._exchange.capture_file import CaptureFile, read_capture
from blender_addon._exchange.lens import distort, pixels
from blender_addon._exchange.motion_file import MotionFile, read_motion
from blender_addon.body.body_file import BodyFile, pose_joints, read_body
from blender_addon.conventions.skeleton import NUM_JOINTS, PARENTS, SMPL

_REST = np.array([
    [0.00, 0.93, 0.00], [0.09, 0.85, 0.00], [-0.09, 0.85, 0.00], [0.00, 1.05, -0.02], [0.10, 0.47, 0.01],
    [-0.10, 0.47, 0.01], [0.00, 1.18, -0.02], [0.10, 0.08, -0.03], [-0.10, 0.08, -0.03], [0.00, 1.24, -0.01],
    [0.11, 0.02, 0.09], [-0.11, 0.02, 0.09], [0.00, 1.44, -0.02], [0.07, 1.36, -0.01], [-0.07, 1.36, -0.01],
    [0.00, 1.53, 0.02], [0.17, 1.39, -0.02], [-0.17, 1.39, -0.02], [0.43, 1.39, -0.03], [-0.43, 1.39, -0.03],
    [0.68, 1.39, -0.03], [-0.68, 1.39, -0.03], [0.76, 1.39, -0.03], [-0.76, 1.39, -0.03],
])  # fmt: skip
_LEAF_END = {10: (0, 0, 0.12), 11: (0, 0, 0.12), 15: (0, 0.18, 0), 22: (0.09, 0, 0), 23: (-0.09, 0, 0)}
_HALF_WIDTH = {0: 0.13, 3: 0.12, 6: 0.13, 9: 0.14, 12: 0.055, 15: 0.085, 1: 0.075, 2: 0.075, 10: 0.04, 11: 0.04}
_SIDES = 8


@dataclass(frozen=True)
class Files:
    """Stand-in files and what they hold."""

    folder: Path
    body_path: Path
    motion_path: Path
    capture_path: Path
    body: BodyFile
    motion: MotionFile
    capture: CaptureFile


def write_files(folder: Path) -> Files:
    """Write a body, a motion and a capture of it."""
    body = write_body(folder / "body.npz")
    arrays = motion_arrays(body)
    np.savez(folder / "walk.npz", **arrays)
    np.savez(folder / "capture.npz", **capture_arrays(arrays["joints"]))
    return Files(
        folder=folder,
        body_path=body,
        motion_path=folder / "walk.npz",
        capture_path=folder / "capture.npz",
        body=read_body(body),
        motion=read_motion(folder / "walk.npz"),
        capture=read_capture(folder / "capture.npz"),
    )


def write_body(path: Path, *, body_id: str = "stand_in") -> Path:
    """Write a body of tapered tubes, one a bone, with shape directions, correctives, texture and materials."""
    vertices, faces, weights, materials = [], [], [], []
    regressor = np.zeros((NUM_JOINTS, 3 * _SIDES * NUM_JOINTS))
    for j in range(NUM_JOINTS):
        first = len(vertices)
        end = _REST[SMPL.main_child[j]] if j in SMPL.main_child else _REST[j] + np.array(_LEAF_END[j])
        for ring, along in enumerate((0.0, 0.5, 1.0)):
            vertices.extend(_ring(_REST[j], end, along, _HALF_WIDTH.get(j, 0.045) * (1 - 0.15 * ring)))
            weights.extend([_ring_weights(j, ring)] * _SIDES)
        regressor[j, first : first + _SIDES] = 1 / _SIDES
        side_faces = _tube_faces(first)
        faces.extend(side_faces)
        materials.extend([0 if j in (15, 20, 21, 22, 23) else 1] * len(side_faces))
    v = np.array(vertices)
    rng = np.random.default_rng(0)
    shapedirs = np.zeros((len(v), 3, 10))
    shapedirs[..., 0] = 0.04 * v
    shapedirs[..., 1] = 0.03 * (v - _REST[9]) * [1, 0, 1]
    np.savez(
        path, v_template=v, shapedirs=shapedirs, posedirs=1e-4 * rng.normal(size=(len(v), 3, 207)),
        J_regressor=regressor, weights=np.array(weights), f=np.array(faces), body_id=np.array(body_id),
        kintree_table=np.array([[4294967295, *PARENTS[1:]], range(NUM_JOINTS)]), vt=v[:, :2] / 2,
        ft=np.array(faces),
        face_material=np.array(materials),
    )  # fmt: skip
    return path


def motion_arrays(body_path: Path, *, frames: int = 60, fps: float = 30.0, seed: int = 0) -> dict[str, np.ndarray]:
    """Return a motion file's arrays: a walk on a circle with swinging limbs and one full turn of a shoulder."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames) / fps
    rotvec = np.zeros((frames, NUM_JOINTS, 3))
    amplitude = 0.12 * rng.normal(size=(22, 3))
    phase = rng.uniform(0, 2 * np.pi, size=(22, 3))
    rotvec[:, :22] = amplitude * np.sin(2 * np.pi * 0.7 * time[:, None, None] + phase)
    swing = np.sin(2 * np.pi * 0.9 * time)
    rotvec[:, 1, 0], rotvec[:, 2, 0] = -0.5 * swing, 0.5 * swing
    rotvec[:, 4, 0], rotvec[:, 5, 0] = 0.4 - 0.4 * swing, 0.4 + 0.4 * swing
    rotvec[:, 16, 2], rotvec[:, 17, 2] = -1.2 + 0.3 * swing, 1.2 + 0.3 * swing
    rotvec[:, 19] = [0.0, 1.0, 0.0] * np.linspace(0, 2 * np.pi, frames)[:, None]
    heading = np.linspace(0, 1.6 * np.pi, frames)
    rotvec[:, 0] = _upright(heading)
    betas = np.zeros(10)
    betas[:2] = 0.8, -0.5
    body = read_body(body_path)
    rest = body.rest_joints(betas)
    transl = np.stack([np.cos(heading), np.sin(heading), 0 * heading], -1) * 0.8
    transl += [0.0, 0.0, 0.97] - rest[0]
    _, joints = pose_joints(rest, rotvec, transl)
    poses = np.zeros((frames, 156))
    poses[:, :66] = rotvec[:, :22].reshape(frames, 66)
    keypoints = joints[:, [15, 12, 16, 17, 18, 19, 20, 21, 1, 2, 4, 5, 7, 8, 10, 11, 0]].copy()
    keypoints[frames // 2, 3] = np.nan
    keyframes = np.zeros(frames, dtype=bool)
    keyframes[::10] = True
    return {
        "format": np.array("manifold_mocap_motion"), "version": np.array(1), "poses": poses, "trans": transl,
        "betas": betas, "mocap_framerate": np.array(fps), "gender": np.array("neutral"), "body": np.array(body.id),
        "joints": joints, "keypoints3d": keypoints, "joint_set": np.array("H36M_17"), "keyframes": keyframes,
        "provenance": np.array('{"version": "test"}'),
    }  # fmt: skip


def capture_arrays(joints: np.ndarray, *, fps: float = 30.0, distorted: bool = True) -> dict[str, np.ndarray]:
    """Return a capture file's arrays: four unlike cameras around the middle that see all 24 joints."""
    size = np.array([[1920, 1080], [1280, 720], [1088, 1920], [1920, 1080]])
    focal = np.array([[1500, 1500], [900, 940], [1680, 1680], [1420, 1300]], float)
    offset = np.array([[0, 0], [31.5, -17.25], [-12.0, 40.0], [-55.0, 21.0]])
    K = np.zeros((4, 3, 3))
    K[:, 0, 0], K[:, 1, 1], K[:, 2, 2] = focal[:, 0], focal[:, 1], 1
    K[:, :2, 2] = (size - 1) / 2 + offset
    distortion = np.zeros((4, 8))
    if distorted:
        distortion[1, :5] = -0.12, 0.05, 0.001, -0.0008, -0.01
        distortion[2, :2] = -0.05, 0.14
    R, t = zip(
        *[_look_at(angle, height) for angle, height in ((0.4, 1.6), (2.0, 2.2), (3.6, 1.1), (5.1, 2.6))], strict=True
    )
    xy = np.stack([
        pixels(distort(p[..., :2] / p[..., 2:], distortion[c], "opencv"), K[c])
        for c, p in enumerate(joints @ R[c].T + t[c] for c in range(4))
    ])  # fmt: skip
    confidence = np.full(xy.shape[:3], 0.9)
    xy[1, 3, 5], confidence[1, 3, 5] = np.nan, 0
    return {
        "format": np.array("manifold_mocap_capture"), "version": np.array(1), "name": np.array("stand-in"),
        "camera_names": np.array(["front", "left side", "back", "right"]), "K": K, "R": np.stack(R), "t": np.stack(t),
        "image_size": size, "distortion": distortion, "distortion_model": np.array("opencv"), "fps": np.array(fps),
        "xy": xy.astype(np.float32), "confidence": confidence.astype(np.float32), "joint_set": np.array("SMPL_24"),
        "footage": np.array(["", "", "", ""]),
    }  # fmt: skip


def _upright(heading: np.ndarray) -> np.ndarray:
    """Return axis-angles of Rz(heading) Rx(90°): body Y to world Z."""
    half = heading / 2
    quat = np.sqrt(0.5) * np.stack([np.cos(half), np.cos(half), np.sin(half), np.sin(half)], -1)
    angle = 2 * np.arccos(np.clip(quat[:, :1], -1, 1))
    return quat[:, 1:] / np.sin(angle / 2) * angle


def _look_at(angle: float, height_m: float) -> tuple[np.ndarray, np.ndarray]:
    centre = np.array([4.2 * np.cos(angle), 4.2 * np.sin(angle), height_m])
    forward = np.array([0, 0, 0.9]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    return R, -R @ centre


def _ring(start: np.ndarray, end: np.ndarray, along: float, radius: float) -> np.ndarray:
    axis = (end - start) / np.linalg.norm(end - start)
    helper = np.array([0, 0, 1.0]) if abs(axis[2]) < 0.8 else np.array([0, 1.0, 0])
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u)
    turn = np.linspace(0, 2 * np.pi, _SIDES, endpoint=False)[:, None]
    return start + along * (end - start) + radius * (np.cos(turn) * u + np.sin(turn) * np.cross(axis, u))


def _ring_weights(j: int, ring: int) -> np.ndarray:
    weights = np.zeros(NUM_JOINTS)
    weights[j] = 1.0
    if ring == 0 and PARENTS[j] >= 0:
        weights[[j, PARENTS[j]]] = 0.5
    return weights


def _tube_faces(first: int) -> list[tuple[int, int, int]]:
    faces = []
    for ring in range(2):
        for k in range(_SIDES):
            a, b = first + ring * _SIDES + k, first + ring * _SIDES + (k + 1) % _SIDES
            faces += [(a, b, b + _SIDES), (a, b + _SIDES, a + _SIDES)]
    for k in range(1, _SIDES - 1):
        last = first + 2 * _SIDES
        faces += [(first, first + k + 1, first + k), (last, last + k, last + k + 1)]
    return faces


def bare_motion(motion: MotionFile, frames: int, **values: Any) -> MotionFile:
    """Return a motion of so many frames at rest with the same body, and nothing else but what is given."""
    rest = {"rotvec": np.zeros((frames, *motion.rotvec.shape[1:])), "transl": np.zeros((frames, 3))}
    return MotionFile(motion.name, betas=motion.betas, fps=motion.fps, body=motion.body, **rest | values)
