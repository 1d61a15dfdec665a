"""Calibrations with values by name, in TOML, YAML, JSON or arrays: one file per camera, or one file for all."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import DEFAULT_MODEL, FISHEYE, LENS_MODELS, LensModel, model_named
from solver_backend.exchange.npz import array_names, read_npz
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, largest_finite
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.calibration.entry import CameraEntry, StatedCameras
from solver_backend.io.calibration.yaml_storage import read_yaml
from solver_backend.io.files import read_json, read_text, read_toml

Values = Mapping[str, Any]  # Values of one camera by name: numbers, nested lists, or ``{rows, cols, data}``.
Nodes = list[tuple[str, Values]]  # Name and values of each camera.
DLT_NUMBERS = 11  # DLT numbers of a camera: the projection matrix by rows, divided by its last element.
_SMALLEST_VOLUME = 1e-6
"""Determinant of the directions of three rows. A camera's is fx fy over their lengths, above 0.01 for any lens."""
_TABLE = """
    K: matrix k cameramatrix intrinsics intrinsic intrinsicmatrix mtx cammatrix calibrationmatrix
    P: projection projectionmatrix p proj
    distortion: distortions distortion dist distcoeffs distcoeff distcoef distortioncoefficients distortioncoeffs d
    rotation: rotation r rvec rot rotationvector rotationmatrix extrinsicr orientation quaternion
    translation: translation t tvec translationvector extrinsict position
    extrinsics: extrinsics extrinsic extrinsicmatrix rt worldtocamera
    pose: pose cameratoworld camtoworld c2w cam2world camera2world
    size: size imagesize imgsize resolution
    width: imagewidth width w
    height: imageheight height h
    model: distortionmodel model cameramodel
"""
"""A value and its names in other tools, in lower case without separators, the likeliest first."""
_SPELLINGS = {key.removesuffix(":"): tuple(names) for key, *names in map(str.split, _TABLE.strip().splitlines())}
_FOCAL, _FOCAL_AND_CENTRE = {"fx", "fy", "cx", "cy"}, {"focal_length", "principal_point"}
"""The four numbers of an intrinsic matrix, and the same as one or two focal lengths and two coordinates."""
_TERMS = frozenset(term for model in LENS_MODELS.values() for term in model.terms)  # Names of distortion terms.


