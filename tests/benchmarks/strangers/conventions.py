"""Calibrations in other programs' conventions. Each function writes a take with one of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras
from tests.benchmarks.strangers.faults import all_of, half, turned
from tests.benchmarks.strangers.take import FPS, Take, demo_take, write_openpose, write_rate, write_take, write_toml


def _recorded(folder: Path, take: Take) -> Path:
    """Write everything except the calibration, and return the calibration's folder."""
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [take.points[c]])
    write_rate(folder)
    (folder / "calibration").mkdir(parents=True, exist_ok=True)
    return folder / "calibration"


def _json(folder: Path, take: Take, content: object, name: str = "cameras.json") -> None:
    (_recorded(folder, take) / name).write_text(json.dumps(content), encoding="utf-8")


def _changed(take: Take, **values: np.ndarray) -> Cameras:
    return replace(take.cameras, **values)


def panoptic(folder: Path, take: Take) -> None:
    """Write CMU Panoptic Studio's JSON: name, K, distCoef, R, and t in cm, with Y down."""
    to_file = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    cameras = replace(take.cameras, R=take.cameras.R @ to_file.T)
    _json(folder, take, {"calibDataSource": "160906", "cameras": [
        {"name": n, "type": "hd", "resolution": cameras.image_size[c].tolist(), "panel": 0, "node": c,
         "K": cameras.K[c].tolist(), "distCoef": cameras.distortion[c, :5].tolist(),
         "R": cameras.R[c].tolist(), "t": (100 * cameras.t[c])[:, None].tolist()} for c, n in enumerate(take.names)
    ]}, "calibration_160906_band2.json")  # fmt: skip


def aist(folder: Path, take: Take) -> None:
    """Write AIST++'s list with name, size, matrix, rotation (vector), translation in cm, and distortions."""
    cameras = take.cameras
    _json(folder, take, [
        {"name": n, "size": cameras.image_size[c].tolist(), "matrix": cameras.K[c].tolist(),
         "rotation": np.asarray(log_so3(cameras.R[c])).tolist(), "translation": (100 * cameras.t[c]).tolist(),
         "distortions": cameras.distortion[c, :5].tolist()} for c, n in enumerate(take.names)
    ], "setting1.json")  # fmt: skip


def zju(folder: Path, take: Take) -> None:
    """Write ZJU-MoCap's lists K, D, R and T (mm) over the cameras, without names."""
    cameras = take.cameras
    _json(folder, take, {"cams": {
        "K": cameras.K.tolist(), "D": cameras.distortion[:, :5, None].tolist(), "R": cameras.R.tolist(),
        "T": (1000 * cameras.t)[..., None].tolist()}}, "annots.json")  # fmt: skip


def xrprimer(folder: Path, take: Take) -> None:
    """Write XRPrimer's JSON per camera: camera to world, and a 4 x 4 intrinsic matrix."""
    place, cameras = _recorded(folder, take), take.cameras
    for c, name in enumerate(take.names):
        K = np.eye(4)
        K[:3, :3] = cameras.K[c]
        K[2:, 2:] = [[0, 1], [1, 0]]
        k1, k2, p1, p2, k3 = cameras.distortion[c, :5].tolist()
        (place / f"{name}.json").write_text(json.dumps({
            "class_name": "FisheyeCameraParameter", "name": name, "height": 1080, "width": 1920,
            "extrinsic_r": cameras.R[c].T.tolist(), "extrinsic_t": cameras.centres[c].tolist(), "world2cam": False,
            "intrinsic": K.tolist(), "dist_coeff_k": [k1, k2, k3, 0.0, 0.0, 0.0], "dist_coeff_p": [p1, p2],
            "convention": "opencv"}))  # fmt: skip


