"""Read Qualisys, Vicon and Metashape calibrations (XML) and COLMAP text models."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid, FileDamaged
from solver_backend.exchange.lens import DEFAULT_MODEL, FISHEYE, LENS_MODELS
from solver_backend.exchange.lens_model import MOST_TERMS
from solver_backend.geometry.rotations import matrix_from_quat
from solver_backend.io.calibration.entry import CameraEntry, StatedCameras
from solver_backend.io.files import LARGEST_TEXT, first_bytes, read_text, read_xml

SUBPIXELS = 64.0  # Qualisys writes focal lengths and principal points in 1/64 pixel.
TO_OPENCV_AXES = np.diag([1.0, -1.0, -1.0])  # Qualisys cameras look along -Z with Y up, OpenCV's along Z with Y down.
_HEAD = 4096  # Number of bytes read to recognise the program that wrote an XML file.
_LARGEST_NUMBER = 1e12  # Largest allowed magnitude of a number in a file, chosen by hand.
_ROWS = re.compile(r"(\d{3,4})p", re.IGNORECASE)  # Matches ``video_resolution="540p"``.
_SAME_ROWS = 0.05  # Relative tolerance between row counts. A sensor with 1088 rows records 1080p.


def read_qualisys(path: Path) -> StatedCameras:
    """Read the cameras in a Qualisys calibration in mm.

    For each camera, the file has the centre ``c`` in mm in a world with Z up, and the rows ``r1, r2, r3`` of the
    rotation from world to camera. These rows point right, up and backward. Hence ``R = diag(1, -1, -1) [r1; r2; r3]``
    and ``t = -R c``. ``K = [[fU, skew, cU - left], [0, fV, cV - top], [0, 0, 1]] / 64``, where left and top are the
    edges of the video's field of view in whole pixels. The distortion coefficients are OpenCV's unitless k1 k2 p1 p2
    k3. Independent checkerboard calibrations of such cameras give the same values.
    """
    nodes = read_xml(path, LARGEST_TEXT, "Qualisys' XML").findall("cameras/camera")
    if not nodes:
        raise FileDamaged("The file lists no cameras.", where=str(path), hint="Export the calibration again.")
    videos = [n for n in nodes if "video" in n.get("model", "").lower()]
    used = [n for n in (videos or nodes) if n.get("active", "1") != "0"]
    problems = [
        diagnostic("qualisys_view_turned", cameras=[n.get("serial", "")], angle=n.get("viewrotation"))
        for n in used
        if n.get("viewrotation", "0") not in ("0", "")
    ]
    entries = [_entry(node, path) for node in used]
    if all(_in_whole_pixels(entry) for entry in entries):
        entries = [replace(e, K=np.diag([SUBPIXELS, SUBPIXELS, 1.0]) @ e.K) for e in entries]
        problems.append(diagnostic("calibration_read_as", convention="whole_pixels", cameras=[e.name for e in entries]))
    problems += _other_resolutions(used, entries)
    return StatedCameras(entries, unit="mm", up_axis="z", source="qualisys", problems=tuple(problems))


def _in_whole_pixels(entry: CameraEntry) -> bool:
    """Return whether a Qualisys file gives intrinsics in pixels instead of the usual 1/64 pixel.

    This is the case if the principal point is near the image centre only when the values are read as pixels.
    """
    assert entry.image_size is not None
    middle = 0.5 * np.array(entry.image_size)
    return bool((np.abs(SUBPIXELS * entry.K[:2, 2] - middle) < 0.5 * middle).all() and entry.K[0, 2] < middle[0] / 8)


def _other_resolutions(nodes: list[ElementTree.Element], entries: list[CameraEntry]) -> list[Diagnostic]:
    found: dict[tuple[int, int], list[str]] = {}
    for node, entry in zip(nodes, entries, strict=True):
        stated = _ROWS.fullmatch(node.get("video_resolution", "").strip())
        assert entry.image_size is not None
        rows, calibrated = int(stated[1]) if stated else 0, entry.image_size[1]
        if rows and abs(rows - calibrated) > _SAME_ROWS * calibrated:
            found.setdefault((rows, calibrated), []).append(entry.name)
    return [
        diagnostic("qualisys_resolution", cameras=names, rows=rows, calibrated=calibrated)
        for (rows, calibrated), names in found.items()
    ]


def _entry(node: ElementTree.Element, path: Path) -> CameraEntry:
    name = node.get("serial", "")
    place = f"{path}, camera {name}"
    transform, intrinsic = node.find("transform"), node.find("intrinsic")
    if transform is None or intrinsic is None:
        tag, hint = "transform" if transform is None else "intrinsic", "Export the calibration again."
        raise CalibrationInvalid(f"The camera has no <{tag}>.", where=place, hint=hint)
    rows = [[_number(transform, f"r{row}{column}", place) for column in (1, 2, 3)] for row in (1, 2, 3)]
    centre = np.array([_number(transform, key, place) for key in "xyz"])
    left, top, size = _field_of_view(node, intrinsic, place)
    keys = ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
    f_u, f_v, c_u, c_v = (_number(intrinsic, key, place) / SUBPIXELS for key in keys)
    skew = _number(intrinsic, "skew", place, default=0.0) / SUBPIXELS
    k1, k2, k3 = (_number(intrinsic, f"radialDistortion{i}", place, default=0.0) for i in (1, 2, 3))
    p1, p2 = (_number(intrinsic, f"tangentalDistortion{i}", place, default=0.0) for i in (1, 2))
    R = TO_OPENCV_AXES @ np.array(rows)
    K = np.array([[f_u, skew, c_u - left], [0.0, f_v, c_v - top], [0.0, 0.0, 1.0]])
    return CameraEntry(name, K, np.array([k1, k2, p1, p2, k3]), R, np.negative(R @ centre), size)


def _field_of_view(
    node: ElementTree.Element, intrinsic: ElementTree.Element, place: str
) -> tuple[float, float, tuple[int, int]]:
    """Return the left edge, top edge and size (width, height) of the video's field of view in pixels."""
    views = (node.find("fov_video"), node.find("fov_video_max"))
    view = next((view for view in views if view is not None), None)
    if view is None:
        size = [_number(intrinsic, f"sensorMax{axis}", place) / SUBPIXELS + 1 for axis in "UV"]
        return 0.0, 0.0, (round(size[0]), round(size[1]))
    left, top, right, bottom = (_number(view, side, place) for side in ("left", "top", "right", "bottom"))
    return left, top, (round(right - left) + 1, round(bottom - top) + 1)


