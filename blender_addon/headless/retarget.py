"""``retarget``: a solved motion and a rig in; a Blender file with the rig playing the motion out."""

from __future__ import annotations

import time
from dataclasses import asdict
from math import isfinite

from .._exchange.errors import FileMissing, OutputExists
from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from .actors import read_source
from .result import TimedResult
from .retarget_request import RetargetRequest
from .retarget_target import lay_out_time, map_target, open_target


class RetargetResult(TimedResult):
    """Of ``retarget``."""

    lengths_by_the_actor: dict[str, float]
    soles_from: str


def run_retarget(request: RetargetRequest, progress: Progress) -> RetargetResult:
    """Write a copy of the target's file in which the rig plays the motion.

    Returns:
        The ``result`` event: outputs, notes, frames, scale, deviation and the map's label.

    Raises:
        MocapError: an input is missing or wrong, the rig or its map is unsuitable, or an output exists.
    """
    from ..retarget.retarget import retarget
    from ..retarget.rig_map import write_map
    from ..scene.session import save_file

    start = time.monotonic()
    for path in (request.source, request.target):
        if not path.is_file():
            raise FileMissing("There is no such file.", where=str(path), hint="Check the path.")
    if request.out.exists() and request.out.samefile(request.target):
        raise OutputExists("The target's own file would be replaced.", where=str(request.out), hint="Name another.")
    progress("reading the actor", 0, 1)
    read = read_source(request.source, request.body, request.armature, request.action)
    actor = read.actor
    with atomic_outputs(request.out.parent, (request.out.name,), overwrite=request.overwrite) as temporary:
        scene, rig = open_target(request)
        rig_map = map_target(request, rig)
        timing = lay_out_time(request, scene, [actor.fps])
        progress("retargeting", 0, 1)
        done = retarget(actor, rig, scene, rig_map, timing, request.settings)
        progress("retargeting", 1, 1)
        scene.frame_start = min(scene.frame_start, request.frame_start)
        scene.frame_end = max(scene.frame_end, timing.last_frame(actor.num_frames, actor.fps))
        save_file(temporary[request.out.name])
        if request.save_map is not None:
            write_map(request.save_map, done.rig_map, overwrite=request.overwrite)
    return {
        "event": "result",
        "outputs": [str(path) for path in (request.out, request.save_map) if path is not None],
        "notes": [*read.notes, *done.notes],
        "frames": actor.num_frames,
        "fps": actor.fps,
        "map": done.rig_map.label,
        "scale": round(done.scale, 5),
        "lengths_by_the_actor": {k: round(v, 4) for k, v in asdict(done.proportions).items() if isfinite(v)},
        "soles_from": done.soles,
        "hands_and_feet_deviation_mm": round(done.deviation_mm, 3),
        "seconds": round(time.monotonic() - start, 3),
    }