def kalibr(folder: Path, take: Take) -> None:
    """Write Kalibr's camchain: each camera's pose relative to the previous one, with the names cam0 to cam3."""
    lines, cameras = [], take.cameras
    whole = np.tile(np.eye(4), (len(cameras), 1, 1))
    whole[:, :3, :3], whole[:, :3, 3] = cameras.R, cameras.t
    for c, name in enumerate(take.names):
        K = cameras.K[c]
        lines += [f"cam{c}:", "  camera_model: pinhole", "  distortion_model: radtan",
                  f"  distortion_coeffs: {cameras.distortion[c, :4].tolist()}",
                  f"  intrinsics: {[K[0, 0], K[1, 1], K[0, 2], K[1, 2]]}", "  resolution: [1920, 1080]",
                  f"  rostopic: /{name}/image_raw"]  # fmt: skip
        if c:
            lines += ["  T_cn_cnm1:", *(f"  - {row}" for row in (whole[c] @ np.linalg.inv(whole[c - 1])).tolist())]
    (_recorded(folder, take) / "camchain.yaml").write_text("\n".join(lines) + "\n")


def quaternions(folder: Path, take: Take) -> None:
    """Write a script's JSON: position (m) and quaternion (w, x, y, z) in the world, f and principal point in px."""
    cameras, listed = take.cameras, {}
    for c, name in enumerate(take.names):
        vector = np.asarray(log_so3(cameras.R[c].T))
        angle = float(np.linalg.norm(vector))
        listed[name] = {
            "position": cameras.centres[c].tolist(),
            "orientation": [np.cos(angle / 2), *(np.sin(angle / 2) * vector / angle)],
            "focal_length": float(cameras.K[c, 0, 0]), "principal_point": cameras.K[c, :2, 2].tolist(),
            "image_size": [1920, 1080],
        }  # fmt: skip
    _json(folder, take, listed)


def matlab_rows(folder: Path, take: Take) -> None:
    """Write MATLAB's camera parameters as JSON: transposed K and R (row vectors), t in mm."""
    cameras = take.cameras
    _json(folder, take, {n: {
        "IntrinsicMatrix": cameras.K[c].T.tolist(), "RotationMatrix": cameras.R[c].T.tolist(),
        "TranslationVector": (1000 * cameras.t[c]).tolist(), "RadialDistortion": cameras.distortion[c, :2].tolist(),
        "TangentialDistortion": cameras.distortion[c, 2:4].tolist(), "ImageSize": [1080, 1920]}
        for c, n in enumerate(take.names)})  # fmt: skip


def projections_by_name(folder: Path, take: Take) -> None:
    """Write one JSON with a 3 x 4 projection matrix per camera in mm."""
    cameras = take.cameras
    P = cameras.K @ np.concatenate([cameras.R, 1000 * cameras.t[..., None]], axis=2)
    _json(folder, take, {n: P[c].tolist() for c, n in enumerate(take.names)}, "projections.json")


def degrees_for_radians(folder: Path, take: Take) -> None:
    """Write rotation vectors in degrees."""
    cameras = take.cameras
    text = [f'[{n}]\nname = "{n}"\nsize = [1920.0, 1080.0]\nmatrix = {cameras.K[c].tolist()}\n'
            f"distortions = {cameras.distortion[c, :4].tolist()}\n"
            f"rotation = {np.degrees(np.asarray(log_so3(cameras.R[c]))).tolist()}\n"
            f"translation = {cameras.t[c].tolist()}\nfisheye = false\n"
            for c, n in enumerate(take.names)]  # fmt: skip
    (_recorded(folder, take) / "Calib.toml").write_text("\n".join(text))


def rotations_alone_transposed(folder: Path, take: Take) -> None:
    """Write R from camera to world with t from world to camera."""
    write_take(folder, take, calibration=_changed(take, R=take.cameras.R.swapaxes(1, 2)))


def places_beside_right_rotations(folder: Path, take: Take) -> None:
    """Write negated positions: R and -C."""
    write_take(folder, take, calibration=_changed(take, t=-take.cameras.centres))


