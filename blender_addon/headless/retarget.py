"""``retarget``: a solved motion and a rig in; a Blender file with the rig playing the motion out."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._exchange.errors import FileMissing, OutputExists
from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from .actors import read_source
from .retarget_target import lay_out_time, map_target, open_target

if TYPE_CHECKING:
    from ..retarget.retarget import RetargetSettings


@dataclass(frozen=True)
class RetargetRequest:
    """What to retarget to what."""

    source: Path
    """Motion file, or a file with an armature that moves: Blender, FBX, glTF, BVH."""
    target: Path
    """File with the rig: Blender, FBX, glTF, VRM; it is not changed."""
    out: Path
    """Blender file to write."""
    object_name: str = ""
    """Which armature of the target; needed where there are several."""
    armature: str = ""
    """Which armature of the source is the actor; needed where there are several."""
    action: str = ""
    """Which of its actions it plays; "" for the one that it shows."""
    preset: str = ""
    """Name of a preset; "" for the one that fits."""
    map_file: Path | None = None
    """Map of the rig, instead of a preset."""
    save_map: Path | None = None
    """Where to write the map that was used, its map pose included."""
    limbs: str = "fk"
    """``fk`` or ``ik``."""
    in_place: bool = False
    """Leave out the way over the ground."""
    root_motion: bool = False
    """Let the root bone carry the way over the ground."""
    body: Path | None = None
    """Body file for a motion; None for the one the motion was solved for."""
    scale: float = 0.0
    """Size of the way by the actor's; 0 for the ratio of the legs."""
    frame_start: int = 1
    """Scene frame of the first frame."""
    overwrite: bool = False
    """Replace files that are there."""

    @property
    def settings(self) -> RetargetSettings:
        """How the motion goes over."""
        from ..retarget.motion.transfer import TransferSettings
        from ..retarget.retarget import RetargetSettings

        return RetargetSettings(self.limbs, TransferSettings(self.in_place, self.root_motion, scale=self.scale))


def run_retarget(request: RetargetRequest, progress: Progress) -> dict[str, Any]:
    """Write a copy of the target's file in which the rig plays the motion.

    Returns:
        The ``result`` event: outputs, notes, frames, scale, deviation and the map's label.

    Raises:
        MocapError: an input is missing or wrong, the rig or its map is unsuitable, or an output exists.
    """
    from ..retarget.maps.rig_map import write_map
    from ..retarget.retarget import retarget
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
