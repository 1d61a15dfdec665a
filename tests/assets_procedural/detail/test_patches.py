"""Pieces of a half mesh that are replaced: rims found, rings joined, what does not fit refused; fingers that bend."""

from __future__ import annotations

import numpy as np
import pytest

from assets_procedural.arrays import LIPS, NONE
from assets_procedural.detail.fingers import DIGITS, finger_knots, relax_fingers
from assets_procedural.detail.patches import HalfBody, Patch, replace, rings_to_faces, zip_rings
from assets_procedural.mesh.meshing import euler_number
from assets_procedural.skeleton.skinning import load_joints
from solver_backend.exchange.errors import BodyInvalid


def _sheet(size: int = 9) -> HalfBody:
    """Return a flat square of 8 cm with x >= 0, its faces towards +z."""
    y, x = np.divmod(np.arange(size * size), size)
    vertices = np.stack([0.01 * x, 0.01 * y, 0 * x], axis=1)
    a = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + size + 1], 1), np.stack([a, a + size + 1, a + size], 1)])
    return HalfBody(vertices, faces, np.full(len(faces), NONE))


def _disc(closed: bool) -> Patch:
    angle = 2 * np.pi * np.arange(10) / 10 if closed else np.linspace(-0.5 * np.pi, 0.5 * np.pi, 7)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    centre = np.array([0.04 if closed else 0.0, 0.04, 0.0])
    vertices = np.concatenate([centre + 0.012 * ring, centre + 0.006 * ring, [centre]])
    vertices[np.abs(vertices[:, 0]) < 1e-9, 0] = 0.0
    rings = np.arange(2 * len(angle)).reshape(2, -1)
    last = np.arange(len(angle) - (not closed))
    fan = np.stack([rings[1][last], np.roll(rings[1], -1)[last], np.full(len(last), len(vertices) - 1)], axis=1)
    faces = np.concatenate([rings_to_faces(list(rings), closed), fan])
    return Patch(vertices, faces, np.full(len(faces), LIPS), rings[0], closed)


def _hole(closed: bool, radius_m: float = 0.02):
    centre = np.array([0.04 if closed else 0.0, 0.04])
    return lambda vertices: np.linalg.norm(vertices[:, :2] - centre, axis=1) < radius_m


@pytest.mark.parametrize("closed", [True, False])
def test_a_patch_fills_its_hole_and_faces_the_same_way(closed: bool) -> None:
    sheet = _sheet()
    mended = replace(sheet, _hole(closed), _disc(closed))
    a, b, c = (mended.vertices[mended.faces[:, k]] for k in range(3))
    areas = 0.5 * np.cross(b - a, c - a)[:, 2]
    assert areas.min() > 0.0
    np.testing.assert_allclose(areas.sum(), 0.08**2, rtol=1e-9)
    assert euler_number(mended.faces, len(mended.vertices)) == 1
    assert set(np.unique(mended.feature)) == {NONE, LIPS}


def test_pockets_that_a_hole_cuts_off_go_too() -> None:
    sheet = _sheet()
    island = HalfBody(
        np.concatenate([sheet.vertices, sheet.vertices[:3] + [0.04, 0.04, -0.02]]),
        np.concatenate([sheet.faces, [[81, 82, 83]]]),
        np.concatenate([sheet.feature, [NONE]]),
    )
    mended = replace(island, _hole(closed=True), _disc(closed=True))
    assert mended.vertices[:, 2].min() == 0.0


@pytest.mark.parametrize("reach", [0.0, 0.5])
def test_a_hole_without_a_rim_is_refused(reach: float) -> None:
    with pytest.raises(BodyInvalid, match="rim of a hole"):
        replace(_sheet(), lambda vertices: np.linalg.norm(vertices - 0.04, axis=1) < reach, _disc(closed=False))


def test_rings_of_different_lengths_are_joined_without_gaps() -> None:
    rng = np.random.default_rng(0)
    outer, inner = (np.sort(rng.uniform(0, 2 * np.pi, n)) for n in (23, 14))
    vertices = np.concatenate(
        [np.stack([np.cos(a), np.sin(a), 0 * a], axis=1) * r for a, r in ((outer, 1.0), (inner, 0.6))]
    )
    faces = zip_rings(vertices, np.arange(23), 23 + np.arange(14), closed=True)
    assert len(faces) == 23 + 14
    assert euler_number(faces, 37) == 0


def test_knuckles_bend_by_their_angles_and_more_towards_the_little_finger() -> None:
    joints = load_joints()
    knots = finger_knots(joints)
    bent = relax_fingers(knots[..., None], knots[..., None], knots, joints)[..., 0]
    chains = {name: np.stack([knots[4 * k : 4 * k + 4], bent[4 * k : 4 * k + 4]]) for k, name in enumerate(DIGITS)}
    total = []
    for name in ("index", "middle", "ring", "little"):
        before, after = (np.diff(chain, axis=0)[-1] for chain in chains[name])
        angle = np.arccos(before @ after / np.linalg.norm(before) / np.linalg.norm(after))
        total.append(np.rad2deg(angle))
        np.testing.assert_allclose(total[-1], sum(DIGITS[name].flexion_deg), atol=10.0)
    assert total == sorted(total)
    np.testing.assert_allclose(bent[:20] * [-1.0, 1.0, 1.0], bent[20:], atol=1e-12)


def test_derivatives_of_curled_fingers_are_those_of_the_points() -> None:
    """Where a shape coefficient moves points and knots, the curled points move by the curled derivative."""
    joints, rng = load_joints(), np.random.default_rng(3)
    points = finger_knots(joints) + 0.004 * rng.normal(size=(40, 3))
    moved = rng.normal(size=(80, 3, 2))
    both = np.concatenate([points, finger_knots(joints)])

    def curled(values: np.ndarray) -> np.ndarray:
        return relax_fingers(values[:40], values[40:], points, joints)

    step = 1e-3
    ahead, back = (curled(both[..., None] + sign * step * moved) for sign in (1, -1))
    np.testing.assert_allclose((ahead - back) / (2 * step), curled(moved), atol=1e-9)
