"""Run the verbs for videos: detect keypoints and hands, and solve folders of videos."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from solver_backend.camera_calibration.boards.board import board_named
from solver_backend.cli.arguments import calibration_of, given_settings, given_world
from solver_backend.cli.describe import describe_capture
from solver_backend.cli.outcome import Outcome, rows
from solver_backend.exchange.diagnostics import Diagnostic, summarise
from solver_backend.exchange.errors import CommandLineInvalid, MocapError
from solver_backend.exchange.outputs import require_path, write_text
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.video_settings import MEDIAPIPE
from solver_backend.io.footage import join_chapters
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.io.recognition.range_checks import checked
from solver_backend.job import positive_fps
from solver_backend.types import Capture
from solver_backend.videos.detect import find_hands as hands
from solver_backend.videos.detect.assemble import assembled
from solver_backend.videos.detect.detect_videos import detect_videos
from solver_backend.videos.detect.measure_noise_map import measure_noise_map
from solver_backend.videos.files.video import PICTURES_FPS
from solver_backend.videos.pipeline.calibrate import KnownOfCameras
from solver_backend.videos.pipeline.layout import NoVideos, look_through
from solver_backend.videos.pipeline.pictures import write_previews
from solver_backend.videos.pipeline.plan import PipelineSettings, described, planned
from solver_backend.videos.pipeline.run import run_take
from solver_backend.videos.sync.synchronise import synchronise


def detect(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Detect keypoints in videos, synchronise the cameras, and write a capture."""
    for video in args.videos:
        require_path(video, "video")
    choice = _choice(args)
    if args.hands and "hands" not in choice.options:
        hint = "Omit --hands, and find the hands afterwards with `hands find`."
        raise CommandLineInvalid("This detector does not find hands.", where=str(args.detector), hint=hint)
    footage = _footage(args.videos)
    videos, names = list(footage.values()), list(footage)
    hint = "Give each video the name of its camera (cam01 and cam_1 are the same)."
    calibration = args.calibration and calibration_of(args.calibration, names, "videos", hint)
    folder = args.work or args.out.parent / "detections"
    found = detect_videos(
        videos, choice, folder, progress, jobs=args.jobs, cameras=names, pictures_fps=_pictures_fps(args)
    )
    clocks = synchronise(found, calibration.cameras if calibration else None, args.clocks, progress)
    capture = assembled(args.out.stem, found, clocks, calibration, progress, world=WorldSettings(**given_world(args)))
    write_capture(args.out, checked(capture) if capture.cameras is not None else capture, overwrite=args.overwrite)
    previews = write_previews(found, args.preview, progress, overwrite=args.overwrite) if args.preview else []
    text, data = describe_capture(capture)
    lines = [text, *rows("preview", *previews)]
    return Outcome("\n".join(lines), {"detections": str(folder), "clocks": clocks.as_dict(), **data})


