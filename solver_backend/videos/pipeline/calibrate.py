"""Calibrate a take's cameras from board footage, or from the person alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.agreement.person_selection import select_in_one_view
from solver_backend.camera_calibration.adjustment.lens import Lens, build_cameras
from solver_backend.camera_calibration.boards.board import Board, board_named
from solver_backend.camera_calibration.boards.footage import BoardFootage
from solver_backend.camera_calibration.extrinsics.board_session import calibrate_by_board, calibrate_lenses
from solver_backend.camera_calibration.extrinsics.person_session import calibrate_by_person
from solver_backend.camera_calibration.extrinsics.two_views import CalibratedCameras
from solver_backend.camera_calibration.formats import write_calibration
from solver_backend.camera_calibration.intrinsics.known_lenses import FocalLength, find_focal_length, known_lenses
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import CalibrationMissing, CommandLineInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.io.camera_names import match_names
from solver_backend.io.recognition.world_fit import stand_camera
from solver_backend.videos.detect.assemble import assembled, everybody
from solver_backend.videos.pipeline.layout import FoundFolder, FoundTake
from solver_backend.videos.pipeline.pictures import draw_boards
from solver_backend.videos.sync.clocks import Clocks
from solver_backend.videos.sync.synchronise import BY_SPEEDS
from solver_backend.videos.video_detections import VideoDetections

ONE_CAMERA = "one camera"  # Name of the method used for a single camera.
_PLACES = ("extrinsics", "both")  # Types of board footage that several cameras recorded simultaneously.
_BOARD_FILES = ("board.toml", "charuco.toml")


@dataclass(frozen=True)
class CalibrationRequest:
    """A take to calibrate, and the data that a calibration can use."""

    found: FoundFolder
    take: FoundTake
    detections: tuple[VideoDetections, ...]  # Detections in the videos, for a calibration from the person.
    clocks: Clocks
    out: Path  # Calibration file to write.
    coverage: Path | None = None  # Image that shows the board positions in each view, if a board is used.


@dataclass(frozen=True)
class KnownOfCameras:
    """User-supplied facts about the cameras and the footage."""

    board: str | None = None  # Board name, see ``board_named``. With None, ``board.toml`` next to the footage is used.
    lenses: Path | None = None
    stature_m: float | None = None  # Stature of the person in metres. It sets the scale if there is no board.
    source: str = "auto"
    """Calibration source. "auto" uses the best one available. "board" and "person" ignore existing calibrations."""
    focal: str = ""  # Focal length of cameras with unknown lenses, see ``find_focal_length``.

    def focal_of(self, video: VideoDetections) -> FocalLength:
        """Find the focal length of a camera without a calibrated lens."""
        return find_focal_length(self.focal, video.video, video.size)


def calibration_source(found: FoundFolder, known: KnownOfCameras) -> str:
    """Choose how uncalibrated cameras will be calibrated: by "board", "lenses" or "person".

    "board" estimates lenses and poses from board footage. "lenses" estimates only the lenses from board footage, and
    the poses from the person. Both need OpenCV.
    """
    kinds = {footage.kind for footage in found.footage}
    if kinds.intersection(_PLACES) and known.source != "person":
        return "board"
    unknown_board = known.source == "person" and known.board is None and _board_file(found) is None
    return "lenses" if "intrinsics" in kinds and known.lenses is None and not unknown_board else "person"


def calibrate_take(
    request: CalibrationRequest, known: KnownOfCameras, progress: Progress
) -> tuple[str, tuple[Diagnostic, ...]]:
    """Calibrate a take's cameras and write the calibration. Return the method and the diagnostics.

    The method is board, person or ``ONE_CAMERA``. If several cameras filmed a board, the board determines lenses and
    poses. Otherwise, the person determines the poses. If no lens is known or can be calibrated from board footage,
    focal lengths are guessed from the image size, and then refined together with the poses.
    """
    lens, places = _footage(request, ("intrinsics",)), _footage(request, _PLACES)
    names = request.take.cameras
    lenses = {} if known.lenses is None else known_lenses(known.lenses, names)
    if known.source == "board" and not places:
        message = "There is no footage of a board for several cameras."
        hint = "Put it in an 'extrinsics' folder next to the takes, or calibrate from the person: --cameras person."
        raise CalibrationMissing(message, where=str(request.found.root), hint=hint)
    unused: tuple[Diagnostic, ...] = ()
    source = calibration_source(request.found, known)
    if source == "board":
        folder = None if request.coverage is None else request.coverage.parent / "boards"
        board = _board(request, known)
        found = calibrate_by_board(BoardFootage(lens, places), board, lenses, progress=progress, coverage=folder)
        if request.coverage is not None and folder is not None:
            draw_boards(folder, names, request.coverage)
    else:
        if source == "lenses":
            measured = calibrate_lenses(lens, _board(request, known), progress=progress)
            lenses = {name: of_camera.lens for name, of_camera in measured.items()}
        elif lens and not lenses:
            unused = (diagnostic("lens_footage_unused"),)
        if len(names) == 1:
            return ONE_CAMERA, (*_by_one_camera(request, lenses, known, progress), *unused)
        found = _by_person(request, lenses, known, progress)
    write_calibration(request.out, found.cameras, "pose2sim", found.rmse_px, overwrite=True)
    done = diagnostic("cameras_calibrated", count=len(names), method=found.method, size=found.rmse_px)
    return found.method, (done, *found.notes, *unused, *found.findings)


def _by_person(
    request: CalibrationRequest, lenses: dict[str, Lens], known: KnownOfCameras, progress: Progress
) -> CalibratedCameras:
    names, clocks = request.take.cameras, [request.clocks]
    if request.clocks.method == BY_SPEEDS and request.clocks.offset_s.any():
        clocks.append(Clocks.alike(names))  # in a short take, the speeds in different views can match by chance
    taken = [assembled(request.take.name, request.detections, one, None, progress).keypoints for one in clocks]
    readings = [keypoints for keypoints in taken if keypoints is not None]
    progress("Cameras from the person", 0, 1)
    seen = zip(names, request.detections, strict=True)
    chosen = [lenses.get(name) or known.focal_of(video).lens(video.size) for name, video in seen]
    found = calibrate_by_person(names, chosen, *readings, stature_m=known.stature_m, free_focal=not lenses)
    progress("Cameras from the person", 1, 1)
    return found


def _by_one_camera(
    request: CalibrationRequest, lenses: dict[str, Lens], known: KnownOfCameras, progress: Progress
) -> tuple[Diagnostic, ...]:
    name, seen = request.take.cameras[0], request.detections[0]
    progress("Camera from the person", 0, 1)
    focal = known.focal_of(seen)
    lens = lenses.get(name) or focal.lens(seen.size)
    camera = build_cameras((name,), [lens], np.eye(3)[None], np.zeros((1, 3)))
    detections, fps = everybody(request.detections, request.clocks)
    person = select_in_one_view(detections, fps)[0]
    stood, placed = stand_camera(camera, person.keypoints, known.stature_m or 0.0)
    write_calibration(request.out, stood, "pose2sim", 0.0, overwrite=True)
    progress("Camera from the person", 1, 1)
    if name in lenses:
        return (placed,)
    severity = Severity.WARNING if focal.sigma else Severity.NOTE
    figures: dict[str, Any] = {"size": focal.px, "share": 100 * focal.sigma, "source": focal.source}
    return (placed, diagnostic("focal_length_of_video", severity=severity, cameras=[name], **figures))


def _footage(request: CalibrationRequest, kinds: tuple[str, ...]) -> dict[str, Path]:
    """Find the take's board footage of the given types, by camera name. Return {} if there is none."""
    names = request.take.cameras
    for footage in request.found.footage:
        if footage.kind in kinds:
            order = match_names(names, tuple(footage.cameras))
            if order is None:
                message = f"The board was filmed by {', '.join(footage.cameras)}, but the take by {', '.join(names)}."
                hint = "Film the board with all cameras, and name both sets of files after the cameras."
                raise CalibrationMissing(message, where=str(footage.folder), hint=hint)
            paths = list(footage.cameras.values())
            return {name: paths[i] for name, i in zip(names, order, strict=True)}
    return {}


def _board_file(found: FoundFolder) -> Path | None:
    places = [place for footage in found.footage for place in (footage.folder, footage.folder.parent)]
    return next((p / name for p in places for name in _BOARD_FILES if (p / name).is_file()), None)


def _board(request: CalibrationRequest, known: KnownOfCameras) -> Board:
    named = known.board or _board_file(request.found)
    if named is None:
        message = "The calibration board is unknown."
        hint = "Add --board, for example --board charuco:5x7:35mm, or put the board.toml written by 'board' next to it."
        raise CommandLineInvalid(message, where=str(request.found.footage[0].folder), hint=hint)
    return board_named(str(named))
