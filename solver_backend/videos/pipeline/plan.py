"""Plan the steps from videos to a motion for every take of a folder."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from solver_backend.exchange.errors import MocapError
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.io.calibration.entry import Calibration
from solver_backend.videos.detect.detector import DetectorChoice
from solver_backend.videos.files.video import PICTURES_FPS
from solver_backend.videos.pipeline.calibrate import KnownOfCameras
from solver_backend.videos.pipeline.layout import FoundFolder, FoundTake

STEPS = ("detect", "sync", "calibrate", "capture", "solve")
"""Steps from videos to a motion, in their order."""


@dataclass(frozen=True)
class TakePlan:
    """Steps of one take."""

    take: FoundTake
    folder: Path
    calibration: Calibration | None
    """The existing calibration. None to calibrate the cameras."""
    problem: str = ""

    @property
    def capture(self) -> Path:
        """The capture file."""
        return self.folder / "capture.npz"

    @property
    def motion(self) -> Path:
        """The motion file."""
        return self.folder / "motion.npz"

    @property
    def clocks(self) -> Path:
        """The file of the cameras' clocks."""
        return self.folder / "sync.json"

    @property
    def made_calibration(self) -> Path:
        """The calibration file that is written if there is no other."""
        return self.folder / "calibration.toml"


def planned(found: FoundFolder, out: Path) -> list[TakePlan]:
    """Return the plan of every take. Several takes have folders of their own."""
    plans, several = [], len(found.takes) > 1
    for take in found.takes:
        folder, calibration, problem = out / take.name if several else out, None, ""
        try:
            calibration = take.calibration(found.root)
        except MocapError as error:
            problem = str(error)
        plans.append(TakePlan(take, folder, calibration, problem))
    return plans


def described(found: FoundFolder, plans: list[TakePlan], detector: str, sync: str, until: str) -> list[str]:
    """Return the plan as lines for a person."""
    lines = [f"{found.root}: {len(plans)} take{'s' * (len(plans) > 1)}"]
    for footage in found.footage:
        lines.append(f"  board footage  {footage.kind} of {len(footage.cameras)} cameras in {footage.folder.name}")
    wanted = STEPS[: STEPS.index(until) + 1]
    for plan in plans:
        lines += [f"  take {plan.take.name}: {', '.join(plan.take.cameras)} → {plan.folder}"]
        steps = {
            "detect": f"keypoints by {detector}; videos done before are kept",
            "sync": f"clocks of the cameras by {sync}" if sync != "none" else "taken to be in step",
            "calibrate": _calibration_words(plan, found),
            "capture": f"{plan.capture.name}",
            "solve": f"{plan.motion.name} and report.html",
        }
        lines += [f"    {step:<10} {steps[step]}" for step in wanted]
    return lines


def _calibration_words(plan: TakePlan, found: FoundFolder) -> str:
    if plan.calibration is not None:
        return f"kept: {plan.calibration.source.name}, {len(plan.calibration.cameras)} cameras"
    if plan.made_calibration.is_file():
        return f"kept: {plan.made_calibration.name}"
    source = "the board footage" if found.footage else "the person alone"
    return f"cameras from {source}" + (f"; {plan.problem}" if plan.problem else "")


@dataclass(frozen=True)
class PipelineSettings:
    """Settings of all steps."""

    detector: DetectorChoice
    """Detector of keypoints."""
    sync: str = "auto"
    """Method for the clocks, see ``synchronise``."""
    until: str = "solve"
    """The last step."""
    jobs: int = 0
    """Number of detectors at a time, 0 for one per core."""
    pictures_fps: float = PICTURES_FPS
    """Rate of folders of pictures, per second."""
    redo: tuple[str, ...] = ()
    """Steps to repeat even if nothing has changed."""
    overwrite: bool = False
    """Replace files of other programs."""
    solve: SolveSettings = field(default_factory=SolveSettings)
    """Settings of the solve."""
    world: WorldSettings = field(default_factory=WorldSettings)
    """Scale and level of the world."""
    cameras: KnownOfCameras = field(default_factory=KnownOfCameras)
    """Facts about cameras without a calibration."""
    hands: DetectorChoice | None = None
    """Detector of hands at the wrists. None uses the hands of ``detector``, if any."""
