"""Open the source of a live run: points, a motion, another program, or a face from a phone."""

from __future__ import annotations

import argparse
import gc
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.cli.arguments import loaded
from solver_backend.cli.motion_reading import any_motion, read_foreign_motion
from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.errors import CommandLineInvalid, NoDetections
from solver_backend.exchange.events import LiveLine, event_line
from solver_backend.exchange.motion_file import is_motion
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.vmc.sender import FACES, IFACIALMOCAP, PORTS, is_address, read_address
from solver_backend.io.native.motion_file import read_subject
from solver_backend.live.face_source import FaceAssembly, ask_phone, face_lines
from solver_backend.live.frames import LATE_S, KeepUp, from_lines, read_ahead, replayed
from solver_backend.live.port import listen
from solver_backend.live.recordings import FaceRecording, PointsRecording, PosesRecording, Recorder, record_points
from solver_backend.live.sending import Proportions, replayed_poses, rest_joints
from solver_backend.live.session import LiveSession, person_fit, with_display
from solver_backend.live.vmc_source import BonesOnBody, FrameAssembly, pose_lines

FOREIGN_CLIPS = (".bvh", ".mvnx")
"""Suffixes of motions with other skeletons. Our body is fitted to them before they are replayed."""


@dataclass(frozen=True)
class LiveSource:
    """Source of a live run: output lines, body proportions, recorders and final statistics."""

    lines: Iterator[LiveLine]
    proportions: Proportions
    recorder: Recorder[...] | None = None
    summary: Callable[[], dict[str, object]] = field(default=dict)  # Returns plain values about the source at its end.
    others: tuple[Recorder[...], ...] = ()  # Recorders of additional data.


def open_source(args: argparse.Namespace, progress: Progress) -> LiveSource:
    """Open the source of a live run that the command line selects."""
    if is_address(args.source):
        if args.repeat or args.fast:
            raise CommandLineInvalid("--fast and --repeat need a file, but the source is another program. Omit them.")
        return _face(args) if read_address(args.source, tuple(PORTS)).scheme in FACES else _poses(args)
    if args.source == "-" and args.repeat:
        raise CommandLineInvalid("--repeat needs a file, but the source is standard input. Omit it.", where="--repeat")
    if args.source != "-" and (Path(args.source).suffix.lower() in FOREIGN_CLIPS or is_motion(Path(args.source))):
        return _motion(args, progress)
    return _points(args, progress)


def _motion(args: argparse.Namespace, progress: Progress) -> LiveSource:
    _refuse(args, "points", "a motion", "record", "subject")
    path = Path(args.source)
    if path.suffix.lower() in FOREIGN_CLIPS:
        brought = read_foreign_motion(path, "neutral", progress)
        motion = brought.done.motion
        for item in brought.diagnostics:
            print(f"{item.severity}: {sentence(item)}", file=sys.stderr)
    else:
        motion = any_motion(path, "neutral")
    rest = rest_joints(motion)
    lines = replayed_poses(motion, paced=not args.fast, repeat=args.repeat)
    return LiveSource(lines, lambda: (motion.body_layout, rest))


def _refuse(args: argparse.Namespace, of: str, source: str, *names: str) -> None:
    for name in names:
        if getattr(args, name) is not None:
            raise CommandLineInvalid(f"--{name} works with {of}, but {args.source} is {source}.", where=f"--{name}")


def _refuse_ending(path: Path | None, what: str, ending: str) -> None:
    if path is not None and path.suffix.lower() != ending:
        hint = f"Specify a file name that ends in {ending}."
        raise CommandLineInvalid(f"{what}.", where=str(path), hint=hint)


