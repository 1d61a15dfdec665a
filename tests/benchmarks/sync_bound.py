"""Accuracy limits for the clocks of ``bench_sync``: ``python -m tests.benchmarks.sync_bound [SEED...]``.

The output has the Cramér-Rao bound of delays and drifts, in frames at the worst time of the take. It also has the
errors of an optimal estimate from the actual detections. The chance is the probability that such an estimate has all
cameras within ``BOUND_FRAMES`` for new random detections. Known are the motion of points and the detector's noise:
standard deviation per view and keypoint, correlation time, hidden keypoints, and wrong detections. Unknown are the
clocks, the cameras' poses, biases by view direction, and the points' positions in every frame. Further rows assume that
one of these is known. The prior of the rates has mean 0, as in a real estimate.

Noise is white plus first-order autoregressive, so a Kalman filter whitens it exactly, including gaps. The points have
white noise of one metre along the cameras' Jacobians.

Reference: Kay 1993, sec. 3.9 (the bound for Gaussian noise), and Durbin and Koopman 2012, sec. 6.2 (regression by the
filter).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np

from research.simulation import filming
from research.simulation.filming import FilmSettings
from solver_backend.agreement.lags import RATE_SIGMA
from solver_backend.cameras.projection import project, project_with_jacobian
from solver_backend.synthesis.faults import MEASURED_DETECTOR, DetectorFaults
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.simulation.keypoint_detector import DetectorOutput, delayed, px_per_mm
from solver_backend.types import Cameras
from tests.benchmarks import bench_sync

BIAS_MM2 = 9.0**2 * np.array([0.2, 0.4, 0.4, 0.4, 0.4])
"""Variance of a bias by direction: constant, and cosine and sine of the angle and of its double."""
TURN_SIGMA, SHIFT_SIGMA_M, POINT_SIGMA_M = 0.02, 0.05, 1.0
"""Prior standard deviations of the cameras' poses and of points."""
KNOWN, DRAWS = 1e6, 100_000  # Factor of the precision of a known part, and number of samples for the chance.


@dataclass(frozen=True)
class Filmed:
    """Detections of a seed with their truth, in millimetres at the person, in the F frames that all cameras see."""

    error: np.ndarray  # (C, F, K, 2) errors, NaN for missing detections and outliers.
    spread: np.ndarray  # (C, F, K) scale of the noise, in standard deviations of the detector's model.
    velocity: np.ndarray  # (C, F, K, 2) velocities per second.
    by_point: np.ndarray  # (C, F, K, 2, 3) derivatives by the point's position, per metre.
    by_pose: np.ndarray  # (C, F, K, 2, 6) derivatives by the camera's pose, per radian and metre.
    facing: np.ndarray  # (C, F, 5) basis functions of biases by direction.
    rate: np.ndarray  # (C,) true rates.
    fps: float


