"""A finished motion as the lines of a live run, at its own rate."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from solver_backend.exchange.live_lines import FrameLine
from solver_backend.exchange.so3 import matrix_from_rotvec
from solver_backend.live.keeping_up import LATE_S
from solver_backend.types import Motion

_DIGITS = 6
"""Decimals of numbers in a line: micrometres and microradians."""


def replayed_poses(motion: Motion, *, paced: bool = True, repeat: bool = False) -> Iterator[FrameLine]:
    """Yield a line a frame, of all joints of the motion; frames that come more than ``LATE_S`` late are left out.

    Args:
        motion: what is replayed.
        paced: at its own rate; False: as fast as lines are taken.
        repeat: again and again; the time goes on.
    """
    vectors = np.concatenate([motion.global_orient, motion.body_pose], axis=1)
    start, number = time.perf_counter(), 0
    while True:
        for root_and_pose, transl in zip(vectors, motion.transl, strict=True):
            due = start + number / motion.fps if paced else time.perf_counter()
            if (ahead := due - time.perf_counter()) > 0:
                time.sleep(ahead)
            lag = time.perf_counter() - due
            if lag < LATE_S:
                yield {
                    "frame": number, "t": round(number / motion.fps, 6), "state": "tracking",
                    "root": _rounded(root_and_pose[:3]), "pose": _rounded(root_and_pose[3:]), "trans": _rounded(transl),
                    "points": 0, "latency_ms": 0.0, "lag_ms": round(1e3 * lag, 3),
                }  # fmt: skip
            number += 1
        if not repeat:
            return


def rest_joints(motion: Motion) -> np.ndarray:
    """Return the (J, 3) rest joints of the body that a motion was solved for, from its first frame.

    ``J_j = J_p + G_pᵀ (x_j - x_p)`` with joints x and global rotations G, ``J_0 = x_0 - transl``.
    """
    layout, places = motion.body_layout, motion.joints[0]
    local = matrix_from_rotvec(np.concatenate([motion.global_orient[0], motion.body_pose[0]]).reshape(-1, 3))
    G, rest = [local[0]], [places[0] - motion.transl[0]]
    for j in range(1, layout.num_joints):
        p = layout.parents[j]
        rest.append(rest[p] + G[p].T @ (places[j] - places[p]))
        G.append(G[p] @ local[j])
    return np.stack(rest)


def _rounded(values: np.ndarray) -> list[float]:
    return np.round(values, _DIGITS).tolist()
