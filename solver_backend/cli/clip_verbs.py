"""Run the verbs that cut, loop, mirror, join and retime motions. Each one writes a new file."""

from __future__ import annotations

import argparse
from pathlib import Path

from solver_backend.cli.motion_reading import any_motion
from solver_backend.cli.outcome import Outcome, rows
from solver_backend.exchange import clips, seams
from solver_backend.exchange.errors import CommandLineInvalid, MotionInvalid
from solver_backend.exchange.motion_file import MotionFile, write_motion
from solver_backend.exchange.progress import Progress
from solver_backend.io.native.motion_file import as_file


def trim(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Trim a motion to a frame range."""
    return _write(args, clips.trim(_read(args, args.motion), *args.frames))


def loop(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Find the best cycle in a motion and make it loop."""
    motion = _read(args, args.motion)
    progress("Comparing frames", 0, 1)
    found = seams.find_loop(motion, args.shortest, args.blend, stay=args.in_place)
    progress("Comparing frames", 1, 1)
    text = f"frames {found.first} to {found.last} of the motion, where {found.gap}"
    values = {"first": found.first, "last": found.last, "gap_degrees": found.gap.degrees, "gap_mm": found.gap.mm}
    return _write(args, found.motion, *rows("cycle", text), **values)


def mirror(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Swap left and right in a motion."""
    return _write(args, clips.mirror(_read(args, args.motion)))


def join(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Append a second motion to the first one."""
    first, second = _read(args, args.motion), _read(args, args.second)
    joined, seam = seams.join(first, second, args.blend)
    notes = (row for note in seams.join_notes(first, second) for row in rows("note", note))
    return _write(args, joined, *rows("blended", f"{seam}"), *notes, gap_degrees=seam.degrees, gap_mm=seam.mm)


def retime(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Change the speed of a motion without changing its frame rate."""
    motion = _read(args, args.motion)
    if (args.speed is None) == (args.seconds is None):
        raise CommandLineInvalid("Specify --speed or --seconds.", where=args.verb)
    if args.seconds is not None and motion.num_frames < 2:
        raise MotionInvalid("The motion has only one frame, so its duration cannot change.", where=motion.name)
    length = (motion.num_frames - 1) / motion.fps
    return _write(args, clips.retime(motion, args.speed or length / args.seconds))


def resample(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Change the frame rate of a motion without changing its speed."""
    return _write(args, clips.resample(_read(args, args.motion), args.fps))


def in_place(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Remove a motion's travel along the ground."""
    return _write(args, clips.in_place(_read(args, args.motion)))


def root_motion(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Add a root bone that follows a motion's travel along the ground."""
    return _write(args, clips.root_motion(_read(args, args.motion)))


def _read(args: argparse.Namespace, path: Path) -> MotionFile:
    return as_file(any_motion(path, args.body), path.stem)


def _write(args: argparse.Namespace, motion: MotionFile, *lines: str, **values: float) -> Outcome:
    write_motion(args.out, motion, overwrite=args.overwrite)
    title = f"{args.verb}: {motion.num_frames} frames at {motion.fps:g} Hz, {motion.num_frames / motion.fps:.2f} s"
    data = {"frames": motion.num_frames, "fps": motion.fps, **values}
    return Outcome("\n".join([title, *lines]), {key: round(float(value), 3) for key, value in data.items()})
