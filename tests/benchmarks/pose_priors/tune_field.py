"""Tune Pose-NDF's weights: ``python -m tests.benchmarks.pose_priors.tune_field [--weights NPZ] [--use USE ...]``.

Every weight is tried on the same training takes, as `bench pose_ndf` does on held-out takes: denoising of clean and
noisy takes (mean error, cm), completion of three limbs (cm), and fits to keypoints with a constant and with the
adaptive weight (mm). The output marks each use's best weight and the shipped weight.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.fitters.pose_ndf.complete import (
    WEIGHTS,
    CompleteSettings,
    DenoiseSettings,
    KeypointSettings,
    complete,
    denoise,
    missing_joints,
)
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.pose_ndf import PoseNDF, load_pose_ndf
from tests.benchmarks.bench_pose_ndf import (
    CONSTANT_WEIGHT,
    FPS,
    KEYPOINT_SETTINGS,
    NOISE_DEG,
    OCCLUSIONS,
    SUBJECT,
    error_cm,
)
from tests.benchmarks.comparison.validation_takes import training_take
from tests.benchmarks.pose_priors.keypoint_fits import manifold_fit
from tests.benchmarks.pose_priors.tune_pulls import FRAMES, TAKES, sightings

Use = Callable[[PoseNDF, float], float]  # Returns the mean error on the training takes for a weight.
MANIFOLDS, SMOOTHNESSES = (0.01, 0.03, 0.1, 0.3), (0.5, 1.0, 2.0, 4.0)
CONSTANTS, ADAPTIVES = (3.0, 10.0, 30.0, 100.0), (10.0, 30.0, 100.0, 300.0)


def denoising(prior: PoseNDF, manifold: float) -> float:
    """Return the mean error in cm of denoising, over unchanged takes and takes with rotated joints."""
    settings = DenoiseSettings(replace(WEIGHTS, manifold=manifold), iterations=12, move_root=False)
    return float(np.mean([error_cm(denoise(SUBJECT, prior, start, FPS, settings), truth) for start, truth in _noisy()]))


def completion(prior: PoseNDF, smoothness: float) -> float:
    """Return the mean error in cm of completing three limbs."""
    errors = []
    for truth in _takes():
        for limbs in OCCLUSIONS.values():
            missing, rest = missing_joints(limbs), truth.local.copy()
            rest[:, list(missing)] = np.eye(3)
            hidden = PosedFrames(truth.root, rest, truth.transl)
            found = complete(SUBJECT, prior, hidden, missing, FPS, CompleteSettings(smoothness=smoothness))
            errors.append(error_cm(found, truth))
    return float(np.mean(errors))


def keypoints(prior: PoseNDF, manifold: float, settings: KeypointSettings = KEYPOINT_SETTINGS) -> float:
    """Return the mean error in mm of fits to one camera's keypoints."""
    chosen = replace(settings, manifold=manifold)
    return float(np.mean([manifold_fit(prior, seen, chosen) for seen in sightings()]))


USES: dict[str, tuple[Use, tuple[float, ...], float]] = {
    "denoise": (denoising, MANIFOLDS, WEIGHTS.manifold),
    "complete": (completion, SMOOTHNESSES, CompleteSettings().smoothness),
    "keypoints": (keypoints, ADAPTIVES, KEYPOINT_SETTINGS.manifold),
    "keypoints-constant": (
        partial(keypoints, settings=replace(KEYPOINT_SETTINGS, adaptive=False)), CONSTANTS, CONSTANT_WEIGHT
    ),
}  # fmt: skip
"""Function of each use, tried weights, and the shipped weight."""


def main(argv: list[str] | None = None) -> int:
    """Try every weight of the chosen uses."""
    parser = argparse.ArgumentParser(prog="tune_field", description="Weights of the uses of Pose-NDF's field.")
    parser.add_argument("--weights", type=Path, help="a field of its own; what ships without")
    parser.add_argument("--use", nargs="+", choices=tuple(USES), default=tuple(USES))
    args = parser.parse_args(argv)
    prior = load_pose_ndf() if args.weights is None else load_pose_ndf(args.weights)
    for name in args.use:
        use, weights, ships = USES[name]
        errors = [use(prior, weight) for weight in weights]
        for weight, error in zip(weights, errors, strict=True):
            note = f"{' best' if error == min(errors) else ''}{' ships' if weight == ships else ''}"
            sys.stdout.write(f"{name:<20} {weight:7.2f} {error:9.3f}{note}\n")
            sys.stdout.flush()
    return 0


@cache
def _takes() -> list[PosedFrames]:
    """Return the takes at 30 frames per second."""
    takes = [training_take(name, FRAMES, start) for name, start in TAKES]
    return [PosedFrames(t.rotations[::2, 0], t.rotations[::2, 1:22], t.root[::2]) for t in takes]


@cache
def _noisy() -> list[tuple[PosedFrames, PosedFrames]]:
    """Return each take unchanged and with rotated joints, each with the truth."""
    rng, pairs = np.random.default_rng(0), []
    for truth in _takes():
        turn = exp_so3(np.radians(NOISE_DEG) * rng.standard_normal((*truth.local.shape[:2], 3)))
        pairs += [(truth, truth), (PosedFrames(truth.root, turn @ truth.local, truth.transl), truth)]
    return pairs


if __name__ == "__main__":
    raise SystemExit(main())
