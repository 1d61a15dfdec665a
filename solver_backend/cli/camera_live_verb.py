"""Run the verb ``live cameras``: estimate poses from live cameras, and write one line per pose."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from solver_backend.cli.arguments import calibration_of, given_world
from solver_backend.cli.live_sources import settle_memory
from solver_backend.cli.live_verb import LiveOutput, live_text
from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.command import cancelling_until_held
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.events import LiveLine
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.exchange.vmc.sender import SENT, read_address
from solver_backend.io.native.motion_file import read_subject
from solver_backend.live.recordings import Recorder
from solver_backend.live.session import with_display
from solver_backend.live.views_session import ViewsSession
from solver_backend.sensors.devices.oak import OakColour, OakPictures
from solver_backend.videos.detect.assemble import FilmedSize, in_video_pixels
from solver_backend.videos.detect.detector import DetectorProcess, chosen_detector, joint_set_of
from solver_backend.videos.streaming.moments import LiveMoments, PictureSource, ReplayedVideo, Webcam
from solver_backend.videos.streaming.recording import ViewsRecording, motion_of, run_recorded

MOST_CAMERAS = 4  # More cameras take time without improving a single person's pose. Chosen by hand.
_SWITCH_S = 5e-4  # Seconds after which a Python thread yields to other threads. Chosen by hand.


def camera_live(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Estimate poses from live cameras until the cameras stop, the time is up or a signal arrives."""
    if not 2 <= len(args.sources) <= MOST_CAMERAS:
        message = f"Live poses need 2 to {MOST_CAMERAS} cameras, not {len(args.sources)}."
        raise CommandLineInvalid(message, hint="Specify a video, webcam:NUMBER or oak:ID for each camera.")
    if args.send is not None:
        read_address(args.send, SENT)
    sources = picture_sources(args.sources, repeat=args.repeat)
    names, hint = [source.name for source in sources], "Write NAME=SOURCE with the calibration's names."
    calibration = calibration_of(args.calibration, names, "cameras", hint)
    choice = chosen_detector(args.detector, python=args.python, people=args.people, worker=args.detector_worker)
    betas = None if args.subject is None else read_subject(args.subject).betas
    recorder = None
    with ExitStack() as stack:
        hold = stack.enter_context(cancelling_until_held())
        live = stack.enter_context(LiveMoments(sources, lambda: DetectorProcess(choice), args.rate))
        sizes = [FilmedSize(Path(source.name), source.size) for source in sources]
        cameras, _ = in_video_pixels(calibration, sizes)
        world = WorldSettings(**given_world(args))
        session = ViewsSession(cameras, joint_set_of(live.about), betas, world, args.up_axis)
        session.warm_up()
        settle_memory()
        # Threads that pass images to detectors wait this long six times while a fit computes. Python's default is 5 ms.
        stack.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(_SWITCH_S)
        if args.record is not None:
            check_output(motion_of(args.record), overwrite=args.overwrite)
            form = ViewsRecording(session, live.about["name"])
            recorder = Recorder(args.record, form, overwrite=args.overwrite)
        output = stack.enter_context(LiveOutput(args, session.proportions, recorder))
        output.run(_lines(live, session, recorder, args), hold)
    assert output.statistics is not None
    counts = {"dropped": live.counts.dropped, "views_left_out": live.counts.views_left_out}
    data = {**output.statistics.summary(), **counts, "detector": live.about["name"], **output.finish()}
    live.require_views()
    return Outcome(live_text(args, data), data)


def picture_sources(texts: list[str], *, repeat: bool) -> list[PictureSource]:
    """Parse camera arguments ``[NAME=]SOURCE`` as webcams, OAK cameras or videos, without opening them."""
    found: list[PictureSource] = []
    for number, text in enumerate(texts):
        name, _, source = text.rpartition("=") if not Path(text).exists() else ("", "", text)
        kind, _, rest = source.partition(":")
        if kind == "webcam":
            if not rest.isdecimal():
                raise CommandLineInvalid("A webcam needs its number.", where=text, hint="Write, for example, webcam:0.")
            found.append(Webcam(name or f"webcam{rest}", int(rest)))
        elif kind == "oak":
            role = "none" if number else "master"
            found.append(OakPictures(OakColour(name or rest, rest, (1280, 720), 30.0, role=role)))
        else:
            found.append(ReplayedVideo(name or Path(source).stem, Path(source), repeat=repeat))
    names = [source.name for source in found]
    if len(set(names)) < len(names):
        raise CommandLineInvalid("Two cameras have the same name.", where=", ".join(names), hint="Write NAME=SOURCE.")
    return found


def _lines(
    live: LiveMoments, session: ViewsSession, recorder: Recorder[...] | None, args: argparse.Namespace
) -> Iterator[LiveLine]:
    """Yield the output lines of live cameras until the time is up. Record each frame before yielding its line."""
    for moment in live.moments():
        for line in [moment] if isinstance(moment, dict) else run_recorded(session, moment, recorder):
            if "event" not in line:
                line["dropped"], line["views_left_out"] = live.counts.dropped, live.counts.views_left_out
                if args.with_points:
                    line = with_display(line, session)
            yield line
        if args.seconds is not None and not isinstance(moment, dict) and moment.time >= args.seconds:
            return
