"""A person before a carried camera is solved in the world as well as before a camera that stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.exchange.progress import silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.pipeline import prepare, solve
from tests.support.carried_camera import Carried, film_carried
from tests.support.limb_errors import limb_errors
from tests.support.walking_take import EXACT, walk


@pytest.fixture(scope="module")
def filmed() -> Carried:
    return film_carried(walk(90), "hand-held", detector=EXACT)


def off_m(points: np.ndarray, truth: np.ndarray) -> float:
    return float(np.nanmedian(np.linalg.norm(points[:, : truth.shape[1]] - truth, axis=-1)))


def test_the_lifted_person_walks_in_the_world(filmed: Carried) -> None:
    capture = filmed.capture
    assert capture.cameras is not None
    stands = replace(capture, cameras=replace(capture.cameras, path=None))
    truth = capture.truth["keypoints3d"]
    carried, still = (prepare(take, SolveSettings(), silent).measurements.points for take in (capture, stands))
    assert off_m(carried, truth) < min(0.2, 0.5 * off_m(still, truth))


@pytest.mark.slow
def test_a_carried_camera_solves_a_walk(filmed: Carried) -> None:
    motion = solve(filmed.capture).motion
    pa, hip = limb_errors(motion.joints, filmed.capture.truth["joints"])
    assert pa < 60.0 and hip < 100.0
    off = motion.joints[:, 0] - filmed.capture.truth["joints"][:, 0]
    assert np.linalg.norm(off - off.mean(axis=0), axis=1).mean() < 0.08
    assert motion.reprojection_px is not None and np.nanmedian(motion.reprojection_px) < 6.0
