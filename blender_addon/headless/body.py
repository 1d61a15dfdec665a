"""``body``: a Blender file with the posable body as an asset, pictured and filed in a catalog of the Asset Browser."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import bpy
import numpy as np

from .._exchange.errors import OutputNotWritable
from .._exchange.outputs import atomic_outputs, temporary_folder, write_text
from .._exchange.progress import Progress
from ..body.body_file import BodyFile, default_body_path, read_body
from ..body.correctives import CORRECTIVES
from ..body.rig import Rig, create_rig, stand_on_floor
from ..body.shape import show_look
from ..conventions.datablocks import child_collection
from ..conventions.naming import PERSON_LOOK
from ..conventions.skeleton import NUM_BETAS, SMPL, SMPL_HANDS
from ..render.picture import layer_from_render
from ..render.stage import RenderQuality, open_stage
from ..render.view import View, three_quarter_view
from ..scene.session import frame_viewports, fresh_scene, save_file
from .result import CommandResult

CATALOG_FILE = "blender_assets.cats.txt"
CATALOG_ID = "55b6587a-a789-40f8-9130-b8d6fcc289a4"
_CATALOG = f"{CATALOG_ID}:Characters/Manifold MoCap:Characters-Manifold MoCap"
_CATALOG_HEADER = "# This is an Asset Catalog Definition file for Blender.\n\nVERSION 1\n\n"
_AUTHOR = "Manifold MoCap contributors"
_TAGS = ("body", "character", "rig", "SMPL")
_PREVIEW_PX = 256
"""Width and height of an asset's preview, pixels, chosen by hand."""
_BACKGROUND = np.array([0.16, 0.17, 0.19, 1.0])  # Red, green, blue and opacity behind the body, chosen by hand.


def mark_body(rig: Rig, collection: bpy.types.Collection, body: BodyFile) -> None:
    """Mark a body's collection, which has nothing else, as an asset."""
    picture = body_picture(rig, collection)
    collection.asset_mark()
    data = collection.asset_data
    data.description = (
        f"Body '{body.id}': 10 shape sliders, pose correctives, 24 bones with SMPL's names. Link and override it, or "
        "append it and switch Instance off in the panel that follows the drop."
    )
    data.author, data.license, data.catalog_id = _AUTHOR, body.licence, CATALOG_ID
    for tag in _TAGS:
        data.tags.new(tag, skip_if_exists=True)
    preview = collection.preview_ensure()
    preview.image_size = (_PREVIEW_PX, _PREVIEW_PX)
    preview.image_pixels_float.foreach_set(picture[::-1].ravel())


def body_picture(rig: Rig, collection: bpy.types.Collection) -> np.ndarray:
    """Return a (256, 256, 4) float32 sRGB picture of a body, top row first."""
    evaluated = rig.mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    corners = np.array([evaluated.matrix_world @ vertex.co for vertex in evaluated.data.vertices])
    size = (_PREVIEW_PX, _PREVIEW_PX)
    view = View(three_quarter_view(corners, -np.pi / 2, size, margin_m=0.05), size)
    look = RenderQuality(shrink=2, cavity=True)
    with temporary_folder() as folder, open_stage("Preview", (collection,), view, look, folder) as stage:
        layer = layer_from_render(stage.render(bpy.context.scene.frame_current), look.shrink)
    return (layer + (1.0 - layer[..., 3:]) * _BACKGROUND).astype(np.float32)


def add_catalog(folder: Path) -> None:
    """Add our catalog to the catalogs of an asset library's folder."""
    path = folder / CATALOG_FILE
    try:
        text = path.read_text(encoding="utf-8") if path.exists() else _CATALOG_HEADER
        if CATALOG_ID in text:
            return
        write_text(path, text.rstrip("\n") + f"\n{_CATALOG}\n", overwrite=True)
    except (OSError, UnicodeDecodeError, OutputNotWritable) as error:
        raise OutputNotWritable(f"The asset catalogs cannot be written: {error}.", where=str(path)) from error


def run_body(args: Namespace, progress: Progress) -> CommandResult:
    """Write a Blender file with one body, standing on the floor, marked as an asset."""
    betas = np.zeros(NUM_BETAS)
    betas[: len(args.betas)] = args.betas
    body = read_body(args.body or default_body_path(), SMPL_HANDS if args.fingers else SMPL)
    with atomic_outputs(args.out.parent, (args.out.name,)) as temporary:
        progress("building the body", 0, 1)
        scene = fresh_scene()
        name = args.out.stem
        collection = child_collection(name, scene.collection)
        rig = create_rig(name, body, betas, collection)
        stand_on_floor(rig, body)
        show_look(rig.mesh, args.look or PERSON_LOOK)
        mark_body(rig, collection, body)
        progress("building the body", 1, 1)
        frame_viewports((0.0, 0.0, 0.9))
        save_file(temporary[args.out.name])
        add_catalog(args.out.parent)
    about = {"body": body.id, "vertices": len(body.v_template), "pose_correctives": CORRECTIVES in rig.mesh.modifiers}
    return {"outputs": [str(args.out)], "notes": [], **about}
