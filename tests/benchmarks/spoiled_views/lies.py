"""Recordings that are valid but wrong: mistakes of a detector, a synchroniser or a person that raise no error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from solver_backend.exchange.joint_sets import JointSet
from tests.benchmarks.spoiled_views.kinds import Recording

FOCAL_ERROR = 1.10  # Factor of the focal length, as after zooming or in another camera mode.
LEFT_SHARE, DROPPED = 0.4, 0.15
"""Share of the take without the person, and share of missing pictures of one camera."""
TREMBLING_PX = 3.0  # Standard deviation of detections of a person at rest.


def flat_confidence(recording: Recording, value: float) -> Recording:
    """Return the recording of a detector with one confidence for everything."""
    return replace(recording, confidence=np.where(recording.confidence > 0, value, 0.0))


def longer_lenses(recording: Recording, chosen: slice | np.ndarray = slice(None)) -> Recording:
    """Return the recording calibrated with focal lengths that are 10 % too long."""
    K = recording.cameras.K.copy()
    K[chosen, 0, 0] *= FOCAL_ERROR
    K[chosen, 1, 1] *= FOCAL_ERROR
    return replace(recording, cameras=replace(recording.cameras, K=K))


def upside_down(recording: Recording) -> Recording:
    """Return the recording with v counted from the bottom of the picture."""
    xy = recording.xy.copy()
    xy[..., 1] = recording.cameras.image_size[:, None, None, 1] - 1 - xy[..., 1]
    return replace(recording, xy=xy)


def mirrored(recording: Recording, chosen: np.ndarray) -> Recording:
    """Return the recording with mirrored pictures of some cameras, so that the detector exchanges sides."""
    xy, confidence, order = recording.xy.copy(), recording.confidence.copy(), list(JointSet.BODY_25.mirrored())
    for c in chosen:
        xy[c, ..., 0] = recording.cameras.image_size[c, 0] - 1 - xy[c, ..., 0]
        for values in (xy, confidence):
            people = values[c].reshape(len(xy[c]), -1, len(order), *values.shape[3:])
            values[c] = people[:, :, order].reshape(values[c].shape)
    return replace(recording, xy=xy, confidence=confidence)


def sides_exchanged(recording: Recording) -> Recording:
    """Return the recording of a detector that exchanges left and right in all views and frames."""
    order = list(JointSet.BODY_25.mirrored())
    return replace(recording, xy=recording.xy[:, :, order], confidence=recording.confidence[:, :, order])


def exchanged(recording: Recording, rng: np.random.Generator) -> Recording:
    """Return the recording with the names of two cameras exchanged."""
    a, b = rng.permutation(len(recording.cameras))[:2]
    xy, confidence = recording.xy.copy(), recording.confidence.copy()
    xy[[a, b]], confidence[[a, b]] = xy[[b, a]], confidence[[b, a]]
    return replace(recording, xy=xy, confidence=confidence)


def dropped_pictures(recording: Recording, camera: int, rng: np.random.Generator) -> Recording:
    """Return the recording of one camera that omitted unnumbered pictures, so that later ones move up."""
    xy, confidence = recording.xy.copy(), recording.confidence.copy()
    kept = np.flatnonzero(rng.uniform(size=xy.shape[1]) >= DROPPED)
    xy[camera, : len(kept)], confidence[camera, : len(kept)] = xy[camera, kept], confidence[camera, kept]
    xy[camera, len(kept) :], confidence[camera, len(kept) :] = np.nan, 0.0
    return replace(recording, xy=xy, confidence=confidence)


def person_away(recording: Recording, rng: np.random.Generator) -> Recording:
    """Return the recording of a person who leaves the room and comes back."""
    xy, confidence = recording.xy.copy(), recording.confidence.copy()
    away = int(LEFT_SHARE * xy.shape[1])
    first = int(rng.integers(away // 2, xy.shape[1] - away - away // 2))
    xy[:, first : first + away], confidence[:, first : first + away] = np.nan, 0.0
    return replace(recording, xy=xy, confidence=confidence)


def late(recording: Recording, camera: int, frames: int) -> Recording:
    """Return the recording with one camera delayed by some frames."""
    xy, confidence = recording.xy.copy(), recording.confidence.copy()
    xy[camera, frames:], confidence[camera, frames:] = xy[camera, :-frames], confidence[camera, :-frames]
    return replace(recording, xy=xy, confidence=confidence)


def still(recording: Recording, rng: np.random.Generator) -> Recording:
    """Return the recording of a person who holds the first frame's pose, with noisy detections."""
    xy = recording.xy[:, :1] + rng.normal(0.0, TREMBLING_PX, recording.xy.shape)
    confidence = np.broadcast_to(recording.confidence[:, :1], recording.confidence.shape).copy()
    return replace(recording, xy=xy, confidence=confidence)


def _one(rng: np.random.Generator, recording: Recording) -> int:
    return int(rng.integers(len(recording.cameras)))


LIES: dict[str, Callable[[Recording, np.random.Generator, int], Recording]] = {
    "confidence 0.01": lambda r, g, seed: flat_confidence(r, 0.01),
    "confidence 1": lambda r, g, seed: flat_confidence(r, 1.0),
    "lenses 10 % long": lambda r, g, seed: longer_lenses(r),
    "one lens 10 % long": lambda r, g, seed: longer_lenses(r, np.array([_one(g, r)])),
    "v from below": lambda r, g, seed: upside_down(r),
    "one mirrored": lambda r, g, seed: mirrored(r, np.array([_one(g, r)])),
    "sides exchanged": lambda r, g, seed: sides_exchanged(r),
    "cameras exchanged": lambda r, g, seed: exchanged(r, g),
    "pictures dropped": lambda r, g, seed: dropped_pictures(r, _one(g, r), g),
    "person away": lambda r, g, seed: person_away(r, g),
    "all mirrored": lambda r, g, seed: mirrored(r, np.arange(len(r.cameras))),
    "still": lambda r, g, seed: still(r, g),
    "one late": lambda r, g, seed: late(r, _one(g, r), 7),
}
"""Faults by name. Each function gets a random generator and the seed."""
