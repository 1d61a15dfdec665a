"""Store the people detected in one video, and read and write them as files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.agreement.reading import extent
from solver_backend.exchange.errors import CaptureInvalid
from solver_backend.exchange.joint_sets import NUM_HAND_POINTS
from solver_backend.exchange.npz import write_npz
from solver_backend.exchange.plausible import FARTHEST_PX, LONGEST_S, require_rate
from solver_backend.exchange.schema import read_fields
from solver_backend.types import JointSet
from solver_backend.videos.files.video import TimedPictures

_AGAIN = "Detect the video again."
FORMAT, VERSION = "manifold_mocap_detections", 3  # Version 2 and later use stored pixels even if these are not square.
_STORED = (
    *("format", "version", "video", "video_hash", "detector", "joint_set"),
    *("size", "times_s", "xy", "confidence", "track", "hands"),
)


@dataclass(frozen=True)
class VideoDetections(TimedPictures):
    """People detected in one video: F images, up to P people per image, K keypoints."""

    video: Path
    video_hash: str
    detector: str
    joint_set: JointSet
    size: tuple[int, int]  # Width and height of the upright images in pixels.
    # pyrefly: ignore[bad-override] - the base class declares what both subclasses have
    times_s: np.ndarray  # (F,) image times on the video's clock, in seconds.
    xy: np.ndarray  # (F, P, K, 2) keypoints in px, NaN where missing.
    confidence: np.ndarray  # (F, P, K) confidences in 0..1, 0 where missing.
    track: np.ndarray  # (F, P) number of each person's track, -1 for none.
    camera: str = ""  # Name of the camera if it differs from the video name.
    hands: np.ndarray | None = None  # (F, P, 2, 21, 3) x, y and confidence, left hand first, NaN where undetected.

    def __post_init__(self) -> None:
        """Check the times, and mark implausible points as missing."""
        times = self.times_s
        if not len(times) or not np.isfinite(times).all() or (np.diff(times) < 0).any():
            raise CaptureInvalid("The image times do not increase.", where=self.name, hint=_AGAIN)
        if len(times) > 1:
            require_rate(self.fps if np.median(np.diff(times)) > 0 else np.inf, CaptureInvalid, self.name)
        if times[-1] - times[0] > LONGEST_S:
            what = f"The images span {times[-1] - times[0]:.3g} s, which is impossible."
            raise CaptureInvalid(what, where=self.name, hint="Convert the video to another file, and detect it again.")
        missing = ~(np.abs(self.xy) <= FARTHEST_PX).all(-1) | ~(np.abs(self.confidence) <= FARTHEST_PX)
        if missing.any():
            object.__setattr__(self, "xy", np.where(missing[..., None], np.nan, self.xy))
            object.__setattr__(self, "confidence", np.where(missing, 0.0, self.confidence))

    @property
    def name(self) -> str:
        """Name of the camera. It defaults to the name of the video."""
        return self.camera or self.video.stem

    def of_track(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return one person's pixels (F, K, 2) and confidences (F, K), by track number."""
        frames, slots = np.nonzero(self.track == number)
        xy = np.full((self.num_frames, *self.xy.shape[2:]), np.nan)
        confidence = np.zeros(xy.shape[:2])
        xy[frames], confidence[frames] = self.xy[frames, slots], self.confidence[frames, slots]
        return xy, confidence

    def main_track(self) -> int:
        """Return the number of the track with the largest sum of confidence times size, or -1 without people."""
        size = np.nan_to_num(extent(self.xy))
        weight = self.confidence.mean(axis=-1) * size
        totals = {int(n): float(weight[self.track == n].sum()) for n in np.unique(self.track) if n >= 0}
        return max(totals, key=lambda n: totals[n]) if totals else -1


def write_detections(path: Path, found: VideoDetections) -> None:
    """Write the detections in a video to a file. An existing file is replaced."""
    facts = {"format": FORMAT, "version": VERSION, "video": found.video.name, "video_hash": found.video_hash}
    facts |= {"detector": found.detector, "joint_set": found.joint_set.value, "size": found.size}
    arrays = {key: np.array(value) for key, value in facts.items()}
    arrays |= {"times_s": found.times_s, "track": found.track.astype(np.int32)}
    points = {"xy": found.xy, "confidence": found.confidence, "hands": found.hands}
    arrays |= {key: value.astype(np.float32) for key, value in points.items() if value is not None}
    write_npz(path, arrays, overwrite=True)


def read_detections(path: Path, video: Path) -> VideoDetections:
    """Read the stored detections of a video."""
    fields = read_fields(path, _STORED)
    fields.require_format(FORMAT, VERSION)
    xy = fields.numbers("xy", (None, None, None, 2))
    if xy.shape[2] != fields.joint_set().num_keypoints:
        raise CaptureInvalid("The keypoints do not match their joint set.", where=str(path), hint=_AGAIN)
    size, track = fields.numbers("size", (2,)), fields.numbers("track", xy.shape[:2])
    if not (np.isfinite(size).all() and (size >= 1).all() and (size < 1e6).all()) or not (np.abs(track) < 2**31).all():
        raise CaptureInvalid("The image size or a person's number is impossible.", where=str(path), hint=_AGAIN)
    facts: dict[str, Any] = {"joint_set": fields.joint_set(), "size": tuple(int(n) for n in size)}
    facts |= {key: fields.text(key, "") for key in ("video_hash", "detector")}
    arrays = {"times_s": fields.numbers("times_s", (len(xy),)), "xy": xy, "track": track.astype(np.int64)}
    arrays["confidence"] = fields.numbers("confidence", xy.shape[:3])
    if "hands" in fields:
        arrays["hands"] = fields.numbers("hands", (*xy.shape[:2], 2, NUM_HAND_POINTS, 3))
    return VideoDetections(video, **facts, **arrays)
