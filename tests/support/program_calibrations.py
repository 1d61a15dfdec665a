"""Calibrations as programs write them, made from their public descriptions; each is a function of the folder."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.geometry.rotations import quat_from_matrix
from tests.support.calibration_files import yaml_matrix
from tests.support.camera_ring import ring

CAMERAS = ring(4)
CAMERAS = replace(CAMERAS, K=CAMERAS.K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # principal points in the middle
NAMES, K, R, T, CENTRES = CAMERAS.names, CAMERAS.K, CAMERAS.R, CAMERAS.t, CAMERAS.centres
WIDTH, HEIGHT = map(int, CAMERAS.image_size[0])
WHOLE = np.tile(np.eye(4), (4, 1, 1))
WHOLE[:, :3, :3], WHOLE[:, :3, 3] = R, T
POSES = np.linalg.inv(WHOLE)
MIRROR, GRAPHICS = np.diag([1.0, 1.0, -1.0]), np.diag([1.0, -1.0, -1.0])


def _json(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def _xyzw(rotation: np.ndarray) -> dict[str, float]:
    w, x, y, z = np.asarray(quat_from_matrix(rotation)).tolist()
    return {"x": x, "y": y, "z": z, "w": w}


def multical(folder: Path) -> None:
    lens = {n: {"model": "standard", "image_size": [WIDTH, HEIGHT], "K": k.tolist(), "dist": [[0.0] * 5]}
            for n, k in zip(NAMES, K, strict=True)}  # fmt: skip
    keys = [NAMES[0], *(f"{name}_to_{NAMES[0]}" for name in NAMES[1:])]
    steps = [whole @ (POSES[0] if c else np.eye(4)) for c, whole in enumerate(WHOLE)]
    steps[0] = np.eye(4)
    poses = {k: {"R": s[:3, :3].tolist(), "T": s[:3, 3].tolist()} for k, s in zip(keys, steps, strict=True)}
    _json(folder / "calibration.json", {"cameras": lens, "image_sets": {}, "camera_poses": poses})


def multical_world(folder: Path) -> None:
    multical(folder)
    content = json.loads((folder / "calibration.json").read_text())
    content["camera_poses"] = {n: {"R": R[c].tolist(), "T": T[c].tolist()} for c, n in enumerate(NAMES)}
    _json(folder / "calibration.json", content)


def mccalib(folder: Path, groups: int = 1) -> None:
    text = "%YAML:1.0\n---\nnb_camera: 4\n"
    for c, name in enumerate(NAMES):
        node = yaml_matrix("camera_matrix", K[c]) + yaml_matrix("distortion_vector", np.zeros(5))
        node += f"distortion_type: 0\ncamera_group: {c % groups}\nimg_width: {WIDTH}\nimg_height: {HEIGHT}\n"
        node += yaml_matrix("camera_pose_matrix", POSES[c])
        text += f"{name}:\n" + "".join(f"   {line}\n" for line in node.splitlines())
    (folder / "calibrated_cameras_data.yml").write_text(text)


def _pair(folder: Path, named: Callable[[Path, str, dict[str, np.ndarray]], None]) -> None:
    step = WHOLE[1] @ POSES[0]
    named(folder, "intrinsics", {"M1": K[0], "D1": np.zeros(5), "M2": K[1], "D2": np.zeros(5)})
    rectified = {"R1": np.eye(3), "R2": np.eye(3), "P1": np.eye(3, 4), "P2": np.eye(3, 4)}
    named(folder, "extrinsics", {"R": step[:3, :3], "T": step[:3, 3:], **rectified, "Q": np.eye(4)})


def stereo_yaml(folder: Path) -> None:
    def write(folder: Path, name: str, values: dict[str, np.ndarray]) -> None:
        text = "".join(yaml_matrix(key, value) for key, value in values.items())
        (folder / f"{name}.yml").write_text(f"%YAML:1.0\n---\n{text}")

    _pair(folder, write)


def stereo_xml(folder: Path) -> None:
    def write(folder: Path, name: str, values: dict[str, np.ndarray]) -> None:
        text = '<?xml version="1.0"?>\n<opencv_storage>\n'
        for key, value in values.items():
            rows, columns = np.atleast_2d(value).shape
            data = " ".join(map(repr, map(float, value.ravel())))
            text += f'<{key} type_id="opencv-matrix"><rows>{rows}</rows><cols>{columns}</cols><dt>d</dt>'
            text += f"<data>\n{data}</data></{key}>\n"
        (folder / f"{name}.xml").write_text(text + "</opencv_storage>\n")

    _pair(folder, write)


def stereo_one_file(folder: Path) -> None:
    step = WHOLE[1] @ POSES[0]
    values = {"cameraMatrix1": K[0], "distCoeffs1": np.zeros(5), "cameraMatrix2": K[1], "distCoeffs2": np.zeros(5),
              "R": step[:3, :3], "T": step[:3, 3]}  # fmt: skip
    content = {key: value.tolist() for key, value in values.items()}
    _json(folder / "stereo.json", {**content, "image_size": [WIDTH, HEIGHT]})


def _camera_info(folder: Path, c: int) -> None:
    text = f"image_width: {WIDTH}\nimage_height: {HEIGHT}\ncamera_name: {NAMES[c]}\ndistortion_model: plumb_bob\n"
    for key, value in (("camera_matrix", K[c]), ("distortion_coefficients", np.zeros((1, 5))),
                       ("rectification_matrix", np.eye(3)), ("projection_matrix", np.eye(3, 4))):  # fmt: skip
        text += f"{key}:\n  rows: {len(value)}\n  cols: {value.shape[1]}\n  data: {value.ravel().tolist()}\n"
    (folder / f"{NAMES[c]}.yaml").write_text(text)


def ros(folder: Path, write: Callable[[int], dict[str, Any]] | None = None, listed: bool = False) -> None:
    def stamped(c: int) -> dict[str, Any]:
        moved = dict(zip("xyz", CENTRES[c].tolist(), strict=True))
        transform = {"translation": moved, "rotation": _xyzw(R[c].T)}
        child = f"{NAMES[c]}_optical_frame"
        return {"header": {"frame_id": "world"}, "child_frame_id": child, "transform": transform}

    for c in range(4):
        _camera_info(folder, c)
    entries = [(write or stamped)(c) for c in range(4)]
    _json(folder / "extrinsics.json", {"transforms": entries} if listed else dict(zip(NAMES, entries, strict=True)))


def ros_list(folder: Path) -> None:
    ros(folder, listed=True)


def ros_links(folder: Path) -> None:
    """Frames of bodies, which look along X, with the pose of the world in each."""
    to_body = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

    def of_world(c: int) -> dict[str, Any]:
        moved = dict(zip("xyz", (to_body @ T[c]).tolist(), strict=True))
        transform = {"translation": moved, "rotation": _xyzw(to_body @ R[c])}
        return {"header": {"frame_id": f"{NAMES[c]}_link"}, "child_frame_id": "world", "transform": transform}

    ros(folder, of_world, listed=True)


def ros_poses(folder: Path) -> None:
    def pose(c: int) -> dict[str, Any]:
        at = dict(zip("xyz", CENTRES[c].tolist(), strict=True))
        return {"pose": {"position": at, "orientation": _xyzw(R[c].T)}}

    ros(folder, pose)


def quaternions(folder: Path) -> None:
    """Intrinsics and a pose of ROS in one node per camera."""
    nodes = [{"name": name, "K": K[c].tolist(), "width": WIDTH, "height": HEIGHT,
              "position": dict(zip("xyz", CENTRES[c].tolist(), strict=True)), "orientation": _xyzw(R[c].T)}
             for c, name in enumerate(NAMES)]  # fmt: skip
    _json(folder / "cameras.json", nodes)


def _unity_pose(c: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and position with Y up, left-handed: swapping Y and Z changes the hand and the up axis."""
    swap = np.eye(3)[[0, 2, 1]]
    return swap @ R[c].T @ np.diag([1.0, -1.0, 1.0]), swap @ CENTRES[c]


