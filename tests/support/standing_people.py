"""Correct a simulated person: planted feet are flat, touch the floor and do not slide over it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.exchange.rigs.rest_frames import swing
from solver_backend.exchange.stands import standing_runs, steps
from solver_backend.fitters.one_view.shape import foot_vertices
from solver_backend.fitters.one_view.steady import RELEASE_S, legs, released, with_ankle_moved
from solver_backend.synthesis.simulation.cast import Person

TOUCH_M = 0.005  # Height above the lowest vertex at which a vertex touches the floor by 1/e.
SLIDES_M_S = 0.2  # Speed of the touching skin at which a frame has a quarter of its weight.

SLOW_M_S, LOW_M = 0.3, 0.02  # Largest speed and height of a planted foot.
FLAT = np.radians(8.0)  # Tilt at which a frame has a quarter of its weight.


def grounded(person: Person, fps: float) -> Person:
    """Return the person with all corrections of this file."""
    touching = with_flat_feet(person, fps).touching_the_floor(fps)
    return standing(with_feet_on_the_floor(touching, fps), fps)


def with_flat_feet(person: Person, fps: float) -> Person:
    """Return the person with a constant turn of each ankle that makes planted soles horizontal.

    Recorded skeletons keep a turn of the feet in our T-pose. Ankles of planted feet are then up to 0.1 m above the
    floor, but 0.08 m for a flat foot. The sole's normal is the robust mean over planted frames.
    """
    body, local, turns = person.body, person.local.copy(), [person.orient]
    skin, names = person.skin(np.arange(len(person.transl))), person.body.layout.joints
    for joint in range(1, local.shape[1] + 1):
        turns.append(turns[body.parents[joint]] @ local[:, joint - 1])
    for side in ("left", "right"):
        ankle, foot = names.index(f"{side}_ankle"), skin[:, foot_vertices(body, side)]
        way, seconds = steps(foot.mean(axis=1, keepdims=True), fps)
        slow = np.linalg.norm(way[:, 0], axis=-1) < SLOW_M_S * seconds[:, 0]
        up = turns[ankle][slow & (foot[..., 2].min(axis=1) < LOW_M), 2]  # In the foot's axes.
        if not len(up):
            continue
        normal = np.median(up, axis=0)
        for _ in range(20):
            tilt = np.linalg.norm(np.cross(up, normal), axis=-1) / np.linalg.norm(normal)
            normal = ((1.0 + (tilt / FLAT) ** 2)[:, None] ** -2.0 * up).sum(axis=0)
        turn = swing(np.array([[0.0, 1.0, 0.0]]), normal[None] / np.linalg.norm(normal))[0]
        local[:, ankle - 1] = local[:, ankle - 1] @ turn
    return replace(person, local=local)


def with_feet_on_the_floor(person: Person, fps: float) -> Person:
    """Return the person with legs bent so that the lowest vertex of each planted foot is on the floor.

    A body that repeats the rotations of an actor with other proportions keeps planted feet up to 20 mm above the floor.
    Feet keep their orientation, and the correction fades before and after a stand.
    """
    body, local, skin = person.body, person.local, person.skin(np.arange(len(person.transl)))
    rest = np.asarray(body.rest_joints(person.betas))
    for side, chain in zip(("left", "right"), legs(body), strict=True):
        foot = skin[:, foot_vertices(body, side)]
        way, seconds = steps(foot.mean(axis=1, keepdims=True), fps)
        low = foot[..., 2].min(axis=1)
        planted = np.zeros(len(low), dtype=bool)
        for first, stop in standing_runs(
            (np.linalg.norm(way, axis=-1) < SLOW_M_S * seconds)[:, 0] & (low < LOW_M), fps
        ):
            planted[first:stop] = True
        if planted.any():
            move = released(-low[:, None] * [0.0, 0.0, 1.0], planted, round(RELEASE_S * fps))
            local = with_ankle_moved(person.orient, local, rest, body.parents, chain, move)
    return replace(person, local=local)


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
