"""Render preview pictures of assets, and add assets to catalogs of the Asset Browser."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np

from .._exchange.errors import OutputNotWritable
from .._exchange.outputs import temporary_folder, write_text
from .picture import layer_from_render
from .stage import RenderQuality, open_stage
from .view import View, three_quarter_view

CATALOG_FILE = "blender_assets.cats.txt"
BODIES, TAKES, POSES = (
    ("55b6587a-a789-40f8-9130-b8d6fcc289a4", "Characters/Manifold MoCap"),
    ("0f4c1c2e-3d0b-4a53-9a55-6a1a0e9c7b11", "Motions/Manifold MoCap"),
    ("7be0a3d4-52c9-4f0e-8d83-1f6f2d9b5c72", "Poses/Manifold MoCap"),
)
"""Identifier and path of each catalog that the add-on creates."""
_CATALOG_HEADER = "# This is an Asset Catalog Definition file for Blender.\n\nVERSION 1\n\n"
_PREVIEW_PX = 256
"""Width and height of an asset's preview in pixels. Chosen by hand."""
_BACKGROUND = np.array([0.16, 0.17, 0.19, 1.0])  # Red, green, blue and opacity behind the body. Chosen by hand.


def show_preview(asset: bpy.types.ID, mesh: bpy.types.Object, objects: Sequence[bpy.types.Object]) -> None:
    """Use a picture of a body's objects in the current frame as the preview of an asset."""
    collection = bpy.data.collections.new("Preview")
    try:
        for obj in objects:
            collection.objects.link(obj)
        picture = body_picture(mesh, collection)
    finally:
        bpy.data.collections.remove(collection)
    preview = asset.preview_ensure()
    preview.image_size = (_PREVIEW_PX, _PREVIEW_PX)
    preview.image_pixels_float.foreach_set(picture[::-1].ravel())


def body_picture(mesh: bpy.types.Object, collection: bpy.types.Collection) -> np.ndarray:
    """Return a picture of a body as (256, 256, 4) float32 sRGB, top row first."""
    evaluated = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    corners = np.array([evaluated.matrix_world @ vertex.co for vertex in evaluated.data.vertices])
    size = (_PREVIEW_PX, _PREVIEW_PX)
    view = View(three_quarter_view(corners, -np.pi / 2, size, margin_m=0.05), size)
    look = RenderQuality(shrink=2, cavity=True)
    with temporary_folder() as folder, open_stage("Preview", (collection,), view, look, folder) as stage:
        layer = layer_from_render(stage.render(bpy.context.scene.frame_current), look.shrink)
    return (layer + (1.0 - layer[..., 3:]) * _BACKGROUND).astype(np.float32)


def add_catalog(folder: Path, catalog: tuple[str, str] = BODIES) -> str:
    """Add one of the add-on's catalogs to the asset library in a folder. Return the catalog's identifier."""
    path, (identifier, place) = folder / CATALOG_FILE, catalog
    try:
        text = path.read_text(encoding="utf-8") if path.exists() else _CATALOG_HEADER
        if identifier not in text:
            row = f"{identifier}:{place}:{place.replace('/', '-')}"
            write_text(path, text.rstrip("\n") + f"\n{row}\n", overwrite=True)
    except (OSError, UnicodeDecodeError, OutputNotWritable) as error:
        raise OutputNotWritable(f"The asset catalogs cannot be written: {error}.", where=str(path)) from error
    return identifier
