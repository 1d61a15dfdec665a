"""Detections and calibrations in formats of programs and scripts. Each function writes a take in one of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras
from tests.benchmarks.strangers.take import COCO, FPS, Take, write_openpose, write_rate, write_toml
from tests.support.calibration_files import toml_text


def _json(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content), encoding="utf-8")


def _by_name(person: np.ndarray, names: Sequence[str] = COCO) -> dict[str, list[float]]:
    return dict(zip(names, person.tolist(), strict=True))


def objects_by_name(folder: Path, take: Take) -> None:
    """Write one file per camera: a list of frames, each an object of points by name."""
    for c, name in enumerate(take.names):
        _json(folder / f"{name}.json", [_by_name(person) for person in take.coco()[c]])
    write_toml(folder, take.cameras)


def objects_by_name_a_frame(folder: Path, take: Take) -> None:
    """Write one file per picture: an object of points by name."""
    for c, name in enumerate(take.names):
        for f, person in enumerate(take.coco()[c]):
            _json(folder / name / f"{f:04d}.json", _by_name(person))
    write_toml(folder, take.cameras)


def objects_in_keypoints(folder: Path, take: Take) -> None:
    """Write one file per camera: frames with their number, and points by name as x, y, score."""
    for c, name in enumerate(take.names):
        frames = [
            {"frame": f, "keypoints": {n: {"x": p[0], "y": p[1], "score": p[2]} for n, p in _by_name(person).items()}}
            for f, person in enumerate(take.coco()[c])
        ]
        _json(folder / f"{name}.json", frames)
    write_toml(folder, take.cameras)


def objects_by_camera(folder: Path, take: Take) -> None:
    """Write one common file: cameras by name, each a list of frames of points by name."""
    _json(folder / "walk.json",
          {name: [_by_name(person) for person in take.coco()[c]] for c, name in enumerate(take.names)})  # fmt: skip
    write_toml(folder, take.cameras)


def openpose_lines(folder: Path, take: Take) -> None:
    """Write one file per camera with an OpenPose document per line."""
    for c, name in enumerate(take.names):
        lines = [
            json.dumps({"version": 1.3, "people": [{"pose_keypoints_2d": person.ravel().tolist()}]})
            for person in take.points[c]
        ]
        (folder / f"{name}.jsonl").parent.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.jsonl").write_text("\n".join(lines), encoding="utf-8")
    write_toml(folder, take.cameras)


def openpose_list(folder: Path, take: Take) -> None:
    """Write one file per camera: a list of OpenPose documents."""
    for c, name in enumerate(take.names):
        people = [{"people": [{"pose_keypoints_2d": person.ravel().tolist()}]} for person in take.points[c]]
        _json(folder / f"{name}.json", people)
    write_toml(folder, take.cameras)


def dlc_other_parts(folder: Path, take: Take) -> None:
    """Write DeepLabCut tables. One camera's table lacks two body parts and has another order."""
    dlc(folder, take, lambda c: [n for n in reversed(COCO) if n not in ("left_ear", "right_ear")] if c == 1 else COCO)


def dlc_few_parts(folder: Path, take: Take) -> None:
    """Write DeepLabCut tables with no common body parts between two pairs of cameras."""
    dlc(folder, take, lambda c: COCO[:8] if c % 2 else COCO[8:])


def dlc_limbs(folder: Path, take: Take) -> None:
    """Write DeepLabCut tables with informal names."""
    spelled = {"left": "L", "right": "R"}
    names = ["".join(spelled.get(p, p.capitalize()) for p in n.split("_")) for n in COCO]
    dlc(folder, take, lambda c: COCO, names)


def dlc(folder: Path, take: Take, parts: Callable[[int], Sequence[str]], spelled: Sequence[str] = COCO) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for c, name in enumerate(take.names):
        chosen = [COCO.index(part) for part in parts(c)]
        heading = [["scorer"] + ["DLC_resnet50"] * 3 * len(chosen)]
        heading += [["bodyparts", *(spelled[i] for i in chosen for _ in range(3))]]
        heading += [["coords"] + ["x", "y", "likelihood"] * len(chosen)]
        rows = [[str(f), *map(str, person[chosen].ravel())] for f, person in enumerate(take.coco()[c])]
        text = "\n".join(",".join(row) for row in heading + rows)
        (folder / f"{name}DLC_resnet50_walkNov1shuffle1_100000.csv").write_text(text, encoding="utf-8")
    write_toml(folder, take.cameras)


def swapped_axes(folder: Path, take: Take) -> None:
    """Write rows and columns instead of x and y."""
    points = take.points.copy()
    points[..., :2] = points[..., [1, 0]]
    _openpose(folder, replace(take, points=points))


