"""Tune the weights of codes in keypoint fits: ``python -m tests.benchmarks.pose_priors.tune_pulls [PRIOR ...]``.

Every weight fits the same ten frames of each training take, as `bench pose_ndf` does on held-out takes. The output is
the mean error in mm, with the best weight of each prior marked.
"""

from __future__ import annotations

import sys
from functools import cache

import numpy as np

from research.priors import load_gmm
from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.priors.gaussian_vae import VaeName, load_vae
from solver_backend.residuals.pose_mixture import read_mixture
from tests.benchmarks.bench_pose_ndf import KEYPOINT_SETTINGS, VAES
from tests.benchmarks.comparison.validation_takes import training_take
from tests.benchmarks.pose_priors.keypoint_fits import Sighting, latent_fit, sighting

TAKES = (("49_02", 600), ("49_09", 60), ("06_02", 60), ("16_15", 60))
"""Name and first frame: acrobatics, dance, ball game, walk."""
FRAMES, EVERY = 120, 12
PULLS = (0.1, 0.3, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def main(names: list[str]) -> int:
    """Try every weight with the named priors, or with all."""
    chosen: list[VaeName] = [name for name in VAES if not names or name in names]
    for name in chosen:
        prior = load_vae(name)
        errors = [
            float(np.mean([latent_fit(prior, seen, pull, KEYPOINT_SETTINGS) for seen in sightings()])) for pull in PULLS
        ]
        for pull, error in zip(PULLS, errors, strict=True):
            sys.stdout.write(f"{'*' if error == min(errors) else ' '} {name:<14} {pull:6.1f} {error:8.2f} mm\n")
    return 0


@cache
def sightings() -> list[Sighting]:
    """Return the takes' frames, each seen by one camera."""
    mixture = load_gmm()
    shares, means, _, _ = read_mixture()
    rest = mixture.decode((shares[:, None] * means).sum(axis=0)[None])[0]
    found = []
    for seed, (name, start) in enumerate(TAKES):
        take = training_take(name, FRAMES, start)
        rotations = take.rotations[::EVERY]
        found.append(sighting(PosedFrames(rotations[:, 0], rotations[:, 1:22], take.root[::EVERY]), rest, 100 + seed))
    return found


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
