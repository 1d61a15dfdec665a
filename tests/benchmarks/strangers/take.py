"""Two seconds of the demo's person, and functions that write the usual files of a take."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras, JointSet
from tests.support.calibration_files import toml_text

FRAMES, LENGTH, FPS = 120, 360, 60.0  # Frames of a take, frames of the whole demo, and frame rate.
COCO = JointSet.COCO_17.keypoints


@dataclass(frozen=True)
class Take:
    """Detections of a take, its cameras, and the truth."""

    points: np.ndarray
    """(C, F, 25, 3) u, v and confidence of BODY_25, zero if unseen."""
    cameras: Cameras
    joints: np.ndarray
    """(N, 24, 3) true joints of the whole demo in metres."""

    @property
    def names(self) -> tuple[str, ...]:
        """Return the cameras' names."""
        return self.cameras.names

    def coco(self) -> np.ndarray:
        """Return the (C, F, 17, 3) keypoints of COCO."""
        return self.points[:, :, [JointSet.BODY_25.keypoints.index(name) for name in COCO]]

    def mapped(self, c: int, xy: np.ndarray) -> Take:
        """Return the take with other (F, 25, 2) pixels in one camera, for the points that it sees."""
        points = self.points.copy()
        points[c, ..., :2] = np.where(points[c, ..., 2:] > 0, xy, 0.0)
        return replace(self, points=points)


def demo_take(first: int = 60, frames: int = FRAMES) -> Take:
    """Return some frames of the demo."""
    capture = demo_capture(LENGTH, FPS)
    cameras, keypoints = capture.require_multiview()
    seen = (keypoints.confidence > 0)[..., None]
    points = np.where(seen, np.concatenate([keypoints.xy, keypoints.confidence[..., None]], -1), 0.0)
    return Take(np.nan_to_num(points[:, first : first + frames]).round(3), cameras, np.asarray(capture.truth["joints"]))


def write_toml(folder: Path, cameras: Cameras, scale: float = 1.0) -> None:
    """Write the calibration as Pose2Sim does, with lengths multiplied by ``scale``."""
    (folder / "calibration").mkdir(parents=True, exist_ok=True)
    (folder / "calibration" / "Calib.toml").write_text(toml_text(cameras, scale=scale), encoding="utf-8")


def write_rate(folder: Path, fps: float = FPS) -> None:
    """Write the frame rate in Pose2Sim's settings."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "Config.toml").write_text(f"[project]\nframe_rate = {fps:g}\n", encoding="utf-8")


def write_openpose(folder: Path, name: str, people: list[np.ndarray], first: int = 0, digits: int = 12) -> None:
    """Write a camera's folder of OpenPose files for people of (F, K, 3). A person with only zeros is omitted."""
    place = folder / "pose" / f"{name}_json"
    place.mkdir(parents=True, exist_ok=True)
    for f in range(len(people[0])):
        here = [{"person_id": [-1], "pose_keypoints_2d": p[f].ravel().tolist()} for p in people if p[f].any()]
        (place / f"{name}_{f + first:0{digits}d}_keypoints.json").write_text(json.dumps({"people": here}))


def write_take(folder: Path, take: Take, *others: Take, calibration: Cameras | None = None) -> None:
    """Write a take in Pose2Sim's layout, with other people in the same views."""
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [take.points[c], *(other.points[c] for other in others)])
    write_toml(folder, take.cameras if calibration is None else calibration)
    write_rate(folder)