def normalised(folder: Path, take: Take) -> None:
    """Write coordinates as fractions of the picture."""
    size = take.cameras.image_size[:, None, None]
    _openpose(folder, replace(take, points=np.concatenate([take.points[..., :2] / size, take.points[..., 2:]], -1)))


def centred_shares(folder: Path, take: Take) -> None:
    """Write coordinates from -1 to 1 over the picture (OpenPose's ``--keypoint_scale 4``)."""
    size = take.cameras.image_size[:, None, None]
    xy = np.where(take.points[..., 2:] > 0, 2 * take.points[..., :2] / size - 1, 0.0)
    _openpose(folder, replace(take, points=np.concatenate([xy, take.points[..., 2:]], -1)))


def per_cent(folder: Path, take: Take) -> None:
    """Write confidences in per cent."""
    _openpose(folder, replace(take, points=take.points * [1, 1, 100]))


def eight_bit(folder: Path, take: Take) -> None:
    """Write confidences from 0 to 255."""
    _openpose(folder, replace(take, points=(take.points * [1, 1, 255]).round(1)))


def origin_with_confidence(folder: Path, take: Take) -> None:
    """Write unseen points at (0, 0) with confidence 1."""
    points = take.points.copy()
    rng = np.random.default_rng(0)
    points[(rng.uniform(size=points.shape[:-1]) < 0.1) | (points[..., 2] == 0)] = [0, 0, 1.0]
    _openpose(folder, replace(take, points=points))


def minus_one(folder: Path, take: Take) -> None:
    """Write unseen points at (-1, -1) with confidence 1."""
    points = take.points.copy()
    rng = np.random.default_rng(0)
    points[(rng.uniform(size=points.shape[:-1]) < 0.1) | (points[..., 2] == 0)] = [-1, -1, 1.0]
    _openpose(folder, replace(take, points=points))


def constant_far_away(folder: Path, take: Take) -> None:
    """Write unseen points in the lower right corner with confidence 0.3."""
    points = take.points.copy()
    rng = np.random.default_rng(0)
    points[rng.uniform(size=points.shape[:-1]) < 0.15] = [1919, 1079, 0.3]
    _openpose(folder, replace(take, points=points))


def _openpose(folder: Path, take: Take, calibration: Cameras | None = None) -> None:
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [take.points[c]])
    write_toml(folder, take.cameras if calibration is None else calibration)
    write_rate(folder)


def anipose_extra(folder: Path, take: Take) -> None:
    """Write Anipose's TOML in mm with eight cameras. The four recorded ones are called A to D in it."""
    more = with_more(take.cameras, 8)
    more = replace(more, names=tuple("HGFEABCD"))
    (folder / "calibration").mkdir(parents=True, exist_ok=True)
    (folder / "calibration" / "calibration.toml").write_text(toml_text(more, scale=1000.0, nested=True))
    for c, letter in enumerate("ABCD"):
        write_openpose(folder, f"2024-03-02_walk1_cam{letter}", [take.points[c]])
    write_rate(folder)


def with_more(cameras: Cameras, count: int) -> Cameras:
    """Return ``count`` cameras: some at other positions, then the given ones."""
    more = count - len(cameras)
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    doubled = {name: np.concatenate([value[:more], value]) for name in ("K", "distortion", "R", "t", "image_size")
               if (value := getattr(cameras, name)) is not None}  # fmt: skip
    doubled["R"][:more] = doubled["R"][:more] @ turn
    doubled["t"][:more] += [0.1, 0.2, 0.7]
    names, models = tuple(f"c{i}" for i in range(count)), cameras.models[:more] + cameras.models
    return replace(cameras, names=names, models=models, **doubled)


def serial_numbers(folder: Path, take: Take) -> None:
    """Write folders named by serial number, and a calibration of eight cameras named by model and serial number."""
    more = replace(with_more(take.cameras, 8), names=tuple(f"FLIR_BFS-U3_1930{i}47{i}" for i in range(8)))
    for c in range(4):
        write_openpose(folder, f"1930{c + 4}47{c + 4}", [take.points[c]])
    write_toml(folder, more)
    write_rate(folder)


def camera_order_only(folder: Path, take: Take) -> None:
    """Write a calibration named by words for folders named by letters. Only the views show which belong together."""
    for letter, c in zip("abcd", (2, 0, 3, 1), strict=True):
        write_openpose(folder, letter, [take.points[c]])
    write_toml(folder, replace(take.cameras, names=("window", "door", "stage", "balcony")))
    write_rate(folder)