def _number(node: ElementTree.Element, key: str, place: str, *, default: float | None = None) -> float:
    text = node.get(key)
    if text is None and default is not None:
        return default
    with suppress(ValueError):
        if abs(value := float(text or "")) < _LARGEST_NUMBER:
            return value
    raise CalibrationInvalid(f"'{key}' of <{node.tag}> is {text!r}, not a number.", where=place)


def read_vicon(path: Path) -> StatedCameras:
    """Read a Vicon calibration (.xcp) in mm. If it contains video cameras, only these are read.

    The last key frame contains the focal length in pixels, the principal point, the position, and the orientation from
    world to camera as a quaternion xyzw. ``VICON_RADIAL2`` has a centre and three radial coefficients in OpenCV's
    model. ``VICON_RADIAL`` has two coefficients.
    """
    found = [(node, frames[-1]) for node in read_xml(path, LARGEST_TEXT, "Vicon's XML").iter("Camera")
             if (frames := node.findall("KeyFrames/KeyFrame")) and frames[-1].get("FOCAL_LENGTH")]  # fmt: skip
    videos = [
        pair for pair in found if re.search("vue|video", pair[0].get("DISPLAY_TYPE", pair[0].get("TYPE", "")), re.I)
    ]
    entries = []
    for node, frame in videos or found:
        name = node.get("DEVICEID") or node.get("USERID", "")
        place = f"{path}, camera {name}"
        keys = {"ORIENTATION": 4, "POSITION": 3, "PRINCIPAL_POINT": 2, "FOCAL_LENGTH": 1}
        q, centre, middle, (f,) = (_listed(frame, key, count, place) for key, count in keys.items())
        aspect = _number(node, "PIXEL_ASPECT_RATIO", place, default=1.0)
        radial = frame.get("VICON_RADIAL2", "").split()[3:6] or frame.get("VICON_RADIAL", "").split()[:2]
        k1, k2, k3 = np.pad(_numbers(radial, place), (0, 3))[:3]
        K = np.array([[f, 0.0, middle[0]], [0.0, f / (aspect or 1.0), middle[1]], [0.0, 0.0, 1.0]])
        if not 0.5 < np.linalg.norm(q) < 2.0:
            raise CalibrationInvalid("'ORIENTATION' is not a unit quaternion.", where=place)
        R = np.asarray(matrix_from_quat(q[[3, 0, 1, 2]]))
        width, height = _listed(node, "SENSOR_SIZE", 2, place)
        size = (round(float(width)), round(float(height)))
        entries.append(CameraEntry(name, K, np.array([k1, k2, 0.0, 0.0, k3]), R, np.negative(R @ centre), size))
    return StatedCameras(entries, unit="mm", up_axis="z", source="file")


