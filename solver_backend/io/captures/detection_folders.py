"""Read a folder of detections and its calibration as a capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.agreement.epipolar_fit import report_lenses
from solver_backend.agreement.evidence import agreement_share
from solver_backend.agreement.explain import assigned_by_views
from solver_backend.agreement.person_selection import SelectedPerson, select_in_one_view, select_people
from solver_backend.agreement.reading import MIN_CONFIDENCE
from solver_backend.agreement.repeated_frames import report_cuts, report_order, take_cuts
from solver_backend.agreement.starts import as_numbered
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, notes_in, warnings_in
from solver_backend.exchange.errors import CalibrationMissing, CaptureInvalid, NoDetections
from solver_backend.exchange.reading_settings import DEFAULTS, ON, calibrated_names
from solver_backend.exchange.solve_settings import SYNC_OFF
from solver_backend.io.calibration.entry import Calibration, CameraEntry, build_cameras
from solver_backend.io.calibration.search import find_calibration, levels_above
from solver_backend.io.captures.agreement import bring_to_agreement
from solver_backend.io.detections.named_keypoints import find_own_keypoints
from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import TrialConfig, camera_sources, listed_paths, read_config
from solver_backend.io.footage import VideoHeader, find_footage, read_video_header, with_sizes_of
from solver_backend.io.interpretation import interpret_rate
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.io.recognition.confidence import in_pixels
from solver_backend.io.recognition.person_scale import in_persons_unit
from solver_backend.io.recognition.world_fit import find_people, fit_world
from solver_backend.types import Cameras, Capture, Detections, PersonInViews

DEFAULT_FPS = 60.0  # Frames per second if no file states them, chosen by hand. A problem reports this assumption.
GUESSED_SHARE, GUESSED_SIGMA = 0.9, 0.15
"""Focal length of an unknown phone camera in longer image sides, and its relative standard deviation."""
INSIDE_SHARE = 0.99  # Smallest fraction of confident keypoints inside the image, chosen by hand.
_LANDSCAPES = ((640, 480), (1280, 720), (1920, 1080), (3840, 2160))  # Common image sizes in pixels.
_KIND = (
    "a Pose2Sim trial folder (pose/<camera>_json/*.json with a calibration); "
    "a folder with detections of each camera and a calibration next to them "
    "(OpenPose, AlphaPose, MMPose, OpenPifPaf, Ultralytics, EasyMocap, COCO, DeepLabCut, SLEAP, FreeMoCap, own tables)"
)


def _read(root: Path, options: ReadOptions) -> Capture:
    sources = camera_sources(root)
    if options.camera_path:  # a calibrated pose does not describe the images of a moving camera
        options = replace(options, as_calibrated=True)
    levels = levels_above(root)
    config = read_config(levels)

    @cache
    def read() -> Detections:
        detections = read_detections(
            sources,
            joint_set=options.joint_set,
            configured=config.joint_set,
            trim=options.trim,
            apart=options.sync != SYNC_OFF or options.by_order or bool(options.offset),
            by_order=options.by_order,
            own=find_own_keypoints(levels),
            progress=options.progress,
        )
        _require_different(detections, root)
        return detections

    footage = find_footage(levels[:2], tuple(sources))
    videos = [read_video_header(path) for path in footage]
    guessed = False
    try:
        calibration = find_calibration(
            root,
            tuple(sources),
            unit=options.unit,
            up_axis=options.up_axis,
            names=calibrated_names(options.camera),
            by_views=lambda cameras, by_order: assigned_by_views(cameras, as_numbered(read()), by_order),
            agreement=lambda cameras: agreement_share(cameras, as_numbered(read())),
        )
    except CalibrationMissing:
        if len(sources) > 1:
            raise
        guessed = True
        calibration = _assumed_camera(root, read(), videos[0])
    detections = in_pixels(read(), calibration.cameras.image_size)
    calibration = with_sizes_of(calibration, videos, detections)
    rate, rate_notes, rate_problems = _frame_rate(options.fps, config, videos)
    stated = [None if header is None else header.fps for header in videos]
    agreeing = bring_to_agreement(calibration, detections, rate, stated, options)
    calibration, detections = agreeing.calibration, agreeing.detections
    hidden = (moved or agreeing.turned for moved in agreeing.resampled)
    footage = tuple(None if other else path for path, other in zip(footage, hidden, strict=True))
    kept = options.as_calibrated or options.scale != 1.0
    calibration, to_plausible = in_persons_unit(calibration, detections, keep=kept)
    one = len(sources) == 1

    def select(cameras: Cameras) -> tuple[SelectedPerson, ...]:
        if one:
            return select_in_one_view(detections, rate)
        return select_people(cameras, detections, rate, options.progress)

    cameras, people, scaled = find_people(calibration.cameras, select, options, to_plausible)
    person = people[0]
    asked = replace(options, level=ON) if guessed else options
    world = fit_world(cameras, person.keypoints, asked, options.up_axis, calibration.rolls)
    as_filmed = not (agreeing.first_rows or any(agreeing.resampled))
    several, filmed = len(people) > 1, any(footage)
    changed = (*scaled, *world.found, *world.check.found())
    notes = (calibration.notes, detections.notes, rate_notes, notes_in(agreeing.found), person.notes, notes_in(changed))
    problems = (
        calibration.problems,
        detections.problems,
        rate_problems,
        warnings_in(agreeing.found),
        _length_problems(videos, detections.num_frames) if as_filmed else (),
        report_cuts(take_cuts(detections), detections.num_frames),
        report_order(detections),
        person.problems,
        warnings_in(changed),
        report_lenses(world.cameras, person.keypoints),
    )
    capture = Capture(
        name=root.name,
        cameras=world.cameras,
        keypoints=person.keypoints,
        footage=footage if filmed else (),
        footage_first=agreeing.first_rows if filmed else (),
        sources=(*listed_paths(tuple(sources.values())), str(calibration.source), *config.sources),
        people=tuple(PersonInViews(p.name, p.keypoints) for p in people) if several else (),
        person=person.name if several else "",
        notes=tuple(note for group in notes for note in group),
        problems=tuple(problem for group in problems for problem in group),
        stature_m=options.stature,
        floor_from_person=world.from_person,
        focal_sigma=GUESSED_SIGMA if guessed else 0.0,
        world_checked=True,
    )
    return capture if options.frames is not None else _configured_frames(capture, config)


def _require_different(detections: Detections, root: Path) -> None:
    """Refuse copies of another camera's detections, because two cameras never see exactly the same.

    Raises:
        CaptureInvalid: two cameras have equal detections of at least one person.
    """
    (xy, confidence), names = (detections.xy, detections.confidence), detections.cameras
    for a, b in combinations(range(len(names)), 2):
        same = np.array_equal(confidence[a], confidence[b]) and np.array_equal(xy[a], xy[b], equal_nan=True)
        if same and confidence[a].any():
            what = f"Cameras {names[a]} and {names[b]} have exactly the same detections."
            hint = "Export the detections of both cameras again, or move one of their folders out of the recording."
            raise CaptureInvalid(what, where=str(root), hint=hint)


def _assumed_camera(root: Path, detections: Detections, video: VideoHeader | None) -> Calibration:
    """Return a calibration of one camera with a typical phone lens, and warn about this assumption.

    Without a video, the image size is the smallest common size that contains nearly all confident keypoints. A few
    extrapolated keypoints may be outside the image.

    Raises:
        NoDetections: no person was detected.
    """
    seen = (detections.confidence > 0) & np.isfinite(detections.xy).all(-1)
    if not seen.any():
        raise NoDetections("No person was detected.", where=str(root), hint="Run the detector again.")
    sure = seen & (detections.confidence >= MIN_CONFIDENCE)
    reach = np.quantile(detections.xy[sure if sure.any() else seen], INSIDE_SHARE, axis=0)
    fitting = [s for size in _LANDSCAPES for s in (size, size[::-1]) if (reach < s).all()] or [
        tuple(np.ceil(reach).astype(int).tolist())
    ]
    width, height = fitting[0] if video is None else video.size
    f = GUESSED_SHARE * max(width, height)
    K = np.array([[f, 0.0, 0.5 * (width - 1)], [0.0, f, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
    name = detections.cameras[0]
    entry = CameraEntry(name, K, np.zeros(0), np.eye(3), np.zeros(3), (int(width), int(height)))
    figures: dict[str, Any] = {"size": f, "share": 100 * GUESSED_SIGMA}
    source = f"a guess for images of {width} x {height}, because there is no calibration"
    assumed = diagnostic("focal_length_of_video", severity=Severity.WARNING, cameras=[name], source=source, **figures)
    return Calibration(build_cameras([entry], where=str(root)), root, (True,), problems=(assumed,))


def _configured_frames(capture: Capture, config: TrialConfig) -> Capture:
    if not config.frame_range:
        return capture
    first, stop = max(config.frame_range[0], 0), min(config.frame_range[1], capture.num_frames)
    if (first, stop) == (0, capture.num_frames):
        return capture
    if first >= stop:
        first, last = config.frame_range
        problem = diagnostic("frames_configured", severity=Severity.WARNING, result="lacking", first=first, last=last)
        return replace(capture, problems=(*capture.problems, problem))
    note = diagnostic("frames_configured", result="used", first=first, last=stop - 1, count=capture.num_frames)
    return replace(capture.frames(first, stop), notes=(*capture.notes, note))


def _frame_rate(
    given: float | None, config: TrialConfig, videos: Sequence[VideoHeader | None]
) -> tuple[float, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    stated = [round(header.fps, 3) for header in videos if header is not None]
    rates = [rate for rate in stated if rate > 0]  # a manipulated header may state an hour per frame
    problems: list[Diagnostic] = []
    if len(set(rates)) > 1:
        problems.append(diagnostic("video_rates_differ", rates=[f"{rate:g}" for rate in rates]))
    video = float(np.median(rates)) if rates else None
    known = config.fps if given is None else None
    if known is not None and video is not None and abs(video - known) > 0.02 * known:
        problems.append(diagnostic("frame_rate_contradicts", rate=config.fps, video=video))
    configured = diagnostic("frame_rate_read", source="file", rate=config.fps or 0.0, file=Path(config.rate_file).name)
    of_videos = diagnostic("frame_rate_read", source="videos", rate=video or 0.0)
    rate, notes, assumed = interpret_rate(given, [(config.fps, configured), (video, of_videos)], DEFAULT_FPS)
    return rate, notes, (*problems, *assumed)


def _length_problems(videos: Sequence[VideoHeader | None], frames: int) -> tuple[Diagnostic, ...]:
    lengths = sorted({header.num_frames for header in videos if header is not None})
    if not lengths or lengths == [frames]:
        return ()
    return (diagnostic("video_lengths_differ", lengths=lengths, count=frames),)


_TAKES = frozenset(DEFAULTS) - {"subject_prefix", "frames"}
READER = Reader(_KIND, lambda path: path.is_dir() and bool(camera_sources(path)), _read, _TAKES)
