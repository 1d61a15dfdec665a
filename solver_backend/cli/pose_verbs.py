"""The verbs that use Pose-NDF: denoise, complete, sample, interpolate, fit-keypoints; motion files in and out."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from solver_backend.cli.outcome import Outcome
from solver_backend.cli.reading import load
from solver_backend.exchange.progress import Progress
from solver_backend.types import Motion


def denoise(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Make a motion smooth and its poses plausible."""
    from solver_backend.fitters.pose_ndf.complete import DenoiseSettings
    from solver_backend.fitters.pose_ndf.edit_motion import denoised_motion

    settings = DenoiseSettings(move_root=not args.keep_root)
    given = {name: value for name in ("smoothness", "manifold") if (value := getattr(args, name)) is not None}
    settings = replace(settings, weights=replace(settings.weights, **given))
    return _made(args, lambda body, prior: denoised_motion(_read(args), body, prior, settings, progress))


def complete(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Find the rotations of joints that are not known."""
    from solver_backend.fitters.pose_ndf.complete import CompleteSettings, missing_joints
    from solver_backend.fitters.pose_ndf.edit_motion import completed_motion

    missing, settings = tuple(args.missing), CompleteSettings(seed=args.seed)
    missing_joints(missing)
    return _made(args, lambda body, prior: completed_motion(_read(args), body, prior, missing, settings, progress))


def fit_keypoints(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Fit poses and one shape to the keypoints of calibrated views (Tiwari et al. 2022, eqs. 10 and 11)."""
    from solver_backend.fitters.pose_ndf.edit_motion import fitted_motion
    from solver_backend.fitters.pose_ndf.fit_keypoints import KeypointSettings

    capture = load(args.capture, {}, progress)
    settings = KeypointSettings(args.manifold, not args.constant, robust_scale=20.0, iterations=30)
    return _made(args, lambda body, prior: fitted_motion(capture, _read(args), body, prior, args.noise_px, settings))


def sample(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write plausible poses drawn at random."""
    from solver_backend.fitters.pose_ndf.edit_motion import sampled_motion

    def work(body: Any, prior: Any) -> Motion:
        progress("Sampling", 0, args.count)
        motion = sampled_motion(body, prior, args.count, args.seed)
        progress("Sampling", args.count, args.count)
        return motion

    return _made(args, work)


def interpolate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Fill the transition between two frames with plausible poses."""
    from solver_backend.fitters.pose_ndf.edit_motion import interpolated_motion

    first, last = args.frames
    return _made(
        args, lambda body, prior: interpolated_motion(_read(args), body, prior, first, last, args.count, progress)
    )


def _read(args: argparse.Namespace) -> Motion:
    from solver_backend.io.native.motion_file import read_motion

    return read_motion(args.motion)


def _made(args: argparse.Namespace, work: Callable[[Any, Any], Motion]) -> Outcome:
    """Check the output, do the work and write its motion."""
    overwrite = args.overwrite
    from solver_backend.body.body import load_body
    from solver_backend.io.native.motion_file import write_motion
    from solver_backend.priors.pose_ndf.pose_ndf import load_pose_ndf

    body, prior = load_body(), load_pose_ndf() if args.prior is None else load_pose_ndf(args.prior)
    motion = work(body, prior)
    write_motion(args.out, motion, overwrite=overwrite)
    distance = prior.energy(_local(motion, body))
    data = {
        "motion": str(args.out),
        "frames": motion.num_frames,
        "fps": motion.fps,
        "distance_median_rad": round(float(sorted(distance)[len(distance) // 2]), 4),
    }
    text = f"{args.verb}: {motion.num_frames} frames, median distance to plausible poses {data['distance_median_rad']}"
    return Outcome(f"{text}\n  written     {args.out}", data)


def _local(motion: Motion, body: Any) -> Any:
    from solver_backend.fitters.pose_ndf.edit_motion import frames_of

    return frames_of(motion, body).local
