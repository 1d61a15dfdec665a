"""What a solve leaves: the motion and its page, neither of them without the other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from solver_backend.exchange.errors import MocapError, OutputExists
from solver_backend.exchange.outputs import atomic_files
from solver_backend.exchange.progress import Progress
from solver_backend.job import Job
from solver_backend.types import Capture, Motion

if TYPE_CHECKING:
    from solver_backend.types.cameras import CameraFits


def write_both(job: Job, capture: Capture, motion: Motion, progress: Progress) -> None:
    """Write the motion and its report, both named in one moment; the motion also where the report fails.

    Args:
        job: where to, and what is overwritten.
        capture: what was solved.
        motion: the solve.
        progress: called as the report is written.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_files``.
    """
    from solver_backend.io.native.motion_file import write_motion

    if job.report is None:
        write_motion(job.out, motion, overwrite=job.overwrite)
        return
    failure: BaseException | None = None
    try:
        with atomic_files([job.out, job.report], overwrite=job.overwrite) as (out, page):
            try:
                _write_page(page, job, capture, motion, progress)
            except BaseException as error:  # raised when the motion is safe
                page.unlink(missing_ok=True)
                failure = error
            write_motion(out, motion, name=job.out.stem)
    except OutputExists:
        if not job.out.exists():  # it is the page's name that somebody took meanwhile
            write_motion(job.out, motion)
        raise
    if failure is not None:
        raise failure


def _write_page(page: Path, job: Job, capture: Capture, motion: Motion, progress: Progress) -> None:
    from solver_backend.report.page import report_html

    progress("Writing the report", 0, 1)
    fit = None if job.resolve is not None else _calibration_fit(capture, progress)
    page.write_text(report_html(capture, motion, fit), encoding="utf-8", newline="\n")
    progress("Writing the report", 1, 1)


def _calibration_fit(capture: Capture, progress: Progress) -> CameraFits | None:
    """Return how the cameras fit what they saw, where two of them see the person."""
    from solver_backend.camera_calibration.calibration_check import check_calibration

    if capture.cameras is None or capture.keypoints is None:
        return None
    try:
        return check_calibration(capture.cameras, capture.keypoints, progress)
    except MocapError:  # too little is seen together to compare
        return None
