"""Recognise cameras in the nested content of YAML, JSON and XML files.

Functions in ``_FORMS`` read a program's entire file. Functions in ``_CAMERAS`` read one camera.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import LENS_MODELS, model_named
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS
from solver_backend.geometry.rotations import exp_so3, matrix_from_quat
from solver_backend.io.calibration.camera_values import (
    SPELLINGS,
    Nodes,
    Values,
    find,
    has_lens,
    has_pose,
    is_projection,
    numbers,
    plain,
)

GRAPHICS = np.diag([1.0, -1.0, -1.0])  # Graphics cameras look along -Z with Y up, OpenCV's along Z with Y down.
_UNITY_LENS = {"fieldofview", "fov", "sensorsize"}  # Lower-case keys. Every Unity camera has at least one.
_UNITY, _LEFT_HANDED = np.diag([1.0, -1.0, 1.0]), np.diag([1.0, 1.0, -1.0])
"""Unity cameras look along Z with Y up in a left-handed world. The second matrix mirrors that world."""
_LINK = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # Robot links look along X with Z up.
_MOST_CAMERAS, _MOST_NODES = 256, 2000  # Limits on NeRF images and on nodes. Larger files hold frames or detections.
_ALL = ("cameras", "cams", "calibration")  # Lower-case keys under which a file may store all of its cameras.
_Steps = Mapping[str, tuple[str, np.ndarray]]
"""For each coordinate frame, the name of its reference frame and the (4, 4) matrix from that frame to it."""


@dataclass(frozen=True)
class Content:
    """Cameras in a file, and the length unit and up axis that its format defines, if any."""

    nodes: Nodes
    unit: str = ""
    up_axis: str = ""


def cameras_in_tree(stem: str, tree: Any) -> Content:
    """Find the cameras in the nested content of a file. Their intrinsics or poses may be missing."""
    for form in _FORMS:
        if isinstance(tree, Mapping) and (found := form(tree)) is not None:
            return found
    return _nodes(stem, tree, {})


def _nodes(stem: str, tree: Any, shared: Values) -> Content:
    """Find the cameras in a tree. A camera is the tree itself, one of its nodes, or an entry of a list."""
    if (camera := _camera(tree, shared)) is not None:
        values, unit, up_axis = camera
        return Content(_stacked(values) or [(stem, values)], unit, up_axis)
    if isinstance(tree, Mapping):
        bare = {key: isinstance(node, list) and len(node) == 3 and is_projection(node) for key, node in tree.items()}
        nodes = [(str(key), {"projection": node} if bare[key] else node) for key, node in tree.items()]
        shared = {**shared, **{k: v for k, v in tree.items() if not isinstance(v, Mapping) and not bare[k]}}
    else:
        nodes = [(f"cam_{i}", node) for i, node in enumerate(tree)] if isinstance(tree, list) else []
    nodes = nodes if len(nodes) <= _MOST_NODES else []
    read = [(name, *camera) for name, node in nodes if (camera := _camera(node, shared)) is not None]
    lenses = [(name, values) for name, values, _, _ in read if has_lens(values)]
    if len(lenses) == 1 and (stacked := _stacked(lenses[0][1])):
        return Content(stacked)
    if read:
        return Content(lenses or [(name, values) for name, values, _, _ in read], *read[0][2:])
    inner = [node for key, node in nodes if key.lower() in _ALL] if isinstance(tree, Mapping) else []
    return _nodes(stem, inner[0], shared) if inner else Content([])


def _camera(node: Any, shared: Values) -> tuple[Values, str, str] | None:
    """Return a camera's values by our key names, its length unit and its up axis, or None if the node is no camera."""
    if not isinstance(node, Mapping):
        return None
    for convert, unit, up_axis in _CAMERAS:
        if (values := convert({**shared, **node})) is not None:
            return values, unit, up_axis
    if has_lens(node) and (pose := _ros_pose(node)) is not None:
        fixed = {k: v for k, v in node.items() if plain(k) not in SPELLINGS["rotation"] + SPELLINGS["translation"]}
        return {**fixed, "extrinsics": np.linalg.inv(pose)}, "", ""
    return (node, "", "") if has_lens(node) or has_pose(node) else None


