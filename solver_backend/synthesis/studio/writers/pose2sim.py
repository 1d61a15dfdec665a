"""A shot as a trial of Pose2Sim: calibration in TOML, OpenPose's JSON a camera and frame, and Config.toml."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras, Capture, JointSet, Keypoints2D

_MODELS = {
    JointSet.BODY_25: "BODY_25", JointSet.BODY_25B: "BODY_25B", JointSet.COCO_17: "COCO_17",
    JointSet.COCO_WHOLEBODY_133: "COCO_133", JointSet.HALPE_26: "HALPE_26", JointSet.MEDIAPIPE_33: "BLAZEPOSE",
}  # fmt: skip
_TRIANGULATION = """
[triangulation]
reproj_error_threshold_triangulation = 15
likelihood_threshold_triangulation = 0.3
min_cameras_for_triangulation = 2
undistort_points = true
interp_if_gap_smaller_than = 20
interpolation = 'linear'
remove_incomplete_frames = false
sections_to_keep = 'all'
min_chunk_size = 10
fill_large_gaps_with = 'last_value'
show_interp_indices = true
make_c3d = false
"""
"""What Pose2Sim's step of that name asks for, at its own values; without this section it ends with an error."""
_WRITTEN = {JointSet.COCO_WHOLEBODY_133: 133}
"""Keypoints that a file holds, where they are fewer than the set's."""


def write_trial(folder: Path, capture: Capture) -> Path:
    """Write a capture's keypoints as a trial into a folder that is new.

    Raises:
        TooFewViews, NoDetections: see ``Capture.require_multiview``.
    """
    cameras, keypoints = capture.require_multiview()
    (folder / "calibration").mkdir(parents=True)
    (folder / "calibration" / "Calib.toml").write_text(calibration_text(cameras), encoding="utf-8", newline="\n")
    for view, name in enumerate(cameras.names):
        target = folder / "pose" / f"{name}_json"
        target.mkdir(parents=True)
        for frame in range(keypoints.num_frames):
            path = target / f"{name}_{frame:012d}_keypoints.json"
            path.write_text(frame_text(keypoints, view, frame), encoding="utf-8", newline="\n")
    model = _MODELS.get(keypoints.joint_set, keypoints.joint_set.value)
    config = (
        f"[project]\nmulti_person = false\nframe_rate = {keypoints.fps:g}\nframe_range = []\n\n"
        f"[pose]\npose_model = '{model}'\n{_TRIANGULATION}"
    )
    (folder / "Config.toml").write_text(config, encoding="utf-8", newline="\n")
    return folder


def calibration_text(cameras: Cameras) -> str:
    """Return the cameras as Pose2Sim's TOML: metres, Rodrigues vectors world to camera, Z up."""
    lines = []
    for view, name in enumerate(cameras.names):
        # Pose2Sim hands four or five coefficients to OpenCV; the rational model's others are written where they are.
        lens = cameras.distortion[view]
        count = 8 if lens[5:].any() else 5 if lens[4] else 4
        fields = {
            "name": name, "size": cameras.image_size[view].astype(float).tolist(), "matrix": cameras.K[view].tolist(),
            "distortions": lens[:count].tolist(), "rotation": log_so3(cameras.R[view]).tolist(),
            "translation": cameras.t[view].tolist(), "fisheye": cameras.models[view] == "fisheye",
        }  # fmt: skip
        lines.append(f'["{name}"]')
        lines += [f"{key} = {json.dumps(value)}" for key, value in fields.items()]
        lines.append("")
    return "\n".join([*lines, "[metadata]", "adjusted = false", "error = 0.0", ""])


def frame_text(keypoints: Keypoints2D, view: int, frame: int) -> str:
    """Return OpenPose's JSON of one frame; a keypoint that is missing is 0 0 0, and nobody at all an empty list."""
    xy, confidence = keypoints.xy[view, frame], keypoints.confidence[view, frame]
    count = _WRITTEN.get(keypoints.joint_set, len(xy))
    rows = np.zeros((count, 3))
    rows[: len(xy), :2], rows[: len(xy), 2] = np.nan_to_num(xy), confidence
    flat = [round(float(v), 3) for v in rows.ravel()]
    people = [{"person_id": [-1], "pose_keypoints_2d": flat}] if (confidence > 0).any() else []
    return json.dumps({"version": 1.3, "people": people})