def from_videos(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Detect, synchronise, calibrate and solve all takes in a folder of videos."""
    from solver_backend.videos.detect.detector import HAND_MODEL, chosen_hand_detector, included_model

    found = look_through(args.folder)
    takes = tuple(take for take in found.takes if args.take in (None, take.name))
    if not takes:
        hint = f"The takes are {_names(found.takes)}."
        raise CommandLineInvalid(f"The folder has no take '{args.take}'.", where=str(args.folder), hint=hint)
    out = args.folder / "mocap" if args.folder.is_dir() else args.folder.parent / f"{args.folder.stem}_mocap"
    plans = planned(replace(found, takes=takes), args.out or out)
    cameras = KnownOfCameras(args.board, args.lenses, args.stature, args.cameras, args.focal)
    lines = described(found, plans, str(args.detector_worker or args.detector), args.clocks, args.until, cameras)
    done: dict[str, dict[str, object]] = {}
    if args.board is not None:
        board_named(args.board)
    detector = _choice(args)
    if args.dry_run:
        return Outcome("\n".join(lines), {"plan": lines, "takes": done})
    python = args.hand_python or args.python
    model = args.hand_model
    if model is None and args.hands and args.detector.lower() == MEDIAPIPE and python is None:
        model = included_model(HAND_MODEL)
    hands = None if model is None else chosen_hand_detector(model, python=python)
    settings = PipelineSettings(
        detector=detector, sync=args.clocks, until=args.until, jobs=args.jobs, pictures_fps=_pictures_fps(args),
        redo=tuple(args.redo), overwrite=args.overwrite, solve=SolveSettings.from_dict(given_settings(args)),
        world=WorldSettings(**{k: v for k, v in given_world(args).items() if k != "stature"}),
        cameras=cameras, hands=hands,
    )  # fmt: skip
    failed: dict[str, MocapError] = {}
    found_in: dict[str, tuple[Diagnostic, ...]] = {}
    for plan in plans:
        try:
            record = run_take(found, plan, settings, progress)
        except MocapError as error:
            if len(plans) == 1 or error.code == "cancelled":
                raise
            failed[plan.take.name] = error
            continue
        words, found_in[plan.take.name] = record.lines(), record.diagnostics()
        report: dict[str, Any] = {
            **words, "steps": record.as_list(), "folder": str(plan.folder), "source": str(plan.take.folder),
            "capture_file": str(plan.output("capture")), "motion_file": str(plan.output("solve")), "read": None,
        }  # fmt: skip
        if "capture" in words:
            capture = plan.output("capture")
            report["read"] = {"capture": str(capture), **describe_capture(read_capture(capture))[1]}
        done[plan.take.name] = report
        lines += [f"  done {plan.take.name}", *(f"    {step:<10} {line}" for step, line in words.items())]
    if failed and not done:
        raise next(iter(failed.values()))
    lines += [f"  failed {name}: {error}" for name, error in failed.items()]
    errors = {name: error.as_event() for name, error in failed.items()}
    return Outcome("\n".join(lines), {"plan": lines, "takes": done, "failed": errors}, _summary(found_in, list(failed)))


def _summary(found: dict[str, tuple[Diagnostic, ...]], failed: list[str]) -> tuple[str, ...]:
    """Return one line per warning, and a last line with the takes to check."""
    if len(found) + len(failed) == 1:
        return tuple(line for items in found.values() for line in summarise(items))
    doubtful = {name: summarise(items)[:-1] for name, items in found.items()}
    lines = [f"{name}: {line}" for name, warnings in doubtful.items() for line in warnings]
    names = [*(name for name, warnings in doubtful.items() if warnings), *failed]
    return (*lines, f"Look at {', '.join(names)}." if names else "OK")


def capture_of_folder(folder: Path, out: Path, progress: Progress) -> Capture | None:
    """Create a capture from videos of a single take in a folder. Return None if there are no videos.

    Args:
        out: folder for the detections and the estimated camera delays.
    """
    from solver_backend.videos.detect.detector import chosen_detector

    try:
        found = look_through(folder)
    except NoVideos:
        return None
    _only_take(found.takes, folder)
    [plan] = planned(found, out / "from_videos")
    run_take(found, plan, PipelineSettings(chosen_detector(), until="capture"), progress)
    return read_capture(plan.output("capture"))


def detector_noise(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Measure a detector's standard deviation at each confidence, from captures with known cameras."""
    import json

    from solver_backend.io.load import load_capture

    captures = [load_capture(path, progress=progress) for path in args.captures]
    weighted = [capture.name for capture in captures if capture.noise_map]
    if weighted:
        message = "These confidences were weighted by a noise map, so they cannot be measured."
        hint = "Detect again without --noise, and measure these captures."
        raise CommandLineInvalid(message, where=", ".join(weighted), hint=hint)
    named = (capture.detector for capture in captures if capture.detector)
    name = args.detector_name or next(named, "unnamed detector")
    noise = measure_noise_map(captures, name)
    write_text(args.out, json.dumps(noise.as_dict(), indent=2) + "\n", overwrite=args.overwrite)
    steps = zip(noise.confidence, noise.sigma_mm, strict=True)
    lines = [f"{noise.detector}: {noise.detections} keypoints"]
    lines += [f"  confidence {c:.2f}: {s:.1f} mm" for c, s in steps]
    return Outcome("\n".join(lines), noise.as_dict())


def find_hands(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Detect a person's hands in the footage of a capture."""
    from solver_backend.io.load import load_capture
    from solver_backend.videos.detect.detector import chosen_hand_detector

    choice = chosen_hand_detector(args.model, python=args.python)
    capture = hands.find_hands(load_capture(args.capture, progress=progress), choice, progress)
    write_capture(args.out, capture, overwrite=args.overwrite)
    shares = hands.seen_by(capture, 2)
    lines = [f"  {side:<11} seen by two views in {share:.0f} % of the frames" for side, share in shares.items()]
    return Outcome("\n".join([f"Hands of {capture.name}", *lines]), {"seen_by_two_percent": shares})


def _choice(args: argparse.Namespace) -> Any:
    from solver_backend.videos.detect.detector import chosen_detector

    return chosen_detector(
        args.detector, python=args.python, people=args.people, hands=args.hands, worker=args.detector_worker
    )


def _pictures_fps(args: argparse.Namespace) -> float:
    return PICTURES_FPS if args.fps is None else positive_fps(args.fps)


def _footage(given: list[Path]) -> dict[str, Path]:
    if len(given) > 1 or not given[0].is_dir():
        return {parts[0].stem: parts[0] for parts in join_chapters(given)}

    take = _only_take(look_through(given[0]).takes, given[0])
    return dict(zip(take.cameras, take.videos, strict=True))


def _only_take(takes: Sequence[Any], folder: Path) -> Any:
    if len(takes) > 1:
        hint = f"Choose one: {_names(takes)}."
        raise CommandLineInvalid("The folder contains several takes.", where=str(folder), hint=hint)
    return takes[0]


def _names(takes: Sequence[Any]) -> str:
    return ", ".join(take.name for take in takes)
