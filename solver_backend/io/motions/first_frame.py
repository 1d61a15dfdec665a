"""Clips that begin with a pose that is no part of the motion: programs write a T-pose before the first frame."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import SkeletonMotion

_APART_DEG, _TIMES = 25.0, 3.0
"""Turn of a joint after the first frame, and its multiple of the largest one in the frames that follow, from which the
first frame stands apart; CMU's conversions to BVH have 60° and more, no other clip of the benchmark has any."""
_FOLLOWING = 12
"""Frames that the first step is compared with."""


def first_frame_apart(motion: SkeletonMotion) -> list[Diagnostic]:
    """Return a warning of a first frame from which a joint turns to the second as it never does right after."""
    parents = np.array(motion.parents)
    G = motion.turns[:_FOLLOWING]
    if len(G) < _FOLLOWING:
        return []
    local = np.where(parents[:, None, None] < 0, G, np.swapaxes(G[:, np.maximum(parents, 0)], -1, -2) @ G)
    steps = np.degrees(np.linalg.norm(log_so3(np.swapaxes(local[:-1], -1, -2) @ local[1:]), axis=-1)).max(axis=1)
    if steps[0] < max(_APART_DEG, _TIMES * steps[1:].max()):
        return []
    return [diagnostic("motion_first_frame_apart", frames=[(0, 0)], angle=steps[0])]
