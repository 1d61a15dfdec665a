"""Look up a camera's calibration values under the names that different programs use."""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping
from contextlib import suppress
from functools import lru_cache
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import DEFAULT_MODEL, FISHEYE, LENS_MODELS, LensModel, model_named
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, largest_finite
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.calibration.entry import CameraEntry

Values = Mapping[str, Any]  # Values of one camera by name: numbers, nested lists, or ``{rows, cols, data}``.
Nodes = list[tuple[str, Values]]  # Name and values of each camera.
_SMALLEST_VOLUME = 1e-6
"""Smallest determinant of a projection matrix's left block with rows of unit length. Real lenses exceed 0.01."""
_TABLE = """
    K: matrix k cameramatrix intrinsics intrinsic intrinsicmatrix intrinsicmat mtx cammatrix calibrationmatrix
    P: projection projectionmatrix p proj
    distortion: distortions distortion dist distcoeffs distcoeff distcoef distortioncoefficients distortioncoeffs d
    rotation: rotation r rvec rot rotationvector rotationmatrix extrinsicr orientation quaternion
    translation: translation t tvec translationvector extrinsict position
    extrinsics: extrinsics extrinsic extrinsicmatrix rt worldtocamera
    pose: pose cameratoworld camtoworld c2w cam2world camera2world cameraposematrix
    size: size imagesize imgsize resolution
    width: imagewidth imgwidth pixelwidth resolutionx width w
    height: imageheight imgheight pixelheight resolutiony height h
    model: distortionmodel model cameramodel
"""
"""Each value and the names that other tools use for it, most common first, in lower case without separators."""
SPELLINGS = {key.removesuffix(":"): tuple(names) for key, *names in map(str.split, _TABLE.strip().splitlines())}
_FOCAL, _FOCAL_AND_CENTRE = {"fx", "fy", "cx", "cy"}, {"focal_length", "principal_point"}
"""Keys of intrinsics without a matrix: four numbers, or a principal point with one or two focal lengths."""
_TERMS = frozenset(term for model in LENS_MODELS.values() for term in model.terms)  # Names of distortion coefficients.


