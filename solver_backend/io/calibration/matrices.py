"""Read cameras stored as named matrices in TOML, YAML, JSON, XML, array and text files."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from solver_backend.body.files.restricted_pickle import read_pickle
from solver_backend.exchange.errors import BodyInvalid, FileDamaged, UnsafePickle
from solver_backend.exchange.npz import array_names, read_npz
from solver_backend.io.calibration.camera_values import (
    SPELLINGS,
    Values,
    camera_entry,
    has_lens,
    has_pose,
    plain,
    projection_of,
)
from solver_backend.io.calibration.entry import StatedCameras
from solver_backend.io.calibration.forms import Content, cameras_in_tree
from solver_backend.io.calibration.yaml_storage import read_yaml
from solver_backend.io.camera_names import listing, match_names
from solver_backend.io.files import LARGEST_TEXT, first_bytes, read_json, read_text, read_toml, read_xml

DLT_NUMBERS = 11  # DLT coefficients per camera: the projection matrix divided by its last element, by rows.
_LARGEST_TEXT, _LARGEST_ARRAYS = 1 << 16, 1 << 24  # Size limits of a text file and of an array file, in bytes.
_CAMERA_NAMES = ("names", "camera_names", "cameras")
_KINDS = ("intrinsic", "intrinsics", "intri", "extrinsic", "extrinsics", "extri")  # Not names of cameras.
_LIKE_CALIBRATION = re.compile(r"calib|extri|intri|stereo|cam(era)?(s|_?(param|pose|info)\w*)?$", re.IGNORECASE)
_TELLING = {
    n for what in ("K", "distortion", "rotation", "translation", "extrinsics") for n in SPELLINGS[what] if n[3:]
}
"""Keys with more than three letters that suggest a calibration."""
_NUMBER = re.compile(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?", re.IGNORECASE)
_HEAD = 256  # Number of bytes read to recognise an XML file.
_MOST_KEYS = 8  # Largest number of keys listed in a message.


@dataclass(frozen=True)
class MatrixFile:
    """Cameras in one file, before their values are interpreted."""

    path: Path
    content: Content
    keys: str = ""
    """Keys of the file, for messages. Set if the file may be a calibration in an unknown format."""

    @property
    def holds_array(self) -> bool:
        """True if the file contains intrinsics and poses of at least two cameras."""
        nodes = self.content.nodes
        return len(nodes) > 1 and all(has_lens(values) and has_pose(values) for _, values in nodes)


def read_toml_cameras(path: Path) -> StatedCameras:
    """Read the cameras in a TOML calibration of Pose2Sim, anipose or caliscope.

    Each camera is a table with ``matrix`` (3, 3), ``distortions``, ``rotation`` (Rodrigues vector or matrix, world to
    camera) and ``translation``. ``size`` and ``fisheye`` are optional.
    """
    return StatedCameras([camera_entry(name, node, where=str(path)) for name, node in camera_tables(read_toml(path))])


def camera_tables(tables: Values) -> Iterator[tuple[str, Values]]:
    """Yield each camera's name and table. The table ``[cameras.0]`` has the name ``cam_0``."""
    for key, table in tables.items():
        if not isinstance(table, Mapping) or table.get("ignore") is True:
            continue
        if has_lens(table):
            yield (f"cam_{key}" if key.isdigit() else key), table
        elif key == "cameras":
            yield from camera_tables(table)


def read_matrix_file(path: Path, nested: bool = False) -> MatrixFile:
    """Read the cameras in a file with a suffix in ``READ``. With ``nested``, the folder name is the camera name."""
    read, largest = READ[path.suffix.lower()]
    if path.is_file() and path.stat().st_size > largest:
        return MatrixFile(path, Content([]))
    nested = nested and path.parent.name.lower() not in _KINDS
    tree = read(path)
    content = cameras_in_tree(path.parent.name if nested else path.stem, tree)
    return MatrixFile(path, content, "" if content.nodes else _keys(path, tree))


def stated_cameras(files: Sequence[MatrixFile]) -> StatedCameras:
    """Combine the cameras of several files. Intrinsics and poses of the same camera are merged."""
    whole: list[tuple[str, Values, str]] = []
    lenses: dict[str, dict[str, Any]] = {}
    poses: dict[str, dict[str, Any]] = {}
    where = str(files[0].path.parent if len(files) > 1 else files[0].path) if files else ""
    for file in files:
        for name, values in file.content.nodes:
            if has_lens(values) and has_pose(values):
                whole.append((name, values, str(file.path)))
            else:
                part = lenses if has_lens(values) else poses
                part.setdefault(str(values.get("camera_name") or name), {}).update(values)
    order = match_names(list(lenses), list(poses)) if lenses and poses else None
    by_lens = dict(zip(lenses, (list(poses)[i] for i in order), strict=True)) if order is not None else {}
    for name, lens in lenses.items():
        pose = poses.get(by_lens.get(name, name), {})
        fixed = {key: value for key, value in lens.items() if not pose or plain(key) not in SPELLINGS["rotation"]}
        whole.append((name, {**fixed, **pose}, where))
    contents = [file.content for file in files if file.content.nodes]
    unit, up = ({getattr(content, name) for content in contents} - {""} for name in ("unit", "up_axis"))
    entries = [camera_entry(name, values, where=place) for name, values, place in whole]
    stated: dict[str, Any] = {"unit": unit.pop() if len(unit) == 1 else "", "up_axis": up.pop() if len(up) == 1 else ""}
    return StatedCameras(entries, **stated, source="file" if any(stated.values()) else "default")


