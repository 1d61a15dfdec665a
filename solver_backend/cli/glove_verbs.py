"""The verb that adds the hands of gloves to a motion."""

from __future__ import annotations

import argparse
from dataclasses import replace

from solver_backend.cli.outcome import Outcome, found_data, found_lines
from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.verb_results import GlovesOfMotion, GlovesResult


def add_hands(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a motion with the fingers of glove recordings, brought to its time."""
    from solver_backend.body.files.choices import load_chosen_body
    from solver_backend.cli.motion_reading import any_motion
    from solver_backend.fitters.motion_import.merge_gloves import merge_gloves
    from solver_backend.io.motions.gloves import read_gloves
    from solver_backend.io.native.motion_file import write_motion

    motion, body = any_motion(args.motion, args.body), load_chosen_body(args.body)
    found: list[Diagnostic] = []
    lines = [f"Motion {args.motion.stem}: {motion.num_frames} frames at {motion.fps:g} Hz"]
    files: list[GlovesOfMotion] = []
    for number, path in enumerate(args.gloves):
        progress("adding hands", number, len(args.gloves))
        gloves = read_gloves(path, args.side)
        done = merge_gloves(motion, body, gloves, args.offset)
        motion, found = done.motion, [*found, *done.found]
        sides = [("left", "right")[side] for side in gloves.sides]
        lines.append(f"  gloves      {path.name}: {' and '.join(sides)} hand, from {done.offset_s:+.2f} s")
        files.append({"file": str(path), "sides": sides, "offset_s": round(done.offset_s, 4)})
    progress("adding hands", len(args.gloves), len(args.gloves))
    motion = replace(motion, provenance={**motion.provenance, "gloves": files})
    write_motion(args.out, motion, overwrite=args.overwrite)
    lines += [*found_lines(found), f"  written     {args.out}"]
    result: GlovesResult = {
        "motion": str(args.out), "frames": motion.num_frames, "fps": motion.fps, "gloves": files, **found_data(found),
    }  # fmt: skip
    return Outcome("\n".join(lines), result)