def split_projection(P: np.ndarray, place: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split a projection matrix ``P = s K [R | t]`` into K (3, 3), R (3, 3) and t (3,).

    K has a positive diagonal and a last element of 1. The left block of P is a triangular matrix times a rotation,
    obtained from the QR decomposition of its inverse (Hartley and Zisserman 2004, "Multiple View Geometry", section
    6.2.4). The skew is set to 0, as in real cameras. ``P`` (3, 4) is in pixels and may have any scale and sign.
    """
    regular = P.shape == (3, 4) and bool(np.isfinite(P).all())
    M = P[:, :3] if regular else np.zeros((3, 3))
    length = np.linalg.norm(M, axis=1, keepdims=True)
    if not (length > 0).all() or abs(np.linalg.det(M / length)) <= _SMALLEST_VOLUME:
        raise CalibrationInvalid(
            "P is not a valid 3 x 4 projection matrix.", where=place, hint="Export the calibration again."
        )
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
    """Return the projection matrix (3, 4) of 11 DLT coefficients (Abdel-Aziz 1971)."""
    return np.append(dlt, 1.0).reshape(3, 4)


@lru_cache(maxsize=1024)
def plain(key: Hashable) -> str:
    """Convert a key to lower case and remove separators, to compare it with ``SPELLINGS``."""
    return re.sub(r"[^a-z0-9]", "", str(key).lower())


def find(values: Values, what: str) -> Any:
    """Find a value by any of its names in ``SPELLINGS``, or return None."""
    keys = {plain(key): key for key in values}
    return next((values[keys[name]] for name in SPELLINGS[what] if name in keys), None)


def has_lens(node: Any) -> bool:
    """Return whether a node of the file contains intrinsics or a projection matrix."""
    if not isinstance(node, Mapping):
        return False
    has_numbers = set(node) >= _FOCAL or set(node) >= _FOCAL_AND_CENTRE
    return find(node, "K") is not None or has_numbers or is_projection(find(node, "P"))


def has_pose(values: Values) -> bool:
    """Return whether a camera's values include a pose, an extrinsic matrix or a projection matrix."""
    if find(values, "rotation") is not None and find(values, "translation") is not None:
        return True
    for what in ("extrinsics", "pose", "P") if find(values, "K") is None else ("extrinsics", "pose"):
        value = find(values, what)
        with suppress(ValueError):
            numbers: Any = value.get("data") if isinstance(value, Mapping) else value
            if np.size(numbers) in (12, 16):
                return True
    return False


def is_projection(value: Any) -> bool:
    """Return whether a value has the shape of one or more projection matrices (3, 4)."""
    try:
        return np.shape(value)[-2:] == (3, 4)
    except ValueError:
        return False


def camera_entry(name: str, values: Values, *, where: str) -> CameraEntry:
    """Build a camera from the values in a file. A name among these values takes precedence over ``name``."""
    own = values.get("name", values.get("camera_name"))
    if own in (None, "") and isinstance(values.get("id"), str):
        own = values["id"]
    name = str(own) if own not in (None, "") else name
    place = f"{where}, camera {name}"
    intrinsics, vector = find(values, "K"), None
    if intrinsics is None and set(values) >= _FOCAL:
        intrinsics = values
    elif intrinsics is None and set(values) >= _FOCAL_AND_CENTRE:
        focal, centre = (numbers(values[key], place).reshape(-1) for key in ("focal_length", "principal_point"))
        intrinsics = np.concatenate([np.resize(focal, 2), centre])
    if intrinsics is None:
        K, R, t = split_projection(numbers(find(values, "P"), place), place)
    else:
        K = _K(intrinsics, place)
        if K.ndim == 3:
            values = {key: _constant(value, place) for key, value in values.items()}
            K = _K(find(values, "K"), place)
        R, t = _pose(values, place)
        written = find(values, "rotation")
        vector = None if written is None else numbers(written, place)
    stated = find(values, "model")
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
    """Convert nested lists or OpenCV's ``{rows, cols, data}`` to a float array."""
    shape = None
    if isinstance(value, Mapping) and "data" in value:
        shape = (value.get("rows", -1), value.get("cols", -1))
        value = value["data"]
    try:
        if np.iscomplexobj(value):
            raise TypeError("complex numbers")
        array = np.array(value, dtype=np.float64)
        array = array if shape is None else array.reshape(shape)
    except (TypeError, ValueError, OverflowError) as error:
        raise CalibrationInvalid("The file contains a value that is not a number.", where=place) from error
    if (largest := largest_finite(array)) > FARTHEST_IN_UNITS:
        most = f"at most {FARTHEST_IN_UNITS:g} is possible"
        raise CalibrationInvalid(f"The camera contains the number {largest:.3g}, but {most}.", where=place)
    return array


def _distortion(values: Values, model: LensModel, place: str) -> np.ndarray:
    written = find(values, "distortion")
    named = written if isinstance(written, Mapping) and "data" not in written else values if written is None else {}
    terms = {plain(key): value for key, value in named.items() if plain(key) in _TERMS}
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
        raise CalibrationInvalid(f"The intrinsic matrix has shape {K.shape}, but (3, 3) is expected.", where=place)
    # MATLAB and JARVIS store the transposed matrix, so the principal point is in the last row.
    columns = (K[..., :2, 2] == 0).all() and (K[..., 2, :2] > 0).all() and (K[..., 2, 2] == 1).all()
    return np.swapaxes(K, -1, -2) if columns else K


def _constant(value: Any, place: str) -> Any:
    if not isinstance(value, list):
        return value
    array = np.array(value, dtype=object)
    if not all(item == value[0] for item in value) and array.ndim > 1:
        what = "The camera moves: its calibration differs from frame to frame."
        raise CalibrationInvalid(what, where=place, hint="Use fixed cameras, with one pose for each.")
    return value[0] if array.ndim > 1 else value


def _pose(values: Values, place: str) -> tuple[np.ndarray, np.ndarray]:
    keys = ("rotation", "translation", "extrinsics", "pose")
    rotation, translation, extrinsics, pose = (find(values, key) for key in keys)
    if rotation is not None and translation is not None:
        t = numbers(translation, place).reshape(-1)
        if t.shape != (3,):
            raise CalibrationInvalid(f"The translation has {t.size} numbers, but 3 are expected.", where=place)
        R = _rotation(rotation, place)
        return (R.T, -R.T @ t) if values.get("world2cam") is False else (R, t)
    if extrinsics is not None:
        return _rigid(extrinsics, place)
    if pose is not None:
        R, centre = _rigid(pose, place)
        return R.T, -R.T @ centre
    lacking = "rotation" if rotation is None else "translation"
    hint = "Calibrate the extrinsics too, so that all cameras share one world."
    what = f"The camera has no {lacking}. It has the keys {', '.join(map(str, values))}."
    raise CalibrationInvalid(what, where=place, hint=hint)


def _rigid(value: Any, place: str) -> tuple[np.ndarray, np.ndarray]:
    E = numbers(value, place)
    E = E.reshape(-1, 4) if E.ndim == 1 and E.size in (12, 16) else E
    if E.shape not in ((3, 4), (4, 4)):
        raise CalibrationInvalid(f"The extrinsic matrix has shape {E.shape}, but (3, 4) is expected.", where=place)
    return E[:3, :3], E[:3, 3]


def _rotation(value: Any, place: str) -> np.ndarray:
    R = numbers(value, place)
    if R.size == 3:
        # ``Cameras`` rejects non-finite values.
        return np.asarray(exp_so3(R.reshape(3))) if np.isfinite(R).all() else np.full((3, 3), np.nan)
    if R.size != 9:
        hint = "Write the rotation as a matrix, because the order in a quaternion is ambiguous." * (R.size == 4)
        what = f"The rotation has {R.size} numbers, but a Rodrigues vector (3) or a matrix (9) is expected."
        raise CalibrationInvalid(what, where=place, hint=hint)
    return R.reshape(3, 3)


def _size(values: Values, place: str) -> tuple[int, int] | None:
    size, width, height = (find(values, key) for key in ("size", "width", "height"))
    if size is None and (width is None or height is None):
        return None
    parts = [width, height] if size is None else [size]
    found = np.concatenate([numbers(part, place).reshape(-1) for part in parts])
    if found.shape != (2,) or not np.isfinite(found).all():
        raise CalibrationInvalid("The image size must be a width and a height.", where=place)
    return round(float(found[0])), round(float(found[1]))
