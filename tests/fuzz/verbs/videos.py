"""The verb that goes from videos to a motion, on what an earlier run has left: detections, clocks, steps, cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from unittest import mock

import numpy as np

from solver_backend.videos.detect import detect_videos
from solver_backend.videos.detect.detector import DetectorFailed, chosen_detector
from solver_backend.videos.files.video import recording_hash
from solver_backend.videos.video_detections import VideoDetections, write_detections
from tests.fuzz.target import Target, Write
from tests.fuzz.verbs.running import in_a_copy, run_verb, verb_target
from tests.fuzz.verbs.views import FRAMES, short_views
from tests.support.calibration_files import toml_text
from tests.support.pose_models import write_rtmpose
from tests.support.videos import write_dots

_SIZE = 160, 120


def _footage(views: int) -> Write:
    """Return what writes small videos and what a detector has found in them."""

    def write(folder: Path) -> None:
        videos, calibration = folder / "footage" / "videos", folder / "footage" / "calibration"
        videos.mkdir(parents=True)
        write_rtmpose(folder / "model.onnx")
        cameras, keypoints = short_views(max(views, 2)).require_multiview()
        scale = np.array(_SIZE) / cameras.image_size
        K = cameras.K.copy()
        K[:, :2] *= scale[:, :, None]
        if views > 1:
            calibration.mkdir()
            small = replace(cameras, K=K, image_size=np.tile(_SIZE, (len(cameras), 1)))
            (calibration / "Calib.toml").write_text(toml_text(small))
        choice, kept = chosen_detector(str(folder / "model.onnx")), folder / "footage" / "mocap" / "detections"
        kept.mkdir(parents=True)
        times = np.arange(FRAMES) / 30.0
        for c, name in enumerate(cameras.names[:views]):
            path = videos / f"{name}.mp4"
            write_dots(path, np.tile([[30.0, 25.0 + c], [120.0, 40.0], [80.0, 95.0]], (FRAMES, 1, 1)), times, _SIZE)
            digest = recording_hash((path,))
            found = VideoDetections(
                path, digest, "detector 1", keypoints.joint_set, _SIZE, times, (keypoints.xy[c] * scale[c])[:, None],
                keypoints.confidence[c][:, None], np.zeros((FRAMES, 1), int),
            )  # fmt: skip
            write_detections(detect_videos._kept_at(kept, path, digest, choice), found)

    return write


def _resumed(folder: Path) -> None:
    """Write what a run has left that came as far as the capture."""
    _footage(2)(folder)
    _road(folder, "capture")


def _road(folder: Path, until: str) -> object:
    # A detector that is started takes a second of its own; here one that must be started has failed.
    stand_in = mock.patch.object(detect_videos, "DetectorProcess", side_effect=DetectorFailed("It does not start."))
    line = "from-videos ./footage --detector ./model.onnx --sync none --stature 1.75 --iterations 1 --until"
    with stand_in:
        return run_verb(folder, f"{line} {until}")


def _run(until: str) -> Callable[[Path], object]:
    def run(folder: Path) -> object:
        with in_a_copy(folder) as copy:
            return _road(copy, until)

    return run


_KINDS = {".npz": "npz", ".json": "json", ".toml": "text"}
TARGETS: tuple[Target, ...] = (
    verb_target("from-videos", (_footage(2), _resumed), _run("capture"), _KINDS),
    verb_target("from-videos, solve", (_footage(1),), _run("solve"), {".npz": "npz"}),
) if find_spec("av") and find_spec("onnx") else ()  # fmt: skip