def split_projection(P: np.ndarray, place: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return K (3, 3), R (3, 3) and t (3,) of ``P = s K [R | t]``, K with a positive diagonal and a last element of 1.

    The left block is a triangular matrix times a rotation: its RQ factors, from the QR factors of its inverse (Hartley
    and Zisserman 2004, "Multiple View Geometry", section 6.2.4). Skew is left out, because it is 0 in real cameras.

    Args:
        P: (3, 4) in pixels, of any scale and sign.
        place: file and camera, for errors.

    Raises:
        CalibrationInvalid: it is no projection of a camera.
    """
    regular = P.shape == (3, 4) and bool(np.isfinite(P).all())
    M = P[:, :3] if regular else np.zeros((3, 3))
    length = np.linalg.norm(M, axis=1, keepdims=True)
    if not (length > 0).all() or abs(np.linalg.det(M / length)) <= _SMALLEST_VOLUME:
        raise CalibrationInvalid("The projection matrix is not that of a camera.", where=place)
    if np.linalg.det(M) < 0:
        P, M = -P, -M
    Q, U = np.linalg.qr(np.linalg.inv(M))
    signs = np.where(np.diag(U) < 0, -1.0, 1.0)
    R, K = (Q * signs).T, np.linalg.inv(signs[:, None] * U)
    t = np.linalg.solve(K, P[:, 3])
    K = K / K[2, 2]
    K[0, 1] = 0.0
    return K, R, t


def projection_of(dlt: np.ndarray) -> np.ndarray:
    """Return the (3, 4) projection matrix of eleven DLT numbers (Abdel-Aziz and Karara 1971)."""
    return np.append(dlt, 1.0).reshape(3, 4)


def _plain(key: object) -> str:
    return re.sub(r"[^a-z0-9]", "", str(key).lower())


def _find(values: Values, what: str) -> Any:
    keys = {_plain(key): key for key in values}
    return next((values[keys[name]] for name in _SPELLINGS[what] if name in keys), None)


def is_camera(node: Any) -> bool:
    """Return whether a node holds an intrinsic matrix, its four numbers or a projection matrix."""
    if not isinstance(node, Mapping):
        return False
    has_numbers = set(node) >= _FOCAL or set(node) >= _FOCAL_AND_CENTRE
    return _find(node, "K") is not None or has_numbers or _is_projection(_find(node, "P"))


def _is_projection(value: Any) -> bool:
    try:
        return np.shape(value)[-2:] == (3, 4)
    except ValueError:
        return False


def camera_entry(name: str, values: Values, *, where: str) -> CameraEntry:
    """Return the camera of some values; ``name`` is used unless the values hold one.

    Raises:
        CalibrationInvalid: intrinsics, rotation or translation are missing or of a wrong size, or vary over time.
    """
    own = values.get("name", values.get("camera_name"))
    if own in (None, "") and isinstance(values.get("id"), str):
        own = values["id"]
    name = str(own) if own not in (None, "") else name
    place = f"{where}, camera {name}"
    intrinsics, vector = _find(values, "K"), None
    if intrinsics is None and set(values) >= _FOCAL:
        intrinsics = values
    elif intrinsics is None and set(values) >= _FOCAL_AND_CENTRE:
        focal, centre = (numbers(values[key], place).reshape(-1) for key in ("focal_length", "principal_point"))
        intrinsics = np.concatenate([np.resize(focal, 2), centre])
    if intrinsics is None:
        K, R, t = split_projection(numbers(_find(values, "P"), place), place)
    else:
        K = _K(intrinsics, place)
        if K.ndim == 3:
            values = {key: _constant(value, place) for key, value in values.items()}
            K = _K(_find(values, "K"), place)
        R, t = _pose(values, place)
        written = _find(values, "rotation")
        vector = None if written is None else numbers(written, place)
    stated = _find(values, "model")
    model = FISHEYE.name if values.get("fisheye") else model_named(stated) if isinstance(stated, str) else DEFAULT_MODEL
    return CameraEntry(
        name=name,
        K=K,
        distortion=_distortion(values, LENS_MODELS[model], place),
        R=R,
        t=t,
        image_size=_size(values, place),
        model=model,
        rotation_vector=vector.reshape(3) if vector is not None and vector.size == 3 else None,
    )


def numbers(value: Any, place: str) -> np.ndarray:
    """Return nested lists, or a ``{rows, cols, data}`` node, as a float array.

    Raises:
        CalibrationInvalid: it is not a rectangular block of numbers, or one of them is impossible.
    """
    shape = None
    if isinstance(value, Mapping) and "data" in value:
        shape = (value.get("rows", -1), value.get("cols", -1))
        value = value["data"]
    try:
        array = np.array(value, dtype=np.float64)
        array = array if shape is None else array.reshape(shape)
    except (TypeError, ValueError, OverflowError) as error:
        raise CalibrationInvalid("Numbers are expected where the file holds something else.", where=place) from error
    if (largest := largest_finite(array)) > FARTHEST_IN_UNITS:
        most = f"at most {FARTHEST_IN_UNITS:g} is possible"
        raise CalibrationInvalid(f"The camera has a number of {largest:.3g}; {most}.", where=place)
    return array


def _distortion(values: Values, model: LensModel, place: str) -> np.ndarray:
    written = _find(values, "distortion")
    named = written if isinstance(written, Mapping) and "data" not in written else values if written is None else {}
    terms = {_plain(key): value for key, value in named.items() if _plain(key) in _TERMS}
    for letter in "kp" if written is None else "":  # XRPrimer's ``dist_coeff_k`` and ``dist_coeff_p``
        listed = numbers(values.get(f"dist_coeff_{letter}", []), place).reshape(-1)
        terms.update({f"{letter}{i + 1}": value for i, value in enumerate(listed) if f"{letter}{i + 1}" in _TERMS})
    if not terms:
        return np.zeros(0) if written is None else numbers(written, place).reshape(-1)
    return numbers([terms.get(term, 0.0) for term in model.terms], place).reshape(-1)


def _K(value: Any, place: str) -> np.ndarray:
    if isinstance(value, Mapping) and set(value) >= _FOCAL:
        value = [value[key] for key in ("fx", "fy", "cx", "cy")]
    K = numbers(value, place)
    if K.shape == (9,):
        K = K.reshape(3, 3)
    if K.shape == (4,):  # fx, fy, cx, cy, as in Kalibr and ROS
        K = np.array([[K[0], 0.0, K[2]], [0.0, K[1], K[3]], [0.0, 0.0, 1.0]])
    if K.shape == (4, 4):
        K = np.concatenate([K[:2, :3], [[0.0, 0.0, 1.0]]])
    if K.shape[-2:] != (3, 3) or K.ndim > 3:
        raise CalibrationInvalid(f"The intrinsic matrix has shape {K.shape}; (3, 3) is expected.", where=place)
    # A matrix written column by column, as by MATLAB and JARVIS, has the principal point in its last row.
    columns = (K[..., :2, 2] == 0).all() and (K[..., 2, :2] > 0).all() and (K[..., 2, 2] == 1).all()
    return np.swapaxes(K, -1, -2) if columns else K


def _constant(value: Any, place: str) -> Any:
    if not isinstance(value, list):
        return value
    array = np.array(value, dtype=object)
    if not all(item == value[0] for item in value) and array.ndim > 1:
        what = "The camera moves: its calibration differs from frame to frame."
        raise CalibrationInvalid(what, where=place, hint="Only fixed cameras are solved.")
    return value[0] if array.ndim > 1 else value


def _pose(values: Values, place: str) -> tuple[np.ndarray, np.ndarray]:
    keys = ("rotation", "translation", "extrinsics", "pose")
    rotation, translation, extrinsics, pose = (_find(values, key) for key in keys)
    if rotation is not None and translation is not None:
        t = numbers(translation, place).reshape(-1)
        if t.shape != (3,):
            raise CalibrationInvalid(f"The translation has {t.size} numbers; 3 are expected.", where=place)
        R = _rotation(rotation, place)
        return (R.T, -R.T @ t) if values.get("world2cam") is False else (R, t)
    if extrinsics is not None:
        return _rigid(extrinsics, place)
    if pose is not None:
        R, centre = _rigid(pose, place)
        return R.T, -R.T @ centre
    lacking = "rotation" if rotation is None else "translation"
    hint = "Calibrate the extrinsics too, so that all cameras share one world."
    raise CalibrationInvalid(f"The camera has no {lacking}.", where=place, hint=hint)


def _rigid(value: Any, place: str) -> tuple[np.ndarray, np.ndarray]:
    E = numbers(value, place)
    E = E.reshape(-1, 4) if E.ndim == 1 and E.size in (12, 16) else E
    if E.shape not in ((3, 4), (4, 4)):
        raise CalibrationInvalid(f"The extrinsic matrix has shape {E.shape}; (3, 4) is expected.", where=place)
    return E[:3, :3], E[:3, 3]


def _rotation(value: Any, place: str) -> np.ndarray:
    R = numbers(value, place)
    if R.size == 3:
        return np.asarray(exp_so3(R.reshape(3)))
    if R.size != 9:
        hint = "Write quaternions as matrices: the real part may be the first number or the last." * (R.size == 4)
        what = f"The rotation has {R.size} numbers; a Rodrigues vector (3) or a matrix (9) is expected."
        raise CalibrationInvalid(what, where=place, hint=hint)
    return R.reshape(3, 3)


def _size(values: Values, place: str) -> tuple[int, int] | None:
    size, width, height = (_find(values, key) for key in ("size", "width", "height"))
    if size is None and (width is None or height is None):
        return None
    parts = [width, height] if size is None else [size]
    found = np.concatenate([numbers(part, place).reshape(-1) for part in parts])
    if found.shape != (2,) or not np.isfinite(found).all():
        raise CalibrationInvalid("The image size is not a width and a height.", where=place)
    return round(float(found[0])), round(float(found[1]))


def read_toml_cameras(path: Path) -> StatedCameras:
    """Return the cameras of a TOML calibration (Pose2Sim, anipose, caliscope).

    Each has a table with ``matrix`` (3, 3), ``distortions``, ``rotation`` (a Rodrigues vector or a matrix, world to
    camera) and ``translation``. ``size`` and ``fisheye`` may be missing.

    Raises:
        FileMissing, FileDamaged: the file is not there or is not TOML.
        CalibrationInvalid: a camera lacks a value or has one of a wrong size.
    """
    return StatedCameras([camera_entry(name, node, where=str(path)) for name, node in camera_tables(read_toml(path))])


def camera_tables(tables: Values) -> Iterator[tuple[str, Values]]:
    """Yield name and table of each camera that is not ignored: ``[cam_01]``, or ``[cameras.0]`` as ``cam_0``."""
    for key, table in tables.items():
        if not isinstance(table, Mapping) or table.get("ignore") is True:
            continue
        if is_camera(table):
            yield (f"cam_{key}" if key.isdigit() else key), table
        elif key == "cameras":
            yield from camera_tables(table)


@dataclass(frozen=True)
class MatrixFile:
    """Cameras in one file, as written."""

    path: Path
    nodes: Nodes
    """Name and values of each camera that it describes completely."""
    parts: dict[str, dict[str, Any]]
    """Values by camera of matrices named after it, which may be spread over several files."""


SUFFIXES = (".npz", ".txt", ".csv")
_LARGEST_TEXT, _LARGEST_ARRAYS = 1 << 16, 1 << 24
"""Bytes of a text file and of arrays that are examined."""
_CAMERA_NAMES = ("names", "camera_names", "cameras")
_PARTS = {"K": "K", "dist": "distortion", "R": "rotation", "T": "translation", "H": "height", "W": "width"}
"""Matrices named ``K_<camera>`` and so on, as in EasyMocap's intri.yml and extri.yml."""
_ALL = ("cameras", "cams", "calibration")  # Keys in small letters under which a file may hold all of its cameras.


def read_matrix_file(path: Path) -> MatrixFile:
    """Return the cameras in one file.

    Raises:
        FileMissing, FileDamaged: the file is not there, truncated, or neither YAML nor JSON.
    """
    suffix = path.suffix.lower()
    if suffix in SUFFIXES:
        read, largest = (_of_arrays, _LARGEST_ARRAYS) if suffix == ".npz" else (_of_text, _LARGEST_TEXT)
        too_large = path.is_file() and path.stat().st_size > largest
        return MatrixFile(path, [] if too_large else read(path), {})
    tree = read_json(path) if suffix == ".json" else read_yaml(path)
    parts: dict[str, dict[str, Any]] = {}
    for key, value in tree.items() if isinstance(tree, Mapping) else ():
        kind, _, camera = str(key).partition("_")
        if kind in _PARTS and camera and (isinstance(value, Mapping) or kind in "HW"):
            parts.setdefault(camera, {})[_PARTS[kind]] = value
    return MatrixFile(path, _nodes(path.stem, tree), parts)


def stated_cameras(files: Sequence[MatrixFile]) -> StatedCameras:
    """Return the cameras of one or several files. Files without cameras are skipped.

    Raises:
        CalibrationInvalid: see ``camera_entry``.
    """
    entries: list[CameraEntry] = []
    parts: dict[str, dict[str, Any]] = {}
    for file in files:
        entries += [camera_entry(name, node, where=str(file.path)) for name, node in file.nodes]
        for camera, values in file.parts.items():
            parts.setdefault(camera, {}).update(values)
    where = str(files[0].path.parent) if files else ""
    entries += [camera_entry(name, node, where=where) for name, node in parts.items() if is_camera(node)]
    return StatedCameras(entries)


def _of_arrays(path: Path) -> Nodes:
    if "format" in array_names(path):  # our own files have readers
        return []
    known = {name for names in _SPELLINGS.values() for name in names}
    values = read_npz(path, lambda name: _plain(name) in known or name in _CAMERA_NAMES)
    if not is_camera(values):
        return []
    count = next((len(v) for v in values.values() if v.ndim == 3 and v.shape[1:] in ((3, 3), (3, 4))), 0)
    if not count:
        return [(path.stem, values)]
    listed = (values[name] for name in _CAMERA_NAMES if name in values and values[name].shape == (count,))
    names = next((found.astype(str).tolist() for found in listed), [f"cam_{i + 1}" for i in range(count)])
    split = {k: value for k, value in values.items() if value.ndim and len(value) == count and k not in _CAMERA_NAMES}
    return [(name, {key: value[i] for key, value in split.items()}) for i, name in enumerate(names)]


def _of_text(path: Path) -> Nodes:
    """Return the camera of a projection matrix, or the cameras of columns of DLT numbers."""
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


def _nodes(stem: str, tree: Any) -> Nodes:
    """Return the cameras of nested content: a form of ``_TREES``, one camera, a node per camera, or lists of values."""
    for nodes_of in _TREES:
        if (recorded := nodes_of(tree)) is not None:
            return recorded
    if is_camera(tree):
        return _stacked(tree) or [(stem, tree)]
    nodes: list[tuple[str, Any]] = []
    if isinstance(tree, Mapping):
        bare = {key: isinstance(node, list) and len(node) == 3 and _is_projection(node) for key, node in tree.items()}
        nodes = [(str(key), {"projection": node} if bare[key] else node) for key, node in tree.items()]
    elif isinstance(tree, list):
        nodes = [(f"cam_{i}", node) for i, node in enumerate(tree)]
    found = [(name, node) for name, node in nodes if is_camera(node)]
    if len(found) == 1 and (stacked := _stacked(found[0][1])):
        return stacked
    if not found and isinstance(tree, Mapping):
        inner = next((node for key, node in tree.items() if str(key).lower() in _ALL), None)
        return _nodes(stem, inner) if inner is not None else []
    return found


def _stacked(values: Values) -> Nodes:
    """Return the cameras of values that are lists over cameras (ZJU-MoCap's), [] for one camera.

    Intrinsics that differ are those of several cameras. A moving camera has the same ones in all frames.
    """
    try:
        K = np.array(_find(values, "K"), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return []
    if K.ndim != 3 or len(K) < 2 or np.array_equal(K, np.broadcast_to(K[0], K.shape)):
        return []
    split = {key: value for key, value in values.items() if isinstance(value, list) and len(value) == len(K)}
    return [(f"cam_{i + 1}", {key: value[i] for key, value in split.items()}) for i in range(len(K))]


def _human36m_nodes(tree: Any) -> Nodes | None:
    """Return the cameras of Human3.6M's JSON, ``intrinsics[camera]`` and ``extrinsics[subject][camera]``, or None."""
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


_MOST_CAMERAS = 256
_FIELDS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2", "camera_angle_x")
"""Values of a picture of NeRF, or of all. ``camera_angle_x`` is the horizontal field of view in radians."""
_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # Graphics look along -z with y up, OpenCV along z with y down.


def _nerf_nodes(tree: Any) -> Nodes | None:
    """Return the cameras of NeRF's transforms.json, None for other content or moving cameras.

    ``transform_matrix`` takes the camera's axes to the world. Its inverse, turned to OpenCV's axes, is the extrinsic
    matrix. A camera is named by its picture, or by the picture's folder if all pictures have one name.
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
    return [
        (name, _nerf_camera({**tree, **frame}, f"camera {name}")) for name, frame in zip(names, frames, strict=True)
    ]


def _nerf_camera(stated: Values, place: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key in _FIELDS:
        value = stated.get(key)
        array = np.zeros(1) if value is None else numbers(value, place)
        if array.size != 1:
            raise CalibrationInvalid("A number is expected where the file holds several.", where=place)
        found[key] = None if value is None else float(array.reshape(-1)[0])
    width, height, angle = found["w"], found["h"], found["camera_angle_x"]
    by_angle = 0.5 * width / math.tan(0.5 * angle) if width and angle and 0 < angle < math.pi else None
    focal = found["fl_x"] or by_angle
    if not focal:
        hint = "Write fl_x, or camera_angle_x with w, for each picture or for all."
        raise CalibrationInvalid("The camera has no focal length.", where=place, hint=hint)
    model = model_named(str(stated.get("camera_model")))
    node = {"fx": focal, "fy": found["fl_y"] or focal, "width": width, "height": height, "model": model}
    for centre, size in (("cx", width), ("cy", height)):
        node[centre] = 0.5 * size if found[centre] is None and size is not None else found[centre]
    node["distortion"] = [found[key] or 0.0 for key in LENS_MODELS[model].terms[:4]]
    pose = numbers(stated["transform_matrix"], place)
    if pose.shape == (4, 4) and np.isfinite(pose).all() and abs(np.linalg.det(pose)) > 0:
        node["extrinsics"] = np.linalg.inv(pose @ _TO_OPENCV)
    return {key: value for key, value in node.items() if value is not None}


_FROM_PREVIOUS = "T_cn_cnm1"  # (4, 4) from the previous camera's axes to this one's.


def _kalibr_nodes(tree: Any) -> Nodes | None:
    """Return the cameras of Kalibr's ``camchain.yaml``, None for other content.

    Reference: Furgale, Rehder and Siegwart 2013, and Kalibr's wiki, "YAML formats".
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


_TREES: tuple[Callable[[Any], Nodes | None], ...] = (_human36m_nodes, _nerf_nodes, _kalibr_nodes)
"""Forms of YAML and JSON without one node per camera."""
