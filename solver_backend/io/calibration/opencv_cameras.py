"""Calibrations of matrices by name, in YAML, JSON or arrays: one file a camera, or one file for all."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import LENS_MODELS, model_named
from solver_backend.exchange.npz import array_names, read_npz
from solver_backend.io.calibration.camera_fields import (
    DLT_NUMBERS,
    camera_entry,
    cameras_in_stacks,
    is_camera,
    is_field,
    is_projection,
    numbers,
    projection_of,
)
from solver_backend.io.calibration.entry import CameraEntry, StatedCameras
from solver_backend.io.calibration.yaml_storage import read_yaml
from solver_backend.io.files import read_json, read_text, read_toml

_FROM_PREVIOUS = "T_cn_cnm1"
"""(4, 4) from the previous camera's axes to this one's."""


def kalibr_nodes(tree: Any) -> list[tuple[str, Mapping[str, Any]]] | None:
    """Return name and values of each camera of a ``camchain.yaml``; None where the content is no such file.

    Raises:
        CalibrationInvalid: a pose is missing or no matrix of 4 x 4, or a camera has another model than a pinhole.

    Reference: Furgale, Rehder and Siegwart 2013; the file is described in Kalibr's wiki, "YAML formats".
    """
    nodes = list(tree.items()) if isinstance(tree, Mapping) else []
    if len(nodes) < 2 or not all(isinstance(node, Mapping) and "intrinsics" in node for _, node in nodes):
        return None
    if not any(_FROM_PREVIOUS in node for _, node in nodes):
        return None
    pose, found = np.eye(4), []
    for i, (name, node) in enumerate(nodes):
        place = f"camera {name}"
        if str(node.get("camera_model", "pinhole")) != "pinhole":
            what = f"Not supported: Kalibr's camera model {node['camera_model']}."
            raise CalibrationInvalid(what, where=place, hint="Calibrate with pinhole-radtan or pinhole-equi.")
        step = numbers(node.get(_FROM_PREVIOUS, np.eye(4) if i == 0 else []), place)
        if step.shape != (4, 4):
            raise CalibrationInvalid(f"{_FROM_PREVIOUS} has shape {step.shape}; (4, 4) is expected.", where=place)
        pose = step @ pose
        found.append((str(name), {**node, "extrinsics": pose}))
    return found


_MOST_CAMERAS = 256
_FIELDS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2", "camera_angle_x")
"""Values of a picture, or of all; ``camera_angle_x`` is the horizontal field of view in radians."""
_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Graphics look along -z with y up; OpenCV along z with y down."""


def nerf_nodes(tree: Any) -> list[tuple[str, Mapping[str, Any]]] | None:
    """Return name and values of each camera; None where the content is no such file or its cameras move.

    ``transform_matrix`` takes the camera's axes to the world; its inverse, turned to OpenCV's axes, is the extrinsic
    matrix. A camera is named by its picture, or by the picture's folder where all pictures have one name.

    Raises:
        CalibrationInvalid: a matrix holds what is no number, or the focal length is missing.
    """
    frames = tree.get("frames") if isinstance(tree, Mapping) else None
    if not isinstance(frames, list) or not 0 < len(frames) <= _MOST_CAMERAS:
        return None
    if not all(isinstance(frame, Mapping) and "transform_matrix" in frame for frame in frames):
        return None
    pictures = [PurePosixPath(str(frame.get("file_path", i))) for i, frame in enumerate(frames)]
    stems = [picture.stem for picture in pictures]
    names = stems if len(set(stems)) == len(stems) else [picture.parent.name for picture in pictures]
    if len(set(names)) < len(names):
        return None
    return [(name, _node(tree, frame, name)) for name, frame in zip(names, frames, strict=True)]


def _node(tree: Mapping[str, Any], frame: Mapping[str, Any], name: str) -> dict[str, Any]:
    place = f"camera {name}"
    stated = {key: frame.get(key, tree.get(key)) for key in _FIELDS}
    found = {key: None if value is None else _number(value, place) for key, value in stated.items()}
    pose = numbers(frame["transform_matrix"], place)
    width, angle = found["w"], found["camera_angle_x"]
    by_angle = 0.5 * width / math.tan(0.5 * angle) if width and angle and 0 < angle < math.pi else None
    focal = found["fl_x"] or by_angle
    if not focal:
        hint = "Write fl_x, or camera_angle_x with w, for each picture or for all."
        raise CalibrationInvalid("The camera has no focal length.", where=place, hint=hint)
    model = model_named(str(frame.get("camera_model", tree.get("camera_model"))))
    node = {"fx": focal, "fy": found["fl_y"] or focal, "width": width, "height": found["h"], "model": model}
    node |= {"cx": _middle(found["cx"], width), "cy": _middle(found["cy"], found["h"])}
    node["distortion"] = [found[key] or 0.0 for key in LENS_MODELS[model].terms[:4]]
    if pose.shape == (4, 4) and np.isfinite(pose).all() and abs(np.linalg.det(pose)) > 0:
        node["extrinsics"] = np.linalg.inv(pose @ _TO_OPENCV)
    return {key: value for key, value in node.items() if value is not None}


