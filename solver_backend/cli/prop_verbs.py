"""The verb about props: a motion's props as JSON, for other programs."""

from __future__ import annotations

import argparse
import json

from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.progress import Progress

FORMAT, VERSION = "manifold_mocap_props", 1


def export_props(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write the props of a motion as JSON: markers, poses and standard deviations, metres and radians, Z up."""
    overwrite = args.overwrite
    from solver_backend.exchange.motion_file import read_motion

    motion = read_motion(args.motion)
    if not motion.props:
        raise MotionInvalid(
            "The motion has no props.", where=str(args.motion),
            hint="Solve a recording with three or more markers on a thing that moves.",
        )  # fmt: skip
    progress("Writing the props", 0, 1)
    plain = {
        "format": FORMAT, "version": VERSION, "fps": motion.fps, "frames": motion.num_frames, "up": "z", "unit": "m",
        "props": [prop.as_dict() for prop in motion.props],
    }  # fmt: skip
    write_text(args.out, json.dumps(plain), overwrite=overwrite)
    progress("Writing the props", 1, 1)
    names = [prop.name for prop in motion.props]
    data = {"props_file": str(args.out), "frames": motion.num_frames, "fps": motion.fps, "props": names}
    text = f"{motion.num_frames} frames of {', '.join(names)} at {motion.fps:g} fps"
    return Outcome(f"{text}\n  written     {args.out}", data)
