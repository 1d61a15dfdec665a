"""How the road from videos to motions is gone."""

from __future__ import annotations

from dataclasses import dataclass, field

from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.world_settings import WorldSettings
from solver_backend.videos.detect.choice import DetectorChoice
from solver_backend.videos.files.probe import PICTURES_FPS
from solver_backend.videos.pipeline.calibrate import KnownOfCameras


@dataclass(frozen=True)
class RoadSettings:
    """How the road is gone."""

    detector: DetectorChoice
    """What finds keypoints."""
    sync: str = "auto"
    """How clocks are found: see ``synchronise``."""
    until: str = "solve"
    """The last step."""
    jobs: int = 0
    """Detectors at a time; 0 is one a core."""
    pictures_fps: float = PICTURES_FPS
    """Rate of cameras whose footage is a folder of pictures."""
    redo: tuple[str, ...] = ()
    """Steps that are done again even if nothing has changed."""
    overwrite: bool = False
    """Replace files that this road did not make."""
    solve: SolveSettings = field(default_factory=SolveSettings)
    """How the capture is solved."""
    world: WorldSettings = field(default_factory=WorldSettings)
    """How the world of the cameras is scaled and levelled."""
    cameras: KnownOfCameras = field(default_factory=KnownOfCameras)
    """What is known of cameras that have no calibration."""
    hands: DetectorChoice | None = None
    """What finds hands where the body has its wrists; None for the hands that ``detector`` finds, or none."""
