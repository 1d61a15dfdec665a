"""Write boards as TOML, and calibrations in the formats of other programs."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from solver_backend.camera_calibration.boards.board import Board
from solver_backend.exchange.errors import CalibrationInvalid, CommandLineInvalid
from solver_backend.exchange.lens import DEFAULT_MODEL, LENS_MODELS
from solver_backend.exchange.outputs import atomic_output, atomic_outputs
from solver_backend.geometry.rotations import log_so3, quat_from_matrix
from solver_backend.io.calibration.programs import SUBPIXELS, TO_OPENCV_AXES
from solver_backend.types import Cameras


def pose2sim_toml(cameras: Cameras, rmse_px: float | None = None, *, scale: float = 1.0, tool: str = "") -> str:
    """Format cameras as TOML for Pose2Sim, anipose and this product.

    Args:
        scale: length units per metre: 1 for Pose2Sim, 1000 for FreeMoCap.
    """
    parts = []
    for c, name in enumerate(cameras.names):
        values = {"name": name, "size": cameras.image_size[c].astype(float), **_lens_values(cameras, c)}
        values |= {"rotation": log_so3(cameras.R[c]), "translation": scale * cameras.t[c]}
        values |= {"fisheye": cameras.models[c] == "fisheye", **_model(cameras.models[c])}
        parts.append(_table(_key(name), values))
    error = {} if rmse_px is None else {"error": float(f"{rmse_px:.6g}")}
    return "\n".join([*parts, _table("metadata", {"adjusted": False, **error, **({"tool": tool} if tool else {})})])


def caliscope_toml(cameras: Cameras, rmse_px: float | None = None) -> str:
    """Format cameras as caliscope's ``camera_array.toml``. The camera numbers start at 0."""
    parts = []
    for c, model in enumerate(cameras.models):
        values = {"cam_id": c, "rotation_count": 0, "error": float(f"{rmse_px or 0.0:.6g}"), "ignore": False}
        values |= {"fisheye": True} if model == "fisheye" else _model(model)
        values |= {"size": cameras.image_size[c], **_lens_values(cameras, c)}
        parts.append(_table(f"cameras.{c}", {**values, "translation": cameras.t[c], "rotation": cameras.R[c]}))
    return "\n".join(parts)


def board_toml(board: Board) -> str:
    """Format a board as TOML that ``board_named`` can read."""
    values: dict[str, Any] = {"kind": board.kind, "columns": board.columns, "rows": board.rows}
    values["square_mm"] = float(f"{board.square_m * 1000:.6g}")
    if board.kind == "charuco":
        values |= {"marker_mm": float(f"{board.marker_m * 1000:.6g}"), "dictionary": board.dictionary}
    return _table("board", {**values, "inverted": board.inverted})


def _table(title: str, values: dict[str, Any]) -> str:
    return f"[{title}]\n" + "".join(f"{key} = {_toml(value)}\n" for key, value in values.items())


def _toml(value: Any) -> str:
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{"".join(c for c in escaped if c.isprintable())}"'
    plain = (value + 0).tolist() if isinstance(value, np.ndarray) else value  # avoid negative zeros
    return repr(plain).lower()


def _key(name: str) -> str:
    plain = name.replace("-", "").replace("_", "")
    return name if plain.isascii() and plain.isalnum() else _toml(name)


def _lens_values(cameras: Cameras, c: int) -> dict[str, Any]:
    return {"matrix": cameras.K[c], "distortions": coefficients(cameras, c)}


def coefficients(cameras: Cameras, index: int) -> np.ndarray:
    """Return the distortion coefficients that a lens file lists: 4 for a fisheye lens, otherwise 5 or 8."""
    return LENS_MODELS[cameras.models[index]].listed(cameras.distortion[index])


def _model(name: str) -> dict[str, Any]:
    return {} if name in ("opencv", "fisheye") else {"distortion_model": name}


LEAST_TERMS = 4  # Minimum number of distortion terms in a written COLMAP model. Simpler ones lack tangential terms.


