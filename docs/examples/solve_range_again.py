"""Solve a few frames again through a pose that a person set.

    python docs/examples/solve_range_again.py CAPTURE MOTION.npz OUT.npz

The frames outside the range do not change. The result has exactly the pinned pose.
"""

import sys
from pathlib import Path

import numpy as np

from solver_backend import FrameRange, Pin, load_capture, read_motion, resolve_range, write_motion

FIRST, LAST, PINNED = 8, 20, 14
LEFT_ELBOW = 17
"""Index into ``body_pose``, which omits the root of SMPL's 24 joints."""


def main(capture_path: str, motion_path: str, out: str) -> None:
    """Bend the left elbow of one frame by ten degrees more and let its neighbours follow."""
    motion = read_motion(Path(motion_path))
    body_pose = motion.body_pose[PINNED].copy()
    body_pose[3 * LEFT_ELBOW + 1] -= np.deg2rad(10.0)
    pin = Pin(PINNED, motion.global_orient[PINNED], body_pose, motion.transl[PINNED])
    solution = resolve_range(load_capture(capture_path), motion, FrameRange(FIRST, LAST, (pin,)))
    write_motion(Path(out), solution.motion)
    moved = 1000 * np.linalg.norm(solution.motion.joints - motion.joints, axis=-1).max(axis=1)
    print(f"Frames {np.flatnonzero(moved > 0.1).tolist()} moved, by {moved.max():.0f} mm at most.")


if __name__ == "__main__":
    main(*sys.argv[1:])