def centre_from_the_middle(folder: Path, take: Take) -> None:
    """Write principal points as offsets from the centre of the picture."""
    K = take.cameras.K.copy()
    K[:, :2, 2] -= (take.cameras.image_size - 1) / 2
    write_take(folder, take, calibration=_changed(take, K=K))


def focal_in_mm(folder: Path, take: Take) -> None:
    """Write focal lengths in mm for a sensor width of 36 mm."""
    K = take.cameras.K.copy()
    K[:, [0, 1], [0, 1]] *= 36.0 / 1920.0
    write_take(folder, take, calibration=_changed(take, K=K))


def portrait_in_the_file(folder: Path, take: Take) -> None:
    """Write image sizes as height and width."""
    write_take(folder, take, calibration=_changed(take, image_size=take.cameras.image_size[:, ::-1].copy()))


def calibrated_small(folder: Path, take: Take) -> None:
    """Write a calibration of pictures of 960 x 540 pixels for a recording of 1920 x 1080."""
    K = take.cameras.K.copy()
    K[:, :2, 2] = (K[:, :2, 2] + 0.5) / 2 - 0.5
    K[:, [0, 1], [0, 1]] /= 2
    size = take.cameras.image_size // 2
    write_take(folder, take, calibration=_changed(take, K=K, image_size=size))


def an_old_calibration_beside(folder: Path, take: Take) -> None:
    """Write two calibrations. In last week's, two cameras have other positions."""
    write_take(folder, take)
    t = take.cameras.t.copy()
    t[[0, 2]] += [0.4, 0.1, -0.3]
    (folder / "calibration" / "Calib.toml").rename(folder / "calibration" / "Calib_new.toml")
    write_toml(folder, _changed(take, t=t))


def one_in_another_unit(folder: Path, take: Take) -> None:
    """Write one separately calibrated camera in mm, the others in metres."""
    t = take.cameras.t.copy()
    t[1] *= 1000
    write_take(folder, take, calibration=_changed(take, t=t))


def one_camera_to_world(folder: Path, take: Take) -> None:
    """Write one camera's pose from camera to world, the others from world to camera."""
    R, t = take.cameras.R.copy(), take.cameras.t.copy()
    R[3], t[3] = R[3].T, take.cameras.centres[3]
    write_take(folder, take, calibration=_changed(take, R=R, t=t))


def mm_camera_to_world_half(folder: Path, take: Take) -> None:
    """Write poses from camera to world in mm, with pictures of half the size."""
    cameras = _changed(take, R=take.cameras.R.swapaxes(1, 2), t=1000 * take.cameras.centres)
    write_take(folder, all_of(take, half), calibration=cameras)


def turned_tilted(folder: Path, take: Take) -> None:
    """Write the first camera as the world, with all pictures rotated."""
    cameras = take.cameras
    R = cameras.R @ cameras.R[0].T
    t = cameras.t - (R @ cameras.t[0])
    write_take(folder, all_of(take, turned), calibration=replace(cameras, R=R, t=t))


def apart_and_turned(folder: Path, take: Take) -> None:
    """Write cameras started up to 60 frames apart, with rotated pictures, in mm."""
    long = all_of(demo_take(0, 360), turned)
    for c, start in enumerate((0, 60, 25, 10)):
        write_openpose(folder, take.names[c], [long.points[c, start : start + 290]])
    write_toml(folder, take.cameras, scale=1000.0)
    write_rate(folder, FPS)


CONVENTIONS: dict[str, Callable[[Path, Take], None]] = {
    f.__name__.replace("_", " "): f
    for f in (
        panoptic, aist, zju, xrprimer, kalibr, quaternions, matlab_rows, projections_by_name, degrees_for_radians,
        rotations_alone_transposed, places_beside_right_rotations, centre_from_the_middle, focal_in_mm,
        portrait_in_the_file, calibrated_small, an_old_calibration_beside, one_in_another_unit, one_camera_to_world,
        mm_camera_to_world_half, turned_tilted, apart_and_turned,
    )
}  # fmt: skip
"""Functions that write a case, by name."""