def filmed(seed: int) -> Filmed:
    """Return the recording that ``bench_sync`` simulates for this seed."""
    kept: list[tuple[Person, Cameras, FilmSettings, DetectorOutput]] = []
    hidden: list[np.ndarray] = []
    film, out_of_sight = filming.film, filming._out_of_sight

    def keeping(person: Person, cameras: Cameras, settings: FilmSettings, rng: np.random.Generator) -> DetectorOutput:
        found = film(person, cameras, settings, rng)
        kept.append((person, cameras, settings, found))
        return found

    def keeping_hidden(*told: object) -> np.ndarray:
        hidden.append(out_of_sight(*told))  # type: ignore[arg-type]
        return hidden[0]

    with patch.object(bench_sync, "film", keeping), patch.object(filming, "_out_of_sight", keeping_hidden):
        take = bench_sync.filmed_by_hand(seed)
    [(person, cameras, settings, found)] = kept
    posed = person.landmarks(settings.joint_set, settings.offsets)
    assert settings.delays is not None
    _, by_point, _ = project_with_jacobian(cameras, posed.points)
    seen = project(cameras, posed.points)
    seen = np.stack([delayed(track, delay) for track, delay in zip(seen, settings.delays, strict=True)])
    scale = px_per_mm(cameras, posed.points)[..., None]
    error = np.where((found.swapped | found.outlier)[..., None], np.nan, (found.xy - seen) / scale)
    model = settings.detector
    worse = np.where(hidden[0], model.occluded_jitter, 1.0)
    steady = error - np.nanmean(error, axis=1, keepdims=True)
    uneven = np.sqrt(np.nanmean((steady / worse[..., None]) ** 2, axis=(1, 3), keepdims=True))[..., 0]
    in_camera = np.einsum("cij,fkj->cfki", cameras.R, posed.points) + cameras.t[:, None, None]
    by_shift = np.einsum("cfkij,clj->cfkil", by_point, cameras.R)
    by_turn = np.cross(in_camera[..., None, :], by_shift)
    way = cameras.centres[:, None] - posed.skeleton.joints[None, :, 0]
    body_way = np.einsum("fij,cfi->cfj", person.orient, way)
    angle = np.arctan2(body_way[..., 0], body_way[..., 2])
    facing = np.stack([np.ones_like(angle), *(f(n * angle) for n in (1, 2) for f in (np.cos, np.sin))], axis=-1)
    first = error.shape[1] - 1 - min(len(track) for track in take.filmed.tracks)
    return Filmed(
        error[:, first:], (worse * uneven / np.hypot(model.drift_mm, model.jitter_mm))[:, first:],
        (np.gradient(seen, axis=1) / scale * settings.fps)[:, first:], (by_point / scale[..., None])[:, first:],
        (np.concatenate([by_turn, by_shift], axis=-1) / scale[..., None])[:, first:], facing[:, first:], take.rate,
        settings.fps,
    )  # fmt: skip


def information(take: Filmed, model: DetectorFaults, *, free: bool) -> np.ndarray:
    """Return (K, 1 + N, 1 + N) information about errors and N unknowns: delays C, drifts C, poses 6 C, biases 10."""
    views, frames, keypoints = take.error.shape[:3]
    rows, place = 2 * views, np.linspace(-1.0, 1.0, frames)
    memory = float(np.exp(-1.0 / (model.drift_s * take.fps)))
    diagonal = np.arange(rows)
    unknowns = 8 * views + 10
    mean = np.zeros((keypoints, rows, 1 + unknowns))
    variance = np.tile(model.drift_mm**2 * np.eye(rows), (keypoints, 1, 1))
    total = np.zeros((keypoints, 1 + unknowns, 1 + unknowns))
    for f in range(frames):
        columns = np.zeros((keypoints, views, 2, 1 + unknowns))
        columns[..., 0] = take.error[:, f].swapaxes(0, 1)
        for c in range(views):
            columns[:, c, :, 1 + c] = take.velocity[c, f]
            columns[:, c, :, 1 + views + c] = take.velocity[c, f] * place[f]
            columns[:, c, :, 1 + 2 * views + 6 * c : 7 + 2 * views + 6 * c] = take.by_pose[c, f]
            for axis in range(2):
                first = 1 + 8 * views + 5 * axis
                columns[:, c, axis, first : first + 5] = take.facing[c, f]
        spread = np.repeat(take.spread[:, f].T, 2, axis=1)
        columns = columns.reshape(keypoints, rows, -1) / spread[..., None]
        known = np.isfinite(columns[..., 0])
        columns = np.where(known[..., None], columns, 0.0)
        new = np.zeros((keypoints, rows, rows))
        new[:, diagonal, diagonal] = np.where(known, model.jitter_mm**2, 1.0)
        if free:
            J = take.by_point[:, f].swapaxes(0, 1).reshape(keypoints, rows, 3) / spread[..., None]
            J = np.where(known[..., None], POINT_SIGMA_M * J, 0.0)
            new += J @ J.swapaxes(1, 2)
        seen = np.zeros((keypoints, rows, rows))
        seen[:, diagonal, diagonal] = known
        gained = seen @ variance
        surprise = columns - seen @ mean
        solved = np.linalg.solve(gained @ seen + new, np.concatenate([surprise, gained], axis=-1))
        total += surprise.swapaxes(1, 2) @ solved[..., : 1 + unknowns]
        gain = solved[..., 1 + unknowns :].swapaxes(1, 2)
        mean = memory * (mean + gain @ surprise)
        variance = memory**2 * (variance - gain @ gained)
        variance = 0.5 * (variance + variance.swapaxes(1, 2))
        variance[:, diagonal, diagonal] += model.drift_mm**2 * (1.0 - memory**2)
    return total