def _listed(node: ElementTree.Element, key: str, count: int, place: str) -> np.ndarray:
    values = _numbers((node.get(key) or node.findtext(key) or "").split(), place)
    if values.shape != (count,) or not np.isfinite(values).all():
        what = f"'{key}' of <{node.tag}> has {len(values)} numbers, but {count} are expected."
        raise CalibrationInvalid(what, where=place, hint="Export the calibration again.")
    return values


def is_metashape(path: Path) -> bool:
    """Return whether a file is a Metashape camera export in XML."""
    return path.suffix.lower() == ".xml" and b"<chunk" in first_bytes(path, _HEAD)


def read_metashape(path: Path) -> StatedCameras:
    """Read the aligned cameras in Metashape's XML ("Export Cameras"), in the unit of its chunk.

    A camera's ``transform`` is from OpenCV's camera axes to the chunk. The chunk's transform is to the world. ``cx``
    and ``cy`` are offsets from the image centre. ``p1`` and ``p2`` are OpenCV's p2 and p1. The horizontal focal length
    is f + b1 (Agisoft Metashape user manual, appendix D, "Camera models").
    """
    chunk = read_xml(path, LARGEST_TEXT, "Metashape's XML").find("chunk")
    chunk = ElementTree.Element("chunk") if chunk is None else chunk
    lenses = {sensor.get("id"): sensor for sensor in chunk.iter("sensor") if sensor.find("calibration") is not None}
    placed = {c.get("id"): c.find("transform") for c in chunk.iter("component")} | {None: chunk.find("transform")}
    entries = []
    for node in chunk.iter("camera"):
        place, lens = f"{path}, camera {node.get('label')}", lenses.get(node.get("sensor_id"))
        if node.find("transform") is None:  # not aligned
            continue
        if lens is None:
            raise CalibrationInvalid("The camera has no <calibration> of its sensor.", where=place)
        model, K, distortion, size = _sensor(lens, place)
        pose = _listed(node, "transform", 16, place).reshape(4, 4)
        whole = placed.get(node.get("component_id"))
        world = whole if whole is not None else placed[None]
        R, centre = pose[:3, :3], pose[:3, 3]
        if world is not None and world.find("rotation") is not None:
            turn = _listed(world, "rotation", 9, place).reshape(3, 3)
            moved, scale = _listed(world, "translation", 3, place), _listed(world, "scale", 1, place)
            R, centre = turn @ R, scale * (turn @ centre) + moved
        name = Path(node.get("label") or node.get("id", "")).stem
        entries.append(CameraEntry(name, K, distortion, R.T, np.negative(R.T @ centre), size, model))
    return StatedCameras(entries)


_TERMS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")  # Elements of a Metashape lens.


