"""Define the result of a pose-estimation network for one video."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS

NUM_TURNED = 1 + NUM_BODY_JOINTS  # Pelvis and the rotating joints in SMPL's tree.
Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # Rotation between worlds.
CAMERA_TO_Z_UP = Y_UP_TO_Z_UP @ np.diag([1.0, -1.0, -1.0])  # From a level camera (X right, Y down) to Z up.


@dataclass(frozen=True)
class NetworkResult:
    """Motion of one person, from a network: rotations, or points in camera axes (X right, Y down, Z forward)."""

    program: str
    person: str
    frames: np.ndarray  # (F,) ascending frame numbers in the video.
    local: np.ndarray | None = (
        None  # (F, 22, 3, 3) from each joint's axes to its parent's, for the pelvis to the camera's.
    )
    fingers: np.ndarray | None = None  # (F, 30, 3, 3) finger rotations in SMPL-H's order.
    world: np.ndarray | None = None  # (F, 3, 3) rotations from pelvis axes to a level world, Z up.
    transl: np.ndarray | None = None  # (F, 3) SMPL translations in that world or in the camera, metres.
    points: np.ndarray | None = None  # (F, K, 3) points in any scale, NaN where unknown.
    names: tuple[str, ...] = ()  # (K,) point names as in joint sets.
    hands: np.ndarray | None = None  # (F, 2, 21, 3) points of the left and right hand.
    fps: float | None = None  # Frame rate if the program always uses the same one.

    def of_frames(self, kept: np.ndarray) -> NetworkResult:
        """Select frames by their indices in this result."""
        fields = ("frames", "local", "fingers", "world", "transl", "points", "hands")
        parts = {name: getattr(self, name) for name in fields}
        return replace(self, **{name: value[kept] for name, value in parts.items() if value is not None})


@dataclass(frozen=True)
class StartingResult:
    """Network results for one camera of a capture, from which the solve can start."""

    people: tuple[NetworkResult, ...]
    file: str
    camera: str = ""  # Name of the camera, or empty if only one camera shows the person.
