"""Create the demo captures: an authored motion, filmed by four cameras or recorded with markers."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.geometry.alignment import look_at
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.synthesis.faults import DEMO_DETECTOR, OPTICAL_MARKERS, DetectorFaults, autoregressive, bursts
from solver_backend.types import (
    NUM_BODY_JOINTS,
    NUM_JOINTS,
    SMPL_JOINTS,
    Cameras,
    Capture,
    JointSet,
    Keypoints2D,
    MarkerCloud,
)

_FILE = Path(__file__).parents[2] / "assets" / "choreography.json"
_COLLAR_SHARE = 0.2  # Fraction of an arm's elevation that comes from the collar bone.
_STEPS_PER_S = 240  # Number of samples per second for interpolating the key poses.
_SHARPNESS = 300.0  # Sharpness in 1/m of the smooth minimum over the sole points.


class Choreography(NamedTuple):
    """SMPL parameters of an authored motion, in a world with Z up and the floor at z = 0."""

    global_orient: np.ndarray  # (F, 3) rotation vectors in radians.
    body_pose: np.ndarray  # (F, 21, 3) rotation vectors in radians.
    transl: np.ndarray  # (F, 3) translations in metres.


@cache
def _score() -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Read the key poses: times (n,) in s, pose vectors (n, 64), and the standing foot at each time."""
    values = json.loads(_FILE.read_text(encoding="utf-8"))
    times, names, headings, feet = zip(*values["score"], strict=True)
    poses = [_rotvecs(values["poses"]["stand"] | values["poses"][name]).ravel() for name in names]
    return np.array(times), np.column_stack([np.stack(poses), headings]), list(feet)


def author_motion(body: Body, betas: np.ndarray, num_frames: int, fps: float) -> Choreography:
    """Interpolate the demo's key poses, and keep the standing foot on the floor.

    Args:
        betas: (10,) shape coefficients.
        num_frames: number of frames F. The motion lasts six seconds. After that, the pose is constant.
        fps: frames per second.
    """
    times, tracks, feet = _score()
    fine = np.arange(-1.0, num_frames / fps + 1.0, 1 / _STEPS_PER_S)
    curves = [np.interp(fine, times, track) for track in tracks.T]
    kernel = np.exp(-0.5 * (np.arange(-120, 121) / _STEPS_PER_S / 0.09) ** 2)
    curves = [np.convolve(np.pad(c, 120, mode="edge"), kernel / kernel.sum(), mode="valid") for c in curves]
    at = np.arange(num_frames) / fps
    sampled = np.stack([np.interp(at, fine, c) for c in curves], axis=1)
    body_pose, heading = sampled[:, :-1].reshape(num_frames, NUM_BODY_JOINTS, 3), sampled[:, -1]
    turn = exp_so3(np.stack([0 * heading, 0 * heading, heading], axis=1))
    root = turn @ exp_so3(np.array([np.pi / 2, 0.0, 0.0]))
    stance = [feet[int(np.searchsorted(times, t, side="right")) - 1] for t in at]
    return Choreography(log_so3(root), body_pose, _planted(body, betas, root, exp_so3(body_pose), stance))


def _rotvecs(pose: dict[str, list[float]]) -> np.ndarray:
    vectors = np.zeros((NUM_BODY_JOINTS, 3))
    for joint, vector in pose.items():
        vectors[SMPL_JOINTS.index(joint) - 1] = vector
    for side in ("left", "right"):
        shoulder, collar = (SMPL_JOINTS.index(f"{side}_{part}") - 1 for part in ("shoulder", "collar"))
        vectors[collar, 2] += _COLLAR_SHARE * vectors[shoulder, 2]
        vectors[shoulder, 2] *= 1 - _COLLAR_SHARE
    return vectors


def _planted(body: Body, betas: np.ndarray, root: np.ndarray, local: np.ndarray, stance: list[str]) -> np.ndarray:
    """Return translations that fix the ball of the standing foot and keep the soles on the floor."""
    still = forward_kinematics(body, betas, root, local, np.zeros((len(root), 3)))
    balls = {side: still.joints[:, SMPL_JOINTS.index(f"{side}_foot")] for side in ("left", "right")}
    transl = np.zeros((len(root), 3))
    for f in range(1, len(root)):
        ball = balls[stance[f]]
        transl[f, :2] = transl[f - 1, :2] + ball[f - 1, :2] - ball[f, :2]
    transl[:, 2] = -_lowest(body, betas, still.G, still.joints)
    return transl