def _sensor(lens: ElementTree.Element, place: str) -> tuple[str, np.ndarray, np.ndarray, tuple[int, int]]:
    """Return a Metashape sensor's lens model, K (3, 3), distortion coefficients and image size."""
    found = lens.findall("calibration")
    used = next((c for c in found if c.get("class") == "adjusted"), found[-1])
    kind, resolution = used.get("type", lens.get("type", "frame")), used.find("resolution")
    if kind not in ("frame", "fisheye", "equidistant_fisheye") or resolution is None:
        hint = "Supported lenses are frame and fisheye cameras with a resolution."
        raise CalibrationInvalid(f"The lens type '{kind}' is not supported.", where=place, hint=hint)
    width, height = (_number(resolution, side, place) for side in ("width", "height"))
    v = {child.tag: _listed(used, child.tag, 1, place)[0] for child in used if (child.text or "").strip()}
    if "f" not in v:
        raise CalibrationInvalid("The lens has no focal length <f>.", where=place)
    f, cx, cy, b1, b2, *k, p1, p2 = (v.get(key, 0.0) for key in _TERMS)
    K = np.array([[f + b1, b2, 0.5 * (width - 1) + cx], [0.0, f, 0.5 * (height - 1) + cy], [0.0, 0.0, 1.0]])
    size = (round(width), round(height))
    if kind != "frame":
        return FISHEYE.name, K, np.array(k), size
    if k[3]:
        raise CalibrationInvalid("The lens has the distortion term k4, which is not supported.", where=place)
    return DEFAULT_MODEL, K, np.array([k[0], k[1], p2, p1, k[2]]), size


CAMERAS, IMAGES = "cameras.txt", "images.txt"
_MODELS = {
    name: (model.name, focals, places) for model in LENS_MODELS.values() for name, focals, places in model.colmap
}
"""For each COLMAP model: our lens model, the number of focal lengths, and our index of each distortion coefficient."""


def is_colmap(folder: Path) -> bool:
    """Return whether a folder contains a COLMAP model as text."""
    return (folder / CAMERAS).is_file() and (folder / IMAGES).is_file()


def read_colmap(folder: Path) -> StatedCameras:
    """Read the cameras of a COLMAP text model, one per image. COLMAP's pixel centres are at 0.5, ours at 0.

    Reference: COLMAP documentation, "Output Format" (text) and "Camera Models".
    """
    cameras, place = _rows(folder / CAMERAS), str(folder / IMAGES)
    lenses = {number: _lens(fields, f"{folder / CAMERAS}, camera {number}") for number, *fields in cameras}
    entries = []
    for row in _rows(folder / IMAGES, every=2):
        if len(row) < 10:
            raise FileDamaged(f"An image has {len(row)} fields, but 10 are expected.", where=place)
        q, t = _numbers(row[1:5], place), _numbers(row[5:8], place)
        if row[8] not in lenses or not 0.5 < np.linalg.norm(q) < 2.0:
            raise CalibrationInvalid("The image has no camera or no rotation.", where=f"{place}, image {row[9]}")
        K, distortion, size, model = lenses[row[8]]
        R = np.asarray(matrix_from_quat(q / np.linalg.norm(q)))
        entries.append(CameraEntry(Path(" ".join(row[9:])).stem, K, distortion, R, t, size, model))
    return StatedCameras(entries)


def _lens(fields: list[str], place: str) -> tuple[np.ndarray, np.ndarray, tuple[int, int], str]:
    known = _MODELS.get(fields[0]) if fields else None
    if known is None:
        hint = f"Supported lens models: {', '.join(_MODELS)}."
        raise CalibrationInvalid(f"Unknown lens model: {fields[0] if fields else ''}.", where=place, hint=hint)
    model, focals, which = known
    values = _numbers(fields[1:], place)
    if len(values) != 2 + focals + 2 + len(which):
        raise FileDamaged(f"{fields[0]} has {len(values) - 2} parameters, which is not the right number.", where=place)
    if not np.isfinite(values).all():
        raise FileDamaged("The lens contains values that are not numbers.", where=place)
    size, values = (round(float(values[0])), round(float(values[1]))), values[2:]
    f, centre = values[[0, focals - 1]], values[focals : focals + 2] - 0.5
    distortion = np.zeros(MOST_TERMS)
    distortion[list(which)] = values[focals + 2 :]
    return np.array([[f[0], 0, centre[0]], [0, f[1], centre[1]], [0, 0, 1.0]]), distortion, size, model


def _rows(path: Path, every: int = 1) -> list[list[str]]:
    """Split a COLMAP file's lines into fields, without comments. ``every=2`` skips each image's line of points."""
    lines = [line for line in read_text(path).splitlines() if not line.startswith("#")]
    return [line.split() for line in lines[::every] if line.strip()]


def _numbers(fields: list[str], place: str) -> np.ndarray:
    try:
        return np.array(fields, dtype=np.float64)
    except ValueError as error:
        what = f"A number is expected but the file has another value ({error})."
        raise FileDamaged(what, where=place) from error
