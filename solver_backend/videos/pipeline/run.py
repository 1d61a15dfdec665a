"""Run the steps from videos to a motion. A result is reused if its inputs are unchanged."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from solver_backend.camera_calibration.calibration_check import CalibrationCheck, check_calibration
from solver_backend.camera_calibration.pictures import opencv
from solver_backend.cameras.noise_map import read_noise_map
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, refuse_errors
from solver_backend.exchange.errors import MocapError, NoDetections, OutputExists
from solver_backend.exchange.outputs import check_output, write_text
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.setting import settings_of_class, values_that_differ
from solver_backend.fitters.pipeline import solve
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.calibration.search import find_calibration
from solver_backend.io.camera_paths import ESTIMATED
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.io.recognition.range_checks import checked
from solver_backend.report.checks import diagnose, recorded_diagnostics
from solver_backend.report.page import write_report
from solver_backend.types import Capture, Motion
from solver_backend.videos.detect.assemble import KnownOfOne, assembled
from solver_backend.videos.detect.detect_videos import Glance, detect_videos
from solver_backend.videos.detect.detector import DetectorChoice
from solver_backend.videos.detect.find_hands import find_hands, seen_by
from solver_backend.videos.detect.follow_camera import without_camera_motion
from solver_backend.videos.pipeline import pictures
from solver_backend.videos.pipeline.calibrate import ONE_CAMERA, CalibrationRequest, calibrate_take, calibration_source
from solver_backend.videos.pipeline.layout import FoundFolder
from solver_backend.videos.pipeline.plan import STEPS, PipelineSettings, Records, Steps, TakePlan
from solver_backend.videos.sync.clocks import Clocks, read_clocks
from solver_backend.videos.sync.synchronise import synchronise
from solver_backend.videos.video_detections import VERSION

T = TypeVar("T")
FOUND_SHARE = 0.5  # Fraction of images with a person below which to warn. Chosen by hand.


def hands_found(capture: Capture, detector: DetectorChoice | None) -> list[Diagnostic]:
    """Report the percentage of frames in which two views (or the only view) show each hand."""
    if detector is None or capture.keypoints is None or capture.keypoints.hands is None:
        return []
    shares, views = seen_by(capture, capture.least_views), "one" if capture.least_views == 1 else "two"
    return [diagnostic("hands_found", views=views, left=shares["left"], right=shares["right"])]


def made_of_hands(detector: DetectorChoice | None) -> list[str]:
    """Return the entry for the hand detector in a capture's list of inputs, or [] without a hand detector."""
    model = None if detector is None else Path(str(detector.options["model"]))
    return [] if model is None else [f"hands by {model.name}, {model.stat().st_size} bytes"]


def run_take(found: FoundFolder, plan: TakePlan, settings: PipelineSettings, progress: Progress = silent) -> Steps:
    """Run the steps for one take. After each step, ``road.json`` and a drawing are written."""
    check_output(plan.output("capture"), overwrite=True)
    run = _TakeRun(found, plan, settings, progress)
    for step in STEPS[: STEPS.index(settings.until) + 1]:
        getattr(run, step)()
    return run.steps


