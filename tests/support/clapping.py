"""Somebody who claps in the midst of a recorded motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.simulation.cast import Take
from solver_backend.types import SMPL_JOINTS

OPEN, CLOSED = np.radians([55.0, 107.0])
"""How far arms are turned forwards from the sides: hands apart, and palms together."""
APPROACH_S, BLEND_S = 0.14, 0.25


def clapping(take: Take, at_s: tuple[float, ...]) -> Take:
    """Return the take with claps at these times: arms level, hands rush together, meet, and part as fast."""
    times = np.arange(len(take.rotations)) / take.fps
    since = np.min([np.abs(times - t) for t in at_s], axis=0)
    # The speed does not vanish where palms meet: it turns.
    turned = OPEN + (CLOSED - OPEN) * np.clip(1.0 - since / APPROACH_S, 0.0, 1.0) ** 1.2
    lifted = np.clip((min(at_s) - times) / BLEND_S, 0.0, None) + np.clip((times - max(at_s)) / BLEND_S, 0.0, None)
    share = np.clip(2.0 - lifted, 0.0, 1.0)[:, None, None]
    rotations = take.rotations.copy()
    for side, sign in (("left", -1.0), ("right", 1.0)):
        joint = SMPL_JOINTS.index(f"{side}_shoulder")
        rotations[:, joint] = _nearest(
            (1 - share) * rotations[:, joint] + share * exp_so3(sign * turned[:, None] * np.array([0.0, 1.0, 0.0]))
        )
        for still in ("collar", "elbow", "wrist"):
            joint = SMPL_JOINTS.index(f"{side}_{still}")
            rotations[:, joint] = _nearest((1 - share) * rotations[:, joint] + share * np.eye(3))
    return replace(take, rotations=rotations)


def _nearest(matrices: np.ndarray) -> np.ndarray:
    U, _, Vt = np.linalg.svd(matrices)
    U[..., -1] *= np.linalg.det(U @ Vt)[..., None]
    return U @ Vt