def _stacked(values: Values) -> Nodes:
    """Split values that list all cameras (as in ZJU-MoCap) into one node per camera.

    Return [] for a single camera. If all entries have equal intrinsics, they describe one moving camera.
    """
    try:
        K = np.array(find(values, "K"), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return []
    if K.ndim != 3 or len(K) < 2 or np.array_equal(K, np.broadcast_to(K[0], K.shape)):
        return []
    split = {key: value for key, value in values.items() if isinstance(value, list) and len(value) == len(K)}
    return [(f"cam_{i + 1}", {key: value[i] for key, value in split.items()}) for i in range(len(K))]


# Values of a single camera.
def _vector(value: Any, size: int, place: str) -> np.ndarray | None:
    """Convert a list, or an object with x, y, z and w, to ``size`` numbers. Return None for other values."""
    if isinstance(value, Mapping) and "data" not in value:
        value = [value[key] for key in "xyzw"[:size] if key in value] if not (size == 3 and "w" in value) else None
    if value is None or isinstance(value, str):
        return None
    found = numbers(value, place).reshape(-1)
    if found.shape == (size,) and not np.isfinite(found).all():
        raise CalibrationInvalid("The camera has a NaN or infinite value.", where=place)
    return found if found.shape == (size,) else None


def _number(values: Values, *keys: str, default: float | None = None) -> float | None:
    """Return the number under the first existing key, or the default."""
    value = next((values[key] for key in keys if values.get(key) is not None), default)
    array = np.zeros(1) if value is None else numbers(value, "")
    if array.size != 1:
        raise CalibrationInvalid(f"'{keys[0]}' contains {array.size} numbers, but one is expected.")
    return None if value is None else float(array.reshape(-1)[0])


def _rotation(value: Any, order: str, degrees: bool) -> np.ndarray | None:
    """Convert a quaternion xyzw, or Euler angles in the given order, to a rotation (3, 3). Return None if invalid."""
    if (q := _vector(value, 4, "rotation")) is not None:
        return np.asarray(matrix_from_quat(q[[3, 0, 1, 2]])) if np.linalg.norm(q) > 1e-9 else None
    if (angles := _vector(value, 3, "rotation")) is None:
        return None
    turned = np.eye(3)
    for axis in order:
        i = "xyz".index(axis)
        turned = exp_so3(np.eye(3)[i] * (np.radians(angles[i]) if degrees else angles[i])) @ turned
    return turned


def _rigid(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = R, t
    return whole


def _world_to_camera(pose: np.ndarray, axes: np.ndarray) -> np.ndarray | None:
    """Convert a camera-to-world pose to extrinsics (4, 4) with OpenCV's axes. Return None if the pose is invalid."""
    if pose.shape != (4, 4) or not (np.abs(pose) <= FARTHEST_IN_UNITS).all():
        return None
    pose = pose @ _rigid(axes, np.zeros(3))
    return np.linalg.inv(pose) if abs(np.linalg.det(pose)) > 0 else None


def _picture(values: Values) -> tuple[float, float] | None:
    """Return the image width and height in pixels, or None if they are missing or not positive."""
    size = find(values, "size")
    found = _vector([find(values, "width"), find(values, "height")] if size is None else size, 2, "size")
    if found is None or not (found > 0).all():
        return None
    width, height = found * (_number(values, "resolution_percentage", default=100.0) or 100.0) / 100.0
    return float(width), float(height)


def _seen(values: Values, f: tuple[float, float], centre: tuple[float, float], E: np.ndarray | None) -> Values:
    """Combine focal lengths and principal point in pixels with extrinsics (4, 4) into a camera's values."""
    (fx, fy), (cx, cy), size = f, centre, _picture(values)
    named = {key: values[key] for key in ("name", "distortion", "model") if key in values}
    return {**named, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "extrinsics": E, "size": size}


# Programs that use different names for a camera's values.
def _unity(values: Values) -> Values | None:
    """Read a Unity camera, or return None for other cameras.

    The pose is ``position`` in metres, and ``rotation`` as a quaternion or in degrees. The lens is a vertical
    ``fieldOfView`` in degrees, or ``focalLength`` with ``sensorSize`` and ``lensShift``.
    """
    known = {plain(key): value for key, value in values.items()}
    if not _UNITY_LENS & known.keys():
        return None
    moved = known["transform"] if isinstance(known.get("transform"), Mapping) else values
    turned = next((moved[key] for key in ("rotation", "eulerAngles", "quaternion") if key in moved), None)
    R, centre = _rotation(turned, "zxy", degrees=True), _vector(moved.get("position"), 3, "position")
    if (size := _picture(values)) is None or R is None or centre is None:
        return None
    angle, (width, height) = _number(known, "fieldofview", "fov"), size
    if angle is not None and 0 < angle < 180:
        fx = fy = 0.5 * height / np.tan(0.5 * np.radians(angle))
    else:
        sensor, length = _vector(known.get("sensorsize"), 2, "sensorSize"), _number(known, "focallength")
        if sensor is None or not length or not (sensor > 0).all():
            return None
        fx, fy = length * width / sensor[0], length * height / sensor[1]
        fit = str(known.get("gatefit", "Horizontal")).lower()  # the sensor side that the image fills
        fits = {"0": (fx, fy), "none": (fx, fy), "1": (fy, fy), "vertical": (fy, fy)}
        fx, fy = fits.get(fit, (fx, fx))
    shift = _vector(known.get("lensshift"), 2, "lensShift")
    across, up = shift if shift is not None else (0.0, 0.0)
    pose = _rigid(_LEFT_HANDED @ R, _LEFT_HANDED @ centre)
    middle = ((0.5 - across) * width - 0.5, (0.5 + up) * height - 0.5)  # The centre of the first pixel is 0.
    return _seen(values, (fx, fy), middle, _world_to_camera(pose, _UNITY))


def _blender(values: Values) -> Values | None:
    """Read a Blender camera, or return None for other cameras.

    The pose is ``matrix_world``, or ``location`` and a rotation. The lens is ``lens`` and ``sensor_width`` in mm with
    ``sensor_fit``, or ``angle`` in radians. Lens shifts are applied.
    """
    if not {"matrix_world", "rotation_euler", "rotation_quaternion"} & values.keys():
        return None
    size, length, angle = _picture(values), _number(values, "lens"), _number(values, "angle", "angle_x")
    if size is None or not (length or (angle and 0 < angle < np.pi)):
        return None
    if "matrix_world" in values:
        pose = numbers(values["matrix_world"], "matrix_world")
        pose = pose.reshape(4, 4) if pose.size == 16 else pose
    else:
        q, where = values.get("rotation_quaternion"), _vector(values.get("location"), 3, "location")
        turns = q is not None and ("rotation_euler" not in values or values.get("rotation_mode") == "QUATERNION")
        turned = np.roll(numbers(q, "rotation_quaternion"), -1) if turns else values.get("rotation_euler")
        R = _rotation(turned, "xyz", False)
        pose = np.zeros((4, 4)) if R is None or where is None else _rigid(R, where)
    width, height = size
    fit = str(values.get("sensor_fit", "AUTO")).upper()
    upright = fit == "VERTICAL" or (fit == "AUTO" and height > width)
    side, usual = ("sensor_height", 24.0) if fit == "VERTICAL" else ("sensor_width", 36.0)
    sensor = _number(values, side, default=usual) or usual
    pixels = height if upright else width
    f = pixels * length / sensor if length else 0.5 * pixels / np.tan(0.5 * (angle or 1.0))
    across, up = (_number(values, f"shift_{axis}", default=0.0) or 0.0 for axis in "xy")
    middle = (0.5 * (width - 1) - across * pixels, 0.5 * (height - 1) + up * pixels)
    return _seen(values, (f, f), middle, _world_to_camera(pose, GRAPHICS))


def _fit3d(values: Values) -> Values | None:
    """Read a Fit3D camera with ``x_cam = R (x - T)``, or return None for other cameras."""
    lens, outer = values.get("intrinsics_w_distortion"), values.get("extrinsics")
    if not isinstance(lens, Mapping) or not isinstance(outer, Mapping) or not {"R", "T"} <= outer.keys():
        return None
    f, c, k, p = (numbers(lens.get(key, []), f"intrinsics_w_distortion, {key}").reshape(-1) for key in "fckp")
    R, T = numbers(outer["R"], "extrinsics, R"), numbers(outer["T"], "extrinsics, T").reshape(-1)
    if f.size != 2 or c.size != 2 or R.shape != (3, 3) or T.size != 3:
        raise CalibrationInvalid("Fit3D's f, c, R or T has a wrong number of values.")
    K = [[f[0], 0.0, c[0]], [0.0, f[1], c[1]], [0.0, 0.0, 1.0]]
    return {"K": K, "distortion": [*k[:2], *p[:2], *k[2:3]], "R": R, "T": -R @ T}


def _opencap(values: Values) -> Values | None:
    """Read an OpenCap camera, or return None. Its ``imageSize`` is (height, width) or (width, height)."""
    if not {"intrinsicMat", "rotation", "translation"} <= values.keys():
        return None
    K = numbers(values["intrinsicMat"], "intrinsicMat")
    size = _vector(values.get("imageSize"), 2, "imageSize")
    if size is not None and K.shape == (3, 3):
        size = min(size, size[::-1], key=lambda found: float(np.abs(0.5 * found - K[:2, 2]).sum()))
    known = {key: values[key] for key in ("distortion", "rotation", "translation") if key in values}
    return {"K": K, **known, **({} if size is None else {"size": size})}


_CAMERAS: tuple[tuple[Callable[[Values], Values | None], str, str], ...] = (
    (_unity, "m", "y"),
    (_blender, "", ""),
    (_fit3d, "m", ""),
    (_opencap, "mm", ""),
)
"""Functions that read one camera, with the length unit and up axis that the program always uses."""


# Programs that store their cameras in another structure than a list of nodes.
def _chained(steps: _Steps, name: str) -> np.ndarray:
    """Multiply the matrices (4, 4) from the root coordinate frame to the named one."""
    pose, at = np.eye(4), name
    for _ in range(len(steps) + 1):
        if at not in steps:
            return pose
        at, step = steps[at][0], steps[at][1]
        if not (np.abs(step) <= FARTHEST_IN_UNITS).all() or not (np.abs(pose) <= FARTHEST_IN_UNITS).all():
            raise CalibrationInvalid("The camera poses contain NaN or infinite values.", where=f"camera {name}")
        pose = pose @ step
    raise CalibrationInvalid("The poses of the cameras refer to each other in a loop.", where=f"camera {name}")


def _multical(tree: Values) -> Content | None:
    """Read multical's cameras, or return None for other files. The pose ``a_to_b`` is the pose of a relative to b."""
    cameras, poses = tree.get("cameras"), tree.get("camera_poses")
    if not isinstance(cameras, Mapping) or not isinstance(poses, Mapping):
        return None
    steps = {}
    for key, pose in poses.items():
        name, _, base = str(key).partition("_to_")
        if isinstance(pose, Mapping) and {"R", "T"} <= pose.keys():
            R, t = (_vector(pose[part], size, f"camera_poses, {key}") for part, size in (("R", 9), ("T", 3)))
            if R is None or t is None:
                raise CalibrationInvalid("R or T has a wrong number of values.", where=f"camera_poses, {key}")
            steps[name] = (base, _rigid(R.reshape(3, 3), t))
    nodes = [(str(name), camera) for name, camera in cameras.items() if isinstance(camera, Mapping)]
    return Content([(n, {**c, "extrinsics": _chained(steps, n)} if n in steps else c) for n, c in nodes])


def _mccalib(tree: Values) -> Content | None:
    """Read MC-Calib's cameras, or return None. A pose converts from the camera to the world of its camera group."""
    nodes = [(str(k), v) for k, v in tree.items() if isinstance(v, Mapping) and "camera_pose_matrix" in v]
    if "nb_camera" not in tree or not nodes:
        return None
    groups = {str(node.get("camera_group", 0)) for _, node in nodes}
    if len(groups) > 1:
        what = f"The cameras are in {len(groups)} groups without common views, so their poses have no common world."
        raise CalibrationInvalid(what, hint="Record the board where cameras of both groups see it.")
    named = [
        (n, {**v, "distortion": v.get("distortion_vector"), "fisheye": v.get("distortion_type")}) for n, v in nodes
    ]
    return Content([(name, {k: v for k, v in node.items() if v is not None}) for name, node in named])


_STEREO = re.compile(r"(?:m|k|mtx|camera_?matrix|intrinsics?)_?(1|2|l|r|left|right)", re.IGNORECASE)
_STEREO_LENS = re.compile(r"(?:d|dist|dist_?coeffs?|distortion)_?(1|2|l|r|left|right)", re.IGNORECASE)
"""Key patterns for the intrinsic matrices and distortion coefficients of a stereo pair."""
_MORE = re.compile(r"_?(?:cam)?_?(?:[03-9]|\d{2,})", re.IGNORECASE)  # End of such a key for a third or later camera.


def _has_nine_numbers(value: Any) -> bool:
    try:
        return np.size(value.get("data", ()) if isinstance(value, Mapping) else value) == 9
    except ValueError:
        return False


def _stereo(tree: Values) -> Content | None:
    """Read an OpenCV stereo pair (``M1 D1 M2 D2``, and ``R T`` from first to second), or return None."""
    sides: dict[str, dict[str, Any]] = {"left": {}, "right": {}}
    for pattern, what in ((_STEREO, "K"), (_STEREO_LENS, "distortion")):
        for key, value in tree.items():
            if (found := pattern.fullmatch(str(key))) and (what != "K" or _has_nine_numbers(value)):
                stem = str(key)[: found.start(1)]
                if any(str(k).startswith(stem) and _MORE.fullmatch(str(k).removeprefix(stem)) for k in tree):
                    return None
                sides["left" if found[1].lower() in ("1", "l", "left") else "right"][what] = value
    rectified = {"R1", "R2", "P1", "P2"} <= tree.keys()
    lenses = all("K" in side for side in sides.values())
    if {"R", "T"} <= tree.keys() and (rectified or lenses):
        sides["left"] |= {"rotation": np.eye(3), "translation": np.zeros(3)}
        sides["right"] |= {"rotation": tree["R"], "translation": tree["T"]}
    elif not lenses:
        return None
    shared = {key: value for key, value in tree.items() if find({key: value}, "size") is not None}
    return Content([(name, {**shared, **side} if lenses else side) for name, side in sides.items()])


def _ros_pose(entry: Any) -> np.ndarray | None:
    """Return the pose (4, 4) in a ROS Transform or Pose message, or None for other content."""
    while isinstance(entry, Mapping):
        inner = next((entry[key] for key in ("transform", "pose") if isinstance(entry.get(key), Mapping)), None)
        if inner is None:
            break
        entry = inner
    if not isinstance(entry, Mapping):
        return None
    turned = next((entry[key] for key in ("rotation", "orientation") if key in entry), None)
    moved = next((entry[key] for key in ("translation", "position") if key in entry), None)
    if turned is None and {"qx", "qy", "qz", "qw"} <= entry.keys():
        turned, moved = {key[1]: entry[key] for key in ("qx", "qy", "qz", "qw")}, entry
    if not isinstance(turned, Mapping) or not {"x", "y", "z", "w"} <= turned.keys() or not isinstance(moved, Mapping):
        return None
    R, t = _rotation(turned, "", False), _vector({k: moved[k] for k in "xyz" if k in moved}, 3, "translation")
    return None if R is None or t is None else _rigid(R, t)


def _ros(tree: Values) -> Content | None:
    """Read camera poses from ROS transforms (REP 103, REP 105), or return None."""
    listed = tree.get("transforms", tree)
    single = "transform" in tree or "child_frame_id" in tree
    entries = [("", tree)] if single else list(listed.items()) if isinstance(listed, Mapping) else []
    entries = [("", entry) for entry in listed] if isinstance(listed, list) else entries
    steps: dict[str, tuple[str, np.ndarray]] = {}
    names: dict[str, str] = {}
    for key, entry in entries:
        if (pose := _ros_pose(entry)) is None or has_lens(entry) or _UNITY_LENS & set(map(plain, entry)):
            continue
        header = stated if isinstance(stated := entry.get("header"), Mapping) else entry
        parent, child = str(header.get("frame_id", "world")), str(entry.get("child_frame_id") or key)
        inverse = child.strip("/").lower() in ("world", "map", "odom")  # the pose of the world in the camera
        child, parent, pose = (parent, child, pose) if inverse else (child, parent, np.linalg.inv(pose))
        steps[child], names[child] = (parent, pose), str(key) or child
    leaves = [child for child in steps if child not in {parent for parent, _ in steps.values()}]
    nodes: Nodes = []
    for child in leaves:
        body = "optical" not in child.lower() and "link" in child.lower()
        whole = _chained(steps, child)
        nodes.append((names[child], {"extrinsics": _rigid(_LINK, np.zeros(3)) @ whole if body else whole}))
    return Content(nodes) if nodes else None


_PARTS = {"K": "K", "dist": "distortion", "R": "rvec", "Rot": "rotation", "T": "translation"}
_PARTS |= {"H": "height", "W": "width"}


def _easymocap(tree: Values) -> Content | None:
    """Read EasyMocap's intri.yml or extri.yml, with names such as ``K_<camera>``. Return None for other files."""
    if {"R", "T"} <= tree.keys():  # an OpenCV stereo pair
        return None
    parts: dict[str, dict[str, Any]] = {}
    for key, value in tree.items():
        kind, _, camera = str(key).partition("_")
        if kind in _PARTS and camera and (isinstance(value, Mapping) or kind in "HW"):
            parts.setdefault(camera, {})[_PARTS[kind]] = value
    return Content(list(parts.items())) if parts else None


def _human36m(tree: Values) -> Content | None:
    """Read Human3.6M's JSON (``intrinsics[camera]`` and ``extrinsics[subject][camera]``), or return None."""
    inner, outer = tree.get("intrinsics"), tree.get("extrinsics")
    if not isinstance(inner, Mapping) or not isinstance(outer, Mapping) or not all(map(has_lens, inner.values())):
        return None
    by_subject = [cameras for cameras in outer.values() if isinstance(cameras, Mapping)]
    subjects = [cameras for cameras in by_subject if all(isinstance(camera, Mapping) for camera in cameras.values())]
    if not subjects or len(subjects) < len(outer):
        return None
    if len(subjects) > 1:
        what = f"The file has the cameras of {len(subjects)} subjects: {', '.join(map(str, outer))}."
        raise CalibrationInvalid(what, hint="Keep the entry under 'extrinsics' of the subject who was recorded.")
    return Content([(str(name), {**inner[name], **camera}) for name, camera in subjects[0].items() if name in inner])


def _nerf(tree: Values) -> Content | None:
    """Read the static cameras in NeRF's transforms.json. Return None if the cameras move.

    ``transform_matrix`` is from camera to world. A camera takes the name of its image, or of the folder if all images
    have the same name.
    """
    frames = tree.get("frames")
    if not isinstance(frames, list) or not 0 < len(frames) <= _MOST_CAMERAS:
        return None
    if not all(isinstance(frame, Mapping) and "transform_matrix" in frame for frame in frames):
        return None
    pictures = [PurePosixPath(str(frame.get("file_path", i))) for i, frame in enumerate(frames)]
    stems = [picture.stem for picture in pictures]
    names = stems if len(set(stems)) == len(stems) else [picture.parent.name for picture in pictures]
    if len(set(names)) < len(names):
        return None
    return Content(
        [(n, _nerf_camera({**tree, **frame}, f"camera {n}")) for n, frame in zip(names, frames, strict=True)]
    )


def _nerf_camera(stated: Values, place: str) -> Values:
    width, height, angle = (_number(stated, key) for key in ("w", "h", "camera_angle_x"))
    by_angle = 0.5 * width / np.tan(0.5 * angle) if width and angle and 0 < angle < np.pi else None
    focal = _number(stated, "fl_x") or by_angle
    if not focal:
        hint = "Write fl_x, or camera_angle_x with w, for each image or for all images."
        raise CalibrationInvalid("The camera has no focal length.", where=place, hint=hint)
    model = model_named(str(stated.get("camera_model")))
    node = {"fx": focal, "fy": _number(stated, "fl_y") or focal, "width": width, "height": height, "model": model}
    for centre, size in (("cx", width), ("cy", height)):
        stated_centre = _number(stated, centre)
        node[centre] = 0.5 * size if stated_centre is None and size is not None else stated_centre
    node["distortion"] = [_number(stated, key) or 0.0 for key in LENS_MODELS[model].terms[:4]]
    node["extrinsics"] = _world_to_camera(numbers(stated["transform_matrix"], place), GRAPHICS)
    return {key: value for key, value in node.items() if value is not None}


_FROM_PREVIOUS = "T_cn_cnm1"  # (4, 4) matrix from the previous camera to this one.


def _kalibr(tree: Values) -> Content | None:
    """Read Kalibr's ``camchain.yaml`` (Furgale, Rehder and Siegwart 2013), or return None for other files."""
    nodes = [(str(name), node) for name, node in tree.items()]
    if len(nodes) < 2 or not all(isinstance(node, Mapping) and "intrinsics" in node for _, node in nodes):
        return None
    if not any(_FROM_PREVIOUS in node for _, node in nodes):
        return None
    steps: dict[str, tuple[str, np.ndarray]] = {}
    for i, (name, node) in enumerate(nodes):
        place = f"camera {name}"
        if str(node.get("camera_model", "pinhole")) != "pinhole":
            what = f"Kalibr's camera model {node['camera_model']} is not supported."
            raise CalibrationInvalid(what, where=place, hint="Calibrate with pinhole-radtan or pinhole-equi.")
        step = numbers(node.get(_FROM_PREVIOUS, np.eye(4) if i == 0 else []), place)
        if step.shape != (4, 4):
            raise CalibrationInvalid(f"{_FROM_PREVIOUS} has shape {step.shape}, but (4, 4) is expected.", where=place)
        steps[name] = (nodes[i - 1][0] if i else "", step)
    return Content([(name, {**node, "extrinsics": _chained(steps, name)}) for name, node in nodes])


_FORMS: tuple[Callable[[Values], Content | None], ...] = (
    _human36m,
    _nerf,
    _kalibr,
    _multical,
    _mccalib,
    _easymocap,
    _stereo,
    _ros,
)
"""Functions that each read a whole file, tried in this order. They return None if the content is not theirs."""