def _number(value: Any, place: str) -> float:
    array = numbers(value, place)
    if array.size != 1:
        raise CalibrationInvalid("A number is expected where the file holds several.", where=place)
    return float(array.reshape(-1)[0])


def _middle(stated: float | None, size: float | None) -> float | None:
    return 0.5 * size if stated is None and size is not None else stated


SUFFIXES = (".npz", ".txt", ".csv")
_LARGEST_TEXT, _LARGEST_ARRAYS = 1 << 16, 1 << 24
"""Bytes of a file that is looked at."""
_NAMES = ("names", "camera_names", "cameras")


def matrix_nodes(path: Path) -> list[tuple[str, Mapping[str, Any]]]:
    """Return name and values of each camera in a file, none where it is something else.

    Raises:
        FileDamaged: an ``.npz`` is truncated.
    """
    small = path.stat().st_size <= (_LARGEST_ARRAYS if path.suffix.lower() == ".npz" else _LARGEST_TEXT)
    if not small or path.suffix.lower() not in SUFFIXES:
        return []
    return _of_arrays(path) if path.suffix.lower() == ".npz" else _of_text(path)


def _of_arrays(path: Path) -> list[tuple[str, Mapping[str, Any]]]:
    if "format" in array_names(path):  # our own files, which have readers
        return []
    values = read_npz(path, lambda name: is_field(name) or name in _NAMES)
    if not is_camera(values):
        return []
    count = next((len(v) for v in values.values() if v.ndim == 3 and v.shape[1:] in ((3, 3), (3, 4))), 0)
    if not count:
        return [(path.stem, values)]
    names = next((values[n].astype(str).tolist() for n in _NAMES if n in values and values[n].shape == (count,)), None)
    names = names or [f"cam_{i + 1}" for i in range(count)]
    split = {key: value for key, value in values.items() if value.ndim and len(value) == count and key not in _NAMES}
    return [(name, {key: value[i] for key, value in split.items()}) for i, name in enumerate(names)]


def _of_text(path: Path) -> list[tuple[str, Mapping[str, Any]]]:
    rows = [line.replace(",", " ").split() for line in read_text(path).splitlines() if line.strip()]
    if len(rows) not in (3, DLT_NUMBERS) or len({len(row) for row in rows}) != 1:
        return []
    try:
        table = np.array(rows, dtype=np.float64)
    except ValueError:
        return []
    if table.shape == (3, 4):
        return [(path.stem, {"projection": table})]
    if len(table) != DLT_NUMBERS or table.shape[1] < 2:
        return []
    return [(f"cam_{i + 1}", {"projection": projection_of(column)}) for i, column in enumerate(table.T)]


_SUFFIXED = {"K": "K", "dist": "distortion", "R": "rotation", "T": "translation", "H": "height", "W": "width"}
"""Matrices named ``K_<camera>`` and so on, as EasyMocap's intri.yml and extri.yml do."""

_ALL = "cameras", "cams", "calibration"
"""Keys in small letters under which a file may hold all of its cameras."""


def read_opencv_tree(path: Path) -> Any:
    """Return the nested content of one YAML or JSON file.

    Raises:
        FileMissing, FileDamaged: it is not there, truncated, or neither.
    """
    return read_json(path) if path.suffix.lower() == ".json" else read_yaml(path)


@dataclass(frozen=True)
class MatrixFile:
    """What one file holds of cameras, as it is written."""

    path: Path
    nodes: list[tuple[str, Mapping[str, Any]]]
    """Name and values of each camera that it describes whole."""
    parts: dict[str, dict[str, Any]]
    """Values by camera of matrices named after it, which may be spread over several files."""


def read_matrix_file(path: Path) -> MatrixFile:
    """Return what one file holds.

    Raises:
        FileMissing, FileDamaged: see ``read_opencv_tree``.
    """
    if path.suffix.lower() in SUFFIXES:
        return MatrixFile(path, matrix_nodes(path), {})
    tree = read_opencv_tree(path)
    return MatrixFile(path, _camera_nodes(path.stem, tree), _suffixed_nodes(tree))


