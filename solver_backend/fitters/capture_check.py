"""A capture examined before it is solved: faults of its views are found, put right where that is sure, and named."""

from __future__ import annotations

from dataclasses import dataclass, replace

from solver_backend.cameras.label_swaps import undo_swaps
from solver_backend.fitters.initial import Observations, observations_of
from solver_backend.progress import Progress
from solver_backend.types import Capture, Fault, FaultKind, Remedy

STAGE = "Checking the cameras"


@dataclass(frozen=True)
class CheckedCapture:
    """A capture with its faults put right or left out."""

    capture: Capture
    """What is to be solved."""
    observations: Observations
    """Of that capture."""
    faults: tuple[Fault, ...]
    """What was found, by first frame."""


def check_capture(capture: Capture, observations: Observations, progress: Progress) -> CheckedCapture:
    """Find faults of single views and put them right.

    Args:
        capture: as it was read.
        observations: of that capture.
        progress: told how far the checks are.
    """
    cameras, keypoints = capture.require_multiview()
    progress(STAGE, 0, 1)
    sides = undo_swaps(cameras, keypoints, observations.triangulation)
    faults = [
        Fault(
            FaultKind.LIMBS_EXCHANGED, cameras.names[swap.view], swap.first, swap.last, round(swap.gain, 1),
            Remedy.REPAIRED, swap.limb,
        )
        for swap in sides.swaps
    ]  # fmt: skip
    progress(STAGE, 1, 1)
    return CheckedCapture(
        replace(capture, keypoints=sides.keypoints),
        observations_of(sides.triangulation),
        tuple(sorted(faults, key=lambda fault: (fault.first, fault.camera))),
    )