def _keys(path: Path, tree: Any) -> str:
    """Describe the keys of a file that may be a calibration, for a message. Return '' for other files."""
    if not isinstance(tree, Mapping) or not tree:
        return ""
    inner = next((node for node in tree.values() if isinstance(node, Mapping) and node), {})
    if len({plain(key) for key in (*tree, *inner)} & _TELLING) < 2 and not _LIKE_CALIBRATION.search(path.stem):
        return ""
    texts = [listing([str(key) for key in node][:_MOST_KEYS]) for node in (tree, inner) if node]
    return ", and in the first ".join(texts)


def _of_arrays(path: Path) -> Any:
    """Read the arrays of an .npz file. If arrays have one entry per camera, they are split into one node per camera."""
    if "format" in array_names(path):  # our own formats have their own readers
        return {}
    known = {name for names in SPELLINGS.values() for name in names}
    values = read_npz(path, lambda name: plain(name) in known or name in _CAMERA_NAMES)
    count = next((len(v) for v in values.values() if v.ndim == 3 and v.shape[1:] in ((3, 3), (3, 4))), 0)
    if not count or not has_lens(values):
        return values
    listed = (values[name] for name in _CAMERA_NAMES if name in values and values[name].shape == (count,))
    names = next((found.astype(str).tolist() for found in listed), [f"cam_{i + 1}" for i in range(count)])
    split = {k: value for k, value in values.items() if value.ndim and len(value) == count and k not in _CAMERA_NAMES}
    return {name: {key: value[i] for key, value in split.items()} for i, name in enumerate(names)}


def _of_text(path: Path) -> Any:
    """Read a text file with one projection matrix, or with a column of DLT coefficients per camera."""
    rows = [line.replace(",", " ").split() for line in read_text(path).splitlines() if line.strip()]
    if len(rows) not in (3, DLT_NUMBERS) or len({len(row) for row in rows}) != 1:
        return {}
    try:
        table = np.array(rows, dtype=np.float64)
    except ValueError:
        return {}
    if table.shape == (3, 4):
        return {"projection": table}
    if len(table) != DLT_NUMBERS or table.shape[1] < 2:
        return {}
    return {f"cam_{i + 1}": {"projection": projection_of(column)} for i, column in enumerate(table.T)}


def _of_xml(path: Path) -> Any:
    """Read OpenCV's XML storage. Return {} for other XML files."""
    if b"<opencv_storage" not in first_bytes(path, _HEAD):
        return {}
    return _storage(read_xml(path, LARGEST_TEXT, "OpenCV's XML"))


def _of_pickle(path: Path) -> Any:
    """Read the arrays in a pickle if its name suggests a calibration, else return {}. Code in the file is never run."""
    if not _LIKE_CALIBRATION.search(path.stem):
        return {}
    try:
        return read_pickle(path)
    except (BodyInvalid, UnsafePickle) as error:
        hint = "Write its arrays with numpy.savez or as JSON."
        raise FileDamaged(f"The pickle has more than arrays: {error.message}", where=str(path), hint=hint) from error


def _storage(node: ElementTree.Element) -> Any:
    if len(node):
        if all(child.tag == "_" for child in node):
            return [_storage(child) for child in node]
        return {child.tag: _storage(child) for child in node}
    text = (node.text or "").strip()
    words = text.split()
    if node.tag == "data" or (len(words) > 1 and all(map(_NUMBER.fullmatch, words))):
        return words
    return int(text) if text.isdecimal() and len(text) < 10 else text


READ: Mapping[str, tuple[Callable[[Path], Any], int]] = {
    ".yml": (read_yaml, LARGEST_TEXT),
    ".yaml": (read_yaml, LARGEST_TEXT),
    ".json": (read_json, LARGEST_TEXT),
    ".xml": (_of_xml, LARGEST_TEXT),
    ".pickle": (_of_pickle, LARGEST_TEXT),
    ".pkl": (_of_pickle, LARGEST_TEXT),
    ".npz": (_of_arrays, _LARGEST_ARRAYS),
    ".txt": (_of_text, _LARGEST_TEXT),
    ".csv": (_of_text, _LARGEST_TEXT),
}
"""For each suffix, the function that reads the nested content, and the size limit in bytes."""
