"""A demo of 17 points as a user's own detector finds them: eight of the body, and nine on bones at known places."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.body.files.choices import load_chosen_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import BONES, Capture, OwnPoint
from tests.support.calibration_files import toml_text

BODY = {
    "schulterL": "left_shoulder", "schulterR": "right_shoulder", "pulsL": "left_wrist", "pulsR": "right_wrist",
    "hueftL": "left_hip", "hueftR": "right_hip", "knoechelL": "left_ankle", "knoechelR": "right_ankle",
}  # fmt: skip
"""Landmark of each of the eight."""
PLACES = {
    **{f"{side}_upper_arm": (s * 0.15, 0.01, -0.05) for side, s in (("left", 1), ("right", -1))},
    **{f"{side}_forearm": (s * 0.08, 0.04, 0.0) for side, s in (("left", 1), ("right", -1))},
    **{f"{side}_thigh": (s * 0.06, -0.2, 0.05) for side, s in (("left", 1), ("right", -1))},
    **{f"{side}_shin": (0.0, -0.1, 0.05) for side in ("left", "right")},
    "spine3": (0.0, 0.05, 0.14),
}
"""Where the nine are, by their bones: metres from the bone's joint, in its rest frame."""
NOISE_PX = 3.0


def own_capture(frames: int = 360, seed: int = 0) -> Capture:
    """Return the demo with the eight keypoints in BODY_25's columns and the nine own points behind them."""
    demo = demo_capture(frames)
    cameras, keypoints = demo.require_multiview()
    body, truth, names = load_chosen_body("neutral"), demo.truth, keypoints.joint_set.keypoints
    local = exp_so3(truth["body_pose"].reshape(len(truth["transl"]), -1, 3))
    posed = forward_kinematics(body, truth["betas"], exp_so3(truth["global_orient"]), local, truth["transl"])
    joints = [body.layout.joints.index(BONES[bone]) for bone in PLACES]
    points = posed.joints[:, joints] + (posed.G[:, joints] @ np.array([*PLACES.values()])[..., None])[..., 0]
    pixels = project(cameras, points)
    pixels = pixels + np.random.default_rng(seed).normal(0.0, NOISE_PX, pixels.shape)
    kept = np.isin(names, [*BODY.values()])
    xy = np.concatenate([np.where(kept[:, None], keypoints.xy, np.nan), pixels], axis=2)
    confidence = np.concatenate([keypoints.confidence * kept, np.full(pixels.shape[:3], 0.9)], axis=2)
    own = tuple(OwnPoint(f"mein_{bone}", bone) for bone in PLACES)
    return replace(demo, keypoints=replace(keypoints, xy=xy, confidence=confidence, own=own))


def write_own_points(root: Path, capture: Capture) -> Path:
    """Write the 17 points as DeepLabCut's tables with a calibration and ``keypoints.json``, and return the folder."""
    cameras, keypoints = capture.require_multiview()
    columns = [keypoints.joint_set.keypoints.index(name) for name in BODY.values()]
    columns += range(keypoints.joint_set.num_keypoints, keypoints.xy.shape[2])
    names = [*BODY, *(point.name for point in keypoints.own)]
    values = np.nan_to_num(np.concatenate([keypoints.xy, keypoints.confidence[..., None]], axis=-1)[:, :, columns])
    (root / "calibration").mkdir(parents=True)
    (root / "calibration" / "Calib.toml").write_text(toml_text(cameras))
    points = {point.name: {"bone": point.bone} for point in keypoints.own}
    (root / "keypoints.json").write_text(json.dumps({"landmarks": BODY, "points": points}))
    for camera, frames in zip(cameras.names, values, strict=True):
        with (root / f"{camera}DLC_resnet50_dance.csv").open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["scorer", *["me"] * 3 * len(names)])
            table.writerow(["bodyparts", *[name for name in names for _ in range(3)]])
            table.writerow(["coords", *["x", "y", "likelihood"] * len(names)])
            table.writerows([f, *frame.ravel().tolist()] for f, frame in enumerate(frames))
    return root
