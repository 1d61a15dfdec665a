"""Faults of a view are named, with the camera and the frame, and cost the solve little."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solve import solve
from solver_backend.synthetic.demo import demo_capture
from solver_backend.types import Capture, FaultKind, Motion, Remedy
from tests.fitters.faulty import swapped

QUICK = SolveSettings(iterations=4)


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(num_frames=90)


@pytest.fixture(scope="module")
def clean(capture) -> Motion:
    return solve(capture, QUICK)


def error_mm(motion: Motion, capture: Capture) -> float:
    return 1000 * float(np.linalg.norm(motion.joints - capture.truth["joints"], axis=-1).mean())


def test_a_good_capture_has_no_findings(clean):
    assert clean.provenance["findings"] == []


def test_exchanged_limbs_are_named_and_cost_nothing(capture, clean):
    motion = solve(swapped(capture, [(2, "legs", 30, 52), (0, "arms", 60, 71)]), QUICK)
    found = motion.provenance["findings"]
    assert [(f["kind"], f["camera"], f["detail"], f["remedy"]) for f in found] == [
        (FaultKind.LIMBS_EXCHANGED, "cam03", "legs", Remedy.REPAIRED),
        (FaultKind.LIMBS_EXCHANGED, "cam01", "arms", Remedy.REPAIRED),
    ]
    np.testing.assert_allclose([(f["first"], f["last"]) for f in found], [(30, 52), (60, 71)], atol=1)
    assert error_mm(motion, capture) < 1.05 * error_mm(clean, capture)
