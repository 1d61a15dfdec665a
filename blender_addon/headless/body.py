"""``body``: a body file in; a Blender file with the posable body as an asset out."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..body.body_file import default_body_path, read_body
from ..conventions.naming import PERSON_LOOK
from ..conventions.skeleton import NUM_BETAS, SMPL, SMPL_HANDS
from .result import CommandResult


@dataclass(frozen=True)
class BodyRequest:
    """Which body to write, and where."""

    out: Path
    """Blender file to write; the catalog of its folder gets an entry."""
    body: Path | None = None
    """Body file; None for the one that ships with the add-on."""
    betas: tuple[float, ...] = ()
    """Up to 10 values of the shape; the others are 0."""
    fingers: bool = False
    """Give the body finger bones and their controls."""
    look: str = PERSON_LOOK
    """One of ``conventions.looks``."""


class BodyResult(CommandResult):
    """Of ``body``."""

    body: str
    vertices: int
    seconds: float
    pose_correctives: bool


def run_body(request: BodyRequest, progress: Progress) -> BodyResult:
    """Write a Blender file that holds one body, standing on the floor, marked as an asset.

    Returns:
        The ``result`` event of the progress protocol.

    Raises:
        MocapError: the body is missing or wrong, or the file exists or cannot be written.
    """
    from ..body.correctives import CORRECTIVES
    from ..body.looks import show_look
    from ..body.rig import create_rig, stand_on_floor
    from ..conventions.datablocks import child_collection
    from ..scene.session import frame_viewports, fresh_scene, save_file
    from .body_asset import add_catalog, mark_body

    start = time.monotonic()
    betas = np.zeros(NUM_BETAS)
    betas[: len(request.betas)] = request.betas
    body = read_body(request.body or default_body_path(), SMPL_HANDS if request.fingers else SMPL)
    with atomic_outputs(request.out.parent, (request.out.name,)) as temporary:
        progress("building the body", 0, 1)
        scene = fresh_scene()
        name = request.out.stem
        collection = child_collection(name, scene.collection)
        rig = create_rig(name, body, betas, collection)
        stand_on_floor(rig, body)
        show_look(rig.mesh, request.look)
        mark_body(rig, collection, body)
        progress("building the body", 1, 1)
        frame_viewports((0.0, 0.0, 0.9))
        save_file(temporary[request.out.name])
        add_catalog(request.out.parent)
    return {
        "event": "result",
        "outputs": [str(request.out)],
        "notes": [],
        "body": body.id,
        "vertices": len(body.v_template),
        "pose_correctives": CORRECTIVES in rig.mesh.modifiers,
        "seconds": round(time.monotonic() - start, 3),
    }