def _poses(args: argparse.Namespace) -> LiveSource:
    _refuse_ending(args.record, "Poses can only be recorded as a motion", ".npz")
    address, assembly = read_address(args.source), FrameAssembly()
    onto = BonesOnBody(load_body(), None if args.subject is None else read_subject(args.subject).betas)
    recorder = face = None
    if args.record is not None:
        form = PosesRecording(args.source, onto.person)
        recorder = Recorder(args.record, form, overwrite=args.overwrite)
        face_path = args.record.with_name(f"{args.record.stem}_face.csv")
        face = Recorder(face_path, FaceRecording(), overwrite=args.overwrite)
    lines, others = pose_lines(listen(address, assembly), onto, recorder, face), () if face is None else (face,)
    return LiveSource(lines, onto.proportions, recorder, lambda: {"not_used": dict(assembly.counts)}, others)


def _face(args: argparse.Namespace) -> LiveSource:
    _refuse(args, "poses", "a face", "send", "subject")
    _refuse_ending(args.record, "A face can only be recorded as a table", ".csv")
    address = read_address(args.source, FACES)
    assembly, body = FaceAssembly(address.scheme), load_body()
    recorder = None if args.record is None else Recorder(args.record, FaceRecording(), overwrite=args.overwrite)
    if address.scheme == IFACIALMOCAP and not address.is_local and address.host not in ("0.0.0.0", "::"):
        asked = ask_phone(address.host, address.port)
        heard = listen(replace(address, host="0.0.0.0"), assembly, asked)
    else:
        heard = listen(address, assembly)
    lines, rest = face_lines(heard, recorder), body.rest_joints(np.zeros(10))
    return LiveSource(lines, lambda: (body.layout, rest), recorder, lambda: {"not_used": dict(assembly.counts)})


def _points(args: argparse.Namespace, progress: Progress) -> LiveSource:
    network, fit = person_fit(args.subject)
    if args.source == "-":
        session, fps = LiveSession(network, fit, unit=args.unit, up_axis=args.up_axis), args.fps
        # Use a separate descriptor, so that a pending read does not keep the process from ending.
        frames = from_lines(os.fdopen(os.dup(sys.stdin.fileno()), "rb"), args.fps or 120.0)
        frames = frames if args.fast else read_ahead(frames)
    else:
        args.capture = Path(args.source)
        capture = loaded(args, progress)
        if capture.markers is None:
            hint = "Choose a C3D, TRC or motion file."
            raise NoDetections("The capture has no markers to play.", where=capture.name, hint=hint)
        cloud = capture.markers
        session, fps = LiveSession(network, fit, unit="m", up_axis="z"), cloud.fps
        frames = replayed(cloud, paced=not args.fast, repeat=args.repeat)
    recorder, keep_up = None, KeepUp()
    if args.record is not None:
        form = PointsRecording(fps, lambda: session.to_metres)
        recorder = Recorder(args.record, form, overwrite=args.overwrite)
        frames = record_points(frames, recorder)
    make_ready(session)
    lines = session.run(frames if args.fast else keep_up.in_time(frames))
    lines = _with_points(session, lines, keep_up, shown=args.with_points)
    return LiveSource(lines, session.proportions, recorder, lambda: {"dropped": keep_up.dropped})


def _with_points(session: LiveSession, lines: Iterator[Any], keep_up: Any, *, shown: bool) -> Iterator[LiveLine]:
    """Add the number of dropped frames to each frame's line, and also the displayed points if ``shown``.

    When the first frame is dropped, also yield an event.
    """
    named = False
    for line in lines:
        if "frame" not in line:
            yield line
            continue
        if keep_up.dropped and not named:
            named = True
            message = f"The poses are {1e3 * LATE_S:.0f} ms late. Frames are dropped until they catch up."
            yield event_line("frames_dropped", message, line["t"])
        line["dropped"] = keep_up.dropped
        yield with_display(line, session) if shown else line


def make_ready(session: LiveSession) -> None:
    """Warm up the solver and avoid pauses for garbage collection, so that the first live frames are not delayed."""
    session.warm_up()
    settle_memory()


def settle_memory() -> None:
    """Exempt all existing objects from garbage collection, because checking them would delay live frames."""
    gc.collect()
    gc.freeze()