def opencv_cameras(files: Sequence[MatrixFile]) -> list[CameraEntry]:
    """Return the cameras of one or several files, in the files' unit; files without cameras are passed over.

    Understood are arrays and projection matrices (``matrix_nodes``), NeRF's pictures, a camera's matrices at the top of
    a file (named by ``camera_name``, ``name`` or the file), a node for each camera, a list ``cameras``, and matrices
    named ``K_<camera>``, ``dist_<camera>``, ``R_<camera>`` and ``T_<camera>``, which may be spread over two files.

    Raises:
        CalibrationInvalid: see ``camera_entry``.
    """
    entries: list[CameraEntry] = []
    suffixed: dict[str, dict[str, Any]] = {}
    for file in files:
        entries += [camera_entry(name, node, where=str(file.path)) for name, node in file.nodes]
        for camera, values in file.parts.items():
            suffixed.setdefault(camera, {}).update(values)
    where = str(files[0].path.parent) if files else ""
    entries += [camera_entry(name, node, where=where) for name, node in suffixed.items() if is_camera(node)]
    return entries


def _camera_nodes(stem: str, tree: Any) -> list[tuple[str, Mapping[str, Any]]]:
    for nodes_of in TREES:
        if (recorded := nodes_of(tree)) is not None:
            return recorded
    if is_camera(tree):
        return _stacked(tree) or [(stem, tree)]
    nodes: list[tuple[str, Any]]
    if isinstance(tree, Mapping):
        nodes = [(str(key), {"projection": node} if _is_projection(node) else node) for key, node in tree.items()]
    elif isinstance(tree, list):
        nodes = [(f"cam_{i}", node) for i, node in enumerate(tree)]
    else:
        return []
    found = [(name, node) for name, node in nodes if is_camera(node)]
    if len(found) == 1 and (stacked := _stacked(found[0][1])):
        return stacked
    if not found and isinstance(tree, Mapping):
        inner = next((node for key, node in tree.items() if str(key).lower() in _ALL), None)
        return _camera_nodes(stem, inner) if inner is not None else []
    return found


def _is_projection(node: Any) -> bool:
    return isinstance(node, list) and len(node) == 3 and is_projection(node)


def _stacked(node: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    return [(f"cam_{i + 1}", values) for i, values in enumerate(cameras_in_stacks(node))]


def _suffixed_nodes(tree: Any) -> dict[str, dict[str, Any]]:
    cameras: dict[str, dict[str, Any]] = {}
    for key, value in tree.items() if isinstance(tree, Mapping) else ():
        kind, _, camera = str(key).partition("_")
        if kind in _SUFFIXED and camera and (isinstance(value, Mapping) or kind in "HW"):
            cameras.setdefault(camera, {})[_SUFFIXED[kind]] = value
    return cameras


def _human36m_nodes(tree: Any) -> list[tuple[str, Mapping[str, Any]]] | None:
    """Return the cameras of Human3.6M's JSON: ``intrinsics[camera]`` and ``extrinsics[subject][camera]``; None else."""
    inner, outer = (tree.get("intrinsics"), tree.get("extrinsics")) if isinstance(tree, Mapping) else (None, None)
    if not isinstance(inner, Mapping) or not isinstance(outer, Mapping) or not all(map(is_camera, inner.values())):
        return None
    by_subject = [cameras for cameras in outer.values() if isinstance(cameras, Mapping)]
    subjects = [cameras for cameras in by_subject if all(isinstance(camera, Mapping) for camera in cameras.values())]
    if not subjects or len(subjects) < len(outer):
        return None
    if len(subjects) > 1:
        what = f"The file holds the cameras of {len(subjects)} subjects: {', '.join(map(str, outer))}."
        raise CalibrationInvalid(what, hint="Keep the entry under 'extrinsics' of the subject who was recorded.")
    return [(str(name), {**inner[name], **camera}) for name, camera in subjects[0].items() if name in inner]


def camera_tables(tables: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield name and table of each camera: ``[cam_01]``, or ``[cameras.0]`` as ``cam_0``; ignored ones are left out."""
    for key, table in tables.items():
        if not isinstance(table, Mapping) or table.get("ignore") is True:
            continue
        if is_camera(table):
            yield (f"cam_{key}" if key.isdigit() else key), table
        elif key == "cameras":
            yield from camera_tables(table)


def read_toml_cameras(path: Path) -> StatedCameras:
    """Return the cameras of a TOML calibration, in the file's unit.

    Each has a table with ``matrix`` (3, 3), ``distortions``, ``rotation`` (a Rodrigues vector or a matrix, world to
    camera) and ``translation``; ``size`` and ``fisheye`` may be missing.

    Raises:
        FileMissing, FileDamaged: the file is not there or is not TOML.
        CalibrationInvalid: a camera lacks a value or has one of a wrong size.
    """
    return StatedCameras([camera_entry(name, node, where=str(path)) for name, node in camera_tables(read_toml(path))])


TREES: tuple[Callable[[Any], list[tuple[str, Mapping[str, Any]]] | None], ...] = (
    _human36m_nodes,
    nerf_nodes,
    kalibr_nodes,
)
"""Formats of YAML and JSON that do not hold one node per camera: name and values of each camera, None elsewhere."""
