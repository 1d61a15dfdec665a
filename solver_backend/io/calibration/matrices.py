"""Calibrations of matrices by name, in YAML, JSON or arrays: one file a camera, or one file for all."""

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

DLT_NUMBERS = 11
"""Of a camera: the projection matrix by rows, divided by its last element."""
_SMALLEST_VOLUME = 1e-6
"""Of the directions of the three rows: a camera's is fx fy over their lengths, above 0.01 for any lens."""


def split_projection(P: np.ndarray, place: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return K (3, 3), R (3, 3) and t (3,) of ``P = s K [R | t]``, K with a positive diagonal and a last element of 1.

    The left block is a triangular matrix times a rotation: its RQ factors, from the QR factors of its inverse (Hartley
    and Zisserman 2004, "Multiple View Geometry", section 6.2.4). Skew is left out; it is 0 in real cameras.

    Args:
        P: (3, 4) in pixels, of any scale and sign.
        place: file and camera, for errors.

    Raises:
        CalibrationInvalid: it is no projection of a camera.
    """
    if P.shape != (3, 4) or not np.isfinite(P).all() or not _is_regular(P[:, :3]):
        raise CalibrationInvalid("The projection matrix is not that of a camera.", where=place)
    M = P[:, :3]
    if np.linalg.det(M) < 0:
        P, M = -P, -M
    Q, U = np.linalg.qr(np.linalg.inv(M))
    signs = np.where(np.diag(U) < 0, -1.0, 1.0)
    R, K = (Q * signs).T, np.linalg.inv(signs[:, None] * U)
    t = np.linalg.solve(K, P[:, 3])
    K = K / K[2, 2]
    K[0, 1] = 0.0
    return K, R, t


def _is_regular(M: np.ndarray) -> bool:
    length = np.linalg.norm(M, axis=1)
    return bool((length > 0).all()) and abs(np.linalg.det(M / length[:, None])) > _SMALLEST_VOLUME


def projection_of(dlt: np.ndarray) -> np.ndarray:
    """Return the (3, 4) projection matrix of eleven DLT numbers (Abdel-Aziz and Karara 1971)."""
    return np.append(dlt, 1.0).reshape(3, 4)


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
"""A value and the names that tools give it, in lower case without separators, the likeliest first."""
_SPELLINGS = {key.removesuffix(":"): tuple(names) for key, *names in map(str.split, _TABLE.strip().splitlines())}
_FOCAL = {"fx", "fy", "cx", "cy"}
"""The four numbers of an intrinsic matrix."""
_FOCAL_AND_CENTRE = {"focal_length", "principal_point"}
"""The same as one or two focal lengths and two coordinates."""
_TERMS = frozenset(term for model in LENS_MODELS.values() for term in model.terms)
"""Names of distortion terms."""


def plain(key: str) -> str:
    """Return a key in lower case without separators."""
    return re.sub(r"[^a-z0-9]", "", key.lower())


def is_field(key: str) -> bool:
    """Whether a key is one of the names of a camera's values."""
    return any(plain(key) in names for names in _SPELLINGS.values())


def is_camera(node: Any) -> bool:
    """Whether a mapping holds an intrinsic matrix, its four numbers or a projection matrix, as cameras do."""
    if not isinstance(node, Mapping):
        return False
    has_numbers = set(node) >= _FOCAL or set(node) >= _FOCAL_AND_CENTRE
    return _find(node, "K") is not None or has_numbers or is_projection(_find(node, "P"))


def cameras_in_stacks(node: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the values of each camera where a mapping holds lists over cameras (ZJU-MoCap's), [] where it does not.

    Intrinsics that differ are those of several cameras; a camera that moves has the same ones in all frames.
    """
    try:
        K = np.array(_find(node, "K"), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return []
    if K.ndim != 3 or len(K) < 2 or np.array_equal(K, np.broadcast_to(K[0], K.shape)):
        return []
    split = {key: value for key, value in node.items() if isinstance(value, list) and len(value) == len(K)}
    return [{key: value[i] for key, value in split.items()} for i in range(len(K))]


def is_projection(value: Any) -> bool:
    """Whether a value is three rows of four."""
    try:
        return np.shape(value)[-2:] == (3, 4)
    except ValueError:
        return False


def camera_entry(name: str, node: Mapping[str, Any], *, where: str) -> CameraEntry:
    """Return the camera a mapping describes.

    Args:
        name: used unless the mapping has a name of its own.
        node: values as numbers, nested lists, or ``{rows, cols, data}``.

    Raises:
        CalibrationInvalid: intrinsics, rotation or translation are missing or of a wrong size, or vary over time.
    """
    own = node.get("name", node.get("camera_name"))
    if own in (None, "") and isinstance(node.get("id"), str):
        own = node["id"]
    name = str(own) if own not in (None, "") else name
    place = f"{where}, camera {name}"
    intrinsics, vector = _find(node, "K"), None
    if intrinsics is None and set(node) >= _FOCAL:
        intrinsics = node
    elif intrinsics is None and set(node) >= _FOCAL_AND_CENTRE:
        focal, centre = (numbers(node[key], place).reshape(-1) for key in ("focal_length", "principal_point"))
        intrinsics = np.concatenate([np.resize(focal, 2), centre])
    if intrinsics is None:
        K, R, t = split_projection(numbers(_find(node, "P"), place), place)
    else:
        K = _K(intrinsics, place)
        if K.ndim == 3:
            node = {key: _constant(value, place) for key, value in node.items()}
            K = _K(_find(node, "K"), place)
        R, t = _pose(node, place)
        written = _find(node, "rotation")
        vector = None if written is None else numbers(written, place)
    model = _lens_model(node)
    return CameraEntry(
        name=name,
        K=K,
        distortion=_distortion(node, LENS_MODELS[model], place),
        R=R,
        t=t,
        image_size=_size(node, place),
        model=model,
        rotation_vector=vector.reshape(3) if vector is not None and vector.size == 3 else None,
    )


def _distortion(node: Mapping[str, Any], model: LensModel, place: str) -> np.ndarray:
    written = _find(node, "distortion")
    named = written if isinstance(written, Mapping) and "data" not in written else node if written is None else {}
    terms = {plain(str(key)): value for key, value in named.items() if plain(str(key)) in _TERMS}
    for letter in "kp" if written is None else "":  # XRPrimer's ``dist_coeff_k`` and ``dist_coeff_p``
        listed = numbers(node.get(f"dist_coeff_{letter}", []), place).reshape(-1)
        terms.update({f"{letter}{i + 1}": value for i, value in enumerate(listed) if f"{letter}{i + 1}" in _TERMS})
    if not terms:
        return np.zeros(0) if written is None else numbers(written, place).reshape(-1)
    return numbers([terms.get(term, 0.0) for term in model.terms], place).reshape(-1)


def numbers(value: Any, place: str) -> np.ndarray:
    """Return nested lists, or a ``{rows, cols, data}`` node, as a float array.

    Raises:
        CalibrationInvalid: it is not a rectangular block of numbers, or one of them cannot be.
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
    largest = largest_finite(array)
    if largest > FARTHEST_IN_UNITS:
        most = f"at most {FARTHEST_IN_UNITS:g} is possible"
        raise CalibrationInvalid(f"The camera has a number of {largest:.3g}; {most}.", where=place)
    return array


def _find(node: Mapping[str, Any], what: str) -> Any:
    keys = {plain(str(key)): key for key in node}
    for name in _SPELLINGS[what]:
        if name in keys:
            return node[keys[name]]
    return None


def _K(value: Any, place: str) -> np.ndarray:
    if isinstance(value, Mapping) and set(value) >= _FOCAL:
        value = [[value["fx"], 0, value["cx"]], [0, value["fy"], value["cy"]], [0, 0, 1]]
    K = numbers(value, place)
    if K.shape == (9,):
        K = K.reshape(3, 3)
    if K.shape == (4,):  # Kalibr's and ROS' fx, fy, cx, cy
        K = np.array([[K[0], 0.0, K[2]], [0.0, K[1], K[3]], [0.0, 0.0, 1.0]])
    if K.shape == (4, 4):
        K = np.concatenate([K[:2, :3], [[0.0, 0.0, 1.0]]])
    if K.shape[-2:] != (3, 3) or K.ndim > 3:
        raise CalibrationInvalid(f"The intrinsic matrix has shape {K.shape}; (3, 3) is expected.", where=place)
    # A matrix written column by column, as MATLAB and JARVIS do, has the principal point in its last row.
    return np.swapaxes(K, -1, -2) if is_transposed(K) else K


def is_transposed(K: np.ndarray) -> bool:
    """Whether intrinsic matrices (..., 3, 3) are written column by column: their last row is ``cx, cy, 1``."""
    return bool((K[..., :2, 2] == 0).all() and (K[..., 2, :2] > 0).all() and (K[..., 2, 2] == 1).all())


def _constant(value: Any, place: str) -> Any:
    if not isinstance(value, list):
        return value
    array = np.array(value, dtype=object)
    if not all(item == value[0] for item in value) and array.ndim > 1:
        what = "The camera moves: its calibration differs from frame to frame."
        raise CalibrationInvalid(what, where=place, hint="Only fixed cameras are solved.")
    return value[0] if array.ndim > 1 else value


def _pose(node: Mapping[str, Any], place: str) -> tuple[np.ndarray, np.ndarray]:
    rotation, translation, extrinsics, pose = (
        _find(node, key) for key in ("rotation", "translation", "extrinsics", "pose")
    )
    if rotation is not None and translation is not None:
        t = numbers(translation, place).reshape(-1)
        if t.shape != (3,):
            raise CalibrationInvalid(f"The translation has {t.size} numbers; 3 are expected.", where=place)
        R = rotation_matrix(rotation, place)
        return (R.T, -R.T @ t) if node.get("world2cam") is False else (R, t)
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


def rotation_matrix(value: Any, place: str) -> np.ndarray:
    """Return the (3, 3) rotation of a Rodrigues vector or a matrix.

    Raises:
        CalibrationInvalid: it has neither 3 nor 9 numbers.
    """
    R = numbers(value, place)
    if R.size == 3:
        return np.asarray(exp_so3(R.reshape(3)))
    if R.size != 9:
        hint = "Write quaternions as matrices: the real part may be the first number or the last." * (R.size == 4)
        what = f"The rotation has {R.size} numbers; a Rodrigues vector (3) or a matrix (9) is expected."
        raise CalibrationInvalid(what, where=place, hint=hint)
    return R.reshape(3, 3)


def _size(node: Mapping[str, Any], place: str) -> tuple[int, int] | None:
    size, width, height = _find(node, "size"), _find(node, "width"), _find(node, "height")
    if size is not None:
        values = numbers(size, place).reshape(-1)
    elif width is not None and height is not None:
        values = np.concatenate([numbers(width, place).reshape(-1), numbers(height, place).reshape(-1)])
    else:
        return None
    if values.shape != (2,) or not np.isfinite(values).all():
        raise CalibrationInvalid("The image size is not a width and a height.", where=place)
    return round(float(values[0])), round(float(values[1]))


def _lens_model(node: Mapping[str, Any]) -> str:
    if bool(node.get("fisheye", False)):
        return FISHEYE.name
    model = _find(node, "model")
    return model_named(model) if isinstance(model, str) else DEFAULT_MODEL


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
