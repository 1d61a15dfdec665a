"""EXR files are read by Blender, bit for bit."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from solver_backend.io.png import read_png
from solver_backend.synthesis.studio.data_set import SHOTS, make_data_set
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.write_pictures import exr_bytes


def colours(path: Path) -> np.ndarray:
    """Return the (h, w, 3) floats that Blender reads, top row first."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    found = np.zeros(len(image.pixels), np.float32)
    image.pixels.foreach_get(found)
    return found.reshape(image.size[1], image.size[0], -1)[::-1, :, :3]


def test_blender_reads_what_was_written(scene: bpy.types.Scene, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for smooth in (True, False):
        picture = rng.normal(size=(37, 53, 3)).astype(np.float32) * 100
        if smooth:
            picture = np.round(np.cumsum(picture, axis=1) * 1e-3)
        path = tmp_path / f"{smooth}.exr"
        path.write_bytes(exr_bytes({name: picture[..., i] for i, name in enumerate("RGB")}))
        assert (colours(path) == picture).all()


def test_depth_and_normals_of_a_shot_are_floats_of_the_same_scene(scene: bpy.types.Scene, tmp_path: Path) -> None:
    array = {"preset": "azure_kinect_3", "scale": 0.2}
    make_data_set(
        spec_of(
            {"camera_arrays": [array], "frames": 2, "film": ["normals", "masks"], "write": ["exr"], "markers": None}
        ),
        tmp_path,
    )
    shot = next((tmp_path / SHOTS).iterdir())
    files = sorted((shot / "exr").rglob("*.exr"))
    assert len(files) == 6
    for path in files:
        normal = colours(path)
        eight = read_png(shot / "normals" / path.parent.name / f"{path.stem}.png") / 127.5 - 1
        seen = read_png(shot / "masks" / path.parent.name / f"{path.stem}.png") > 0
        assert np.abs(np.linalg.norm(normal[seen], axis=-1) - 1).max() < 1e-5
        assert np.abs(normal - eight)[seen].max() < 1 / 255 + 1e-6
    depth = {"R": (values := np.linspace(0.5, 4, 48, dtype=np.float32).reshape(6, 8)), "G": values, "B": values}
    path = tmp_path / "depth.exr"
    path.write_bytes(exr_bytes(depth | {"Z": values}))
    assert (colours(path)[..., 0] == values).all(), "a fourth channel does not shift the others"
