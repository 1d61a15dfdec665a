"""Which cameras see a marker, found without a picture.

The limb that carries a marker hides it where it turns away; the others and furniture stand in its sight line.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.markers import marker_landmarks, skin_normals
from solver_backend.cameras.projection import project
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.sight import body_proxy, hidden_by_boxes, hidden_by_ellipsoids, sight_lines
from solver_backend.synthesis.studio.stage import Stage

_TURNED_AWAY = -0.4  # Cosine of skin and sight from which a limb hides its marker, tuned on rendered pictures.
_CHUNK = 64  # Frames that are looked at together.


def marker_sight(stage: Stage) -> np.ndarray:
    """Return (C, F, M) float32, 1 where a camera sees a marker and 0 elsewhere: the picture's answer for 9 in 10."""
    cameras, person = stage.cameras, stage.person
    seen = np.zeros((len(cameras), stage.num_frames, len(stage.labels)), np.float32)
    if not len(stage.labels):
        return seen
    proxy = body_proxy(person.body, person.betas)
    bone, normal = _carried(person.body, stage.labels)
    counted = proxy.bone[:, None] != bone
    px = project(cameras, stage.markers)
    with np.errstate(invalid="ignore"):
        within = ((px >= -0.5) & (px < cameras.image_size[:, None, None] - 0.5)).all(axis=-1)
    for start in range(0, stage.num_frames, _CHUNK):
        chunk = slice(start, start + _CHUNK)
        part = Person(person.body, person.betas, person.orient[chunk], person.local[chunk], person.transl[chunk])
        posed, points = proxy.posed(part), stage.markers[chunk]
        lines = sight_lines(cameras.centres, points)
        hidden = hidden_by_ellipsoids(cameras.centres, lines, posed.middle, posed.shape, counted)
        hidden |= hidden_by_boxes(cameras.centres, lines, stage.room.furniture)
        facing = -(lines * np.einsum("fkij,kj->fki", posed.turn[:, bone], normal)[:, None]).sum(axis=-1)
        hidden |= facing < _TURNED_AWAY * np.linalg.norm(lines, axis=-1)
        seen[:, chunk] = within[:, chunk] & ~np.swapaxes(hidden, 0, 1)
    return seen


@lru_cache(maxsize=8)
def _carried(body: Body, labels: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return (M,) the bone that moves each marker most, and the (M, 3) skin's normals at rest."""
    return marker_landmarks(body, labels).weights.argmax(axis=1), skin_normals(body, labels)