def rodrigues_json(folder: Path, take: Take) -> None:
    """Write a script's JSON: a list of cameras with rvec and tvec as columns, in mm."""
    cameras = take.cameras
    _json(folder / "calibration" / "cams.json", {"cameras": [
        {"id": name, "intrinsics": cameras.K[c].tolist(), "dist_coeffs": [cameras.distortion[c, :5].tolist()],
         "rvec": [[v] for v in np.asarray(log_so3(cameras.R[c])).tolist()],
         "tvec": [[v] for v in (1000 * cameras.t[c]).tolist()], "resolution": cameras.image_size[c].tolist()}
        for c, name in enumerate(cameras.names)]})  # fmt: skip
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [take.points[c]])
    write_rate(folder)


def xcp(folder: Path, take: Take) -> None:
    """Write Vicon's cameras: quaternion from world to camera (x, y, z, w), position in mm."""
    rows = []
    for c, name in enumerate(take.names):
        K = take.cameras.K[c]
        x, y, z, w = _quaternion(take.cameras.R[c])
        place = " ".join(f"{v:.6f}" for v in 1000 * take.cameras.centres[c])
        optics = f'FOCAL_LENGTH="{K[0, 0]}" PRINCIPAL_POINT="{K[0, 2]} {K[1, 2]}"'
        rows.append(
            f'<Camera DEVICEID="{2100 + c}" USERID="{c + 1}" NAME="{name}" PIXEL_ASPECT_RATIO="1" TYPE="Vue" '
            f'SENSOR_SIZE="1920 1080"><KeyFrames><KeyFrame FRAME="0" {optics} ORIENTATION="{x} {y} {z} {w}" '
            f'POSITION="{place}" VICON_RADIAL2="ViconRadial2 0 0 0 0 0"/></KeyFrames></Camera>'
        )
    (folder / "calibration").mkdir(parents=True, exist_ok=True)
    text = '<?xml version="1.0"?><Cameras>' + "".join(rows) + "</Cameras>"
    (folder / "calibration" / "walk01.xcp").write_text(text, encoding="utf-8")
    for c in range(len(take.names)):
        write_openpose(folder, f"walk01.{2100 + c}", [take.points[c]])
    write_rate(folder)


def _quaternion(R: np.ndarray) -> tuple[float, float, float, float]:
    vector = np.asarray(log_so3(R))
    angle = float(np.linalg.norm(vector))
    x, y, z = (np.sin(angle / 2) * vector / angle).tolist()
    return x, y, z, float(np.cos(angle / 2))


def own_table_of_all(folder: Path, take: Take) -> None:
    """Write one common table with camera, frame, keypoint, x, y and confidence in each row."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = ["camera,frame,keypoint,x,y,confidence"]
    coco = take.coco()
    for c, name in enumerate(take.names):
        for f in range(coco.shape[1]):
            rows += [f"{name},{f},{n},{p[0]},{p[1]},{p[2]}" for n, p in _by_name(coco[c, f]).items()]
    (folder / "keypoints.csv").write_text("\n".join(rows), encoding="utf-8")
    write_toml(folder, take.cameras)


def one_array(folder: Path, take: Take) -> None:
    """Write one (C, F, K, 3) array of all cameras as .npy."""
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "keypoints.npy", take.coco())
    write_toml(folder, take.cameras)


def one_archive(folder: Path, take: Take) -> None:
    """Write one .npz with an array per camera."""
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "keypoints.npz", **dict(zip(take.names, take.coco(), strict=True)))
    write_toml(folder, take.cameras)


def mediapipe_landmarks(folder: Path, take: Take) -> None:
    """Write one list of frames per camera, each with x, y (fractions), z and visibility of COCO's points."""
    for c, name in enumerate(take.names):
        width, height = take.cameras.image_size[c].tolist()
        _json(folder / f"{name}.json", {"fps": FPS, "frames": [
            {"frame": f, "landmarks": [{"name": n, "x": p[0] / width, "y": p[1] / height, "z": 0.0, "visibility": p[2]}
                                       for n, p in _by_name(person).items()]}
            for f, person in enumerate(take.coco()[c])]})  # fmt: skip
    write_toml(folder, take.cameras)


FORMS: dict[str, Callable[[Path, Take], None]] = {
    f.__name__.replace("_", " "): f
    for f in (
        objects_by_name, objects_by_name_a_frame, objects_in_keypoints, objects_by_camera, openpose_lines,
        openpose_list, dlc_other_parts, dlc_few_parts, dlc_limbs, swapped_axes, normalised, centred_shares, per_cent,
        eight_bit, origin_with_confidence, minus_one, constant_far_away, anipose_extra, serial_numbers,
        camera_order_only, rodrigues_json, xcp, own_table_of_all, one_array, one_archive, mediapipe_landmarks,
    )
}  # fmt: skip
"""Functions that write a case, by name."""