def unity(folder: Path) -> None:
    cameras = []
    for c, name in enumerate(NAMES):
        turn, at = _unity_pose(c)
        angle = float(np.degrees(2 * np.arctan(0.5 * HEIGHT / K[c, 1, 1])))
        position = dict(zip("xyz", at.tolist(), strict=True))
        cameras.append({"name": name, "position": position, "rotation": _xyzw(turn), "fieldOfView": angle,
                        "width": WIDTH, "height": HEIGHT})  # fmt: skip
    _json(folder / "cameras.json", {"cameras": cameras})


def unity_physical(folder: Path) -> None:
    """A map of physical cameras with Euler angles, whose picture size is stated once."""
    cameras = {}
    for c, name in enumerate(NAMES):
        turn, at = _unity_pose(c)
        x, y, z = np.arcsin(-turn[1, 2]), np.arctan2(turn[0, 2], turn[2, 2]), np.arctan2(turn[1, 0], turn[1, 1])
        cameras[name] = {
            "transform": {"position": at.tolist(), "eulerAngles": np.degrees([x, y, z]).tolist()},
            "focalLength": K[c, 0, 0] * 36.0 / WIDTH,
            "sensorSize": {"x": 36.0, "y": 36.0 * HEIGHT / WIDTH},
        }
    _json(folder / "cameras.json", {"pixelWidth": WIDTH, "pixelHeight": HEIGHT, "cameras": cameras})


