"""Run the verbs that create motions from clips, gloves, Pose-NDF and props."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.files.choices import load_chosen_body
from solver_backend.cli.arguments import load
from solver_backend.cli.motion_reading import any_motion, read_foreign_motion
from solver_backend.cli.outcome import Outcome, found_data, found_lines, rows
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import CommandLineInvalid, MotionInvalid
from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.motion_import.merge_gloves import merge_gloves
from solver_backend.fitters.motion_import.network_motion import network_motion
from solver_backend.fitters.pose_ndf import edit_motion
from solver_backend.fitters.pose_ndf.complete import CompleteSettings, DenoiseSettings, KeypointSettings, missing_joints
from solver_backend.io.motions.acclaim import SUFFIXES as RATELESS
from solver_backend.io.motions.amass import is_amass
from solver_backend.io.motions.gloves import read_gloves
from solver_backend.io.motions.network_results import is_network_result, read_network_result
from solver_backend.io.native.motion_file import write_motion
from solver_backend.priors.pose_ndf import load_pose_ndf
from solver_backend.types import Motion

PROPS_FORMAT, PROPS_VERSION = "manifold_mocap_props", 1


def motion(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Convert a motion of another skeleton to our body, and fit the body's shape to the skeleton."""
    of_skeletons = {"--unit": args.unit, "--up-axis": args.up_axis, "--keep-height": args.keep_height}
    if is_network_result(args.clip):
        _refuse_unused(args.clip, of_skeletons)
        return _network(args, progress)
    if is_amass(args.clip):
        _refuse_unused(args.clip, {**of_skeletons, "--person": args.person})
        return _amass(args, progress)
    _refuse_unused(args.clip, {"--person": args.person})
    if args.fps is not None and args.clip.suffix.lower() not in RATELESS:
        raise MotionInvalid("The clip states its frame rate.", where=str(args.clip), hint="Omit --fps.")
    brought = read_foreign_motion(
        args.clip,
        args.body,
        progress,
        unit=args.unit,
        up_axis=args.up_axis,
        keep_height=args.keep_height,
        fps=args.fps,
    )
    source, found = brought.source, brought.diagnostics
    write_motion(args.out, brought.done.motion, overwrite=args.overwrite, name=source.name)
    lines = [
        f"Motion {source.name}: {source.num_frames} frames at {source.fps:g} Hz",
        *rows("joints", f"{len(brought.roles)} of {len(source.names)} are mapped to the body"),
        *rows("distance", f"{brought.limbs_mm:.1f} mm from the skeleton's limbs (root mean square)"),
        *found_lines(found),
    ]
    distances = {role: round(off, 2) for role, off in brought.done.distances_mm.items()}
    data = {"roles": brought.roles, "distance_mm": brought.limbs_mm, "distances_mm": distances}
    return Outcome("\n".join(lines), {"frames": source.num_frames, "fps": source.fps, **data, **found_data(found)})


def _refuse_unused(clip: Path, options: dict[str, object]) -> None:
    """Raise ``CommandLineInvalid`` for the first given option that does not apply to this clip format."""
    for name, value in options.items():
        if value:
            raise CommandLineInvalid(
                f"{name} does not apply to clips of this format.", where=str(clip), hint=f"Omit {name}."
            )


