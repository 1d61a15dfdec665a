"""What one camera leaves open, stated: deviations along the line of sight, and the limbs whose depth is a guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.fitters.measurements.base import OneView
from solver_backend.fitters.model.posed_frames import BLOCK_POSES
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.one_view.doubtful_view import glides
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.solution import SolvedFrames
from solver_backend.geometry.arrays import constant, to_numpy
from solver_backend.geometry.runs import true_runs
from solver_backend.geometry.symmetric import packed, unpacked
from solver_backend.priors.limb_slants import PARTS, bone_slants, flip_chances

ALIKE = 0.9
"""Lifted depths are off by so many of the lifter's deviations in solved takes, and for so long that a bundle averages
none of it out. Like ``ACROSS_M`` set on eight takes of subjects 01, 08, 09, 60 and 127, so that 95 % ellipsoids hold 90
to 97 %."""
ACROSS_M = 0.015
"""What a body of average proportions and an unseen bias of the detector leave across the picture, per axis."""
OPEN_M = 0.15
"""A limb's depth is open where its end's deviation along the line of sight, about the body, is larger: half a step."""
FLIP_CHANCE = 0.01
"""It is open, too, where the chance is larger that one of its bones points the other way. That is so in a seventh of
the limb frames of 18 takes of subjects 01, 08, 09 and 60, which hold 73 % of their flips."""
SHORTEST_S = 0.2
"""A shorter stretch is not worth a look."""
STANDS_SHARE = 0.02
"""Of feet and frames; in fewer, nothing locates the floor. A walker's feet stand in half of them."""
LIMB_ENDS = {
    "left_wrist": "left arm", "right_wrist": "right arm", "left_ankle": "left leg", "right_ankle": "right leg",
    "head": "head",
}  # fmt: skip
"""Joints by which limbs are named."""


def with_open_depth(solved: SolvedFrames, one: OneView, joints: np.ndarray) -> SolvedFrames:
    """Return the solution with the deviations that one camera leaves.

    ``Σ + a² 1 + ((k l)² + f² z²) d dᵀ + s² p pᵀ`` with ``ACROSS_M`` a, ``ALIKE`` k, and the lifter's deviation l.

    A person s times as large and as far away looks the same, p from the camera to the joint; with a focal length that
    is f too long everybody is as much too far along the line of sight d. Both are alike in all frames, so that no
    number of frames takes them away.

    Args:
        solved: with the covariances of the bundle.
        one: what is open.
        joints: (J,) joints of the body whose covariances there are.
    """
    if solved.covariance is None:
        return solved
    covariance = unpacked(to_numpy(solved.covariance))
    for start in range(0, len(covariance), BLOCK_POSES):
        part = slice(start, start + BLOCK_POSES)
        away = _joints(solved.subject, solved, part)[:, joints] - one.centre
        covariance[part] += one.size_sigma**2 * away[..., :, None] * away[..., None, :]
        sight = one.sight[part]
        far = one.focal_sigma * np.einsum("fja,fa->fj", away, sight)
        deep = (ALIKE * one.sight_sigma_m[part]) ** 2 + far**2
        covariance[part] += ACROSS_M**2 * np.eye(3)
        covariance[part] += deep[..., None, None] * (sight[:, None, :, None] * sight[:, None, None, :])
    return replace(solved, covariance=constant(packed(covariance), solved.frames.transl))


def diagnose_one_view(solved: SolvedFrames, one: OneView, problem: Problem) -> list[Diagnostic]:
    """Return what a result of one camera always reports, and the limbs whose depth is open."""
    joints = problem.body.layout.recorded.joints
    columns = [joints.index(name) for name in LIMB_ENDS if name in joints]
    usual = 100.0 * float(np.median(one.sight_sigma_m[:, columns]))
    found = [diagnostic("one_camera", size=usual, share=100.0 * one.size_sigma, source=one.size_source)]
    if one.focal_sigma:
        found.append(diagnostic("focal_length_unsure", cameras=[one.camera], share=100.0 * one.focal_sigma))
    if one.up_from_person:
        found.append(diagnostic("up_from_person", cameras=[one.camera]))
    posed, fps = _all_joints(solved), problem.fps
    slants = bone_slants(posed[:, list(problem.body.layout.standing_for(SMPL))], one.sight)
    flips = dict(zip(PARTS, flip_chances(one.slant_chances, slants).T, strict=True))
    for name, part in LIMB_ENDS.items():
        if name not in joints:
            continue
        doubtful = one.sight_sigma_m[:, joints.index(name)] > OPEN_M
        if part in flips:
            doubtful |= flips[part] > FLIP_CHANCE
        runs = [run for run in true_runs(doubtful) if run[1] - run[0] + 1 >= SHORTEST_S * fps]
        if runs:
            found.append(diagnostic("limb_depth_open", frames=runs, joints=[name], part=part))
    return found + _diagnose_steps(solved, problem, posed)


def _all_joints(solved: SolvedFrames) -> np.ndarray:
    """Return (F, J, 3) the joints of all frames."""
    blocks = [slice(start, start + BLOCK_POSES) for start in range(0, len(solved.frames.transl), BLOCK_POSES)]
    return np.concatenate([_joints(solved.subject, solved, part) for part in blocks])


def _diagnose_steps(solved: SolvedFrames, problem: Problem, joints: np.ndarray) -> list[Diagnostic]:
    """Return where the person moves without a step, and that no foot stands."""
    names, seen = problem.body.layout.joints, problem.measurements.seen
    root, feet = joints[:, 0], joints[:, [names.index("left_ankle"), names.index("right_ankle")]]
    found: list[Diagnostic] = []
    runs = glides(root, feet, seen, problem.fps)
    if runs:
        size = max(float(np.linalg.norm(root[last, :2] - root[first, :2])) for first, last in runs)
        found.append(diagnostic("person_glides", frames=runs, size=size))
    if solved.contacts is not None and not solved.contacts[seen].mean() > STANDS_SHARE:
        found.append(diagnostic("feet_never_stand"))
    return found


def _joints(subject: Subject, solved: SolvedFrames, part: slice) -> np.ndarray:
    return np.asarray(to_numpy(pose(subject, solved.frames.select(part)).skeleton.joints))
