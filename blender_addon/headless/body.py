"""``body``: a Blender file with the posable body as an asset."""

from __future__ import annotations

from argparse import Namespace

import numpy as np

from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..body.body_file import default_body_path, read_body
from ..body.correctives import CORRECTIVES
from ..body.rig import create_rig, stand_on_floor
from ..body.shape import show_look
from ..conventions.datablocks import child_collection
from ..conventions.naming import PERSON_LOOK
from ..conventions.skeleton import NUM_BETAS, SMPL, SMPL_HANDS
from ..scene.session import frame_viewports, fresh_scene, save_file
from .body_asset import add_catalog, mark_body
from .result import CommandResult


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
