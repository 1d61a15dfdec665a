"""What the primitives are fitted to: settings, regions, samples and first guesses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from assets_procedural.surface.reference import Reference
from assets_procedural.surface.sampling import signed_distance

_SHARE = {"body": 0.30, "skull": 0.06, "face": 0.19, "eye": 0.13, "mouth": 0.09, "hand": 0.14, "foot": 0.09}
"""Samples of each part in hundred thousands; more than their area where the shape is fine; chosen by hand."""


@dataclass(frozen=True)
class FitSettings:
    """How the primitives are spread and optimised."""

    regions: tuple[tuple[str, int, float], ...] = (
        ("body", 120, 0.022),
        ("skull", 24, 0.020),
        ("face", 150, 0.005),
        ("eye", 56, 0.003),
        ("mouth", 40, 0.003),
        ("hand", 110, 0.005),
        ("foot", 56, 0.007),
    )
    """Name, number of Gaussians and depth of their first centres under the skin, metres."""
    iterations: int = 6000
    seed: int = 0


@dataclass(frozen=True)
class Samples:
    """What the field must satisfy."""

    surface: np.ndarray
    normals: np.ndarray
    near: np.ndarray
    near_distance: np.ndarray
    far: np.ndarray
    far_sign: np.ndarray


def regions_of(reference: Reference) -> dict[str, np.ndarray]:
    """Return a mask of the samples for each region of the half body."""
    p, wrist = reference.points, reference.bones["wrist.L"][0]
    ear = (p[:, 0] > 0.062) & (p[:, 1] > 1.49) & (p[:, 1] < 1.63) & (p[:, 0] < 0.12)
    head = (p[:, 1] > 1.45) & (p[:, 0] < 0.2)
    face = head & ((p[:, 2] > 0.062) | ear)
    hand, foot = p[:, 0] > wrist + 0.015, p[:, 1] < 0.08
    eye = np.linalg.norm(p - reference.bones["eye.L"] - [0.0, 0.0, 0.006], axis=1) < 0.024
    mouth = np.linalg.norm((p - [0.0, 1.521, 0.13]) / [0.030, 0.017, 0.035], axis=1) < 1.0
    rest = face & ~(eye | mouth)
    masks = {"body": ~(head | hand | foot), "skull": head & ~face, "face": rest, "eye": eye, "mouth": mouth & ~eye}
    return masks | {"hand": hand, "foot": foot}


def draw_samples(reference: Reference, settings: FitSettings) -> Samples:
    """Draw surface, near-surface and volume samples, denser where the shape is fine."""
    rng = np.random.default_rng(settings.seed)
    region = regions_of(reference)
    picks = [rng.choice(np.nonzero(region[name])[0], int(share * 100_000)) for name, share in _SHARE.items()]
    chosen = np.concatenate(picks)
    surface, normals = reference.points[chosen], reference.normals[chosen]
    fine = ~(region["body"] | region["skull"])[chosen]
    radius = np.where(fine, 0.010, 0.030)
    near = surface + rng.normal(size=surface.shape) * 0.6 * radius[:, None]
    near[:, 0] = np.abs(near[:, 0])
    around = rng.integers(0, len(reference.points), 160_000)
    volume = reference.points[around] - rng.uniform(-0.06, 0.09, (len(around), 1)) * reference.normals[around]
    volume[:, 0] = np.abs(volume[:, 0])
    depth = signed_distance(reference.points, reference.normals, volume)
    inside = np.nonzero(depth < -0.006)[0][:16_000]
    outside = np.nonzero(depth > 0.006)[0][:20_000]
    far = volume[np.concatenate([inside, outside])]
    return Samples(
        surface,
        normals,
        near,
        signed_distance(reference.points, reference.normals, near),
        far,
        np.concatenate([np.ones(len(inside)), -np.ones(len(outside))]),
    )


def first_guess(reference: Reference, settings: FitSettings) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and log-scales by k-means of inset samples, region by region."""
    rng = np.random.default_rng(settings.seed + 1)
    masks, centres, scales = regions_of(reference), [], []
    for name, count, inset in settings.regions:
        points = (reference.points - inset * reference.normals)[masks[name]]
        points = points[points[:, 0] > -0.001]
        points = points[rng.choice(len(points), min(len(points), 15_000), replace=False)]
        centre = points[rng.choice(len(points), count, replace=False)]
        owner = KDTree(centre).query(points)[1]
        for _ in range(15):
            centre = np.stack([points[owner == k].mean(0) if np.any(owner == k) else centre[k] for k in range(count)])
            owner = KDTree(centre).query(points)[1]
        spread = [points[owner == k].std(0) if np.sum(owner == k) > 3 else np.full(3, inset) for k in range(count)]
        centres.append(centre)
        scales.append(np.log(0.9 * np.clip(spread, 0.5 * inset, 0.1)))
    return np.concatenate(centres), np.concatenate(scales)
