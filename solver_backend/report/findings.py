"""What deserves a look, said in sentences, each with what to do about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from solver_backend.geometry.runs import true_runs
from solver_backend.io.recognition.motion_checks import motion_problems
from solver_backend.metrics import foot_skating_cm_per_frame
from solver_backend.report.faults import fault_texts, faults_of, frames_text
from solver_backend.report.statistics import Residuals, detected_share
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE, SMPL_JOINTS, Capture, FaultKind, Motion

BELOW_FLOOR_M = 0.05
"""Depth of a foot joint under the floor beyond which the floor is doubted."""
LONGEST_LIST = 6
"""Keypoints named one by one; the rest is counted."""


@dataclass(frozen=True)
class Finding:
    """One observation."""

    what: str
    advice: str
    level: str = "look"
    """'look' or 'bad'."""


def findings_of(capture: Capture, motion: Motion, residuals: Residuals | None) -> list[Finding]:
    """Return everything that deserves a look, the worst first; an empty list says that all is well."""
    found = [Finding(problem, "Reported by the reader of the capture.", "bad") for problem in capture.problems]
    found += [
        Finding(fault.what, fault.advice, "bad" if fault.bad else "look")
        for fault in fault_texts([f for f in faults_of(motion) if f.kind is not FaultKind.PERSON_AWAY], motion.fps)
    ]
    found += [
        Finding(problem, "Look at the motion there; solve again with other settings or better detections.", "bad")
        for problem in motion_problems(motion)
    ]
    found += _flagged(motion)
    if residuals is not None:
        found += [*_cameras(capture, residuals), *_keypoints(capture, residuals)]
    found += _floor(motion)
    return sorted(found, key=lambda finding: finding.level != "bad")


def _flagged(motion: Motion) -> Iterator[Finding]:
    if motion.flags is None:
        return
    kinds = (
        (FLAG_UNSEEN, "bad", "Nobody was seen by two cameras; the pose is bridged from its neighbours",
         "Detect again there, add a camera that sees the spot, or animate the stretch by hand."),
        (FLAG_UNSURE, "look", "The body is far from the detections, or some joint is hardly known",
         "Compare with the footage: a limb may be swapped, hidden or badly detected."),
    )  # fmt: skip
    if motion.markers is not None:
        kinds = (
            (FLAG_UNSEEN, "bad", "Too few markers are seen; the pose is bridged from its neighbours",
             "Fill the gaps in the program that recorded them, or animate the stretch by hand."),
            (FLAG_UNSURE, "look", "The body is far from the markers, or some joint is hardly known",
             "Look for markers that are named wrongly, exchanged or loose there."),
        )  # fmt: skip
    for bit, level, what, advice in kinds:
        runs = true_runs((motion.flags & bit) > 0)
        if runs:
            yield Finding(f"{what}: {frames_text(runs, motion.fps)}.", advice, level)


def _cameras(capture: Capture, residuals: Residuals) -> Iterator[Finding]:
    assert capture.cameras is not None
    seen = detected_share(capture)
    assert seen is not None
    medians = residuals.by_camera
    for c, name in enumerate(capture.cameras.names):
        others = np.delete(medians, c)
        others = others[np.isfinite(others)]
        share = 100 * float(seen[c].mean())
        if others.size and medians[c] > 1.6 * float(np.median(others)):
            yield Finding(
                f"Camera {name} disagrees with the others: {medians[c]:.1f} px against {np.median(others):.1f} px.",
                "Check its calibration, whether it moved during the take, and whether it is synchronised.",
            )
        if share < 50:
            yield Finding(
                f"Camera {name} detects only {share:.0f} % of the keypoints.",
                "Check that the person is in its view, its exposure, and the detector's input.",
            )


def _keypoints(capture: Capture, residuals: Residuals) -> Iterator[Finding]:
    assert capture.cameras is not None and capture.keypoints is not None
    agreement = residuals.agreement_percent(1)
    names = [name.replace("_", " ") for name in capture.keypoints.joint_set.keypoints]
    twice = 100.0 * ((capture.keypoints.confidence > 0).sum(axis=0) >= 2).mean(axis=0)
    rare = [f"{names[k]} ({twice[k]:.0f} %)" for k in np.argsort(twice, kind="stable") if twice[k] < 50]
    if rare:
        yield Finding(
            f"Seldom detected by two cameras: {listed(rare)}.",
            "The motion of what hangs on these points comes from the pose prior and the neighbouring frames.",
        )
    poor = sorted((float(agreement[c, k]), c, k) for c, k in np.argwhere(np.nan_to_num(agreement, nan=100.0) < 80))
    if poor:
        worst = [f"{names[k]} in {capture.cameras.names[c]} ({100 - value:.0f} %)" for value, c, k in poor]
        yield Finding(
            f"Often an outlier: {listed(worst)}.",
            "They hardly count in the solve. If they matter, look for swapped sides or an occlusion in that view.",
        )


def listed(items: list[str]) -> str:
    """Return the first items as text, and how many more there are."""
    more = f" and {len(items) - LONGEST_LIST} more" if len(items) > LONGEST_LIST else ""
    return ", ".join(items[:LONGEST_LIST]) + more


def _floor(motion: Motion) -> Iterator[Finding]:
    feet = motion.joints[:, [SMPL_JOINTS.index("left_foot"), SMPL_JOINTS.index("right_foot")]]
    lowest = float(feet[..., 2].min(axis=1).min())
    usual = float(np.median(feet[..., 2].min(axis=1)))
    if lowest < -BELOW_FLOOR_M:
        yield Finding(
            f"A foot goes {-100 * lowest:.0f} cm below the floor.",
            "Check that the calibration's origin lies on the floor and that Z points up.",
            "bad" if usual < -BELOW_FLOOR_M else "look",
        )
    skating = foot_skating_cm_per_frame(feet)
    if skating * motion.fps > 15.0:
        yield Finding(
            f"The feet slide by {skating:.2f} cm a frame while they are on the floor.",
            "Look at the feet in the baked scene; a low detection rate of the toes is the usual reason.",
        )
