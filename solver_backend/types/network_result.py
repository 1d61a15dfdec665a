"""A person that a network estimated from one video."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS

NUM_TURNED = 1 + NUM_BODY_JOINTS  # Pelvis and the turned joints of SMPL's tree.
Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # Rotation between worlds.
CAMERA_TO_Z_UP = Y_UP_TO_Z_UP @ np.diag([1.0, -1.0, -1.0])  # From a level camera (X right, Y down) to Z up.


@dataclass(frozen=True)
class NetworkResult:
    """One person over F frames: rotations, or points in the camera's axes (X right, Y down, Z ahead)."""

    program: str
    person: str
    frames: np.ndarray  # (F,) numbers of the video's frames, ascending.
    local: np.ndarray | None = (
        None  # (F, 22, 3, 3) from each joint's axes to its parent's, the pelvis' to the camera's.
    )
    fingers: np.ndarray | None = None  # (F, 30, 3, 3) the same of the fingers, in SMPL-H's order.
    world: np.ndarray | None = None  # (F, 3, 3) from the pelvis' axes to a level world, Z up.
    transl: np.ndarray | None = None  # (F, 3) SMPL's translation there, or in the camera, metres.
    points: np.ndarray | None = None  # (F, K, 3) in any scale, NaN where unknown.
    names: tuple[str, ...] = ()  # K names of points, as in joint sets.
    hands: np.ndarray | None = None  # (F, 2, 21, 3) points of the left and right hand.
    fps: float | None = None  # Frames per second, if the program has only one rate.

    def of_frames(self, kept: np.ndarray) -> NetworkResult:
        """Return the result of the frames at these indices."""
        fields = ("frames", "local", "fingers", "world", "transl", "points", "hands")
        parts = {name: getattr(self, name) for name in fields}
        return replace(self, **{name: value[kept] for name, value in parts.items() if value is not None})


@dataclass(frozen=True)
class StartingResult:
    """A network's result of one camera of a capture."""

    people: tuple[NetworkResult, ...]
    file: str
    camera: str = ""  # Name of the camera, empty for the only one that sees the person.
