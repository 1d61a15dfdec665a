"""A camera from a mapping of names to values, under the many names tools give to the same things."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import DEFAULT_MODEL, FISHEYE, LENS_MODELS, LensModel, model_named
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, largest_finite
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.calibration.entry import CameraEntry

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
_NAMES = {key.removesuffix(":"): tuple(names) for key, *names in map(str.split, _TABLE.strip().splitlines())}
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
    return any(plain(key) in names for names in _NAMES.values())


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
    for name in _NAMES[what]:
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
