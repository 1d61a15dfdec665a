"""A multi-stage fit of every frame on its own, in the manner of MuVS (Huang et al. 2017; thesis 6.3.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.fitters.baselines.base import Baseline, BaselineResult
from solver_backend.fitters.baselines.person import prepare
from solver_backend.fitters.frame_method import solve_by_frame
from solver_backend.fitters.result import build_motion
from solver_backend.fitters.settings import SolveSettings
from solver_backend.progress import silent
from solver_backend.types import Capture


@dataclass(frozen=True)
class PerFrame(Baseline):
    """Frames fitted through a falling robust scale, with no knowledge of time."""

    name: str = "MuVS-like, per frame"
    simplified: str = (
        "SPoser's sphere in place of VPoser's Gaussian latent, Levenberg-Marquardt in place of L-BFGS, no silhouettes, "
        "no DCT stage, start and shape from triangulated points in place of HMR."
    )

    def solve(self, capture: Capture) -> BaselineResult:
        """Fit each frame."""
        settings = SolveSettings(method="frame")
        problem, subject = prepare(capture)
        frames = solve_by_frame(problem, subject, settings, silent)
        motion = build_motion(
            capture, subject, frames, problem.observations, key_times=np.arange(0), sigma=None,
            scale=settings.robust_scale, provenance={"baseline": self.name},
        )  # fmt: skip
        assert motion.keypoints3d is not None
        return BaselineResult(motion.keypoints3d, motion)
