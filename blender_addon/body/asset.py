"""The body as an asset: marked, described, pictured and filed in a catalog of the Asset Browser."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np

from ..errors import OutputNotWritable
from ..files.body_file import BodyFile
from ..render.picture import layer_from_render
from ..render.stage import Look, open_stage
from ..render.view import View, three_quarter_view
from .rig import Rig

CATALOG_FILE = "blender_assets.cats.txt"
CATALOG_ID = "6d1c3c6e-0b9e-4f0c-9b54-5a2f2f1d7c11"
_CATALOG = f"{CATALOG_ID}:Characters/Manifold MoCap:Characters-Manifold MoCap"
_CATALOG_HEADER = "# This is an Asset Catalog Definition file for Blender.\n\nVERSION 1\n\n"
_AUTHOR = "Manifold MoCap contributors"
_TAGS = ("body", "character", "rig", "SMPL")
_PREVIEW_PX = 256
_BACKGROUND = np.array([0.16, 0.17, 0.19, 1.0])


def mark_body(rig: Rig, collection: bpy.types.Collection, body: BodyFile) -> None:
    """Mark a body as two assets: its armature, to drop in and pose, and its collection, to link and override.

    Args:
        rig: the body's objects.
        collection: holds them and nothing else.
        body: the body.
    """
    picture = body_picture(rig, collection)
    what = f"Body '{body.id}' with 10 shape sliders and pose correctives; 24 bones with SMPL's names"
    for asset, use in ((rig.armature, "Drag it in and pose it."), (collection, "Link it and override it.")):
        asset.asset_mark()
        data = asset.asset_data
        data.description = f"{what}. {use}"
        data.author, data.license, data.catalog_id = _AUTHOR, body.licence, CATALOG_ID
        for tag in _TAGS:
            data.tags.new(tag, skip_if_exists=True)
        preview = asset.preview_ensure()
        preview.image_size = (_PREVIEW_PX, _PREVIEW_PX)
        preview.image_pixels_float.foreach_set(picture[::-1].ravel())


def body_picture(rig: Rig, collection: bpy.types.Collection) -> np.ndarray:
    """Return a (256, 256, 4) float32 sRGB picture of a body, top row first.

    Raises:
        RenderFailed: Blender cannot render here.
    """
    depsgraph = bpy.context.evaluated_depsgraph_get()
    corners = np.array([rig.mesh.matrix_world @ v.co for v in rig.mesh.evaluated_get(depsgraph).data.vertices])
    size = (_PREVIEW_PX, _PREVIEW_PX)
    view = View(three_quarter_view(corners, -np.pi / 2, size, margin_m=0.05), size)
    look = Look(shrink=2, cavity=True)
    with TemporaryDirectory() as folder, open_stage("Preview", (collection,), view, look, Path(folder)) as stage:
        layer = layer_from_render(stage.render(bpy.context.scene.frame_current), look.shrink)
    colour = np.asarray(layer, dtype=np.float32) / 255.0
    return (colour + (1.0 - colour[..., 3:]) * _BACKGROUND).astype(np.float32)


def add_catalog(folder: Path) -> None:
    """Add our catalog to the catalogs of an asset library's folder; those that are there stay.

    Raises:
        OutputNotWritable: the file cannot be read or written.
    """
    path = folder / CATALOG_FILE
    partial = path.with_suffix(f".part{os.getpid()}")
    try:
        text = path.read_text(encoding="utf-8") if path.exists() else _CATALOG_HEADER
        if CATALOG_ID in text:
            return
        partial.write_text(text.rstrip("\n") + f"\n{_CATALOG}\n", encoding="utf-8")
        os.replace(partial, path)
    except (OSError, UnicodeDecodeError) as error:
        raise OutputNotWritable(f"The asset catalogs cannot be written: {error}.", where=str(path)) from error
    finally:
        partial.unlink(missing_ok=True)
