"""Options of a solve that clean up after it: calmer curves, firmer feet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.person_shape import find_contacts
from solver_backend.fitters.pipeline import solve
from solver_backend.metrics import mpjpe_mm
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, Motion

START, STOP = 60, 180


@pytest.fixture(scope="module")
def capture() -> Capture:
    whole = demo_capture()
    assert whole.keypoints is not None
    return replace(whole, keypoints=whole.keypoints.frames(START, STOP))


def solved(capture: Capture, **chosen: float) -> Motion:
    return solve(capture, SolveSettings(iterations=8, **chosen)).motion  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def plain(capture: Capture) -> Motion:
    return solved(capture)


def acceleration(motion: Motion) -> float:
    """Return the mean over joints and frames in m/s²."""
    return float(np.linalg.norm(np.diff(motion.joints[:, :22], 2, axis=0), axis=-1).mean() * motion.fps**2)


def slip(motion: Motion, planted: np.ndarray) -> float:
    """Return the mean speed in m/s of keypoints (F, K) that stand."""
    assert motion.keypoints3d is not None
    speed = np.linalg.norm(np.diff(motion.keypoints3d, axis=0), axis=-1) * motion.fps
    return float(speed[planted[1:] & planted[:-1]].mean())


@pytest.mark.slow
def test_more_smoothing_is_calmer(capture: Capture, plain: Motion) -> None:
    calm = solved(capture, smoothing=3.0)
    truth = capture.truth["joints"][START:STOP, :22]
    assert acceleration(calm) < 0.97 * acceleration(plain)
    assert mpjpe_mm(calm.joints[:, :22], truth) < 1.1 * mpjpe_mm(plain.joints[:, :22], truth)
    assert acceleration(solved(capture, smoothing=10.0)) < 0.95 * acceleration(calm)


@pytest.mark.slow
def test_a_firmer_foot_lock_holds_feet_stiller(capture: Capture, plain: Motion) -> None:
    assert plain.keypoints3d is not None and plain.joint_set is not None
    planted = find_contacts(plain.keypoints3d, plain.joint_set.keypoints, plain.fps).planted
    assert planted.any()
    loose, firm = (slip(solved(capture, foot_lock=lock), planted) for lock in (0.3, 3.0))
    assert firm < 0.8 * slip(plain, planted) < 0.5 * loose


@pytest.mark.parametrize("chosen", [{"smoothing": 0.0}, {"foot_lock": -1.0}])
def test_what_cannot_be_is_named(chosen: dict[str, float]) -> None:
    with pytest.raises(JobInvalid, match=next(iter(chosen))):
        SolveSettings(**chosen)  # type: ignore[arg-type]
