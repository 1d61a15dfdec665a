"""Calibrations as NeRF tools, NumPy scripts, DLT tools and others write them, each as a function of the folder."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tests.support.camera_ring import ring

CAMERAS = ring(4)
NAMES = CAMERAS.names
P = CAMERAS.K @ np.concatenate([CAMERAS.R, CAMERAS.t[..., None]], axis=2)


def _write(path: Path, content: object) -> None:
    path.write_text(json.dumps(content))


def nerf(folder: Path) -> None:
    frames = []
    for c, name in enumerate(NAMES):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = CAMERAS.R[c].T, CAMERAS.centres[c]
        pose = pose @ np.diag([1, -1, -1, 1])
        K, (w, h) = CAMERAS.K[c], CAMERAS.image_size[c].tolist()
        frames.append({"file_path": f"images/{name}.png", "fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2],
                       "cy": K[1, 2], "w": w, "h": h, "transform_matrix": pose.tolist()})  # fmt: skip
    _write(folder / "transforms.json", {"camera_model": "OPENCV", "frames": frames})


def numbers_by_name(folder: Path) -> None:
    keys = ("fx", "fy", "cx", "cy", "rotation", "tvec")
    values = [
        (K[0, 0], K[1, 1], K[0, 2], K[1, 2], R.tolist(), t.tolist())
        for K, R, t in zip(CAMERAS.K, CAMERAS.R, CAMERAS.t, strict=True)
    ]
    nodes = {name: dict(zip(keys, camera, strict=True)) for name, camera in zip(NAMES, values, strict=True)}
    _write(folder / "cameras.json", nodes)


def projections(folder: Path) -> None:
    _write(folder / "cameras.json", {name: {"P": (-3.0 * p).tolist()} for name, p in zip(NAMES, P, strict=True)})


def projection_texts(folder: Path) -> None:
    for name, p in zip(NAMES, P, strict=True):
        np.savetxt(folder / f"{name}.txt", p)


def dlt(folder: Path) -> None:
    np.savetxt(folder / "dltcoefs.csv", (P / P[:, 2:, 3:]).reshape(4, 12)[:, :11].T, delimiter=",")


def arrays(folder: Path) -> None:
    np.savez(folder / "calibration.npz", K=CAMERAS.K, R=CAMERAS.R, t=CAMERAS.t, names=np.array(NAMES))


def arrays_a_camera(folder: Path) -> None:
    for c, name in enumerate(NAMES):
        np.savez(folder / f"{name}.npz", mtx=CAMERAS.K[c], dist=np.zeros(5), R=CAMERAS.R[c], T=CAMERAS.t[c])


def stacks(folder: Path) -> None:
    """ZJU-MoCap's lists over the cameras, which have no names; focal lengths differ, as calibrated ones do."""
    K = CAMERAS.K * np.array([1.0, 1.0 + 1e-6, 1.0, 1.0])[:, None, None]
    K[:, 2, 2] = 1.0
    _write(folder / "annots.json", {"cams": {"K": K.tolist(), "R": CAMERAS.R.tolist(), "T": CAMERAS.t.tolist()}})


def projections_alone(folder: Path) -> None:
    _write(folder / "cameras.json", {name: p.tolist() for name, p in zip(NAMES, P, strict=True)})


def xrprimer(folder: Path) -> None:
    for c, name in enumerate(NAMES):
        K = np.zeros((4, 4))
        K[:2, :3], K[2, 3], K[3, 2] = CAMERAS.K[c, :2], 1.0, 1.0
        _write(folder / f"{name}.json", {
            "name": name, "intrinsic": K.tolist(), "world2cam": False, "extrinsic_r": CAMERAS.R[c].T.tolist(),
            "extrinsic_t": CAMERAS.centres[c].tolist(), "dist_coeff_k": [0.0] * 6, "dist_coeff_p": [0.0, 0.0],
        })  # fmt: skip


UNNAMED = (dlt, stacks)
WRITERS = (
    nerf, numbers_by_name, projections, projection_texts, dlt, arrays, arrays_a_camera, stacks, projections_alone,
    xrprimer,
)  # fmt: skip
"""All of them."""
