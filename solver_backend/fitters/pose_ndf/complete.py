"""Completion of poses in which some joints are not known (Tiwari et al. 2022, sec. 4.2, "Fitting to partial data")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from array_api_compat import array_namespace

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.pose_ndf.sequence_equations import ManifoldWeights, PoseSequence
from solver_backend.fitters.pose_ndf.sequence_solver import solve_sequence
from solver_backend.geometry.arrays import Array, constant
from solver_backend.priors.pose_ndf.pose_ndf import PoseNDF
from solver_backend.priors.weights import BODY_JOINTS

_SIDED = {
    "arm": ("shoulder", "elbow", "wrist"),
    "shoulder_and_arm": ("collar", "shoulder", "elbow", "wrist"),
    "leg": ("hip", "knee", "ankle", "foot"),
}
LIMBS: dict[str, tuple[str, ...]] = {
    **{f"{s}_{limb}": tuple(f"{s}_{j}" for j in joints) for limb, joints in _SIDED.items() for s in ("left", "right")},
    "trunk": ("spine1", "spine2", "spine3"),
    "head_and_neck": ("neck", "head"),
}
"""Groups of joints that may be named as missing, beside single joints."""
_LOOKED_AT = 12
"""Frames of a take that the candidates are tried on."""


@dataclass(frozen=True)
class CompleteSettings:
    """Weights of (7), where nothing but the missing joints moves and nothing of them is observed."""

    manifold: float = 1.0
    """w, 1/rad²."""
    smoothness: float = 2.0
    """λ_t, 1/m², at 30 frames a second; chosen on takes of training subjects."""
    iterations: int = 30
    """Linearisations at most for each chunk of frames."""
    candidates: int = 64
    """Samples of the prior whose limbs are tried in place of the missing ones."""
    starts: int = 3
    """Candidates, those that fit best, that are started from; the one that ends with the least cost is kept."""
    seed: int = 0
    """Of the samples."""


def missing_joints(names: Sequence[str]) -> tuple[int, ...]:
    """Return the columns of joints named one by one or by limb.

    Raises:
        JobInvalid: an unknown name, or none.
    """
    known = BODY_JOINTS
    unknown = [name for name in names if name not in LIMBS and name not in known]
    if unknown or not names:
        raise JobInvalid(
            f"There is no joint or limb {', '.join(unknown)}." if unknown else "No joint is named as missing.",
            where="missing", hint=f"Limbs: {', '.join(LIMBS)}; joints: {', '.join(known)}.",
        )  # fmt: skip
    joints = {joint for name in names for joint in LIMBS.get(name, (name,))}
    return tuple(column for column, joint in enumerate(known) if joint in joints)


def complete(
    subject: Subject,
    prior: PoseNDF,
    frames: PosedFrames,
    missing: tuple[int, ...],
    fps: float,
    settings: CompleteSettings = CompleteSettings(),
    progress: Progress = silent,
) -> PosedFrames:
    """Return the poses with the missing joints' rotations found near the manifold; nothing else moves.

    The paper starts near rest and finds that the result hangs on it; here limbs of sampled poses are tried first.

    Args:
        subject: body, shape and the landmarks in which smoothness is measured.
        prior: whose distance is minimised.
        frames: F poses; what stands for the missing joints is not looked at.
        missing: columns of the joints, see ``missing_joints``.
        fps: frames per second.
        settings: weights and starts.
        progress: called as chunks of frames are done.

    Raises:
        PoseInvalid: known joints that are NaN or off SO(3).
    """
    best, least, layout = None, float("inf"), frames.layout
    for number, limb in enumerate(_starts(prior, frames, missing, settings)):
        start = _with_limb(frames, missing, limb)
        observed = pose(subject, start).points
        weights = ManifoldWeights(0.0, settings.manifold, settings.smoothness * (fps / 30.0) ** 2)
        free = tuple(column for joint in missing for column in range(layout.dof)[layout.joint(joint)])
        sequence = PoseSequence(subject, prior, weights, observed, observed[..., 0] * 0.0, free)
        name = f"Completing {number + 1}/{settings.starts}"
        found, cost = solve_sequence(sequence, start, settings.iterations, name, progress)
        if best is None or float(cost[0]) < least:
            best, least = found, float(cost[0])
    assert best is not None
    return best


def _starts(prior: PoseNDF, frames: PosedFrames, missing: tuple[int, ...], settings: CompleteSettings) -> Array:
    """Return the missing joints' rotations (starts, n, 3, 3) of those samples that lie nearest to the manifold."""
    xp = array_namespace(frames.local)
    limbs = constant(prior.sample(settings.candidates, settings.seed)[:, list(missing)], frames.local)
    some = frames.select(slice(0, None, max(1, len(frames.local) // _LOOKED_AT)))
    cost = [xp.sum(prior.energy(_with_limb(some, missing, limb).local) ** 2) for limb in limbs]
    return limbs[xp.argsort(xp.stack(cost))[: settings.starts]]


def _with_limb(frames: PosedFrames, missing: tuple[int, ...], limb: Array) -> PosedFrames:
    """Return the poses with the (n, 3, 3) rotations of the missing joints, the same in all frames."""
    xp = array_namespace(frames.local)
    columns = [frames.local[:, j] for j in range(frames.local.shape[1])]
    for number, joint in enumerate(missing):
        columns[joint] = xp.broadcast_to(limb[number], columns[joint].shape)
    return PosedFrames(frames.root, xp.stack(columns, axis=1), frames.transl)
