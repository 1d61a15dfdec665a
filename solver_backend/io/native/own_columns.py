"""Own points of a capture as arrays of their own: other programs find the joint set's keypoints alone in ``xy``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.schema import Fields
from solver_backend.types import BONES, Capture, Keypoints2D, OwnPoint

STORED = ("own", "own_names", "own_bones", "people_own")
"""Fields of a capture file."""


def own_arrays(capture: Capture) -> dict[str, np.ndarray]:
    """Return the fields of a capture's own points: (C, F, N, 3) x, y, confidence, and names; of everybody as well."""
    if capture.keypoints is None or not capture.keypoints.own:
        return {}
    points = capture.keypoints.own
    arrays = {
        "own": _values(capture.keypoints),
        "own_names": np.array([point.name for point in points]),
        "own_bones": np.array([point.bone for point in points]),
    }
    if capture.people:
        arrays["people_own"] = np.stack([_values(person.keypoints) for person in capture.people])
    return arrays


def own_points(fields: Fields) -> tuple[OwnPoint, ...]:
    """Return the own points that a file names.

    Raises:
        FileDamaged: names and bones do not fit each other, or a bone is unknown.
    """
    names, bones = fields.texts("own_names"), fields.texts("own_bones")
    if len(names) != len(bones) or not set(bones) <= set(BONES):
        raise FileDamaged(f"Own points {', '.join(names)} are on {', '.join(bones)}.", where=str(fields.path))
    return tuple(map(OwnPoint, names, bones))


def with_own(keypoints: Keypoints2D, points: tuple[OwnPoint, ...], values: np.ndarray) -> Keypoints2D:
    """Return keypoints with own points behind them.

    Args:
        keypoints: of the joint set.
        points: N points.
        values: (C, F, N, 3) x, y in pixels and confidence.
    """
    xy = np.concatenate([keypoints.xy, values[..., :2]], axis=2)
    return replace(
        keypoints, xy=xy, confidence=np.concatenate([keypoints.confidence, values[..., 2]], axis=2), own=points
    )


def _values(keypoints: Keypoints2D) -> np.ndarray:
    behind = slice(keypoints.joint_set.num_keypoints, None)
    values = np.concatenate([keypoints.xy, keypoints.confidence[..., None]], axis=-1)
    return values[:, :, behind].astype(np.float32)
