"""Calibrations of matrices by name, in YAML, JSON or arrays: one file a camera, or one file for all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.io.calibration.camera_fields import camera_entry, cameras_in_stacks, is_camera, is_projection
from solver_backend.io.calibration.entry import CameraEntry
from solver_backend.io.calibration.kalibr_cameras import kalibr_nodes
from solver_backend.io.calibration.matrix_files import SUFFIXES, matrix_nodes
from solver_backend.io.calibration.nerf_cameras import nerf_nodes
from solver_backend.io.calibration.yaml_storage import read_yaml
from solver_backend.io.files import read_json

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
    for special in (_human36m_nodes, nerf_nodes, kalibr_nodes):
        if (recorded := special(tree)) is not None:
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
    """Whether a value is a list of three rows of four; long lists are not looked through."""
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
    """Return the cameras of Human3.6M's JSON: ``intrinsics[camera]`` and ``extrinsics[subject][camera]``; None else.

    Raises:
        CalibrationInvalid: it holds the extrinsics of several subjects, and nothing shows whose the recording is.
    """
    inner, outer = (tree.get("intrinsics"), tree.get("extrinsics")) if isinstance(tree, Mapping) else (None, None)
    if not isinstance(inner, Mapping) or not isinstance(outer, Mapping) or not all(map(is_camera, inner.values())):
        return None
    by_subject = [cameras for cameras in outer.values() if isinstance(cameras, Mapping)]
    subjects = [cameras for cameras in by_subject if all(isinstance(camera, Mapping) for camera in cameras.values())]
    if not subjects or len(subjects) < len(outer):
        return None
    if len(subjects) > 1:
        raise CalibrationInvalid(
            f"The file holds the cameras of {len(subjects)} subjects: {', '.join(map(str, outer))}.",
            hint="Keep the entry under 'extrinsics' of the subject who was recorded.",
        )
    return [(str(name), {**inner[name], **camera}) for name, camera in subjects[0].items() if name in inner]
