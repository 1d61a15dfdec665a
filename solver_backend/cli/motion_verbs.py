"""The verb that brings motions of other programs onto our body."""

from __future__ import annotations

import argparse

from solver_backend.cli.outcome import Outcome, found_data, found_lines
from solver_backend.exchange.diagnostics import Severity, diagnostic
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.verb_results import ClipResult


def motion(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a foreign skeleton's motion as a motion of our body, with the shape of its bones."""
    overwrite = args.overwrite
    from solver_backend.io.motions.amass import is_amass
    from solver_backend.io.native.motion_file import write_motion

    if is_amass(args.clip):
        return _amass(args, progress)
    from solver_backend.cli.foreign_motion import read_foreign_motion

    brought = read_foreign_motion(
        args.clip, args.body, progress, unit=args.unit, up_axis=args.up_axis, keep_height=args.keep_height
    )  # fmt: skip
    source, roles, found = brought.source, brought.roles, brought.diagnostics
    write_motion(args.out, brought.done.motion, overwrite=overwrite, name=source.name)
    lines = [
        f"Motion {source.name}: {source.num_frames} frames at {source.fps:g} Hz",
        f"  joints      {len(roles)} of {len(source.names)} have a role",
        f"  distance    {brought.limbs_mm:.1f} mm from the skeleton's limbs (root mean square)",
        *found_lines(found),
        f"  written     {args.out}",
    ]
    data = {
        "motion": str(args.out), "frames": source.num_frames, "fps": source.fps, "roles": roles, **found_data(found),
        "distance_mm": brought.limbs_mm,
        "distances_mm": {role: round(off, 2) for role, off in brought.done.distances_mm.items()},
    }  # fmt: skip
    return Outcome("\n".join(lines), data)


def _amass(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write AMASS' poses as a motion of our body, of mean shape: its shape coefficients are those of other bodies."""
    from solver_backend.cli.motion_reading import any_motion
    from solver_backend.io.native.motion_file import write_motion

    progress("reading the clip", 0, 1)
    clip = any_motion(args.clip, args.body, keep_shape=False)
    write_motion(args.out, clip, overwrite=args.overwrite, name=args.clip.stem)
    found = [
        diagnostic("motion_mean_shape"),
        *([diagnostic("single_frame", severity=Severity.NOTE)] if clip.num_frames == 1 else []),
    ]
    lines = [
        f"Motion {args.clip.stem}: {clip.num_frames} frames at {clip.fps:g} Hz (AMASS)",
        *found_lines(found), f"  written     {args.out}",
    ]  # fmt: skip
    result: ClipResult = {"motion": str(args.out), "frames": clip.num_frames, "fps": clip.fps, **found_data(found)}
    return Outcome("\n".join(lines), result)
