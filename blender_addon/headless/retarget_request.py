"""What a retarget on the command line asks for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

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
    """Leave out the travel over the ground."""
    root_motion: bool = False
    """Let the root bone carry the travel over the ground."""
    body: Path | None = None
    """Body file for a motion; None for the one the motion was solved for."""
    scale: float = 0.0
    """Size of the travel by the actor's; 0 for the ratio of the legs."""
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
