"""Inputs for the verbs of the add-on's command line, beside those of ``verb_inputs``, and what is typed for each."""

from __future__ import annotations

import json
import os
from pathlib import Path

import bpy

from tests.support.played_character import known_clip, play_on_character, write_clip

_FILMED = {
    "film": ["rgb"], "camera_arrays": [{"preset": "webcam_ring_4", "scale": 0.5}], "frames": 20, "fps": 10,
    "looks": ["everyday"],
}  # fmt: skip


def write_addon_inputs(folder: Path) -> None:
    """Add what the commands read to a folder of ``write_inputs``."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    play_on_character(known_clip(), bpy.context.scene)
    write_clip(folder / "clip.glb")
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "character.blend"))
    (folder / "captures").mkdir()
    for name in ("a", "b"):
        os.link(folder / "capture.npz", folder / "captures" / f"{name}.npz")
    (folder / "filmed.json").write_text(json.dumps(_FILMED))


ADDON_COMMANDS: dict[str, tuple[str, ...]] = {
    "solve": ("solve", "capture.npz", "--out", "out.npz", "--report", "out.html"),
    "markers calibrate": ("markers calibrate", "take.c3d", "--out", "out.npz"),
    "markers export": ("markers export", "marked.npz", "--out", "out.c3d"),
    "bake": ("bake", "motion.npz", "--capture", "capture.npz", "--out", "out"),
    "render": ("render", "motion.npz", "--out", "out"),
    "export": ("export", "motion.npz", "--format", "fbx", "gltf", "usd", "--out", "out"),
    "body": ("body", "--out", "out/body.blend", "--fingers"),
    "retarget": ("retarget", "motion.npz", "--target", "character.blend", "--out", "out.blend"),
    "motion convert": ("motion convert", "clip.glb", "--out", "out.npz"),
    "hands add": ("hands add", "motion.npz", "gloves.bvh", "--offset", "0", "--out", "out.npz"),
    "batch": ("batch", "captures", "--out", "out", "--bake", "--export", "fbx"),
    "batch --workers": ("batch", "captures", "--out", "out", "--workers", "2"),
    "batch --watch": ("batch", "--watch", "captures", "--out", "out", "--settled", "0.1"),
    "dataset make": ("dataset make", "filmed.json", "--out", "out"),
    "certificates": ("certificates", "--out", "out"),
}
"""What is typed for each verb, and for ways of it, in that folder."""
