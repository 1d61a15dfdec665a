"""Qualisys Track Manager's calibration, ``.qca.txt`` (XML)."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid, FileDamaged
from solver_backend.exchange.lens import LENS_MODELS
from solver_backend.exchange.lens_model import MOST_TERMS
from solver_backend.geometry.rotations import matrix_from_quat
from solver_backend.io.calibration.entry import CameraEntry, StatedCameras
from solver_backend.io.files import LARGEST_TEXT, read_bytes, read_text

SUBPIXELS = 64.0
"""Focal lengths and centres are in 1/64 pixel."""

TO_OPENCV_AXES = np.diag([1.0, -1.0, -1.0])
"""Qualisys' camera looks along -Z with Y up; OpenCV's along +Z with Y down."""

_LARGEST_NUMBER = 1e12
"""Magnitude of a number in a file at most; chosen by hand."""
_ROWS = re.compile(r"(\d{3,4})p", re.IGNORECASE)
"""``video_resolution="540p"``."""
_SAME_ROWS = 0.05
"""Share by which numbers of rows differ that are the same: a sensor of 1088 rows records 1080p."""
_TRANSFORM = [[f"r{row}{column}" for column in (1, 2, 3)] for row in (1, 2, 3)]
"""Names of a rotation's numbers, row by row."""


def read_qualisys(path: Path) -> StatedCameras:
    """Return the cameras, in mm, and what the user should know.

    The file holds for each camera its centre ``c`` in mm in a world with Z up and the rows ``r1, r2, r3`` of the
    rotation world to camera: right, up and backward. Hence ``R = diag(1, -1, -1) [r1; r2; r3]`` and ``t = -R c``.
    ``K = [[fU, skew, cU - left], [0, fV, cV - top], [0, 0, 1]] / 64`` (left and top of the video's field of view are
    whole pixels). The distortion coefficients are OpenCV's k1 k2 p1 p2 k3 and have no unit: checkerboard pictures of
    such cameras, calibrated on their own, give the same values.

    Raises:
        FileMissing, FileDamaged: the file is not there, truncated or not Qualisys' XML.
        CalibrationInvalid: a camera lacks a value.
    """
    try:
        root = ElementTree.fromstring(read_bytes(path, LARGEST_TEXT))
    except (ElementTree.ParseError, LookupError, ValueError, RecursionError) as error:
        what = f"The file is truncated or is not Qualisys' XML ({error})."
        raise FileDamaged(what, where=str(path), hint="Export the calibration again.") from error
    nodes = root.findall("cameras/camera")
    if not nodes:
        raise FileDamaged("The file lists no cameras.", where=str(path), hint="Export the calibration again.")
    videos = [n for n in nodes if "video" in n.get("model", "").lower()]
    used = [n for n in (videos or nodes) if n.get("active", "1") != "0"]
    problems = tuple(
        diagnostic("qualisys_view_turned", cameras=[n.get("serial", "")], angle=n.get("viewrotation"))
        for n in used
        if n.get("viewrotation", "0") not in ("0", "")
    )
    entries = [_entry(node, path) for node in used]
    return StatedCameras(
        entries, unit="mm", source="qualisys", problems=(*problems, *_other_resolutions(used, entries))
    )


def _other_resolutions(nodes: list[ElementTree.Element], entries: list[CameraEntry]) -> tuple[Diagnostic, ...]:
    found: dict[tuple[int, int], list[str]] = {}
    for node, entry in zip(nodes, entries, strict=True):
        stated = _ROWS.fullmatch(node.get("video_resolution", "").strip())
        assert entry.image_size is not None
        rows, calibrated = int(stated[1]) if stated else 0, entry.image_size[1]
        if rows and abs(rows - calibrated) > _SAME_ROWS * calibrated:
            found.setdefault((rows, calibrated), []).append(entry.name)
    return tuple(
        diagnostic("qualisys_resolution", cameras=names, rows=rows, calibrated=calibrated)
        for (rows, calibrated), names in found.items()
    )


def _entry(node: ElementTree.Element, path: Path) -> CameraEntry:
    name = node.get("serial", "")
    place = f"{path}, camera {name}"
    transform, intrinsic = _child(node, "transform", place), _child(node, "intrinsic", place)
    rows = np.array([[_number(transform, key, place) for key in row] for row in _TRANSFORM])
    centre = np.array([_number(transform, key, place) for key in "xyz"])
    left, top, size = _field_of_view(node, intrinsic, place)
    f_u, f_v, c_u, c_v = (
        _number(intrinsic, key, place) / SUBPIXELS
        for key in ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
    )
    skew = _number(intrinsic, "skew", place, default=0.0) / SUBPIXELS
    radial = [_number(intrinsic, f"radialDistortion{i}", place, default=0.0) for i in (1, 2, 3)]
    tangential = [_number(intrinsic, f"tangentalDistortion{i}", place, default=0.0) for i in (1, 2)]
    R = TO_OPENCV_AXES @ rows
    return CameraEntry(
        name=name,
        K=np.array([[f_u, skew, c_u - left], [0.0, f_v, c_v - top], [0.0, 0.0, 1.0]]),
        distortion=np.array([radial[0], radial[1], tangential[0], tangential[1], radial[2]]),
        R=R,
        t=np.negative(R @ centre),
        image_size=size,
    )


