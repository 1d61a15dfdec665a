"""A detector whose confidence means something else than others' does."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import erf
from pathlib import Path

import numpy as np

from solver_backend.cameras.noise_map import NoiseMap
from solver_backend.cameras.projection import project
from solver_backend.synthesis.faults import autoregressive
from solver_backend.synthesis.simulation.keypoint_detector import px_per_mm
from solver_backend.types import Capture


def detected_by_another(capture: Capture, seed: int, least_mm: float, most_mm: float) -> Capture:
    """Return a benchmark capture as another detector would see it.

    Each keypoint of each view has a quality that comes and goes; its spread runs from ``least_mm`` to ``most_mm`` by
    it, and its confidence from 0.95 to 0.85.
    """
    assert capture.cameras is not None and capture.keypoints is not None
    rng = np.random.default_rng(seed)
    cameras = replace(capture.cameras, R=capture.truth["R"], t=capture.truth["t"])
    points = capture.truth["meant3d"]
    px = project(cameras, points)
    wander = autoregressive((*px.shape[:-1], 1), 0.95, rng)[..., 0]
    badness = 0.5 * (1.0 + np.vectorize(erf)(wander / np.sqrt(2.0)))
    sigma_mm = least_mm * (most_mm / least_mm) ** badness
    error_mm = sigma_mm[..., None] * autoregressive(px.shape, 0.8, rng)
    confidence = 0.95 - 0.1 * badness + 0.005 * rng.normal(size=badness.shape)
    xy = px + error_mm * px_per_mm(cameras, points)[..., None]
    keypoints = replace(capture.keypoints, xy=xy, confidence=np.clip(confidence, 0.01, 1.0))
    return replace(capture, keypoints=keypoints, detector="another 1")


@contextmanager
def written_map(noise: NoiseMap) -> Iterator[Path]:
    """Yield the file of a noise map, which is gone afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "noise.json"
        path.write_text(json.dumps(noise.as_dict()), encoding="utf-8")
        yield path
