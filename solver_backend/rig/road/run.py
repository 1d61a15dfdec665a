"""Goes the road: detections, clocks, calibration, capture, motion; what is there and still true is kept."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from solver_backend.exchange.errors import OutputExists
from solver_backend.exchange.outputs import check_output, write_text
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.pipeline import solve
from solver_backend.fitters.settings import SolveSettings
from solver_backend.io.calibration import Calibration
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.calibration.search import find_calibration
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.io.recognition.range_checks import checked
from solver_backend.report.page import write_report
from solver_backend.rig.detect.assemble import assembled
from solver_backend.rig.detect.choice import DetectorChoice
from solver_backend.rig.detect.detect_videos import detect_videos
from solver_backend.rig.detect.noise_map import NoiseMap
from solver_backend.rig.detect.video_detections import VideoDetections
from solver_backend.rig.road.calibrate import CalibrationRequest, KnownOfCameras, calibrate_take
from solver_backend.rig.road.layout import FoundFolder
from solver_backend.rig.road.plan import STEPS, TakePlan
from solver_backend.rig.road.records import Records
from solver_backend.rig.sync.clocks import Clocks, read_clocks
from solver_backend.rig.sync.synchronise import synchronise


@dataclass(frozen=True)
class RoadSettings:
    """How the road is gone."""

    detector: DetectorChoice
    """What finds keypoints."""
    sync: str = "auto"
    """How clocks are told: see ``synchronise``."""
    until: str = "solve"
    """The last step."""
    jobs: int = 0
    """Detectors at a time; 0 is one a core."""
    noise: NoiseMap | None = None
    """How the detector's confidence tells its spread; None takes it as it is."""
    redo: tuple[str, ...] = ()
    """Steps that are done again even if nothing has changed."""
    overwrite: bool = False
    """Replace files that this road did not make."""
    solve: SolveSettings = field(default_factory=SolveSettings)
    """How the capture is solved."""
    cameras: KnownOfCameras = field(default_factory=KnownOfCameras)
    """What is known of cameras that have no calibration."""


def go(found: FoundFolder, plan: TakePlan, settings: RoadSettings, progress: Progress = silent) -> dict[str, str]:
    """Go the road of one take and return, by step, what is there now: 'kept' or 'made', and the file.

    Raises:
        MocapError: whatever a step raises; the results of the steps before stay.
    """
    folder, last = plan.folder, STEPS.index(settings.until)
    check_output(plan.capture, overwrite=True)
    records, said = Records(folder), dict[str, str]()
    detections = tuple(
        detect_videos(plan.take.videos, settings.detector, folder / "detections", progress, jobs=settings.jobs)
    )
    said["detect"] = f"{sum(d.num_frames for d in detections)} pictures by {detections[0].detector}"
    seen = [(d.video_hash, d.detector) for d in detections]
    if last < 1:
        return said
    calibration = plan.calibration
    if calibration is None and plan.made_calibration.is_file():
        calibration = _of_take(plan.made_calibration, plan)
    clocks = _clocks(plan, detections, calibration, settings, records, [seen, settings.sync], progress, said)
    if last < 2:
        return said
    if calibration is None:
        request = CalibrationRequest(found, plan.take, detections, clocks, plan.made_calibration)
        words = calibrate_take(request, settings.cameras, progress)
        calibration = _of_take(plan.made_calibration, plan)
        records.made(plan.made_calibration, seen)
        clocks = _clocks(plan, detections, calibration, settings, records, [seen, settings.sync], progress, said)
        said["calibrate"] = "; ".join((f"made: {plan.made_calibration}", *words))
    else:
        said["calibrate"] = f"kept: {calibration.source}"
    if last < 3:
        return said
    made_of = [seen, clocks.as_dict(), _numbers(calibration), settings.noise and settings.noise.as_dict()]
    if _kept(records, plan.capture, made_of, "capture", settings):
        capture = read_capture(plan.capture)
        said["capture"] = f"kept: {plan.capture}"
    else:
        capture = assembled(plan.take.name, detections, clocks, calibration, progress)
        if settings.noise is not None and capture.keypoints is not None:
            weighted, note = settings.noise.applied(capture.keypoints, detections[0].detector)
            capture = replace(capture, keypoints=weighted, notes=(*capture.notes, note))
        capture = checked(capture)
        write_capture(plan.capture, capture, overwrite=True)
        records.made(plan.capture, made_of)
        said["capture"] = f"made: {plan.capture}"
    if last < 4:
        return said
    made_of = [made_of, repr(settings.solve)]
    if _kept(records, plan.motion, made_of, "solve", settings):
        said["solve"] = f"kept: {plan.motion}"
        return said
    motion = solve(capture, settings.solve, progress).motion
    write_report(folder / "report.html", capture, motion, overwrite=True)
    write_motion(plan.motion, motion, overwrite=True)
    records.made(plan.motion, made_of)
    said["solve"] = f"made: {plan.motion}"
    return said


def _clocks(
    plan: TakePlan, detections: Sequence[VideoDetections], calibration: Calibration | None, settings: RoadSettings,
    records: Records, made_of: list, progress: Progress, said: dict[str, str],
) -> Clocks:  # fmt: skip
    made_of = [*made_of, None if calibration is None else _numbers(calibration)]
    if _kept(records, plan.clocks, made_of, "sync", settings):
        said["sync"] = f"kept: {plan.clocks}"
        return read_clocks(plan.clocks)
    cameras = None if calibration is None else calibration.cameras
    clocks = synchronise(detections, cameras, settings.sync, progress)
    write_text(plan.clocks, json.dumps(clocks.as_dict(), indent=2) + "\n", overwrite=True)
    records.made(plan.clocks, made_of)
    said["sync"] = "made: " + "; ".join(clocks.lines())
    return clocks


def _kept(records: Records, output: Path, made_of: object, step: str, settings: RoadSettings) -> bool:
    """Return whether an output stays.

    Raises:
        OutputExists: somebody else's file is in its place.
    """
    if step not in settings.redo and records.is_made(output, made_of):
        return True
    if output.exists() and not records.is_ours(output) and not settings.overwrite:
        raise OutputExists(
            "There is a file that this road did not make.",
            where=str(output),
            hint="Choose another --out, or --overwrite.",
        )
    return False


def _of_take(path: Path, plan: TakePlan) -> Calibration:
    """Return the calibration that was made, its cameras in the take's order."""
    read_calibration(path)
    return find_calibration(path.parent, plan.take.cameras)


def _numbers(calibration: Calibration) -> list:
    cameras = calibration.cameras
    return [cameras.names, *(a.tolist() for a in (cameras.K, cameras.distortion, cameras.R, cameras.t))]
