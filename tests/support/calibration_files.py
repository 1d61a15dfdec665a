"""Calibrations written in other tools' formats, for the tests of reading them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras


def toml_text(cameras: Cameras, *, matrices: bool = False, scale: float = 1.0, nested: bool = False) -> str:
    """Return the TOML of Pose2Sim and anipose, with Rodrigues vectors or matrices."""
    lines = []
    for c, name in enumerate(cameras.names):
        rotation = cameras.R[c] if matrices else log_so3(cameras.R[c])
        fields = {
            "name": name, "size": cameras.image_size[c].astype(float).tolist(), "matrix": cameras.K[c].tolist(),
            "distortions": cameras.distortion[c, :5].tolist(), "rotation": np.asarray(rotation).tolist(),
            "translation": (cameras.t[c] * scale).tolist(), "fisheye": cameras.models[c] == "fisheye",
        }  # fmt: skip
        lines.append(f"[cameras.{c}]" if nested else f'["{name}"]')
        lines += [f"{key} = {json.dumps(value)}" for key, value in fields.items() if not (nested and key == "name")]
    return "\n".join([*lines, "[metadata]", "adjusted = false", "error = 0.0", ""])


def qca_text(cameras: Cameras, *, left: float = 0.0, extra: str = "") -> str:
    """Return Qualisys' XML of the cameras (millimetres, 1/64 pixel, camera looking along -Z)."""
    out = ["<?xml version='1.0' encoding='ASCII'?>", "<calibration>", " <cameras>"]
    for c, name in enumerate(cameras.names):
        rows = np.diag([1.0, -1.0, -1.0]) @ cameras.R[c]
        centre = cameras.centres[c] * 1000
        K, (k1, k2, p1, p2, k3) = cameras.K[c] * 64, cameras.distortion[c, :5]
        w, h = cameras.image_size[c]
        rotation = " ".join(f'r{i + 1}{j + 1}="{float(rows[i, j])!r}"' for i in range(3) for j in range(3))
        out.append(f' <camera active="1" model="Miqus Video" serial="{name}" viewrotation="0">')
        out.append(f'  <fov_video left="{left}" top="0" right="{left + w - 1}" bottom="{h - 1}"/>')
        out.append(
            f'  <transform {rotation} x="{float(centre[0])!r}" y="{float(centre[1])!r}" z="{float(centre[2])!r}"/>'
        )
        out.append(
            f'  <intrinsic focalLengthU="{K[0, 0]}" focalLengthV="{K[1, 1]}" centerPointU="{K[0, 2] + left * 64}"'
            f' centerPointV="{K[1, 2]}" skew="0" radialDistortion1="{k1}" radialDistortion2="{k2}"'
            f' radialDistortion3="{k3}" tangentalDistortion1="{p1}" tangentalDistortion2="{p2}"/>'
        )
        out.append(" </camera>")
    return "\n".join([*out, extra, " </cameras>", "</calibration>", ""])


def yaml_matrix(key: str, value: np.ndarray) -> str:
    """Return a matrix as ``cv2.FileStorage`` writes it, its numbers broken over lines."""
    value = np.atleast_2d(value)
    numbers = [repr(float(x)) for x in value.ravel()]
    rows = [", ".join(numbers[i : i + 3]) for i in range(0, len(numbers), 3)]
    data = ",\n       ".join(rows)
    return (
        f"{key}: !!opencv-matrix\n   rows: {value.shape[0]}\n   cols: {value.shape[1]}\n   dt: d\n   data: [ {data} ]\n"
    )


def yaml_camera(cameras: Cameras, c: int, pose: str) -> str:
    """Return one camera's YAML with its pose as 'rt', 'rvec' or 'extrinsics'."""
    text = f'%YAML:1.0\n---\ncalibration_time: "Mon 1 Jan # 2024"\nimage_width: {cameras.image_size[c, 0]}\n'
    text += f"image_height: {cameras.image_size[c, 1]}\n"
    text += yaml_matrix("camera_matrix", cameras.K[c]) + yaml_matrix(
        "distortion_coefficients", cameras.distortion[c, :5]
    )
    if pose == "extrinsics":
        return text + yaml_matrix("extrinsics", np.concatenate([cameras.R[c], cameras.t[c][:, None]], axis=1))
    R = cameras.R[c] if pose == "rt" else np.asarray(log_so3(cameras.R[c]))[:, None]
    return text + yaml_matrix("R" if pose == "rt" else "rvec", R) + yaml_matrix("T", cameras.t[c][:, None])


def write_easymocap(folder: Path, cameras: Cameras) -> None:
    """Write intri.yml and extri.yml."""
    names = "names:\n" + "".join(f'   - "{name}"\n' for name in cameras.names)
    intri, extri = "%YAML:1.0\n---\n" + names, "%YAML:1.0\n---\n" + names
    for c, name in enumerate(cameras.names):
        intri += yaml_matrix(f"K_{name}", cameras.K[c]) + yaml_matrix(f"dist_{name}", cameras.distortion[c, :5])
        extri += yaml_matrix(f"R_{name}", np.asarray(log_so3(cameras.R[c]))[:, None])
        extri += yaml_matrix(f"Rot_{name}", cameras.R[c]) + yaml_matrix(f"T_{name}", cameras.t[c][:, None])
    (folder / "intri.yml").write_text(intri)
    (folder / "extri.yml").write_text(extri)


def json_text(cameras: Cameras, layout: str) -> str:
    """Return the cameras as JSON: 'list', 'dict' or 'storage' (as ``cv2.FileStorage`` writes matrices)."""

    def value(array: np.ndarray) -> object:
        array = np.atleast_2d(array)
        if layout != "storage":
            return array.tolist()
        return {
            "type_id": "opencv-matrix",
            "rows": array.shape[0],
            "cols": array.shape[1],
            "dt": "d",
            "data": array.ravel().tolist(),
        }

    nodes = {
        name: {
            "K": value(cameras.K[c]), "distCoef": value(cameras.distortion[c, :5]), "R": value(cameras.R[c]),
            "t": value(cameras.t[c][:, None]), "resolution": cameras.image_size[c].tolist(),
        }
        for c, name in enumerate(cameras.names)
    }  # fmt: skip
    if layout == "list":
        return json.dumps({"cameras": [{"name": name, **node} for name, node in nodes.items()]})
    return json.dumps(nodes)