def blender(folder: Path) -> None:
    cameras = {}
    for c, name in enumerate(NAMES):
        pose = POSES[c].copy()
        pose[:3, :3] = pose[:3, :3] @ GRAPHICS
        cameras[name] = {"matrix_world": pose.tolist(), "lens": K[c, 0, 0] * 36.0 / WIDTH, "sensor_width": 36.0,
                         "resolution": [WIDTH, HEIGHT]}  # fmt: skip
    _json(folder / "cameras.json", cameras)


def blender_angles(folder: Path) -> None:
    cameras = []
    for c, name in enumerate(NAMES):
        w, x, y, z = np.asarray(quat_from_matrix(R[c].T @ GRAPHICS)).tolist()
        angle = float(2 * np.arctan(0.5 * WIDTH / K[c, 0, 0]))
        cameras.append({"name": name, "location": CENTRES[c].tolist(), "rotation_quaternion": [w, x, y, z],
                        "angle": angle})  # fmt: skip
    render = {"resolution_x": 2 * WIDTH, "resolution_y": 2 * HEIGHT, "resolution_percentage": 50}
    _json(folder / "scene.json", {**render, "cameras": cameras})


def fit3d(folder: Path) -> None:
    for c, name in enumerate(NAMES):
        lens = {"f": [[K[c, 0, 0], K[c, 1, 1]]], "c": [K[c, :2, 2].tolist()], "k": [[0.0] * 3], "p": [[0.0] * 2]}
        outer = {"R": R[c].tolist(), "T": [CENTRES[c].tolist()]}
        for take in ("squat", "warmup_1"):
            path = folder / "camera_parameters" / name / f"{take}.json"
            _json(path, {"extrinsics": outer, "intrinsics_w_distortion": lens, "intrinsics_wo_distortion": {}})


def aist(folder: Path) -> None:
    for number, shift in ((1, 0.5), (2, 0.0)):
        cameras = [{"name": name, "size": [WIDTH, HEIGHT], "matrix": K[c].tolist(), "rotation": R[c].tolist(),
                    "translation": (T[c] + shift * c).tolist(), "distortions": [0.0] * 5}
                   for c, name in enumerate(NAMES)]  # fmt: skip
        _json(folder / "cameras" / f"setting{number}.json", cameras)
    (folder / "cameras" / "mapping.txt").write_text(f"gBR_sBM_other setting1\n{folder.name} setting2\n")


def opencap(folder: Path) -> None:
    for c, name in enumerate(NAMES):
        path = folder / "Videos" / name / "cameraIntrinsicsExtrinsics.pickle"
        path.parent.mkdir(parents=True)
        values = {"distortion": np.zeros((1, 5)), "intrinsicMat": K[c], "rotation": R[c],
                  "imageSize": np.array([[float(HEIGHT)], [float(WIDTH)]]), "translation": 1000.0 * T[c][:, None],
                  "rotation_EulerAngles": np.zeros((3, 1))}  # fmt: skip
        path.write_bytes(pickle.dumps(values))


