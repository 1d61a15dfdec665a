"""Solve a capture and print where to look: ``python docs/examples/solve_capture.py CAPTURE MOTION.npz``.

CAPTURE is what the command line takes too: a Pose2Sim trial, a folder of OpenPose JSON, a capture file.
"""

import os
import sys
from pathlib import Path

# Before NumPy is loaded: the solver divides its work among cores itself, and threads in each product wait for these.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from solver_backend import SolveSettings, load_capture, solve, write_motion, write_report


def main(capture_path: str, motion_path: str) -> None:
    """Read, solve, write the motion and its report."""
    capture = load_capture(capture_path)
    for note in (*capture.notes, *capture.problems):
        print(f"- {note}")
    solution = solve(capture, SolveSettings(refine_window=10))
    write_motion(Path(motion_path), solution.motion)
    write_report(Path(motion_path).with_suffix(".html"), capture, solution.motion)
    doubtful = np.flatnonzero(solution.motion.flags)
    print(solution.status)
    print(f"{solution.motion.num_frames} frames, {len(doubtful)} of them deserve a look: {doubtful.tolist()}")


if __name__ == "__main__":
    main(*sys.argv[1:])
