"""Which recorded poses are the manifold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.geometry.rotations import exp_so3
from tests.support.swaying_people import swaying
from training.pose_ndf.train import manifold_of, possible_frames


def test_poses_out_of_reach_are_no_part_of_the_manifold() -> None:
    corpus = swaying(0)
    bent = corpus.rotations.copy()
    bent[corpus.distinct[0], 14] = exp_so3(np.array([0.0, 3.0, 0.0]))  # the head looks backwards
    assert len(possible_frames(replace(corpus, rotations=bent))) == len(np.unique(corpus.distinct)) - 1
    manifold = manifold_of(corpus)
    assert len(manifold.quats) == len(manifold.people) == 2 * len(possible_frames(corpus))
    assert manifold.nearest.distances(manifold.quats[-5:], 1).max() < 1e-3
