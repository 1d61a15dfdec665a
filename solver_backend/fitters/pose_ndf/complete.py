"""Edit poses with Pose-NDF: complete missing joints, denoise, interpolate (Tiwari et al. 2022, sec. 4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.states import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.pose_ndf.fit_keypoints import ManifoldWeights, PoseSequence, solve_sequence
from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.pose_ndf.pose_ndf import RECORDED_RAD, PoseNDF, ProjectionSettings
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
"""Groups of joints that may be named as missing, like single joints."""
_LOOKED_AT = 12  # Frames on which candidates are tried.


@dataclass(frozen=True)
class CompleteSettings:
    """Weights of (7) for missing joints, which alone move and have no observation."""

    manifold: float = 1.0  # w, 1/rad².
    smoothness: float = 2.0  # λ_t, 1/m², at 30 frames a second; chosen on takes of training subjects.
    iterations: int = 30  # Largest number of linearisations per chunk of frames.
    candidates: int = 64  # Samples of the prior whose limbs are tried.
    starts: int = 3  # Best candidates that are optimised; the cheapest result is kept.
    seed: int = 0


def missing_joints(names: Sequence[str]) -> tuple[int, ...]:
    """Return the columns of joints named one by one or by limb; raise ``JobInvalid`` for an unknown name, or none."""
    known = BODY_JOINTS
    unknown = [name for name in names if name not in LIMBS and name not in known]
    if unknown or not names:
        message = f"There is no joint or limb {', '.join(unknown)}." if unknown else "No joint is named as missing."
        raise JobInvalid(message, where="missing", hint=f"Limbs: {', '.join(LIMBS)}; joints: {', '.join(known)}.")
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
    """Return the poses with the missing joints close to the manifold; no other joint moves.

    The paper starts near rest, on which its result depends; here limbs of sampled poses are tried first.

    Args:
        subject: its landmarks measure smoothness.
        frames: F poses, arbitrary at the missing joints.
        missing: columns of the joints, see ``missing_joints``.

    Raises:
        PoseInvalid: known joints are NaN or off SO(3).
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
    """Return missing joints' rotations (starts, n, 3, 3) of the samples nearest to the manifold."""
    xp = array_namespace(frames.local)
    limbs = constant(prior.sample(settings.candidates, settings.seed)[:, list(missing)], frames.local)
    some = frames.select(slice(0, None, max(1, len(frames.local) // _LOOKED_AT)))
    cost = [xp.sum(prior.energy(_with_limb(some, missing, limb).local) ** 2) for limb in limbs]
    return limbs[xp.argsort(xp.stack(cost))[: settings.starts]]


def _with_limb(frames: PosedFrames, missing: tuple[int, ...], limb: Array) -> PosedFrames:
    """Return the poses with the missing joints at (n, 3, 3) rotations, the same in all frames."""
    xp = array_namespace(frames.local)
    columns = [frames.local[:, j] for j in range(frames.local.shape[1])]
    for number, joint in enumerate(missing):
        columns[joint] = xp.broadcast_to(limb[number], columns[joint].shape)
    return PosedFrames(frames.root, xp.stack(columns, axis=1), frames.transl)


WEIGHTS = ManifoldWeights(data=1.0, manifold=0.03, smoothness=2.0, level=0.5)
"""Chosen on takes of training subjects, clean and with noise of 6.5 degrees, at 30 frames a second."""


@dataclass(frozen=True)
class DenoiseSettings:
    """Weights of (7) at 30 frames per second, and how long to search."""

    weights: ManifoldWeights = WEIGHTS
    iterations: int = 20  # Largest number of linearisations per chunk of frames.
    move_root: bool = True  # Let the root move too; only smoothness and data hold it.


def denoise(
    subject: Subject,
    prior: PoseNDF,
    frames: PosedFrames,
    fps: float,
    settings: DenoiseSettings = DenoiseSettings(),
    progress: Progress = silent,
) -> PosedFrames:
    """Return the poses that minimise ``λ_v L_v + λ_θ L_θ + λ_t L_t`` (7), from the noisy ones.

    ``L_v`` and ``L_t`` use the subject's landmarks as its skin, ``L_θ`` is ``max(f - level, 0)²`` of the prior's
    distance f. ``λ_t`` grows with the square of ``fps``, so that a speed costs the same at every rate.

    Raises:
        PoseInvalid: poses are NaN or off SO(3).
    """
    xp = array_namespace(frames.local)
    observed, w = pose(subject, frames).points, settings.weights
    weights = replace(w, smoothness=w.smoothness * (fps / 30.0) ** 2)
    columns = range(frames.layout.dof)
    free = columns if settings.move_root else columns[frames.layout.joints]
    sequence = PoseSequence(subject, prior, weights, observed, xp.ones_like(observed[..., 0]), tuple(free))
    return solve_sequence(sequence, frames, settings.iterations, "Denoising", progress)[0]


ALONG = ProjectionSettings(level=RECORDED_RAD)
"""Recorded poses stay in place; closer to the manifold, steps would lead to the mean pose."""


def interpolate_poses(
    prior: PoseNDF,
    start: Array,
    end: Array,
    count: int,
    settings: ProjectionSettings = ALONG,
    progress: Progress = silent,
) -> Array:
    """Return (N, count, 21, 3, 3) poses on the manifold between pairs of (N, 21, 3, 3) poses, without the ends.

    ``θ_t = θ'_{t-1} + τ (θ'_T - θ'_{t-1})`` with ``τ = 1/(T - t + 1)`` along each joint's geodesic; (6) projects θ'.

    Raises:
        PoseInvalid: poses are NaN or off SO(3).
    """
    xp = array_namespace(start, end)
    here, target = prior.project(start, settings), prior.project(end, settings)
    found = []
    for step in range(count):
        share = 1.0 / (count + 1 - step)
        way = log_so3(xp.matmul(target, xp.matrix_transpose(here)))
        here = prior.project(xp.matmul(exp_so3(share * way), here), settings)
        found.append(here)
        progress("Interpolating", step + 1, count)
    return xp.stack(found, axis=1)
