"""Fit primitives to the CC0 reference body: ``python -m training.body.fit`` (needs anny and torch)."""

from __future__ import annotations

import argparse
import logging
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from assets_procedural.primitives import NUMBERS, Primitives
from solver_backend.exchange.outputs import atomic_output
from training.body.reference import Reference, load_reference, sample_density, signed_distance

_SHARE = {"body": 0.30, "skull": 0.06, "face": 0.19, "eye": 0.13, "mouth": 0.09, "hand": 0.14, "foot": 0.09}
"""Samples per part, in hundred thousands. Detailed parts get more samples than their area suggests. Chosen by hand."""


@dataclass(frozen=True)
class FitSettings:
    """Settings for fitting primitives: their initial distribution, and the optimisation."""

    regions: tuple[tuple[str, int, float], ...] = (
        ("body", 120, 0.022),
        ("skull", 24, 0.020),
        ("face", 150, 0.005),
        ("eye", 56, 0.003),
        ("mouth", 40, 0.003),
        ("hand", 110, 0.005),
        ("foot", 56, 0.007),
    )
    """For each region: name, number of Gaussians, and depth of their initial centres below the skin in metres."""
    iterations: int = 6000
    seed: int = 0


@dataclass(frozen=True)
class Samples:
    """Training samples of the body's field: on the surface, near it and in the volume. Lengths are in metres."""

    surface: np.ndarray
    normals: np.ndarray
    near: np.ndarray
    near_distance: np.ndarray
    far: np.ndarray
    far_sign: np.ndarray


def regions_of(reference: Reference) -> dict[str, np.ndarray]:
    """Return a mask (N,) of the samples in each region of the half body, by region name."""
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
    """Draw samples on the surface, near it and in the volume. Detailed parts of the shape get more samples."""
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
    near_distance = signed_distance(reference.points, reference.normals, near)
    sign = np.concatenate([np.ones(len(inside)), -np.ones(len(outside))])
    return Samples(surface, normals, near, near_distance, far, sign)


def first_guess(reference: Reference, settings: FitSettings) -> tuple[np.ndarray, np.ndarray]:
    """Cluster samples below the skin by k-means in each region. Return initial centres and log scales."""
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


_LOG = logging.getLogger(__name__)
_NEIGHBOURS, _POOL, _BATCH = 32, 14_000, 1_600
_STRAY_M, _LOST_M = 0.0015, 0.004
_MIN_SCALE, _MAX_SCALE = 0.0018, 0.14


class _Model:
    """Torch parameters of the left half, and the field that they define."""

    def __init__(self, torch: Any, centres: np.ndarray, log_scales: np.ndarray) -> None:
        def leaf(value: np.ndarray) -> Any:
            return torch.tensor(value, dtype=torch.float32, requires_grad=True)

        self.torch, self.count = torch, len(centres)
        self.mean, self.log_scale = leaf(centres), leaf(log_scales)
        self.rotation, self.log_weight = leaf(np.zeros((len(centres), 3))), leaf(np.full(len(centres), -0.2))
        self.mirror = torch.tensor([-1.0, 1.0, 1.0])

    def both_halves(self) -> tuple[Any, Any, Any]:
        torch, axis = self.torch, self.rotation
        angle = (axis * axis).sum(1, keepdim=True).add(1e-12).sqrt()
        x, y, z = (axis / angle).unbind(1)
        o = torch.zeros_like(x)
        cross = torch.stack([o, -z, y, z, o, -x, -y, x, o], 1).view(-1, 3, 3)
        sine, cosine = torch.sin(angle)[:, :, None], torch.cos(angle)[:, :, None]
        turn = torch.eye(3) + sine * cross + (1 - cosine) * (cross @ cross)
        whiten = torch.exp(-self.log_scale)[:, :, None] * turn.transpose(1, 2)
        parts = (self.mean, self.mean * self.mirror), (whiten, whiten * self.mirror), (self.log_weight,) * 2
        mean, both, weight = (torch.cat(halves) for halves in parts)
        return mean, both, weight

    def strongest(self, points: Any) -> Any:
        """Return the indices (N, 32) of the primitives that have the largest weights at each point."""
        torch = self.torch
        with torch.no_grad():
            mean, whiten, weight = self.both_halves()
            flat, origin = whiten.reshape(-1, 3), (whiten @ mean[:, :, None])[..., 0].reshape(-1)
            found = []
            for part in torch.split(points, 4000):
                y = (part @ flat.T - origin).view(len(part), -1, 3)
                found.append((weight - 0.5 * (y * y).sum(-1)).topk(_NEIGHBOURS, 1).indices)
        return torch.cat(found)

    def log_field(self, points: Any, near: Any, halves: tuple[Any, Any, Any]) -> tuple[Any, Any]:
        mean, whiten, weight = halves
        y = self.torch.matmul(whiten[near], (points[:, None] - mean[near])[..., None])
        share = self.torch.exp(weight[near] - 0.5 * (y[..., 0] ** 2).sum(-1))
        total = share.sum(1) + 1e-7
        pulled = self.torch.matmul(whiten[near].transpose(-1, -2), y)[..., 0]
        return total.log(), -(share[..., None] * pulled).sum(1) / total[:, None]