def _field_of_view(
    node: ElementTree.Element, intrinsic: ElementTree.Element, place: str
) -> tuple[float, float, tuple[int, int]]:
    """Return left, top and (width, height) of the video in pixels."""
    view = node.find("fov_video")
    if view is None:
        view = node.find("fov_video_max")
    if view is None:
        size = [_number(intrinsic, f"sensorMax{axis}", place) / SUBPIXELS + 1 for axis in "UV"]
        return 0.0, 0.0, (round(size[0]), round(size[1]))
    left, top, right, bottom = (_number(view, side, place) for side in ("left", "top", "right", "bottom"))
    return left, top, (round(right - left) + 1, round(bottom - top) + 1)


def _child(node: ElementTree.Element, tag: str, place: str) -> ElementTree.Element:
    child = node.find(tag)
    if child is None:
        raise CalibrationInvalid(f"The camera has no <{tag}>.", where=place, hint="Export the calibration again.")
    return child


def _number(node: ElementTree.Element, key: str, place: str, *, default: float | None = None) -> float:
    text = node.get(key)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
        if not abs(value) < _LARGEST_NUMBER:
            raise ValueError(text)
        return value
    except ValueError as error:
        raise CalibrationInvalid(f"'{key}' of <{node.tag}> is {text!r}, not a number.", where=place) from error


CAMERAS, IMAGES = "cameras.txt", "images.txt"
_MODELS = {
    name: (model.name, focals, places) for model in LENS_MODELS.values() for name, focals, places in model.colmap
}
"""Our lens model, number of focal lengths, and places among our terms of those that follow the centre."""


def is_colmap(folder: Path) -> bool:
    """Whether a folder holds COLMAP's text model."""
    return (folder / CAMERAS).is_file() and (folder / IMAGES).is_file()


def read_colmap(folder: Path) -> StatedCameras:
    """Return the cameras, one an image, in the model's unit; COLMAP's pixels begin at 0.5, ours at 0.

    Raises:
        FileMissing, FileDamaged: a file is not there, cut off, or no text model.
        CalibrationInvalid: a lens is of a model that is not read, or an image names a camera that is not there.

    Reference: COLMAP, "Output Format" (text) and "Camera Models".
    """
    lenses: dict[str, tuple[np.ndarray, np.ndarray, tuple[int, int], str]] = {}
    for number, *fields in _rows(folder / CAMERAS):
        lenses[number] = _lens(fields, f"{folder / CAMERAS}, camera {number}")
    entries = []
    for row in _rows(folder / IMAGES, every=2):
        place = str(folder / IMAGES)
        if len(row) < 10:
            raise FileDamaged(f"An image has {len(row)} fields; 10 are expected.", where=place)
        q, t = _numbers(row[1:5], place), _numbers(row[5:8], place)
        if row[8] not in lenses or not 0.5 < np.linalg.norm(q) < 2.0:
            raise CalibrationInvalid("The image has no camera or no rotation.", where=f"{place}, image {row[9]}")
        K, bent, size, model = lenses[row[8]]
        R = np.asarray(matrix_from_quat(q / np.linalg.norm(q)))
        entries.append(CameraEntry(Path(" ".join(row[9:])).stem, K, bent, R, t, size, model))
    return StatedCameras(entries)


def _lens(fields: list[str], place: str) -> tuple[np.ndarray, np.ndarray, tuple[int, int], str]:
    known = _MODELS.get(fields[0]) if fields else None
    if known is None:
        hint = f"Read are {', '.join(_MODELS)}."
        raise CalibrationInvalid(f"The lens model {fields[0] if fields else ''} is not read.", where=place, hint=hint)
    model, focals, which = known
    values = _numbers(fields[1:], place)
    if len(values) != 2 + focals + 2 + len(which):
        raise FileDamaged(f"{fields[0]} has {len(values) - 2} parameters; others are expected.", where=place)
    if not np.isfinite(values).all():
        raise FileDamaged("The lens has values that are not numbers.", where=place)
    size, values = (round(float(values[0])), round(float(values[1]))), values[2:]
    f, centre = values[[0, focals - 1]], values[focals : focals + 2] - 0.5
    bent = np.zeros(MOST_TERMS)
    bent[list(which)] = values[focals + 2 :]
    return np.array([[f[0], 0, centre[0]], [0, f[1], centre[1]], [0, 0, 1.0]]), bent, size, model


def _rows(path: Path, every: int = 1) -> list[list[str]]:
    """Return the fields of the lines that are no comments; of ``images.txt`` every other, points lie between."""
    lines = [line for line in read_text(path).splitlines() if not line.startswith("#")]
    return [line.split() for line in lines[::every] if line.strip()]


def _numbers(fields: list[str], place: str) -> np.ndarray:
    try:
        return np.array(fields, dtype=np.float64)
    except ValueError as error:
        what = f"A number is expected where the file holds something else ({error})."
        raise FileDamaged(what, where=place) from error