def _amass(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Apply AMASS poses to our mean shape, because AMASS shape coefficients are for another body."""
    progress("reading the clip", 0, 1)
    clip = any_motion(args.clip, args.body, keep_shape=False, fps=args.fps)
    write_motion(args.out, clip, overwrite=args.overwrite, name=args.clip.stem)
    found = [diagnostic("other_body_read", result="motion")]
    if clip.num_frames == 1:
        found.append(diagnostic("single_frame", severity=Severity.NOTE))
    title = f"Motion {args.clip.stem}: {clip.num_frames} frames at {clip.fps:g} Hz (AMASS)"
    data = {"frames": clip.num_frames, "fps": clip.fps, **found_data(found)}
    return Outcome("\n".join([title, *found_lines(found)]), data)


def _network(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Convert one person in a network result to a motion of our body."""
    people = read_network_result(args.clip)
    settings = SolveSettings(body=args.body)
    made, found = network_motion(
        people, load_chosen_body(args.body), person=args.person, fps=args.fps, settings=settings, progress=progress
    )
    write_motion(args.out, made, overwrite=args.overwrite, name=args.clip.stem)
    program = made.provenance["source"]
    title = f"Motion {args.clip.stem}: {made.num_frames} frames at {made.fps:g} Hz ({program})"
    data = {"frames": made.num_frames, "fps": made.fps, "program": program, **found_data(found)}
    return Outcome("\n".join([title, *found_lines(found)]), data)


def add_hands(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Synchronise glove recordings with a motion, and add the fingers."""
    motion, body = any_motion(args.motion, args.body), load_chosen_body(args.body)
    found: list[Diagnostic] = []
    lines = [f"Motion {args.motion.stem}: {motion.num_frames} frames at {motion.fps:g} Hz"]
    files: list[dict[str, Any]] = []
    for number, path in enumerate(args.gloves):
        progress("adding hands", number, len(args.gloves))
        gloves = read_gloves(path, args.side)
        done = merge_gloves(motion, body, gloves, args.offset)
        motion, found = done.motion, [*found, *done.found]
        sides = [("left", "right")[side] for side in gloves.sides]
        lines += rows("gloves", f"{path.name}: {' and '.join(sides)} hand, from {done.offset_s:+.2f} s")
        files.append({"file": str(path), "sides": sides, "offset_s": round(done.offset_s, 4)})
    progress("adding hands", len(args.gloves), len(args.gloves))
    motion = replace(motion, provenance={**motion.provenance, "gloves": files})
    write_motion(args.out, motion, overwrite=args.overwrite)
    data = {"frames": motion.num_frames, "fps": motion.fps, "gloves": files, **found_data(found)}
    return Outcome("\n".join([*lines, *found_lines(found)]), data)


def denoise(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Smooth a motion and make its poses plausible with Pose-NDF."""
    settings = DenoiseSettings(move_root=not args.keep_root)
    given = {name: value for name in ("smoothness", "manifold") if (value := getattr(args, name)) is not None}
    settings = replace(settings, weights=replace(settings.weights, **given))
    return _by_pose_ndf(
        args, lambda body, prior: edit_motion.denoised_motion(_read(args), body, prior, settings, progress)
    )


def complete(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Estimate a motion's unknown joint rotations with Pose-NDF."""
    missing, settings = tuple(args.missing), CompleteSettings(seed=args.seed)
    missing_joints(missing)
    return _by_pose_ndf(
        args, lambda body, prior: edit_motion.completed_motion(_read(args), body, prior, missing, settings, progress)
    )


def fit_keypoints(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Refit a motion to a capture's keypoints with Pose-NDF (Tiwari et al. 2022, eqs. 10 and 11)."""
    capture = load(args.capture, {}, progress)
    settings = KeypointSettings(args.manifold, not args.constant, robust_scale=20.0, iterations=30)
    return _by_pose_ndf(
        args, lambda body, prior: edit_motion.fitted_motion(capture, _read(args), body, prior, args.noise_px, settings)
    )


def sample(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Draw random plausible poses with Pose-NDF."""
    progress("Sampling", 0, args.count)
    outcome = _by_pose_ndf(args, lambda body, prior: edit_motion.sampled_motion(body, prior, args.count, args.seed))
    progress("Sampling", args.count, args.count)
    return outcome


def interpolate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Generate the transition between two frames of a motion with Pose-NDF."""
    first, last = args.frames
    return _by_pose_ndf(
        args,
        lambda body, prior: edit_motion.interpolated_motion(
            _read(args), body, prior, first, last, args.count, progress
        ),
    )


def _read(args: argparse.Namespace) -> Motion:
    from solver_backend.io.native.motion_file import read_motion

    return read_motion(args.motion)


def _by_pose_ndf(args: argparse.Namespace, work: Callable[[Any, Any], Motion]) -> Outcome:
    body, prior = load_body(), load_pose_ndf() if args.prior is None else load_pose_ndf(args.prior)
    motion = work(body, prior)
    write_motion(args.out, motion, overwrite=args.overwrite)
    energy = np.sort(prior.energy(edit_motion.frames_of(motion, body).local))
    distance = round(float(energy[len(energy) // 2]), 4)
    data = {"frames": motion.num_frames, "fps": motion.fps, "distance_median_rad": distance}
    text = f"{args.verb}: {motion.num_frames} frames, median distance to plausible poses {distance}"
    return Outcome(text, data)


def export_props(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a motion's props as JSON, in metres with Z up: markers, poses and standard deviations."""
    from solver_backend.exchange.motion_file import read_motion

    motion = read_motion(args.motion)
    if not motion.props:
        hint = "Solve a recording with three or more markers on a moving object."
        raise MotionInvalid("The motion has no props.", where=str(args.motion), hint=hint)
    progress("Writing the props", 0, 1)
    length = {"fps": motion.fps, "frames": motion.num_frames}
    plain: dict[str, Any] = {"format": PROPS_FORMAT, "version": PROPS_VERSION, **length, "up": "z", "unit": "m"}
    plain["props"] = [prop.as_dict() for prop in motion.props]
    write_text(args.out, json.dumps(plain), overwrite=args.overwrite)
    progress("Writing the props", 1, 1)
    names = [prop.name for prop in motion.props]
    text = f"{motion.num_frames} frames of {', '.join(names)} at {motion.fps:g} fps"
    return Outcome(text, {**length, "props": names})
