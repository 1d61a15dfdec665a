"""Run the steps from videos to a motion. Results whose inputs have not changed are kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.camera_calibration.calibration_check import CalibrationCheck, check_calibration
from solver_backend.cameras.noise_map import read_noise_map
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, refuse_errors
from solver_backend.exchange.errors import NoDetections, OutputExists
from solver_backend.exchange.outputs import check_output, write_text
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.setting import settings_of_class, values_that_differ
from solver_backend.fitters.pipeline import solve
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.calibration.search import find_calibration
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.io.recognition.range_checks import checked
from solver_backend.report.checks import diagnose, recorded_diagnostics
from solver_backend.report.page import write_report
from solver_backend.types import Capture
from solver_backend.videos.detect.assemble import KnownOfOne, assembled, steadied
from solver_backend.videos.detect.detect_videos import detect_videos
from solver_backend.videos.detect.detector import DetectorChoice
from solver_backend.videos.detect.find_hands import find_hands, seen_by
from solver_backend.videos.pipeline import pictures
from solver_backend.videos.pipeline.calibrate import ONE_CAMERA, CalibrationRequest, calibrate_take
from solver_backend.videos.pipeline.layout import FoundFolder
from solver_backend.videos.pipeline.plan import STEPS, PipelineSettings, Records, Steps, TakePlan
from solver_backend.videos.sync.clocks import read_clocks
from solver_backend.videos.sync.synchronise import synchronise


def hands_found(capture: Capture, detector: DetectorChoice | None) -> list[Diagnostic]:
    """Report the share of frames in which two views, or the only one, show each hand."""
    if detector is None or capture.keypoints is None or capture.keypoints.hands is None:
        return []
    least, views = (1, "one") if capture.is_one_view else (2, "two")
    shares = seen_by(capture, least)
    return [diagnostic("hands_found", views=views, left=shares["left"], right=shares["right"])]


def made_of_hands(detector: DetectorChoice | None) -> list[str]:
    """Return the hand model as one more input of a capture."""
    if detector is None:
        return []
    model = Path(str(detector.options["model"]))
    return [f"hands by {model.name}, {model.stat().st_size} bytes"]


FOUND_SHARE = 0.5  # Least share of a video's pictures that show a person without a warning. Chosen by hand.


def run_take(found: FoundFolder, plan: TakePlan, settings: PipelineSettings, progress: Progress = silent) -> Steps:
    """Run the steps of one take and return their reports. ``road.json`` and the pictures are written after each step.

    Raises:
        MocapError: a step failed. The results of earlier steps are kept.
    """
    check_output(plan.capture, overwrite=True)
    run = _TakeRun(found, plan, settings, progress)
    for step in STEPS[: STEPS.index(settings.until) + 1]:
        getattr(run, step)()
    return run.steps


class _TakeRun:
    """State of one take. One method per step, in the order of ``STEPS``."""

    def __init__(self, found: FoundFolder, plan: TakePlan, settings: PipelineSettings, progress: Progress) -> None:
        self._found, self._plan, self._settings, self._progress = found, plan, settings, progress
        self.steps = Steps(plan.folder, plan.take.name, STEPS)
        self._records = Records(plan.folder)
        self._pictures = plan.folder / "pictures"

    def detect(self) -> None:
        settings, folder = self._settings, self._plan.folder / "detections"
        done_before = set(folder.glob("*.npz"))
        videos, cameras, again = self._plan.take.videos, self._plan.take.cameras, "detect" in settings.redo
        options = {"jobs": settings.jobs, "cameras": cameras, "pictures_fps": settings.pictures_fps}
        found = detect_videos(videos, settings.detector, folder, self._progress, again=again, **options)
        self._detections = tuple(found)
        self._seen = [(item.video_hash, item.detector) for item in self._detections]
        count = sum(item.num_frames for item in self._detections)
        drawn = self._pictures / "detect.png"
        if not self._records.is_made(drawn, self._seen) or again:
            pictures.detections_picture(self._detections, drawn)
            self._records.made(drawn, self._seen)
        found = [diagnostic("videos_searched", count=count, detector=self._detections[0].detector)]
        for item in self._detections:
            if (share := float((item.confidence > 0).any((-1, -2)).mean())) < FOUND_SHARE:
                found.append(diagnostic("person_seldom_found", file=item.video.name, share=100 * (1 - share)))
        if any(video.is_dir() for video in self._plan.take.videos):
            found.append(diagnostic("frame_rate_assumed", rate=settings.pictures_fps))
        kept = set(folder.glob("*.npz")) == done_before and not again
        self.steps.report("detect", "kept" if kept else "made", found, [drawn])

    def sync(self) -> None:
        self._calibration = self._kept_calibration()
        self._report_clocks()

    def calibrate(self) -> None:
        plan, settings = self._plan, self._settings
        drawn = [self._pictures / "calibrate.png"]
        if self._calibration is not None:
            figures = {"file": self._calibration.source.name, "count": len(self._calibration.cameras)}
            found = [diagnostic("calibration_read", kind="kept", **figures)]
            self.steps.report("calibrate", "kept", found, drawn)
            return
        if plan.made_calibration.exists() and not self._records.is_ours(plan.made_calibration):
            _refuse(plan.made_calibration, settings)
        out = plan.made_calibration
        request = CalibrationRequest(self._found, plan.take, self._detections, self._clocks, out, drawn[0])
        with self._records.making(plan.made_calibration):
            made = calibrate_take(request, settings.cameras, self._progress)
        self._calibration = _of_take(plan.made_calibration, plan)
        self._records.made(plan.made_calibration, self._calibrated_from(made.method))
        self._report_clocks()
        self.steps.report("calibrate", "made", made.diagnostics, drawn)

    def capture(self) -> None:
        plan, calibration = self._plan, self._calibration
        assert calibration is not None
        world = values_that_differ(self._settings.world, settings_of_class(self._settings.world))
        self._made_of = [self._seen, self._clocks.as_dict(), _numbers(calibration), world]
        if len(plan.take.videos) == 1:
            self._made_of.append(repr(self._of_one()))
        self._made_of += made_of_hands(self._settings.hands)
        if self._is_kept(plan.capture, self._made_of, "capture"):
            self._capture, state = read_capture(plan.capture), "kept"
        else:
            name, world, state, one = plan.take.name, self._settings.world, "made", self._of_one()
            detections, found = steadied(self._detections, calibration, self._progress)
            made = assembled(name, detections, self._clocks, calibration, self._progress, world=world, one=one)
            notes, problems = ([i for i in found if (i.severity is Severity.NOTE) is kind] for kind in (True, False))
            made = replace(made, notes=(*made.notes, *notes), problems=(*made.problems, *problems))
            self._capture = checked(made)
            if self._settings.hands is not None:
                self._capture = find_hands(self._capture, self._settings.hands, self._progress)
            with self._records.making(plan.capture):
                write_capture(plan.capture, self._capture, overwrite=True)
            self._records.made(plan.capture, self._made_of)
        self._check = self._checked(self._capture)
        drawn = [path for name in ("cameras.png", "check.png") if (path := self._pictures / name).is_file()]
        found = [diagnostic("file_written", kind="capture", file=str(plan.capture)), *self._how_cameras_fit()]
        found += hands_found(self._capture, self._settings.hands)
        self.steps.report("capture", state, found, drawn)

    def _how_cameras_fit(self) -> list[Diagnostic]:
        check = self._check
        if check is None:
            return [diagnostic("calibration_unchecked", reason="single" if self._capture.is_one_view else "short")]
        return [diagnostic("cameras_fit_take", size=check.all_px, best=check.refined_px), *check.diagnostics]

    def _of_one(self) -> KnownOfOne:
        """Return the facts for solving a single video."""
        plan, cameras = self._plan, self._settings.cameras
        if len(plan.take.videos) > 1:
            return KnownOfOne()
        ours = plan.calibration is None or cameras.source != "auto"
        focal_sigma = cameras.focal_of(self._detections[0]).sigma if ours and cameras.lenses is None else 0.0
        return KnownOfOne(cameras.stature_m or 0.0, ours, focal_sigma)

    def solve(self) -> None:
        plan, settings = self._plan, self._settings
        noise = settings.solve.noise
        meant = [read_noise_map(noise).as_dict()] if noise else []
        made_of = [self._made_of, repr(settings.solve), *meant]
        written = diagnostic("file_written", kind="motion", file=str(plan.motion))
        if self._is_kept(plan.motion, made_of, "solve"):
            found = recorded_diagnostics(read_motion(plan.motion))
            self.steps.report("solve", "kept", [written, *found])
            return
        motion = solve(self._capture, settings.solve, self._progress).motion
        found = diagnose(self._capture, motion)
        refuse_errors(found, settings.solve.accept, str(plan.capture))
        record = {**motion.provenance, "diagnostics": [item.as_dict() for item in found]}
        motion = replace(motion, provenance=record)
        write_report(plan.folder / "report.html", self._capture, motion, self._check, overwrite=True)
        with self._records.making(plan.motion):
            write_motion(plan.motion, motion, overwrite=True)
        self._records.made(plan.motion, made_of)
        self.steps.report("solve", "made", [written, *found])

    def _kept_calibration(self) -> Calibration | None:
        """Return the take's own or an earlier calibration, unless the user asks for another."""
        plan, source = self._plan, self._settings.cameras.source
        if source == "auto" and plan.calibration is not None:
            return plan.calibration
        made, ours = plan.made_calibration, self._records.is_ours(plan.made_calibration)
        fits = source == "auto" or self._records.is_made(made, source) or not ours
        if len(plan.take.videos) == 1 and ours:  # the user states its lens, which is not estimated again
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
        plan, settings, cameras = self._plan, self._settings, self._calibration and self._calibration.cameras
        made_of = [self._seen, settings.sync, self._calibration and _numbers(self._calibration)]
        drawn = self._pictures / "sync.png"
        kept = self._is_kept(plan.clocks, made_of, "sync")
        if kept:
            self._clocks = read_clocks(plan.clocks)
        else:
            self._clocks = synchronise(self._detections, cameras, settings.sync, self._progress)
            with self._records.making(plan.clocks):
                write_text(plan.clocks, json.dumps(self._clocks.as_dict(), indent=2) + "\n", overwrite=True)
            self._records.made(plan.clocks, made_of)
        if not kept or not drawn.is_file():
            pictures.clocks_picture(self._detections, self._clocks, drawn)
        notes = self._clocks.notes() or (diagnostic("clocks_assumed", reason="as_filmed", severity=Severity.NOTE),)
        found = [*notes, *self._clocks.findings]
        self.steps.report("sync", "kept" if kept else "made", found, [drawn])

    def _checked(self, capture: Capture) -> CalibrationCheck | None:
        """Check the calibration on the take and draw the result. Return None if too little is visible."""
        if capture.is_one_view:
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

    def _is_kept(self, output: Path, made_of: Any, step: str) -> bool:
        if step not in self._settings.redo and self._records.is_made(output, made_of):
            return True
        if output.exists() and not self._records.is_ours(output):
            _refuse(output, self._settings)
        return False


def _refuse(output: Path, settings: PipelineSettings) -> None:
    if not settings.overwrite:
        hint = "Choose another --out, or --overwrite."
        raise OutputExists("The output is a file that from-videos did not write.", where=str(output), hint=hint)


def _of_take(path: Path, plan: TakePlan) -> Calibration:
    read_calibration(path)
    return find_calibration(path.parent, plan.take.cameras)


def _numbers(calibration: Calibration) -> list:
    cameras = calibration.cameras
    return [cameras.names, *(a.tolist() for a in (cameras.K, cameras.distortion, cameras.R, cameras.t))]
