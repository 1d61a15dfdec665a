"""The verb that brings motions of other programs onto our body."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from solver_backend.cli.outcome import Outcome, found_data, found_lines
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.rigs.rest_frames import bent_at_rest

if TYPE_CHECKING:
    from solver_backend.fitters.motion_import.import_motion import ImportedMotion

_FAR_MM = 20.0
"""Distance of a joint from its source, the mean over the frames, from which it is noted."""
_RAISED_M = 0.02
"""Metres by which a motion is put on its floor that are noted."""
_STRANGE = 5.0
"""Standard deviations of a shape that hardly a person has."""
_LOOSE = ("_toe", "head")
"""Joints that are not fitted by place."""


def motion_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of motion."""
    verb.add_argument("clip", type=Path, metavar="CLIP", help="motion of any skeleton (BVH, MVNX, C3D segments, AMASS)")
    verb.add_argument("--out", type=Path, required=True, metavar="MOTION.npz", help="motion file to write")
    verb.add_argument("--unit", default="", help="length unit of the clip; estimated from the legs if left out")
    verb.add_argument(
        "--up-axis", default="", metavar="AXIS", help="axis that points up in the clip; detected if left out"
    )
    verb.add_argument("--keep-height", action="store_true", help="do not put the lowest soles on the floor")
    verb.add_argument("--body", default="neutral", metavar="NAME|PATH", help="whose body, see bodies")


def motion(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a foreign skeleton's motion as a motion of our body, with the shape of its bones."""
    overwrite = bool(args.overwrite)
    check_output(args.out, overwrite=overwrite)
    from solver_backend.body.files.choices import load_chosen_body
    from solver_backend.io.motions.amass import is_amass
    from solver_backend.io.native.motion_file import write_motion

    if is_amass(args.clip):
        return _amass(args, progress)
    from solver_backend.fitters.motion_import.import_motion import import_motion
    from solver_backend.io.motions.foreign_skeleton import read_foreign_clip

    progress("reading the clip", 0, 1)
    source, roles, found = read_foreign_clip(args.clip, args.unit, args.up_axis)
    progress("fitting the body", 0, 1)
    done = import_motion(source, roles, load_chosen_body(args.body), keep_height=bool(args.keep_height))
    progress("fitting the body", 1, 1)
    index = {name: j for j, name in enumerate(source.names)}
    bent = bent_at_rest({role: source.rest[index[name]] for role, name in roles.items()})
    found = [*found, *([bent] if bent else []), *_found_in(done)]
    write_motion(args.out, done.motion, overwrite=overwrite, name=source.name)
    placed = [off for role, off in done.distances_mm.items() if not role.endswith(_LOOSE)]
    rms = float(np.sqrt(np.mean(np.square(placed))))
    lines = [
        f"Motion {source.name}: {source.num_frames} frames at {source.fps:g} Hz",
        f"  joints      {len(roles)} of {len(source.names)} have a role",
        f"  distance    {rms:.1f} mm from the skeleton's limbs (root mean square)",
        *found_lines(found),
        f"  written     {args.out}",
    ]
    data = {
        "motion": str(args.out), "frames": source.num_frames, "fps": source.fps, "roles": roles, **found_data(found),
        "distance_mm": rms, "distances_mm": {role: round(off, 2) for role, off in done.distances_mm.items()},
    }  # fmt: skip
    return Outcome("\n".join(lines), data)


def _amass(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write AMASS' poses as a motion of our body, of mean shape: its shape coefficients are those of other bodies."""
    from solver_backend.cli.motion_reading import any_motion
    from solver_backend.io.native.motion_file import write_motion

    progress("reading the clip", 0, 1)
    clip = any_motion(args.clip, args.body, keep_shape=False)
    write_motion(args.out, clip, overwrite=bool(args.overwrite), name=args.clip.stem)
    found = [diagnostic("motion_mean_shape"), *([diagnostic("motion_one_frame")] if clip.num_frames == 1 else [])]
    lines = [
        f"Motion {args.clip.stem}: {clip.num_frames} frames at {clip.fps:g} Hz (AMASS)",
        *found_lines(found), f"  written     {args.out}",
    ]  # fmt: skip
    return Outcome("\n".join(lines), {
        "motion": str(args.out), "frames": clip.num_frames, "fps": clip.fps, **found_data(found),
    })  # fmt: skip


def _found_in(done: ImportedMotion) -> list[Diagnostic]:
    found = []
    if done.motion.num_frames == 1:
        found.append(diagnostic("motion_one_frame"))
    if abs(done.raised_m) > _RAISED_M:
        way = "Raised" if done.raised_m > 0 else "Lowered"
        found.append(diagnostic("motion_on_floor", way=way, size=abs(done.raised_m)))
    far = {r: off for r, off in done.distances_mm.items() if off > _FAR_MM and not r.endswith(_LOOSE)}
    if far:
        off = [f"{role.replace('_', ' ')} {size:.0f} mm" for role, size in far.items()]
        found.append(diagnostic("motion_joints_elsewhere", joints=list(far), off=off))
    if (size := np.abs(done.motion.betas).max()) > _STRANGE:
        found.append(diagnostic("motion_lengths_strange", size=size))
    return found
