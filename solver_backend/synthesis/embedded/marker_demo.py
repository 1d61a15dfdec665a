"""The embedded take of optical markers: an authored motion on a body of known shape, as an optical system records it.

``python -m solver_backend.synthesis.embedded.marker_demo`` writes it anew to where it is committed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.markers.c3d_writer import write_c3d
from solver_backend.synthesis.embedded.choreography import author_motion
from solver_backend.synthesis.faults import OPTICAL_MARKERS, MarkerFaults, autoregressive, bursts
from solver_backend.types import MarkerCloud

DEMO_TAKE = Path(__file__).parents[2] / "assets" / "demo_markers.c3d"
"""The committed take."""
BETAS = np.array([-0.6, 0.7, -0.3, 0.5, -0.2, 0.1, 0.3, -0.2, 0.1, 0.0])
"""Shape of the person who wears the markers."""
_SUBJECT = "Demo"
_UNKNOWN = ("ARMBAND", "LUPA")
"""A label that no layout knows, and the place beside which its marker sits."""


@dataclass(frozen=True)
class RecordedMarkers:
    """A take of markers with its truth; F frames."""

    cloud: MarkerCloud
    joints: np.ndarray
    """(F, 24, 3) metres: the joints of the body that wore the markers."""


def record_markers(
    num_frames: int = 240, fps: float = 60.0, seed: int = 11, faults: MarkerFaults = OPTICAL_MARKERS,
    layout: str = "CMU_41",
) -> RecordedMarkers:  # fmt: skip
    """Return the take: a layout's markers and one whose label no layout knows.

    Args:
        num_frames: F.
        fps: frames per second.
        seed: of everything random; the motion is the same for all seeds.
        faults: of the recording; gaps, placement, skin and measurement alone.
        layout: by its name.
    """
    body, rng = load_body(), np.random.default_rng(seed)
    motion = author_motion(body, BETAS, num_frames, fps)
    places = (*marker_layout(layout), _UNKNOWN[1])
    placement = 1e-3 * faults.placement_mm * rng.normal(size=(len(places), 3))
    placement[-1] += (0.0, 0.0, -0.04)
    posed = pose_landmarks(
        body, marker_landmarks(body, places), BETAS, exp_so3(motion.global_orient), exp_so3(motion.body_pose),
        motion.transl, offsets=placement,
    )  # fmt: skip
    shape, correlation = (len(places), num_frames, 3), float(np.exp(-1 / (fps * faults.skin_s)))
    sliding = 1e-3 * faults.skin_mm * autoregressive(shape, correlation, rng).swapaxes(0, 1)
    measured = 1e-3 * faults.measurement_mm * rng.normal(size=(num_frames, len(places), 3))
    hidden = bursts(rng.random((len(places), num_frames)), faults.hidden, faults.hidden_s * fps).T
    points = np.where(hidden[..., None], np.nan, posed.points + sliding + measured)
    labels = tuple(f"{_SUBJECT}:{name}" for name in (*marker_layout(layout), _UNKNOWN[0]))
    return RecordedMarkers(MarkerCloud(points, fps, labels), posed.skeleton.joints)


if __name__ == "__main__":
    write_c3d(DEMO_TAKE, record_markers().cloud, overwrite=True)