def colmap_texts(cameras: Cameras) -> dict[str, str]:
    """Format cameras as COLMAP's three text files, in metres and without points.

    In COLMAP, the centre of the first pixel is (0.5, 0.5), so its principal points differ by half a pixel. Lens models
    are OPENCV (k1 k2 p1 p2), FULL_OPENCV (k1 k2 p1 p2 k3 k4 k5 k6) and OPENCV_FISHEYE.

    Reference: COLMAP, "Output Format" (text files).
    """
    lenses = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# (an empty line for the image's points)"]
    turns = np.asarray(quat_from_matrix(cameras.R))
    for c, name in enumerate(cameras.names):
        K, bent = cameras.K[c], cameras.distortion[c]
        model, more = _lens(cameras.models[c], bent, name)
        numbers = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, *more]
        width, height = cameras.image_size[c].tolist()
        lenses.append(f"{c + 1} {model} {width} {height} " + " ".join(repr(float(v)) for v in numbers))
        pose = " ".join(repr(float(v)) for v in (*turns[c], *cameras.t[c]))
        images += [f"{c + 1} {pose} {c + 1} {name.replace(' ', '_')}", ""]
    texts = {"cameras.txt": "\n".join([*lenses, ""]), "images.txt": "\n".join([*images, ""])}
    return texts | {"points3D.txt": "# no points\n"}


def _lens(model: str, terms: np.ndarray, camera: str) -> tuple[str, np.ndarray]:
    """Return COLMAP's name and coefficients for a lens. The model has separate focal lengths for x and y."""
    for name, focals, places in LENS_MODELS[model].colmap:
        if focals == 2 and len(places) >= LEAST_TERMS and not np.delete(terms, places).any():
            return name, terms[list(places)]
    hint = "Write another format, or calibrate with another lens model."
    raise CalibrationInvalid(f"COLMAP has no lens model '{model}'.", where=f"camera {camera}", hint=hint)


def opencv_yaml(cameras: Cameras) -> str:
    """Format all cameras as a single OpenCV YAML file, with lengths in metres."""
    lines = ["%YAML:1.0", "---"]
    for c, name in enumerate(cameras.names):
        key = re.sub(r"[^A-Za-z0-9_]", "_", name)
        key = key if key[:1].isalpha() else f"cam_{key}"
        plain = "".join(c for c in name if c.isprintable() and c not in "\"'\\")
        lines += [f"{key}:", f'   name: "{plain}"']
        lines += [f"   image_width: {cameras.image_size[c, 0]}", f"   image_height: {cameras.image_size[c, 1]}"]
        if cameras.models[c] != DEFAULT_MODEL:
            lines.append(f'   distortion_model: "{cameras.models[c]}"')
        lines += _opencv_matrix("camera_matrix", cameras.K[c])
        lines += _opencv_matrix("distortion_coefficients", coefficients(cameras, c)[:, None])
        lines += _opencv_matrix("R", cameras.R[c]) + _opencv_matrix("T", cameras.t[c][:, None])
    return "\n".join([*lines, ""])


def _opencv_matrix(key: str, values: np.ndarray) -> list[str]:
    data = ", ".join(f"{float(v):.17g}" if float(v) % 1 else f"{float(v):.1f}" for v in values.ravel())
    head = [f"   {key}: !!opencv-matrix", f"      rows: {values.shape[0]}", f"      cols: {values.shape[1]}"]
    return [*head, "      dt: d", f"      data: [ {data} ]"]


_INTRINSIC = (
    *("focalLengthU", "focalLengthV", "centerPointU", "centerPointV", "skew"),
    *("radialDistortion1", "radialDistortion2", "radialDistortion3", "tangentalDistortion1", "tangentalDistortion2"),
    *("sensorMinU", "sensorMinV", "sensorMaxU", "sensorMaxV"),
)