def fit(reference: Reference, settings: FitSettings) -> dict[str, np.ndarray]:
    """Fit the parameters of the left half to sampled distances, normals and signs, using Adam."""
    import torch

    torch.manual_seed(settings.seed)
    torch.set_num_threads(max(1, int(os.environ.get("OMP_NUM_THREADS", "1"))))
    rng = np.random.default_rng(settings.seed + 2)
    samples, model = draw_samples(reference, settings), _Model(torch, *first_guess(reference, settings))
    rates = {"mean": 1e-3, "log_scale": 1e-2, "rotation": 1.5e-2, "log_weight": 1e-2}
    optimiser = torch.optim.Adam([{"params": [getattr(model, key)], "lr": rate} for key, rate in rates.items()])

    def pool(*arrays: np.ndarray) -> tuple[Any, ...]:
        pick = rng.choice(len(arrays[0]), _POOL, replace=False)
        kept = [torch.tensor(a[pick], dtype=torch.float32) for a in arrays]
        return (*kept, model.strongest(kept[0]))

    groups: list[tuple[Any, ...]] = []
    for step in range(settings.iterations):
        if step % 300 == 0:
            near = pool(samples.near, samples.near_distance)
            groups = [pool(samples.surface, samples.normals), near, pool(samples.far, samples.far_sign)]
        done = step / settings.iterations
        decay = 1.0 if done < 0.4 else 0.5 * (1 + np.cos(np.pi * (done - 0.4) / 0.6)) + 0.01
        for group, rate in zip(optimiser.param_groups, rates.values(), strict=True):
            group["lr"] = rate * decay
        if step in (settings.iterations * 3 // 10, settings.iterations * 6 // 10, settings.iterations * 8 // 10):
            _reseed(model, reference, rng)
        pick = torch.randint(_POOL, (_BATCH,))
        loss, error, cosine = _loss(model, [[a[pick] for a in group] for group in groups])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        with torch.no_grad():
            model.log_scale.clamp_(np.log(_MIN_SCALE), np.log(_MAX_SCALE))
            model.mean[:, 0].clamp_(min=0.0)
        if step % 500 == 0 or step == settings.iterations - 1:
            _LOG.info("step %d: surface error %.3f mm, normals %.4f", step, 1e3 * error, cosine)
    kept = ~_strayed(model, reference, _LOST_M)
    return {key: getattr(model, key).detach().numpy()[kept] for key in rates}


def _strayed(model: _Model, reference: Reference, limit_m: float) -> np.ndarray:
    """Return a mask of the primitives with centres outside the body, which only produce specks."""
    return signed_distance(reference.points, reference.normals, model.mean.detach().double().numpy()) > limit_m


def _reseed(model: _Model, reference: Reference, rng: np.random.Generator) -> None:
    """Move primitives outside the body to the points where the skin fits worst, and reset them."""
    torch, strayed = model.torch, np.nonzero(_strayed(model, reference, _STRAY_M))[0]
    pick = rng.choice(len(reference.points), 20_000, replace=False)
    points = torch.tensor(reference.points[pick], dtype=torch.float32)
    with torch.no_grad():
        value, gradient = model.log_field(points, model.strongest(points), model.both_halves())
        worst = (value / (gradient.norm(dim=1) + 1e-3)).abs().argsort(descending=True)[: 40 * len(strayed) : 40]
        index = pick[worst.numpy()]
        centre = reference.points[index] - 0.003 * reference.normals[index]
        model.mean[strayed] = torch.tensor(centre, dtype=torch.float32)
        model.log_scale[strayed] = float(np.log(0.003))
        model.log_weight[strayed] = -1.0


def _loss(model: _Model, groups: list[list[Any]]) -> tuple[Any, float, float]:
    (p, normal, p_near), (q, distance, q_near), (r, sign, r_near) = groups
    halves = model.both_halves()
    value, gradient = model.log_field(p, p_near, halves)
    slope = gradient.norm(dim=1) + 1e-3
    error = (value / slope).abs()
    cosine = -(gradient * normal).sum(1) / slope
    value_q, gradient_q = model.log_field(q, q_near, halves)
    off = (-value_q / (gradient_q.norm(dim=1) + 1e-3) - distance).abs() - 0.4 * distance.abs()
    value_r, _ = model.log_field(r, r_near, halves)
    loss = 3.0 * error.clamp(max=0.02).mean() + off.clamp(min=0.0, max=0.02).mean() + 0.006 * (1 - cosine).mean()
    loss = loss + 0.01 * (0.4 - value_r * sign).clamp(min=0.0, max=4.0).mean()
    return loss, float(error.mean()), float(cosine.mean())


def surface_error_mm(reference: Reference, half: dict[str, np.ndarray]) -> np.ndarray:
    """Return distances (20,000,) in millimetres from area-uniform reference samples to the fitted skin."""
    names = ("mean", "log_scale", "rotation", "log_weight")
    primitives = Primitives.from_half(*(half[name].astype(np.float64) for name in names))
    density = sample_density(reference.points)
    pick = np.random.default_rng(5).choice(len(density), 20_000, p=(1 / density) / np.sum(1 / density))
    points = reference.points[pick]
    return 1e3 * np.linalg.norm(primitives.project(points, steps=8) - points, axis=1)


def main() -> None:
    """Fit the primitives and write ``numbers/primitives.npz``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=NUMBERS / "primitives.npz")
    parser.add_argument("--iterations", type=int, default=FitSettings.iterations)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    reference = load_reference()
    result = fit(reference, FitSettings(iterations=arguments.iterations))
    error = surface_error_mm(reference, result)
    _LOG.info(
        "surface error: mean %.2f mm, 95 %% %.2f mm, largest %.2f mm", error.mean(), *np.quantile(error, [0.95, 1])
    )
    with atomic_output(arguments.out, overwrite=True) as temporary:
        np.savez_compressed(temporary, **{key: value.astype(np.float32) for key, value in result.items()})


if __name__ == "__main__":
    main()
