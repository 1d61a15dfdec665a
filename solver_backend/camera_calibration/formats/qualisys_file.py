"""Calibrations as Qualisys has them, ``.qca.txt`` (XML); the inverse of ``io/calibration/qualisys.py``."""

from __future__ import annotations

from xml.etree import ElementTree

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import DEFAULT_MODEL
from solver_backend.io.calibration.qualisys import SUBPIXELS, TO_OPENCV_AXES
from solver_backend.types import Cameras


def qualisys_xml(cameras: Cameras, rmse_px: float | None = None) -> str:
    """Return the text of the file: mm, 1/64 px, camera axes right, up and backward.

    Raises:
        CalibrationInvalid: a lens has more than k1 k2 p1 p2 k3, or is a fisheye.
    """
    root = ElementTree.Element("calibration", source="Manifold MoCap", type="regular")
    group = ElementTree.SubElement(root, "cameras")
    for c, name in enumerate(cameras.names):
        bent = cameras.distortion[c]
        if cameras.models[c] != DEFAULT_MODEL or bent[5:].any():
            raise CalibrationInvalid(
                "Qualisys' file holds the coefficients k1 k2 p1 p2 k3 alone; the lens has others.",
                where=f"camera {name}",
                hint="Calibrate with --lens pinhole5, or write another format.",
            )
        width, height = cameras.image_size[c].tolist()
        node = ElementTree.SubElement(
            group, "camera", {"active": "1", "serial": name, "viewrotation": "0", "model": "none",
                              "avg-residual": f"{rmse_px or 0.0:.6f}"}
        )  # fmt: skip
        view = {"left": "0", "top": "0", "right": str(width - 1), "bottom": str(height - 1)}
        for tag in ("fov_marker", "fov_marker_max", "fov_video", "fov_video_max"):
            ElementTree.SubElement(node, tag, view)
        rows = TO_OPENCV_AXES @ cameras.R[c]
        centre = 1000.0 * cameras.centres[c]
        place = {f"r{i + 1}{j + 1}": repr(float(rows[i, j])) for i in range(3) for j in range(3)}
        ElementTree.SubElement(
            node, "transform", place | {axis: repr(float(v)) for axis, v in zip("xyz", centre, strict=True)}
        )
        K = cameras.K[c] * SUBPIXELS
        numbers = {
            "focalLengthU": K[0, 0], "focalLengthV": K[1, 1], "centerPointU": K[0, 2], "centerPointV": K[1, 2],
            "skew": K[0, 1], "radialDistortion1": bent[0], "radialDistortion2": bent[1], "radialDistortion3": bent[4],
            "tangentalDistortion1": bent[2], "tangentalDistortion2": bent[3], "sensorMinU": 0.0, "sensorMinV": 0.0,
            "sensorMaxU": (width - 1) * SUBPIXELS, "sensorMaxV": (height - 1) * SUBPIXELS,
        }  # fmt: skip
        ElementTree.SubElement(node, "intrinsic", {key: repr(float(v)) for key, v in numbers.items()})
    ElementTree.indent(root)
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ElementTree.tostring(root, encoding="unicode") + "\n"
