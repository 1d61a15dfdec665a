"""Calibrations as COLMAP's text model: ``cameras.txt``, ``images.txt``, ``points3D.txt``."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import LENS_MODELS
from solver_backend.geometry.quaternions import quat_from_matrix
from solver_backend.types import Cameras

LEAST_TERMS = 4
"""Simpler models of COLMAP are not written: they have one focal length, or no tangential terms."""


def colmap_texts(cameras: Cameras) -> dict[str, str]:
    """Return the three files' texts by their names; metres, one image a camera, no points.

    COLMAP's pixel (0.5, 0.5) is the centre of the first pixel, so its principal point is half a pixel further. Lenses
    are OPENCV (k1 k2 p1 p2), FULL_OPENCV (k1 k2 p1 p2 k3 k4 k5 k6) or OPENCV_FISHEYE.

    Reference: COLMAP, "Output Format" (text).
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
    return {
        "cameras.txt": "\n".join([*lenses, ""]),
        "images.txt": "\n".join([*images, ""]),
        "points3D.txt": "# no points\n",
    }


def _lens(model: str, terms: np.ndarray, camera: str) -> tuple[str, np.ndarray]:
    """Return COLMAP's name of a lens with two focal lengths and its terms.

    Raises:
        CalibrationInvalid: COLMAP has no such lens.
    """
    for name, focals, places in LENS_MODELS[model].colmap:
        if focals == 2 and len(places) >= LEAST_TERMS and not np.delete(terms, places).any():
            return name, terms[list(places)]
    raise CalibrationInvalid(f"COLMAP has no lens model '{model}'.", where=f"camera {camera}")
