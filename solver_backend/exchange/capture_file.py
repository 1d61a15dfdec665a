"""Read capture files: calibrated cameras, detections, markers and footage paths."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import CaptureInvalid
from .lens import DEFAULT_MODEL, LENS_MODELS
from .npz import read_arrays
from .schema import Fields

FORMAT, VERSION = "manifold_mocap_capture", 1
_CAMERA_SHAPES = {"K": (3, 3), "R": (3, 3), "t": (3,), "image_size": (2,)}
"""Shape of each array for one camera."""
_OTHERS = "format version name camera_names distortion distortion_model footage footage_first fps xy confidence"
_SHOWN = (*_CAMERA_SHAPES, *_OTHERS.split(), "joint_set", "marker_positions", "marker_fps", "marker_labels")


@dataclass(frozen=True)
class CameraFile:
    """A calibrated camera with OpenCV axes: ``x_cam = R @ x_world + t``."""

    name: str
    K: np.ndarray  # (3, 3) intrinsic matrix in pixels.
    R: np.ndarray  # (3, 3) rotation from world to camera.
    t: np.ndarray  # (3,) translation in metres.
    image_size: tuple[int, int]  # Width and height in pixels.
    distortion: np.ndarray  # (8,) coefficients in the order of the lens model, padded with zeros.
    distortion_model: str  # Name of the lens model in ``LENS_MODELS``.
    footage: Path | None  # Video file or image folder. It may not exist.
    footage_first: int = 0
    """Index of the image that belongs to the first frame. Negative if the camera started later."""


@dataclass(frozen=True)
class CaptureFile:
    """A recording with C cameras, F frames and K keypoints."""

    name: str
    cameras: tuple[CameraFile, ...]  # Calibrated cameras, in the order of the views.
    fps: float  # Frames per second of the detections.
    xy: np.ndarray | None = None  # (C, F, K, 2) distorted pixels, NaN where undetected.
    confidence: np.ndarray | None = None  # (C, F, K) confidences in 0..1, 0 where undetected.
    joint_set: str = ""
    markers: np.ndarray | None = None  # (F, M, 3) optical markers in world metres, NaN where missing.
    marker_labels: tuple[str, ...] = ()  # (M,) labels of ``markers``, or empty if the recording has no labels.

    @property
    def num_frames(self) -> int:
        """Number of frames of the detections, or of the markers if there are no detections."""
        if self.xy is not None:
            return self.xy.shape[1]
        return 0 if self.markers is None else len(self.markers)


def read_capture(path: Path) -> CaptureFile:
    """Read the parts of a capture file that Blender displays.

    Raises:
        CaptureInvalid: cameras or detections have wrong shapes or invalid values.
    """
    path = Path(path)
    fields = Fields(path, read_arrays(path, required=("format",), optional=_SHOWN))
    fields.accept_format(FORMAT, VERSION)
    cameras = _cameras(fields)
    rates = [fields.first_number(key, CaptureInvalid) for key in ("fps", "marker_fps") if key in fields]
    fps = rates[0] if rates else 0.0
    if not (np.isfinite(fps) and fps > 0):
        raise CaptureInvalid(f"The frame rate must be positive, not {fps}.", where=str(path))
    xy, confidence = _detections(fields, len(cameras)) if "xy" in fields else (None, None)
    markers, labels = None, fields.texts("marker_labels")
    if "marker_positions" in fields:
        markers = fields.shaped("marker_positions", ("frames", "markers", 3), CaptureInvalid)
    if labels and len(labels) != (count := 0 if markers is None else markers.shape[1]):
        raise CaptureInvalid(f"{len(labels)} labels do not match {count} markers.", where=str(path))
    name, joint_set = fields.text("name", path.stem), fields.text("joint_set", "")
    return CaptureFile(name, cameras, fps, xy, confidence, joint_set, markers, labels)


def portable_path(path: Path | None, folder: Path) -> str:
    """Convert a footage path for a capture file. Paths inside ``folder`` become relative, and None becomes ""."""
    if path is None:
        return ""
    full, base = os.path.abspath(path), os.path.abspath(folder)
    inside = os.path.splitdrive(full)[0] == os.path.splitdrive(base)[0] and os.path.commonpath([full, base]) == base
    return Path(os.path.relpath(full, base)).as_posix() if inside else full


def footage_path(name: str, capture: Path | str) -> Path | None:
    """Return the path of the footage named in a capture file. This is the inverse of ``portable_path``."""
    return Path(capture).absolute().parent / name if name else None


def _cameras(fields: Fields) -> tuple[CameraFile, ...]:
    names, where = fields.texts("camera_names"), str(fields.path)
    arrays = {key: _camera_numbers(fields, key, (len(names), *shape)) for key, shape in _CAMERA_SHAPES.items()}
    footage = fields.texts("footage") or ("",) * len(names)
    models = fields.texts("distortion_model") or (DEFAULT_MODEL,)
    models = models * len(names) if len(models) == 1 else models
    if not set(models) <= LENS_MODELS.keys() or len(models) != len(names) or len(footage) != len(names):
        entries = f"{len(footage)} entries of footage and the distortion model '{', '.join(dict.fromkeys(models))}'"
        hint = f"One entry per camera ('' for none) and models of {', '.join(LENS_MODELS)} are expected."
        raise CaptureInvalid(f"{len(names)} cameras have {entries}.", where=where, hint=hint)
    firsts = np.zeros(len(names))
    if "footage_first" in fields:
        firsts = np.nan_to_num(fields.shaped("footage_first", (len(names),), CaptureInvalid))
    distortion = np.zeros((len(names), 8))
    if "distortion" in fields:
        given = fields.shaped("distortion", (len(names), "coefficients"), CaptureInvalid)[:, :8]
        distortion[:, : given.shape[1]] = given
    cameras = []
    for c, name in enumerate(names):
        K, R, t, size = (arrays[key][c] for key in _CAMERA_SHAPES)
        width, height = (int(length) for length in size)
        if min(K[0, 0], K[1, 1]) <= 0:
            what = f"The focal length must be positive, not {K[0, 0]:g}, {K[1, 1]:g}."
            raise CaptureInvalid(what, where=f"camera {name}")
        if min(width, height) <= 0:
            raise CaptureInvalid(f"The image size {width} x {height} is not positive.", where=f"camera {name}")
        lens, film = (distortion[c], models[c]), (footage_path(footage[c], fields.path), int(firsts[c]))
        cameras.append(CameraFile(name, K, R, t, (width, height), *lens, *film))
    return tuple(cameras)


_REMEDY = "Convert the recording again."


def _camera_numbers(fields: Fields, key: str, shape: tuple[int, ...]) -> np.ndarray:
    value = fields.floats(key, CaptureInvalid) if key in fields else np.zeros((0, *shape[1:]))
    if value.shape != shape:
        raise CaptureInvalid(
            f"{key} has shape {value.shape}, but {shape} is expected.", where=str(fields.path), hint=_REMEDY
        )
    if not np.isfinite(value).all():
        raise CaptureInvalid(f"{key} contains NaN or infinite values.", where=str(fields.path), hint=_REMEDY)
    return value


def _detections(fields: Fields, views: int) -> tuple[np.ndarray, np.ndarray]:
    xy = fields.shaped("xy", (views, "frames", "keypoints", 2), CaptureInvalid).copy()
    if "confidence" in fields:
        confidence = fields.shaped("confidence", xy.shape[:3], CaptureInvalid).copy()
    else:
        confidence = np.ones(xy.shape[:3])
    unseen = ~np.isfinite(xy).all(-1) | ~(confidence > 0)
    xy[unseen], confidence[unseen] = np.nan, 0.0
    return xy, confidence
