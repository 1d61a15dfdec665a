"""The capture file: calibrated cameras, detections, markers and where the footage is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import CaptureInvalid
from .arrays import read_arrays, require_format, text, texts

FORMAT, VERSION = "manifold_mocap_capture", 1
_CAMERA_SHAPES = {"K": (3, 3), "R": (3, 3), "t": (3,), "image_size": (2,)}
_OPTIONAL = (
    "format", "version", "name", "camera_names", *_CAMERA_SHAPES, "distortion", "distortion_model", "footage", "fps",
    "xy", "confidence", "joint_set", "marker_positions", "marker_fps",
)  # fmt: skip


@dataclass(frozen=True)
class CameraFile:
    """One calibrated camera: ``x_cam = R @ x_world + t`` in OpenCV's axes, pixel (0, 0) is a pixel's centre."""

    name: str
    """Name of the camera."""
    K: np.ndarray
    """(3, 3) intrinsic matrix in pixels."""
    R: np.ndarray
    """(3, 3) rotation world to camera."""
    t: np.ndarray
    """(3,) metres."""
    image_size: tuple[int, int]
    """Width and height in pixels."""
    distortion: np.ndarray
    """(8,) k1 k2 p1 p2 k3 k4 k5 k6, or the fisheye's k1 k2 k3 k4 and zeros."""
    distortion_model: str
    """'opencv' or 'fisheye'."""
    footage: Path | None
    """Video file or folder of images; it may not exist."""


@dataclass(frozen=True)
class CaptureFile:
    """What was recorded; C cameras, F frames, K keypoints."""

    name: str
    """Name of the recording."""
    cameras: tuple[CameraFile, ...]
    """The calibrated cameras, in the order of the views."""
    fps: float
    """Frames per second of the detections."""
    xy: np.ndarray | None = None
    """(C, F, K, 2) distorted pixels, NaN where unseen."""
    confidence: np.ndarray | None = None
    """(C, F, K) in 0..1, 0 where unseen."""
    joint_set: str = ""
    """Name of the set of keypoints."""
    markers: np.ndarray | None = None
    """(F, M, 3) optical markers in world metres, NaN where unseen."""

    @property
    def num_frames(self) -> int:
        """Number of frames of the detections or, without any, of the markers."""
        if self.xy is not None:
            return self.xy.shape[1]
        return 0 if self.markers is None else len(self.markers)


def read_capture(path: Path) -> CaptureFile:
    """Read a capture file.

    Raises:
        FileMissing, FileDamaged: see ``read_arrays``.
        CaptureInvalid: cameras or detections have wrong shapes or impossible values.
    """
    path = Path(path)
    arrays = read_arrays(path, required=("format",), optional=_OPTIONAL)
    require_format(arrays, FORMAT, VERSION, path=path)
    cameras = _cameras(arrays, path)
    fps = float(arrays.get("fps", arrays.get("marker_fps", 0.0)))
    if not (np.isfinite(fps) and fps > 0):
        raise CaptureInvalid(f"The frame rate must be positive, not {fps}.", where=str(path))
    xy, confidence = _detections(arrays, len(cameras), path)
    return CaptureFile(
        name=text(arrays, "name", path.stem),
        cameras=cameras,
        fps=fps,
        xy=xy,
        confidence=confidence,
        joint_set=text(arrays, "joint_set"),
        markers=np.asarray(arrays["marker_positions"], np.float64) if "marker_positions" in arrays else None,
    )


def _cameras(arrays: dict[str, np.ndarray], path: Path) -> tuple[CameraFile, ...]:
    names = texts(arrays, "camera_names")
    for key, shape in _CAMERA_SHAPES.items():
        found = np.shape(arrays.get(key, np.zeros((0, *shape))))
        if found != (len(names), *shape):
            raise CaptureInvalid(f"{key} has shape {found}; {(len(names), *shape)} is expected.", where=str(path))
        if names and not np.isfinite(arrays[key]).all():
            raise CaptureInvalid(f"{key} holds NaN or infinite values.", where=str(path))
    footage = texts(arrays, "footage") or ("",) * len(names)
    model = text(arrays, "distortion_model", "opencv")
    if model not in ("opencv", "fisheye") or len(footage) != len(names):
        raise CaptureInvalid(
            f"{len(names)} cameras have {len(footage)} entries of footage and the distortion model '{model}'.",
            where=str(path),
            hint="One entry a camera ('' for none) and the model 'opencv' or 'fisheye' are expected.",
        )
    distortion = np.zeros((len(names), 8))
    given = np.asarray(arrays.get("distortion", distortion), np.float64).reshape(len(names), -1)[:, :8]
    distortion[:, : given.shape[1]] = given
    return tuple(
        CameraFile(
            name=name,
            K=_checked_K(np.asarray(arrays["K"][c], np.float64), name),
            R=np.asarray(arrays["R"][c], np.float64),
            t=np.asarray(arrays["t"][c], np.float64),
            image_size=_checked_size(arrays["image_size"][c], name),
            distortion=distortion[c],
            distortion_model=model,
            footage=path.absolute().parent / footage[c] if footage[c] else None,
        )
        for c, name in enumerate(names)
    )


def _checked_K(K: np.ndarray, name: str) -> np.ndarray:
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        raise CaptureInvalid(
            f"The focal length must be positive, not {K[0, 0]:g}, {K[1, 1]:g}.", where=f"camera {name}"
        )
    return K


def _checked_size(size: np.ndarray, name: str) -> tuple[int, int]:
    width, height = (int(v) for v in size)
    if width <= 0 or height <= 0:
        raise CaptureInvalid(f"The image size {width} x {height} is not positive.", where=f"camera {name}")
    return width, height


def _detections(arrays: dict[str, np.ndarray], views: int, path: Path) -> tuple[np.ndarray | None, np.ndarray | None]:
    if "xy" not in arrays:
        return None, None
    xy = np.array(arrays["xy"], np.float64)
    if xy.ndim != 4 or xy.shape[0] != views or xy.shape[3] != 2:
        raise CaptureInvalid(f"xy has shape {xy.shape}; ({views}, frames, keypoints, 2) is expected.", where=str(path))
    confidence = np.array(arrays.get("confidence", np.ones(xy.shape[:3])), np.float64)
    if confidence.shape != xy.shape[:3]:
        raise CaptureInvalid(f"confidence has shape {confidence.shape}; {xy.shape[:3]} is expected.", where=str(path))
    unseen = ~np.isfinite(xy).all(-1) | ~(confidence > 0)
    xy[unseen], confidence[unseen] = np.nan, 0.0
    return xy, confidence