class _TakeRun:
    def __init__(self, found: FoundFolder, plan: TakePlan, settings: PipelineSettings, progress: Progress) -> None:
        self._found, self._plan, self._settings, self._progress = found, plan, settings, progress
        self.steps = Steps(plan.folder, plan.take.name)
        self._records = Records(plan.folder)
        self._pictures = plan.folder / "pictures"

    def detect(self) -> None:
        settings, folder = self._settings, self._plan.folder / "detections"
        done_before = set(folder.glob("*.npz"))
        videos, cameras, again = self._plan.take.videos, self._plan.take.cameras, "detect" in settings.redo
        filmed = len(videos) > 1 and calibration_source(self._found, settings.cameras) != "person"
        if filmed and STEPS.index(settings.until) >= STEPS.index("calibrate") and self._kept_calibration() is None:
            opencv()  # fail now if it is missing, because the detection can take hours
        drawn = self._pictures / "detect.png"
        options: dict[str, Any] = {"jobs": settings.jobs, "cameras": cameras, "pictures_fps": settings.pictures_fps}
        options["show"] = partial(self._show, path=drawn)
        found = detect_videos(videos, settings.detector, folder, self._progress, again=again, **options)
        self._detections = tuple(found)
        self._seen = [(item.video_hash, item.detector, VERSION) for item in self._detections]
        count = sum(item.num_frames for item in self._detections)
        if not self._records.is_made(drawn, self._seen) or again:
            pictures.detections_picture(self._detections, drawn)
            self._records.made(drawn, self._seen)
        found = [diagnostic("videos_searched", count=count, detector=self._detections[0].detector)]
        for item in self._detections:
            if (share := float((item.confidence > 0).any((-1, -2)).mean())) < FOUND_SHARE:
                found.append(diagnostic("person_seldom_found", file=item.video.name, share=100 * (1 - share)))
        if any(video.is_dir() for video in videos):
            found.append(diagnostic("frame_rate_assumed", rate=settings.pictures_fps))
        kept = set(folder.glob("*.npz")) == done_before and not again
        self.steps.report("detect", "kept" if kept else "made", found, [drawn])

    def _show(self, glances: Sequence[Glance], path: Path) -> None:
        """Draw a preview of the detection. If it cannot be written, the detection continues."""
        with suppress(MocapError):
            self._records.made(path, "unfinished")
            names = dict(zip(self._plan.take.videos, self._plan.take.cameras, strict=True))
            pictures.glances_picture(glances, path, names)

    def sync(self) -> None:
        self._calibration = self._kept_calibration()
        self._report_clocks()

    def calibrate(self) -> None:
        plan, out = self._plan, self._plan.output("calibrate")
        drawn = [self._pictures / "calibrate.png"]
        if self._calibration is not None:
            figures = {"file": self._calibration.source.name, "count": len(self._calibration.cameras)}
            found = [diagnostic("calibration_read", kind="kept", **figures)]
            self.steps.report("calibrate", "kept", found, drawn)
            return
        self._refuse_foreign(out)
        request = CalibrationRequest(self._found, plan.take, self._detections, self._clocks, out, drawn[0])
        with self._records.making(out):
            method, found = calibrate_take(request, self._settings.cameras, self._progress)
        self._calibration = _of_take(out, plan)
        self._records.made(out, self._calibrated_from(method))
        self._report_clocks()
        self.steps.report("calibrate", "made", found, drawn)

    def capture(self) -> None:
        assert self._calibration is not None
        world = values_that_differ(self._settings.world, settings_of_class(self._settings.world))
        self._made_of: list[Any] = [self._seen, self._clocks.as_dict(), _numbers(self._calibration), world]
        if len(self._plan.take.videos) == 1:
            self._made_of.append(repr(self._of_one()))
        self._made_of += made_of_hands(self._settings.hands)
        self._capture, state = self._result("capture", self._made_of, read_capture, self._assembled, write_capture)
        self._check = self._checked(self._capture)
        drawn = [path for name in ("cameras.png", "check.png") if (path := self._pictures / name).is_file()]
        written = diagnostic("file_written", kind="capture", file=str(self._plan.output("capture")))
        found = [written, *self._how_cameras_fit(), *hands_found(self._capture, self._settings.hands)]
        self.steps.report("capture", state, found, drawn)

    def _assembled(self) -> Capture:
        calibration, settings, progress = self._calibration, self._settings, self._progress
        assert calibration is not None
        about_moves = settings.world, self._plan.folder / ESTIMATED, progress
        detections, world, found = without_camera_motion(self._detections, calibration, *about_moves)
        about = {"world": world, "one": self._of_one()}
        made = assembled(self._plan.take.name, detections, self._clocks, calibration, progress, **about)
        notes, problems = (tuple(i for i in found if (i.severity is Severity.NOTE) is kind) for kind in (True, False))
        made = checked(replace(made, notes=made.notes + notes, problems=made.problems + problems))
        return made if settings.hands is None else find_hands(made, settings.hands, progress)

    def _how_cameras_fit(self) -> list[Diagnostic]:
        check = self._check
        if check is None:
            return [diagnostic("calibration_unchecked", reason="single" if self._capture.is_one_view else "short")]
        return [diagnostic("cameras_fit_take", size=check.all_px, best=check.refined_px), *check.diagnostics]

    def _of_one(self) -> KnownOfOne:
        """Return the known facts about person, floor and lens of a single-video take, or no facts for other takes."""
        plan, cameras = self._plan, self._settings.cameras
        if len(plan.take.videos) > 1:
            return KnownOfOne()
        ours = plan.calibration is None or cameras.source != "auto"
        focal_sigma = cameras.focal_of(self._detections[0]).sigma if ours and cameras.lenses is None else 0.0
        return KnownOfOne(cameras.stature_m or 0.0, ours, focal_sigma)

    def solve(self) -> None:
        noise = self._settings.solve.noise
        made_of = [self._made_of, repr(self._settings.solve), *([read_noise_map(noise).as_dict()] if noise else [])]
        motion, state = self._result("solve", made_of, read_motion, self._solved, write_motion)
        written = diagnostic("file_written", kind="motion", file=str(self._plan.output("solve")))
        self.steps.report("solve", state, [written, *recorded_diagnostics(motion)])

    def _solved(self) -> Motion:
        plan, settings = self._plan, self._settings.solve
        motion = solve(self._capture, settings, self._progress).motion
        found = diagnose(self._capture, motion)
        refuse_errors(found, settings.accept, str(plan.output("capture")))
        record = {**motion.provenance, "diagnostics": [item.as_dict() for item in found]}
        motion = replace(motion, provenance=record)
        write_report(plan.folder / "report.html", self._capture, motion, self._check, overwrite=True)
        return motion

    def _kept_calibration(self) -> Calibration | None:
        """Return a calibration from the user or from an earlier run, or None if the cameras must be calibrated."""
        plan, source, made = self._plan, self._settings.cameras.source, self._plan.output("calibrate")
        if source == "auto" and plan.calibration is not None:
            return plan.calibration
        ours = self._records.is_ours(made)
        fits = source == "auto" or self._records.is_made(made, source) or not ours
        if len(plan.take.videos) == 1 and ours:  # the lens parameters that the user gave are not estimated again
            fits = self._records.is_made(made, self._calibrated_from(ONE_CAMERA))
        again = "calibrate" in self._settings.redo and ours
        return _of_take(made, plan) if made.is_file() and fits and not again else None

    def _calibrated_from(self, method: str) -> Any:
        cameras = self._settings.cameras
        if method != ONE_CAMERA:
            return method
        focal = cameras.focal_of(self._detections[0])
        return [method, str(cameras.lenses or ""), focal.px, focal.sigma, cameras.stature_m or 0.0]

    def _report_clocks(self) -> None:
        wanted, calibration = self._settings.sync, self._calibration
        made_of = [self._seen, wanted, calibration and _numbers(calibration)]
        drawn = self._pictures / "sync.png"

        def make() -> Clocks:
            return synchronise(self._detections, calibration.cameras if calibration else None, wanted, self._progress)

        def write(path: Path, clocks: Clocks, *, overwrite: bool) -> None:
            write_text(path, json.dumps(clocks.as_dict(), indent=2) + "\n", overwrite=overwrite)

        self._clocks, state = self._result("sync", made_of, read_clocks, make, write)
        if state == "made" or not drawn.is_file():
            pictures.clocks_picture(self._detections, self._clocks, drawn)
        notes = self._clocks.notes()
        if not notes and len(self._clocks.names) > 1:
            notes = (diagnostic("clocks_assumed", reason="as_filmed", severity=Severity.NOTE),)
        self.steps.report("sync", state, [*notes, *self._clocks.findings], [drawn])

    def _checked(self, capture: Capture) -> CalibrationCheck | None:
        """Check the calibration on the take and draw the result. Return None if too little is visible."""
        if capture.several_views is None:
            return None
        cameras, keypoints = capture.require_multiview()
        self._progress("Checking the calibration", 0, 1)
        points = triangulate(cameras, keypoints.xy, keypoints.confidence).points
        known = np.isfinite(points).all(-1)
        middle = np.where(known[..., None], points, 0.0).sum(1) / np.maximum(known.sum(1), 1)[:, None]
        way = np.where(known.any(1)[:, None], middle, np.nan)
        pictures.cameras_picture(cameras, way, self._pictures / "cameras.png")
        try:
            check = check_calibration(cameras, keypoints)
            pictures.check_picture(cameras.names, check, self._pictures / "check.png")
        except NoDetections:
            check = None
        self._progress("Checking the calibration", 1, 1)
        return check

    def _result(
        self, step: str, made_of: Any, read: Callable[[Path], T], make: Callable[[], T], write: Callable[..., Any]
    ) -> tuple[T, str]:
        """Read the result of a step if its inputs are unchanged. Otherwise, compute and write it."""
        path = self._plan.output(step)
        if step not in self._settings.redo and self._records.is_made(path, made_of):
            return read(path), "kept"
        self._refuse_foreign(path)
        found = make()
        with self._records.making(path, made_of):
            write(path, found, overwrite=True)
        return found, "made"

    def _refuse_foreign(self, output: Path) -> None:
        if output.exists() and not self._records.is_ours(output) and not self._settings.overwrite:
            hint = "Choose another --out, or add --overwrite."
            raise OutputExists("The output is a file that from-videos did not write.", where=str(output), hint=hint)


def _of_take(path: Path, plan: TakePlan) -> Calibration:
    read_calibration(path)
    return find_calibration(path.parent, plan.take.cameras)


def _numbers(calibration: Calibration) -> list:
    cameras = calibration.cameras
    return [cameras.names, *(a.tolist() for a in (cameras.K, cameras.distortion, cameras.R, cameras.t))]
