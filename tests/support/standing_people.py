"""Scale the way of a simulated person so that planted feet do not slide over the floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.fitters.one_view.shape import foot_vertices
from solver_backend.synthesis.simulation.cast import Person

TOUCH_M = 0.005  # Height above the lowest vertex at which a vertex touches the floor by 1/e.
SLIDES_M_S = 0.2  # Speed of the touching skin at which a frame has a quarter of its weight.


def standing(person: Person, fps: float) -> Person:
    """Return the person with the way over the floor scaled to the legs.

    ``cast_person`` scales the recorded way by the height of the pelvis. This is wrong for actors with other proportions
    and on uneven ground, where planted feet then slide by up to a quarter of the way. The scale s is the minimum
    ``min_s Σ_f ρ(|u_f + s d_f|)`` with the pelvis' step d, the step u of the touching skin relative to the pelvis, and
    Geman and McClure's ρ.
    """
    feet = np.concatenate([foot_vertices(person.body, side) for side in ("left", "right")])
    skin = person.skin(np.arange(len(person.transl)))[:, feet]
    touch = np.exp(-(skin[..., 2] - skin[..., 2].min(axis=1, keepdims=True)) / TOUCH_M)
    hold = touch[1:] * touch[:-1]
    hold /= hold.sum(axis=1, keepdims=True)
    way = person.transl * [1.0, 1.0, 0.0]
    step = np.diff(way, axis=0)[:, :2]
    about = np.einsum("fv,fva->fa", hold, np.diff((skin - way[:, None])[..., :2], axis=0))
    scale = 1.0
    for _ in range(30):
        square = ((about + scale * step) ** 2).sum(axis=1) * fps**2
        weight = (1.0 + square / SLIDES_M_S**2)[:, None] ** -2.0
        scale = -float((weight * about * step).sum() / max((weight * step**2).sum(), 1e-12))
    return replace(person, transl=person.transl + (scale - 1.0) * (way - way[:1]))
