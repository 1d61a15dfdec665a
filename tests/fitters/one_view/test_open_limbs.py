"""A limb that may point the other way is reported where it does, and no other."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.fitters.one_view import measure
from solver_backend.fitters.pipeline import solve
from solver_backend.priors.view_lifter import SLANT, bone_slants, load_limb_slants
from tests.support.limb_errors import flagged
from tests.support.one_view_situations import filmed_walk
from tests.support.short_solves import QUICK

FRAMES = 30


@pytest.mark.slow
@pytest.mark.parametrize("limbs", [(0, 1, 2, 3), (2, 3)])
def test_limbs_that_may_point_the_other_way_are_reported_there(
    limbs: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    walked = filmed_walk(FRAMES)

    def chances(hidden: np.ndarray) -> np.ndarray:
        found = np.tile([0.0, 1.0, 0.0], (len(hidden), 8, 1))
        for limb in limbs:
            found[10:25, 2 * limb : 2 * limb + 2] = [0.5, 0.0, 0.5]
        return found

    monkeypatch.setattr(measure, "load_limb_slants", lambda: chances)
    motion = solve(walked, QUICK).motion
    slanted = np.abs(bone_slants(motion.joints, np.tile(walked.require_views()[0].R[0, 2], (FRAMES, 1))))
    expected = (slanted.reshape(FRAMES, 4, 2) > SLANT + 0.05).any(axis=-1)[10:25].all(axis=0)
    reported = flagged(motion)
    assert expected[list(limbs)].any() and reported[10:25, [k for k in limbs if expected[k]]].all()
    assert not reported[:, [k for k in range(4) if k not in limbs]].any()
    assert not reported[:10].any() and not reported[25:].any()


@pytest.mark.slow
def test_chances_of_a_walk_are_small_and_a_few_limbs_are_open() -> None:
    motion = solve(filmed_walk(60), QUICK).motion
    assert flagged(motion).mean() < 0.35
    assert load_limb_slants().metadata["view_lifter_sha256"]