def qualisys_xml(cameras: Cameras, rmse_px: float | None = None) -> str:
    """Format cameras as Qualisys' XML in mm and 1/64 px. Camera axes point right, up and backward.

    Raises:
        CalibrationInvalid: a lens uses more coefficients than k1 k2 p1 p2 k3, or is a fisheye lens.
    """
    root = ElementTree.Element("calibration", source="Manifold MoCap", type="regular")
    group = ElementTree.SubElement(root, "cameras")
    for c, name in enumerate(cameras.names):
        bent = cameras.distortion[c]
        if cameras.models[c] != DEFAULT_MODEL or bent[5:].any():
            message = "A Qualisys file can only store the coefficients k1 k2 p1 p2 k3, but the lens has others."
            hint = "Calibrate with --lens pinhole5, or write another format."
            raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
        width, height = cameras.image_size[c].tolist()
        about = {"active": "1", "serial": name, "viewrotation": "0", "model": "none"}
        node = ElementTree.SubElement(group, "camera", about | {"avg-residual": f"{rmse_px or 0.0:.6f}"})
        view = {"left": "0", "top": "0", "right": str(width - 1), "bottom": str(height - 1)}
        for tag in ("fov_marker", "fov_marker_max", "fov_video", "fov_video_max"):
            ElementTree.SubElement(node, tag, view)
        rows = TO_OPENCV_AXES @ cameras.R[c]
        centre = 1000.0 * cameras.centres[c]
        place = {f"r{i + 1}{j + 1}": repr(float(rows[i, j])) for i in range(3) for j in range(3)}
        place |= {axis: repr(float(v)) for axis, v in zip("xyz", centre, strict=True)}
        ElementTree.SubElement(node, "transform", place)
        K = cameras.K[c] * SUBPIXELS
        pinhole = K[[0, 1, 0, 1, 0], [0, 1, 2, 2, 1]]
        far = np.array([0.0, 0.0, width - 1, height - 1]) * SUBPIXELS
        numbers = dict(zip(_INTRINSIC, [*pinhole, *np.array(bent)[[0, 1, 4, 2, 3]], *far], strict=True))
        ElementTree.SubElement(node, "intrinsic", {key: repr(float(v)) for key, v in numbers.items()})
    ElementTree.indent(root)
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ElementTree.tostring(root, encoding="unicode") + "\n"


TOOL = "Manifold MoCap"
# Formats that consist of a single text file.
_TEXTS: dict[str, Callable[[Cameras, float | None], str]] = {
    "pose2sim": lambda cameras, rmse: pose2sim_toml(cameras, rmse, tool=TOOL),
    "anipose": lambda cameras, rmse: pose2sim_toml(cameras, rmse),
    "freemocap": lambda cameras, rmse: pose2sim_toml(cameras, rmse, scale=1000.0),
    "caliscope": caliscope_toml,
    "qualisys": qualisys_xml,
    "opencv": lambda cameras, rmse: opencv_yaml(cameras),
}
FORMATS = (*_TEXTS, "colmap")  # Lengths are in metres, but in mm for FreeMoCap and Qualisys.


def format_of(path: Path) -> str:
    """Choose a calibration format by file name. A path without a suffix is a COLMAP folder."""
    name = path.name.lower()
    if name.endswith((".qca.txt", ".qca")):
        return "qualisys"
    found = {".toml": "pose2sim", ".yml": "opencv", ".yaml": "opencv", "": "colmap"}.get(path.suffix.lower())
    if found is None:
        message = "A calibration is written as .toml, .yml, .qca.txt, or a folder (COLMAP)."
        raise CommandLineInvalid(message, where=str(path))
    return found


def write_calibration(
    path: Path, cameras: Cameras, kind: str | None = None, rmse_px: float | None = None, *, overwrite: bool = False
) -> str:
    """Write cameras to a calibration file, or to a folder for COLMAP. Return the format's name.

    Args:
        kind: one of ``FORMATS``. The default depends on the file name.
    """
    kind = kind or format_of(path)
    if kind not in FORMATS:
        raise CommandLineInvalid(f"Unknown calibration format '{kind}'.", hint=f"Known formats: {', '.join(FORMATS)}.")
    if kind == "colmap":
        texts = colmap_texts(cameras)
        with atomic_outputs(path, tuple(texts), overwrite=overwrite) as places:
            for name, text in texts.items():
                places[name].write_text(text, encoding="utf-8")
        return kind
    text = _TEXTS[kind](cameras, rmse_px)
    with atomic_output(path, overwrite=overwrite) as place:
        place.write_text(text, encoding="utf-8")
    return kind
