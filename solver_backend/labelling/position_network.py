"""Run landmark networks that users have trained: attention weights, or any position network as ONNX."""

from __future__ import annotations

import hashlib
import math
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import BackendMissing, FileMissing, WeightsInvalid
from solver_backend.labelling.outputs import LANDMARKS, MARKERS
from solver_backend.labelling.point_network import CloudReading, LandmarkNetwork, load_network, lower_median

SIGMA_M, GHOST_M = 0.03, 0.09
"""Standard deviation (m) of a point around its marker, and distance to all markers beyond which a point is none.
Chosen by hand."""


@dataclass(frozen=True)
class PositionNetwork:
    """Network that estimates only landmark positions, such as the UNet in thesis 4.3.

    A point x is the marker k at ``m_k`` with log probability ``-|x - m_k|² / 2σ²``. It is no marker with log
    probability ``-d² / 2σ²``, where d is ``GHOST_M``.
    """

    session: Any  # Onnxruntime session: ``points`` and ``seen`` to ``positions`` (B, L, 3), 53 markers first.
    sha256: str

    def __call__(self, points: np.ndarray, seen: np.ndarray | None = None) -> CloudReading:
        """Label the points of (B, N, 3) clouds in metres, Z up. Joints are NaN unless the network has all 24."""
        points = np.asarray(points)
        seen = np.ones(points.shape[:2], bool) if seen is None else seen
        centre = lower_median(points, seen)
        local = np.where(seen[..., None], points - centre, 0.0).astype(np.float32)
        found = self.session.run(["positions"], {"points": local, "seen": seen})[0] + centre
        positions = np.full((len(points), len(LANDMARKS), 3), np.nan)
        known = len(LANDMARKS) if found.shape[1] == len(LANDMARKS) else len(MARKERS)
        positions[:, :known] = found[:, :known]
        apart = np.linalg.norm(points[:, :, None] - positions[:, None, : len(MARKERS)], axis=-1)
        scores = -0.5 * np.concatenate([apart, np.full((*apart.shape[:2], 1), GHOST_M)], axis=-1) ** 2 / SIGMA_M**2
        spread = np.zeros((*positions.shape[:2], 6))
        spread[..., :3] = math.log(math.sqrt(2.0) * 0.1 / SIGMA_M)  # the covariance is then σ² I
        return CloudReading(scores, np.zeros(len(MARKERS)), positions, spread)


@lru_cache(maxsize=2)
def chosen_network(file: str = "") -> LandmarkNetwork:
    """Load a landmark network from a file, or the built-in one.

    Raises:
        FileMissing, WeightsInvalid: the file does not exist, or is not a landmark network.
        BackendMissing: onnxruntime is not installed.
    """
    path = Path(os.path.expanduser(file))
    if not file or path.suffix.lower() != ".onnx":
        return load_network(path if file else None)
    if not path.is_file():
        raise FileMissing("The landmark network is missing.", where=path.name, hint="Choose the file again.")
    try:
        import onnxruntime
    except ImportError as error:
        hint = "Install it with: pip install onnxruntime."
        raise BackendMissing("An ONNX network needs onnxruntime.", where=path.name, hint=hint) from error
    hint = "Export the network with `train export`."
    try:
        quiet = onnxruntime.SessionOptions()
        quiet.log_severity_level = 3  # errors only, because it warns about symbolic sizes from its own exporter
        session = onnxruntime.InferenceSession(str(path), quiet, providers=["CPUExecutionProvider"])
        tried = {"points": np.zeros((1, 8, 3), np.float32), "seen": np.ones((1, 8), bool)}
        found = np.asarray(session.run(["positions"], tried)[0])
    except Exception as error:  # onnxruntime's exception types differ between releases
        raise WeightsInvalid("The file is not a landmark network.", where=path.name, hint=hint) from error
    if found.ndim != 3 or found.shape[::2] != (1, 3) or found.shape[1] < len(MARKERS) or not np.isfinite(found).all():
        message = f"The network does not estimate the {len(MARKERS)} markers. Its output has the shape {found.shape}."
        raise WeightsInvalid(message, where=path.name, hint=hint)
    return PositionNetwork(session, hashlib.sha256(path.read_bytes()).hexdigest())
