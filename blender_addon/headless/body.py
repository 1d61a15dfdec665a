"""``body``: write a Blender file with the posable body as an asset, with a preview and a catalog."""

from __future__ import annotations

from argparse import Namespace

import bpy
import numpy as np

from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..body.body_file import BodyFile, default_body_path, read_body
from ..body.correctives import CORRECTIVES
from ..body.looks import show_look
from ..body.rig import Rig, create_rig, stand_on_floor
from ..conventions.datablocks import child_collection
from ..conventions.naming import PERSON_LOOK
from ..conventions.skeleton import NUM_BETAS, SMPL, SMPL_HANDS
from ..render.asset import BODIES, add_catalog, show_preview
from ..scene.session import frame_viewports, fresh_scene, save_file
from .result import CommandResult

_AUTHOR = "Manifold MoCap contributors"
_TAGS = ("body", "character", "rig", "SMPL")


def mark_body(rig: Rig, collection: bpy.types.Collection, body: BodyFile) -> None:
    """Mark a collection that contains only a body as an asset, with a description and tags."""
    collection.asset_mark()
    data = collection.asset_data
    data.description = (
        f"Body '{body.id}': 10 shape sliders, pose correctives, 24 bones with SMPL's names. Link and override it, or "
        "append it and switch Instance off in the panel that follows the drop."
    )
    data.author, data.license, data.catalog_id = _AUTHOR, body.licence, BODIES[0]
    for tag in _TAGS:
        data.tags.new(tag, skip_if_exists=True)
    show_preview(collection, rig.mesh, (rig.armature, rig.mesh))


def run_body(args: Namespace, progress: Progress) -> CommandResult:
    """Write a Blender file that contains one standing body, marked as an asset."""
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