def bound_frames(take: Filmed, total: np.ndarray, told: str = "") -> tuple[np.ndarray, np.ndarray, float]:
    """Return the (C - 1,) deviations and estimated errors of the other cameras' clocks, and the chance of the bound.

    With the information ``I`` of the detections, the prior's ``P`` and true drifts x, the error is ``(I + P)⁻¹ (g - P
    x)``. g has the covariance I. ``told`` is the known part: "biases", "cameras", "rates" or nothing.
    """
    views, size = len(take.error), 1 + 8 * len(take.error)
    known = {what: KNOWN if what == told else 1.0 for what in ("biases", "cameras", "rates")}
    biases = total[:, size:, size:] + known["biases"] * np.diag(np.tile(1.0 / BIAS_MM2, 2))
    across = total[:, size:, :size]
    reduced = (total[:, :size, :size] - across.swapaxes(1, 2) @ np.linalg.solve(biases, across)).sum(axis=0)
    half_s = 0.5 * take.error.shape[1] / take.fps
    poses = known["cameras"] * np.tile(np.repeat([TURN_SIGMA**-2, SHIFT_SIGMA_M**-2], 3), views)
    normal = reduced[1:, 1:] + np.diag(np.concatenate([np.zeros(2 * views), poses]))
    against, pull = np.zeros((views - 1, 2, len(normal))), np.zeros(len(normal))
    for c in range(1, views):
        against[c - 1, :, [c, views + c]] = np.eye(2)
        against[c - 1, :, [0, views]] = -np.eye(2)
        precision = known["rates"] / (RATE_SIGMA * half_s) ** 2
        normal += precision * np.outer(against[c - 1, 1], against[c - 1, 1])
        # A fast clock shows earlier times, which is a drift of -rate. The prior of rate 0 pulls it by +rate.
        pull += (0.0 if told == "rates" else precision * take.rate[c] * half_s) * against[c - 1, 1]
    # The first camera's clock is the reference. With free points, it cannot be distinguished from the others.
    normal += 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
    covariance = np.linalg.inv(normal)
    moments = take.fps * np.stack([against[:, 0] + s * against[:, 1] for s in (-1.0, 0.0, 1.0)])
    sigma = np.sqrt(np.einsum("mci,ij,mcj->mc", moments, covariance, moments)).max(axis=0)
    off = np.abs(moments @ covariance @ (reduced[1:, 0] + pull)).max(axis=0)
    by_clocks = (moments @ covariance).reshape(-1, len(normal))
    drawn = np.random.default_rng(0).multivariate_normal(
        by_clocks @ pull, by_clocks @ reduced[1:, 1:] @ by_clocks.T, DRAWS, check_valid="ignore", method="eigh"
    )
    return sigma, off, float((np.abs(drawn) <= bench_sync.BOUND_FRAMES).all(axis=1).mean())


def main(argv: list[str]) -> int:
    """Print the bounds of the given seeds, or of all, and the chance that all of them are within the bound."""
    model = MEASURED_DETECTOR
    chances: dict[str, float] = {}
    for seed in map(int, argv or range(bench_sync.SEEDS)):
        take = filmed(seed)
        free, given = (information(take, model, free=free) for free in (True, False))
        rows = {"nothing": (free, ""), "biases": (free, "biases"), "cameras": (free, "cameras")}
        rows |= {"rates": (free, "rates"), "points": (given, "")}
        for what, (total, told) in rows.items():
            sigma, off, chance = bound_frames(take, total, told)
            chances[what] = chances.get(what, 1.0) * chance
            sys.stdout.write(
                f"seed {seed}: told {what}: {np.round(sigma, 3)}, left {np.round(off, 3)} frames, chance {chance:.3f}\n"
            )
        sys.stdout.flush()
    sys.stdout.write("all: " + ", ".join(f"told {what} {chance:.2f}" for what, chance in chances.items()) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