def _lowest(body: Body, betas: np.ndarray, G: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return the (F,) height of the lowest sole point. A smooth minimum avoids jumps between points."""
    rest = body.rest_joints(betas)
    lowest = (body.v_template[:, 1] + body.shapedirs[:, 1] @ betas).min()
    sole_depth = rest[SMPL_JOINTS.index("left_foot"), 1] - lowest
    heights = []
    for side in ("left", "right"):
        ankle, foot = SMPL_JOINTS.index(f"{side}_ankle"), SMPL_JOINTS.index(f"{side}_foot")
        back = [0.0, rest[foot, 1] - rest[ankle, 1] - sole_depth, -0.04]
        points = ((foot, [0.0, -sole_depth, 0.0]), (ankle, back), (foot, [0.0, -sole_depth, 0.065]))
        heights += [(joints[:, joint] + G[:, joint] @ np.array(offset))[:, 2] for joint, offset in points]
    stacked = np.stack(heights)
    low = stacked.min(axis=0)
    return -np.log(np.exp(-_SHARPNESS * (stacked - low)).sum(axis=0)) / _SHARPNESS + low


PX_PER_MM = 0.32  # Pixels per millimetre at 4.2 m from the demo's cameras, for images 1920 px wide.


def detect(
    px: np.ndarray, image_size: np.ndarray, fps: float, faults: DetectorFaults, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate detections: noisy (C, F, K, 2) pixels, NaN where missing, and (C, F, K) confidences.

    ``px`` (C, F, K, 2) are the true pixels, NaN behind the camera. ``image_size`` (C, 2) is width and height.
    """
    scale = image_size[:, None, None, :].max(axis=-1, keepdims=True) / 1920
    correlation = float(np.exp(-1.0 / (faults.drift_s * fps)))
    jitter = autoregressive(px.shape, correlation, rng) * (PX_PER_MM * faults.drift_mm) * scale
    angle = rng.uniform(0, 2 * np.pi, px.shape[:-1])
    elsewhere = (PX_PER_MM * faults.outlier_mm) * scale * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    wrong = rng.random(px.shape[:-1]) < faults.outliers
    xy = px + jitter + np.where(wrong[..., None], elsewhere, 0.0)
    inside = ((xy >= 0) & (xy < image_size[:, None, None, :])).all(-1)
    views, frames, points = wrong.shape
    missing = bursts(rng.random((frames, views, points)).swapaxes(0, 1), faults.missing, faults.burst_s * fps) | ~inside
    confidence = np.clip(
        0.85 - 0.03 * np.linalg.norm(jitter / scale, axis=-1) + 0.08 * rng.normal(size=wrong.shape), 0.1, 1
    )
    confidence = np.where(wrong, rng.uniform(0.15, 0.7, wrong.shape), confidence)
    return np.where(missing[..., None], np.nan, xy), np.where(missing, 0.0, confidence)


DEMO_BETAS = np.array([0.8, -0.5, 0.4, -0.3, 0.2, 0.3, -0.2, 0.1, 0.0, 0.2])  # Shape of the person in the demo capture.


def demo_capture(
    num_frames: int = 360, fps: float = 60.0, seed: int = 7, faults: DetectorFaults = DEMO_DETECTOR
) -> Capture:
    """Return the demo capture with its ground truth. The seed only affects the detector noise."""
    body = load_body()
    root, local, transl = author_motion(body, DEMO_BETAS, num_frames, fps)
    joint_set = JointSet.BODY_25
    landmarks = keypoint_landmarks(body, joint_set)
    posed = pose_landmarks(body, landmarks, DEMO_BETAS, exp_so3(root), exp_so3(local), transl)
    centre = posed.skeleton.joints[:, 0].mean(axis=0)
    cameras = tripods(np.array([centre[0], centre[1], 0.95]))
    px = project(cameras, posed.points)
    xy, confidence = detect(px, cameras.image_size, fps, faults, np.random.default_rng(seed))
    truth = smpl_truth(DEMO_BETAS, root, local, transl)
    truth |= {"joints": posed.skeleton.joints, "keypoints3d": posed.points}
    keypoints = Keypoints2D(xy, confidence, joint_set, fps)
    notes = (diagnostic("synthetic", origin="authored motion, four cameras, detector-like noise"),)
    footage, sources = (None,) * len(cameras), ("embedded demo capture",)
    return Capture("demo", cameras, keypoints, footage=footage, sources=sources, notes=notes, truth=truth)


def smpl_truth(betas: np.ndarray, root: np.ndarray, local: np.ndarray, transl: np.ndarray) -> dict[str, np.ndarray]:
    """Convert root and joint rotation vectors to the ground truth of a capture."""
    body_pose = np.zeros((len(root), 3 * (NUM_JOINTS - 1)))
    body_pose[:, : local[0].size] = local.reshape(len(root), -1)
    return {"betas": betas, "global_orient": root, "body_pose": body_pose, "transl": transl}


def tripods(target: np.ndarray, count: int = 4, radius_m: float = 4.2) -> Cameras:
    """Return cameras on tripods around a target, with slightly distorted images of 1920 x 1080 px."""
    angles = (
        np.deg2rad(35.0) + 2 * np.pi * (np.arange(count) + np.array([0.0, 0.08, -0.06, 0.05] * count)[:count]) / count
    )
    heights = 1.6 + 0.25 * np.cos(2.3 * np.arange(count))
    centres = np.stack([radius_m * np.cos(angles), radius_m * np.sin(angles), heights], axis=1)
    centres[:, :2] += target[:2]
    R = look_at(centres, target)
    focal = 1350.0 + 25.0 * np.arange(count)
    K = np.zeros((count, 3, 3))
    K[:, 0, 0], K[:, 1, 1], K[:, 2, 2] = focal, focal * 1.002, 1.0
    K[:, 0, 2], K[:, 1, 2] = 960.0 + 6.0 * np.arange(count), 540.0 - 4.0 * np.arange(count)
    distortion = np.tile([-0.08, 0.03, 0.0004, -0.0003, 0.0, 0.0, 0.0, 0.0], (count, 1))
    names = tuple(f"cam{i + 1:02d}" for i in range(count))
    t = -np.einsum("cij,cj->ci", R, centres)
    return Cameras(names, K, distortion, R, t, np.tile([1920, 1080], (count, 1)))


DEMO_TAKE = Path(__file__).parents[2] / "assets" / "demo_markers.c3d"  # Recording included in the repository.
BETAS = np.array([-0.6, 0.7, -0.3, 0.5, -0.2, 0.1, 0.3, -0.2, 0.1, 0.0])  # Shape of the person wearing the markers.
_SUBJECT = "Demo"
_UNKNOWN = ("ARMBAND", "LUPA")  # A label that is in no layout, and the landmark near its marker.


@dataclass(frozen=True)
class RecordedMarkers:
    """A simulated marker recording over F frames with its ground truth."""

    cloud: MarkerCloud
    truth: dict[str, np.ndarray]
    """SMPL parameters, ``joints`` (F, 24, 3) and ``markers`` (F, M, 3) on the body, in metres."""

    @property
    def joints(self) -> np.ndarray:
        """(F, 24, 3) true joint positions in metres."""
        return self.truth["joints"]


def record_markers(num_frames: int = 240, fps: float = 60.0, seed: int = 11, layout: str = "CMU_41") -> RecordedMarkers:
    """Simulate a recording of a layout's markers, and of one marker with an unknown label."""
    body, rng, faults = load_body(), np.random.default_rng(seed), OPTICAL_MARKERS
    root, local, transl = author_motion(body, BETAS, num_frames, fps)
    places = (*marker_layout(layout), _UNKNOWN[1])
    placement = 1e-3 * faults.placement_mm * rng.normal(size=(len(places), 3))
    placement[-1] += (0.0, 0.0, -0.04)
    landmarks = marker_landmarks(body, places)
    posed = pose_landmarks(body, landmarks, BETAS, exp_so3(root), exp_so3(local), transl, offsets=placement)
    shape, correlation = (len(places), num_frames, 3), float(np.exp(-1 / (fps * faults.skin_s)))
    sliding = 1e-3 * faults.skin_mm * autoregressive(shape, correlation, rng).swapaxes(0, 1)
    measured = 1e-3 * faults.measurement_mm * rng.normal(size=(num_frames, len(places), 3))
    hidden = bursts(rng.random((len(places), num_frames)), faults.hidden, faults.hidden_s * fps).T
    points = np.where(hidden[..., None], np.nan, posed.points + sliding + measured)
    labels = tuple(f"{_SUBJECT}:{name}" for name in (*marker_layout(layout), _UNKNOWN[0]))
    truth = smpl_truth(BETAS, root, local, transl) | {"joints": posed.skeleton.joints, "markers": posed.points}
    return RecordedMarkers(MarkerCloud(points, fps, labels), truth)


if __name__ == "__main__":
    write_c3d(DEMO_TAKE, record_markers().cloud, overwrite=True)
