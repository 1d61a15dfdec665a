"""Optical markers made from our own body in a known motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import marker_landmarks
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import MarkerCloud


@dataclass(frozen=True)
class WornMarkers:
    """Markers and the joints of the body that wears them."""

    cloud: MarkerCloud
    joints: np.ndarray
    """(F, 24, 3) metres."""
    betas: np.ndarray
    """(10,) shape of the body."""
    offsets: np.ndarray
    """(M, 3) metres: how far the markers are off their places."""


def worn_markers(
    labels: Sequence[str], frames: int, *, fps: float = 60.0, step: int = 1, stray_m: float = 0.008
) -> WornMarkers:
    """Return markers that sit up to 2 cm off their places on a body of known shape, with 1 mm of noise."""
    truth, body, rng = demo_capture().truth, load_body(), np.random.default_rng(8)
    chosen = slice(0, frames * step, step)
    places = tuple(str(load_layouts().place_of(label)) for label in labels)
    landmarks = marker_landmarks(body, places)
    subject = Subject(body, landmarks, truth["betas"], stray_m * rng.normal(size=(len(labels), 3)))
    local = exp_so3(truth["body_pose"][chosen, :63].reshape(-1, 21, 3))
    posed = PosedFrames(exp_so3(truth["global_orient"][chosen]), local, truth["transl"][chosen])
    points = pose(subject, posed).points + 0.001 * rng.normal(size=(frames, len(labels), 3))
    cloud = MarkerCloud(points, fps, tuple(labels))
    return WornMarkers(cloud, truth["joints"][chosen], subject.betas, subject.offsets)
