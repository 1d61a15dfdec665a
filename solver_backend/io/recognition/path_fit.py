"""Place the path of a moving camera in a world in metres, from the filmed person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.body_evidence import MEAN_STATURE_M, STATURE_SPREAD_M
from solver_backend.agreement.evidence import FRAMES, MOST_ROUNDS
from solver_backend.biomechanics.support import SIGMA_M_S
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.camera_corrections import QUARTER, TURNS
from solver_backend.cameras.steady_camera import steady_camera
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.geometry.alignment import turn_to_z
from solver_backend.geometry.small_matrices import unit
from solver_backend.io.camera_paths import ESTIMATED, FilmedPath
from solver_backend.io.recognition.gravity import foot_keypoints
from solver_backend.priors.lifted_take import LiftedTake, lift_take, lowest_feet, up_by_floor
from solver_backend.types import Cameras, Keypoints2D

STEP_S = 0.2  # Time in seconds between compared foot positions.
ALONG_SIGHT = 10.0  # Error of lifted feet along the line of sight relative to the error across it.
BIAS, UNSURE = 0.02, 0.2
"""Relative scale error that more frames do not reduce, and relative standard deviation that causes a warning. The bias
is the RMS error of 22 simulated walks (subjects 02, 07, 12, 16 and 35, known statures, ``SIGMA_M_S`` of 0.15 m/s)."""


def fit_path(
    camera: Cameras, keypoints: Keypoints2D, path: FilmedPath, stature_m: float = 0.0
) -> tuple[Cameras, Diagnostic]:
    """Place a moving camera in a world with Z up and the floor under the person. Return a diagnostic too.

    The up direction comes from lifting the person to 3D. The scale and the slope of the floor come from standing feet.
    An up direction or metres in the path's file have priority. A stature of 0 means an average adult.
    """
    body = load_body()
    landmarks = keypoint_landmarks(body, keypoints.joint_set)
    turns, lifted = path.R, lift_take(replace(camera, path=None), keypoints, body)
    up = unit(_mean_up(lifted, turns)) if path.up is None else path.up
    if path.up is not None:  # phones state the pose of their sensor, which is rotated in a portrait video
        quarters = [np.linalg.matrix_power(QUARTER, turn) for turn in TURNS]
        turns = turns @ max(quarters, key=lambda quarter: float(up @ _mean_up(lifted, path.R @ quarter)))
    centre = path.centre - path.centre[0]
    for again in (True, False):
        Q = turn_to_z(up)
        R, centre = np.swapaxes(Q @ turns, -1, -2), centre @ Q.T
        turns = Q @ turns
        steady, seen = steady_camera(camera.carried(R, -np.einsum("fab,fb->fa", R, centre)), keypoints)
        V, _ = steady.poses(0, len(R))
        lifted = lift_take(steady, seen, body, up=V[:, :, 2] if path.up is not None or not again else None)
        size = stature_m / body.stature_m if stature_m else 1.0
        from_camera = size * lifted.placed(body, landmarks, np.zeros(10))[0] @ V
        shown = lifted.confidence > 0
        feet = foot_keypoints(np.where(shown[..., None], from_camera, np.nan), keypoints.joint_set)
        feet.sort(key=lambda k: keypoints.joint_set.keypoints[k])  # by side
        # The rays of the detections, because lifted feet are smoothed and move while they stand.
        depth = np.where(shown, np.einsum("fka,fa->fk", from_camera, V[:, 2]), np.nan)[:, feet, None]
        visible = depth * (np.insert(lifted.image[:, feet], 2, 1.0, axis=-1) @ V)
        scale, sigma = scale_by_feet(visible, centre, (lifted.view.sight[:, None, 2] @ V)[:, 0], keypoints.fps)
        points = from_camera + (path.metres or scale) * centre[:, None]
        if path.up is not None or not again:
            break
        up = up_by_floor(lifted, points, landmarks.names, unit(_mean_up(lifted, V.swapaxes(-1, -2))))
    sigma = float(np.hypot(sigma, 0.0 if stature_m else STATURE_SPREAD_M / MEAN_STATURE_M))
    floor = lowest_feet(points, landmarks.names, shown) or 0.0
    places = (path.metres or scale) * centre - [0.0, 0.0, floor]
    carried = float(np.linalg.norm(np.diff(places[:: max(1, round(STEP_S * keypoints.fps))], axis=0), axis=1).sum())
    unsure = not path.metres and UNSURE < sigma < np.inf  # the scale of a static camera does not matter
    figures = {"length": carried, "share": 100.0 * sigma, "source": path.source}
    severity = Severity.WARNING if unsure else Severity.NOTE
    how = "scaled" if unsure else "metric" if path.metres else "followed"
    how = "estimated" if path.source == ESTIMATED else how
    found = diagnostic("camera_moves", path=how, cameras=list(camera.names), severity=severity, **figures)
    return camera.carried(R, -np.einsum("fab,fb->fa", R, places)), found


def _mean_up(lifted: LiftedTake, turns: np.ndarray) -> np.ndarray:
    weight = lifted.confidence.sum(axis=1)
    return np.einsum("f,fab,fb->a", weight, turns, lifted.view.up)


def scale_by_feet(feet: np.ndarray, centre: np.ndarray, sight: np.ndarray, fps: float) -> tuple[float, float]:
    """Estimate the metres per unit of a camera path from standing feet, and the relative standard deviation.

    The scale s minimises ``Σ_f min_j Σ_k ρ(|Δp_jk + s Δc| / Δt)``. Here Δ is the change after a time Δt from frame f,
    p_jk is point k of foot j, c is the camera position, and ρ is the function of Geman and McClure with the scale
    ``SIGMA_M_S``. The minimum over the feet is used because a walking person always has a standing foot. The points of
    this foot only creep forwards, so a wide ρ, or only the slowest point, would underestimate s. A static camera gets
    the scale 1 with an infinite deviation.

    Args:
        feet: (F, K, 3) points of one foot, then of the other, relative to the camera in world axes, metres, NaN where
            undetected.
        centre: (F, 3) camera positions in the unit of the path.
        sight: (F, 3) unit directions from the camera to the person.
    """
    gap = max(1, round(STEP_S * fps))
    seconds = gap / fps
    moved, carried = feet[gap:] - feet[:-gap], centre[gap:] - centre[:-gap]
    known, along = np.isfinite(moved).all(axis=-1), sight[gap:]

    def whitened(steps: np.ndarray, sight: np.ndarray) -> np.ndarray:
        part = (steps * sight).sum(-1, keepdims=True) * sight
        return (steps - (1.0 - 1.0 / ALONG_SIGHT) * part) / seconds

    a, b = whitened(np.where(known[..., None], moved, 0.0), along[:, None]), whitened(carried, along)
    aa, ab, bb = (a**2).sum(-1), np.einsum("fka,fa->fk", a, b), (b**2).sum(-1)

    def squares(scale: float) -> np.ndarray:
        return np.where(known, aa + 2.0 * scale * ab + (scale**2 * bb)[:, None], np.inf)

    def planted(scale: float) -> np.ndarray:
        """Return (F, K) weights from 0 to 1 of the points on the foot that stands more firmly."""
        stands = (SIGMA_M_S**2 / (SIGMA_M_S**2 + squares(scale))).reshape(len(known), 2, -1)
        firm = stands.sum(axis=2, keepdims=True)
        return np.where(firm == firm.max(axis=1, keepdims=True), stands, 0.0).reshape(known.shape)

    def cost(scale: float) -> float:
        return -float(planted(scale).sum())

    each = -ab / np.maximum(bb, 1e-18)[:, None]  # scale at which each foot stands in each frame
    each = each[known & (each > 0)]
    if not len(each):
        return 1.0, np.inf
    best = min(np.quantile(each, np.linspace(0.0, 1.0, FRAMES)), key=cost)
    weight, information = np.zeros(known.shape), 0.0
    for _ in range(MOST_ROUNDS):
        weight = planted(best) ** 2
        information = float((weight * bb[:, None]).sum())
        best = max(-float((weight * ab).sum()) / max(information, 1e-12), 1e-9)
    spread = float((weight * squares(best).clip(0.0, 1e6)).sum() / max(weight.sum(), 1e-9)) / 2.0
    sigma = np.sqrt(spread * max(1.0, STEP_S * fps) / max(information, 1e-12)) / best
    return best, float(np.hypot(sigma, BIAS))