def vicon(folder: Path) -> None:
    text = "<Cameras>"
    for c, name in enumerate(NAMES):
        q = " ".join(str(_xyzw(R[c])[key]) for key in "xyzw")
        at = " ".join(map(str, (1000.0 * CENTRES[c]).tolist()))
        text += f'<Camera DEVICEID="{name}" DISPLAY_TYPE="Vue" SENSOR_SIZE="{WIDTH} {HEIGHT}" PIXEL_ASPECT_RATIO="1">'
        text += f'<KeyFrames><KeyFrame FOCAL_LENGTH="{K[c, 0, 0]}" PRINCIPAL_POINT="{K[c, 0, 2]} {K[c, 1, 2]}" '
        text += f'ORIENTATION="{q}" POSITION="{at}" VICON_RADIAL2="ViconRadial2 960 540 0 0 0"/></KeyFrames></Camera>'
    text += '<Camera DEVICEID="2100001" DISPLAY_TYPE="Vantage" SENSOR_SIZE="1 1"><KeyFrames/></Camera>'
    (folder / "take.xcp").write_text(text + "</Cameras>")


def metashape(folder: Path) -> None:
    """Cameras in a chunk that is turned, moved and twice as large as the world."""
    turn, moved, scale = R[2], np.array([1.0, -2.0, 0.5]), 0.5
    text = '<?xml version="1.0"?>\n<document version="2.0.0"><chunk><sensors>'
    for c in range(4):
        off = K[c, :2, 2] - 0.5 * np.array([WIDTH - 1, HEIGHT - 1])
        text += f'<sensor id="{c}" type="frame"><calibration type="frame" class="adjusted"><resolution width="{WIDTH}"'
        text += f' height="{HEIGHT}"/><f>{K[c, 0, 0]}</f><cx>{off[0]}</cx><cy>{off[1]}</cy></calibration></sensor>'
    text += "</sensors><cameras>"
    for c, name in enumerate(NAMES):
        pose = POSES[c].copy()
        pose[:3, :3], pose[:3, 3] = turn.T @ POSES[c, :3, :3], turn.T @ (CENTRES[c] - moved) / scale
        numbers = " ".join(map(str, pose.ravel().tolist()))
        text += f'<camera id="{c}" sensor_id="{c}" label="{name}.png"><transform>{numbers}</transform></camera>'
    rotation, translation = (" ".join(map(str, values.ravel().tolist())) for values in (turn, moved))
    text += f"</cameras><transform><rotation>{rotation}</rotation><translation>{translation}</translation>"
    (folder / "doc.xml").write_text(text + f"<scale>{scale}</scale></transform></chunk></document>")


def colmap(folder: Path) -> None:
    (model := folder / "sparse" / "0").mkdir(parents=True)
    lines = [
        f"{c} PINHOLE {WIDTH} {HEIGHT} {K[c, 0, 0]} {K[c, 1, 1]} {K[c, 0, 2] + 0.5} {K[c, 1, 2] + 0.5}"
        for c in range(4)
    ]
    (model / "cameras.txt").write_text("\n".join(["# cameras", *lines]))
    q = [" ".join(str(_xyzw(R[c])[key]) for key in "wxyz") for c in range(4)]
    moved = [" ".join(map(str, t.tolist())) for t in T]
    rows = [f"{c} {q[c]} {moved[c]} {c} {name}.png\n" for c, name in enumerate(NAMES)]
    (model / "images.txt").write_text("\n".join(["# images", *rows]))


WRITERS = (multical, multical_world, mccalib, ros, ros_list, ros_links, ros_poses, quaternions, unity,
           unity_physical, blender, blender_angles, fit3d, aist, opencap, vicon, metashape, colmap)  # fmt: skip
PAIRS = (stereo_yaml, stereo_xml, stereo_one_file)
RELATIVE = (multical, *PAIRS)
"""Forms whose world is the first camera."""
