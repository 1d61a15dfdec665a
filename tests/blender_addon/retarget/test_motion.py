"""The transfer in NumPy: limbs, map poses, Euler angles, feet and the way over the ground."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from mathutils import Euler

from blender_addon._exchange.limb_bend import bend_to, swing, within_reach
from blender_addon._exchange.rigs.rest_frames import limb_frame
from blender_addon._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from blender_addon.conventions.coordinates import euler_from_matrix
from blender_addon.retarget.motion.figures import Actor, Target
from blender_addon.retarget.motion.foreign_actor import find_low_feet
from blender_addon.retarget.motion.limbs import FootPath, foot_paths, steadied
from blender_addon.retarget.motion.map_pose import lean_at_rest_deg
from blender_addon.retarget.motion.transfer import within_arms

RNG = np.random.default_rng(3)


def _limbs(frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    upper, axis = RNG.normal(size=(2, frames, 3))
    upper *= 0.4 / np.linalg.norm(upper, axis=1, keepdims=True)
    axis = np.cross(upper, axis)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    bend = matrix_from_rotvec(RNG.uniform(0.1, 2.0, (frames, 1)) * axis)
    return upper, 0.8 * (bend @ upper[..., None])[..., 0], axis


def test_a_limb_ends_where_it_should_and_bends_in_its_own_plane() -> None:
    upper, lower, axis = _limbs(200)
    lengths = np.linalg.norm(upper, axis=1), np.linalg.norm(lower, axis=1)
    reach = RNG.normal(size=(200, 3))
    reach *= (RNG.uniform(0.3, 0.98, 200) * (lengths[0] + lengths[1]) / np.linalg.norm(reach, axis=1))[:, None]
    first, second = bend_to(reach, upper, lower, axis)
    u, v = (first @ upper[..., None])[..., 0], (second @ lower[..., None])[..., 0]
    assert np.abs(u + v - reach).max() < 1e-9
    assert (
        np.abs(
            (np.cross(u, v) * (first @ axis[..., None])[..., 0]).sum(1) - np.linalg.norm(np.cross(u, v), axis=1)
        ).max()
        < 1e-9
    )


def test_a_limb_that_is_right_already_does_not_turn() -> None:
    upper, lower, axis = _limbs(50)
    first, second = bend_to(upper + lower, upper, lower, axis)
    assert np.abs(first - np.eye(3)).max() < 1e-6 and np.abs(second - np.eye(3)).max() < 1e-6


def test_a_straight_limb_bends_to_the_side_that_anatomy_has() -> None:
    upper = np.array([[0.0, 0.0, -0.4]])
    first, second = bend_to(np.array([[0.0, 0.0, -0.6]]), upper, upper, np.array([[1.0, 0.0, 0.0]]))
    knee = (first @ upper[..., None])[0, :, 0]
    assert knee[1] < -0.2 and abs(knee[0]) < 1e-9  # the knee comes forward, to -Y
    assert np.allclose(knee + (second @ upper[..., None])[0, :, 0], [0, 0, -0.6])


def test_a_limb_that_is_too_short_points_to_its_goal() -> None:
    upper, lower, axis = _limbs(20)
    reach = 5.0 * _unit(RNG.normal(size=(20, 3)))
    first, second = bend_to(reach, upper, lower, axis)
    end = (first @ upper[..., None] + second @ lower[..., None])[..., 0]
    assert np.allclose(_unit(end), _unit(reach), atol=1e-9)
    assert np.all(np.linalg.norm(end, axis=1) > 0.999 * 0.4 * 1.8)


def test_a_swing_takes_one_direction_to_another_and_adds_no_twist() -> None:
    a, b = _unit(RNG.normal(size=(2, 100, 3)))
    R = swing(a, b)
    assert np.allclose((R @ a[..., None])[..., 0], b)
    axis = np.cross(a, b)
    assert np.allclose((R @ axis[..., None])[..., 0], axis)


def test_the_hips_give_way_until_both_legs_reach() -> None:
    hips = np.stack([np.tile([0.1, 0, 1.0], (5, 1)), np.tile([-0.1, 0, 1.0], (5, 1))])
    ankles = hips - [0, 0, 0.9] + RNG.normal(scale=0.1, size=(2, 5, 3))
    way = within_reach(hips, ankles, np.full(hips.shape[:2], 0.9995 * 0.8))
    assert np.linalg.norm(ankles - hips - way, axis=-1).max() < 0.803
    near = within_reach(hips, hips - [0, 0, 0.7], np.full(hips.shape[:2], 0.8))
    assert not near.any()


def test_the_hips_move_no_farther_than_both_legs_need() -> None:
    """Against random offsets: none that is right for both legs is shorter, and folded legs are no shorter than fits."""
    hips, ankles = RNG.normal(scale=0.5, size=(2, 2, 60, 3))
    longest, shortest = RNG.uniform(0.6, 1.0, (2, 60)), RNG.uniform(0.0, 0.3, (2, 60))
    way = within_reach(hips, ankles, longest, shortest)
    apart = np.linalg.norm(ankles - hips - way, axis=-1)
    centres = (ankles - hips)[1] - (ankles - hips)[0]
    meet = np.linalg.norm(centres, axis=-1) < longest.sum(0)
    assert 20 < meet.sum() < 60 and ((apart < longest + 1e-6) & (apart > shortest - 1e-6))[:, meet].all()
    tried = RNG.normal(scale=0.6, size=(4000, 60, 3))
    far = np.linalg.norm((ankles - hips)[:, None] - tried, axis=-1)
    fits = ((far <= longest[:, None]) & (far >= shortest[:, None])).all(axis=0)
    best = np.where(fits, np.linalg.norm(tried, axis=-1), np.inf).min(axis=0)
    assert (np.linalg.norm(way, axis=-1)[meet] <= best[meet] + 1e-6).all()
    gap = (apart - longest)[:, ~meet]
    assert np.allclose(gap[0], gap[1]), "feet too far apart miss by the same distance"


def test_legs_of_unequal_bones_keep_their_feet_in_a_squat() -> None:
    """A thigh twice as long as its shin cannot fold as far as the actor's leg: the hips stay higher."""
    hips = np.array([[[0.1, 0.0, 0.25]], [[-0.1, 0.0, 0.25]]])
    ankles = np.array([[[0.1, 0.05, 0.1]], [[-0.1, 0.05, 0.1]]])
    way = within_reach(hips, ankles, np.full((2, 1), 0.8), np.full((2, 1), 0.26))
    assert np.linalg.norm(ankles - hips - way, axis=-1) == pytest.approx(0.26) and way[0, 2] > 0.05


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_euler_angles_are_blenders_and_continuous_through_the_pole(order: str) -> None:
    t = np.linspace(0, 1, 400)[:, None]
    R = matrix_from_rotvec(t * [0.3, 4.0, 0.2]) @ matrix_from_rotvec(t * [2.0, 0.1, -3.0])
    angles = euler_from_matrix(R, order)
    again = np.array([Euler(angle, order).to_matrix() for angle in angles])
    assert np.abs(again - R).max() < 1e-6
    assert np.abs(np.diff(angles, axis=0)).max() < 1.0


def test_limb_frames_are_right_handed_also_where_the_axis_lies_along_the_limb() -> None:
    directions = RNG.normal(size=(30, 3))
    for axis in (RNG.normal(size=(30, 3)), directions):
        F = limb_frame(directions, axis)
        assert np.allclose(F @ F.swapaxes(1, 2), np.eye(3)) and np.allclose(np.linalg.det(F), 1)
        assert np.allclose(np.cross(F[..., 0], directions), 0)


def test_a_standing_foot_is_held_and_let_go_without_a_jump() -> None:
    frames = np.arange(90)
    sole = np.zeros((90, 3))
    sole[:, 0] = np.clip(frames - 60, 0, None) * 0.02
    sole[20:60, 0] += 0.003 * np.sin(np.arange(40))
    stands = (frames >= 20) & (frames < 60)
    held = steadied(_foot(sole), stands, 60.0)
    still = stands & (frames < 58)  # the speed of the last frames of a contact is that of the step
    assert np.ptp(held.sole[still, 0]) < 1e-9 and np.ptp(sole[still, 0]) > 0.005
    added = (held.sole - sole)[:, 0]
    assert np.abs(np.diff(added[60:])).max() < 0.001 and abs(added[-1]) < 1e-9


def test_a_sliding_foot_is_held_where_it_rests() -> None:
    """A steady slide stays. A slide of 12 cm that ends in rest is held in the rest, and eased into it."""
    slide = np.zeros((90, 3))
    slide[:, 0] = np.arange(90) * 0.003
    assert np.array_equal(steadied(_foot(slide), np.ones(90, bool), 60.0).sole, slide)
    slide[40:] = slide[40] + 0.001 * np.sin(np.arange(50))[:, None]
    held = steadied(_foot(slide), np.ones(90, bool), 60.0).sole
    assert np.ptp(held[48:], axis=0).max() < 1e-9 and np.array_equal(held[:25], slide[:25])
    assert np.abs(np.diff(held[:, 0])).max() < 0.006


def test_the_ankle_of_a_flat_foot_is_still_and_that_of_a_rolling_foot_is_not() -> None:
    """A foot that trembles by 2 degrees stands. One whose heel rises by 40 degrees keeps its roll."""
    frames = np.arange(120)
    tremble = 0.035 * np.sin(frames / 9.0)
    for angle, drift in ((tremble, 0.0), (tremble + 0.7 * (frames > 60) * (frames - 60) / 60, 0.05)):
        turns = matrix_from_rotvec(angle[:, None] * [1.0, 0.0, 0.0])
        held = steadied(_foot(np.zeros((120, 3)), turns), np.ones(120, bool), 60.0)
        assert np.ptp(held.ankle[:55], axis=0).max() < 1e-9 < 0.004 < np.ptp((turns @ held.own)[:55], axis=0).max()
        assert np.ptp(held.ankle, axis=0).max() >= drift


@pytest.mark.parametrize("size", [0.1, 0.2, 1.0, 5.0])
def test_a_foot_of_any_size_is_locked_alike(size: float) -> None:
    """A step of 20 cm keeps its lift of 3 cm, a raised heel and a pivot stay, and a standing foot is still."""
    t, share = np.arange(240) / 60.0, np.zeros(240)
    share = np.clip((t - 1.5) / 0.4, 0.0, 1.0)
    step = share[:, None] * [0.0, 0.2, 0.0] + np.sin(np.pi * share)[:, None] * [0.0, 0.0, 0.03]
    held = steadied(_foot(size * step, size=size), np.ones(240, bool), 60.0)
    assert held.sole[:, 2].max() > 0.025 * size and np.abs(held.sole - size * step).max() < 0.01 * size
    for axis in np.eye(3):
        turns = matrix_from_rotvec(np.radians(45.0) * np.clip((t - 1.5) / 0.8, 0.0, 1.0)[:, None] * axis)
        turned = steadied(_foot(np.zeros((240, 3)), turns, size), np.ones(240, bool), 60.0).turns
        off = np.linalg.norm(rotvec_from_matrix(turned.swapaxes(-1, -2) @ turns), axis=-1)
        assert np.degrees(off.max()) < 12.0
    sway = 0.008 * np.sin(2.0 * np.pi * 0.7 * t)[:, None] * [1.0, 0.0, 0.0]
    assert np.ptp(steadied(_foot(size * sway, size=size), np.ones(240, bool), 60.0).sole, axis=0).max() < 1e-9


def test_the_size_of_feet_is_the_scaled_actors_leg() -> None:
    rest, joints = _standing(np.zeros((3, 2)), 0.8)
    actor = Actor("a", rest, np.tile(np.eye(3), (3, 24, 1, 1)), joints, 30.0)
    target = SimpleNamespace(index=lambda role: 0, heads=np.zeros((1, 3)), ends=np.full((1, 3), np.nan))
    for scale in (0.2, 1.0):
        path, _ = foot_paths(actor, cast(Target, target), np.tile(np.eye(3), (1, 3, 1, 1)), scale)
        assert path.size == pytest.approx(scale, rel=0.02)


def _standing(heights: np.ndarray, hips: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a rest pose with legs of 0.8 m, and (F, 24, 3) joints with flat feet so high, hips over the lower one."""
    rest = np.zeros((24, 3))
    rest[[1, 2], 2], rest[[4, 5], 2], rest[[7, 8], 2], rest[[10, 11], 2] = 0.89, 0.49, 0.09, 0.02
    joints = np.tile(rest, (len(heights), 1, 1))
    joints[:, [7, 8, 10, 11], 2] += np.tile(heights, 2)
    joints[:, [1, 2], 2] = heights.min(axis=1, keepdims=True) + 0.09 + hips
    return rest, joints


@pytest.mark.parametrize(("heights", "hips", "low"), [
    ([0.5, 0.5], 0.45, [False, False]),  # seated high, feet dangle
    ([0.0, 0.4], 0.8, [True, False]),  # on one leg
    ([0.3, 0.3], 0.78, [True, True]),  # on a step
    ([0.3, 0.7], 0.78, [True, False]),  # on one leg on a step
])  # fmt: skip
def test_a_foot_in_the_air_is_not_on_the_floor(heights: list[float], hips: float, low: list[bool]) -> None:
    rest, joints = _standing(np.tile(heights, (50, 1)), hips)
    assert (find_low_feet(rest, joints) == low).all()


def test_contacts_of_a_solve_decide_which_low_feet_stand() -> None:
    rest, joints = _standing(np.zeros((50, 2)), 0.8)
    joints[20:30, [10, 11], 2] += 0.2
    contacts = np.zeros((50, 2), bool)
    contacts[5:8, 0] = True
    found = find_low_feet(rest, joints, contacts)
    assert found[:20, 0].all() and not found[20:, 0].any() and not found[:, 1].any()
    assert find_low_feet(rest, joints, np.zeros((50, 2), bool)).any(), "a solve without any contact decides nothing"


def _foot(sole: np.ndarray, turns: np.ndarray | None = None, size: float = 1.0) -> FootPath:
    turns = np.tile(np.eye(3), (len(sole), 1, 1)) if turns is None else turns
    return FootPath("left_foot", sole, turns, size * np.array([0.0, 0.12, 0.08]), size)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def test_hand_goals_beyond_the_arm_are_shortened_and_the_shift_is_told() -> None:
    """A touch that a rig's arm cannot reach is the plan's limit, not a constraint of the rig."""
    roles = ("left_upper_arm", "left_forearm", "left_hand")
    heads = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.55, 0.0, 0.0]])
    target = SimpleNamespace(heads=heads, index=lambda role: roles.index(role) if role in roles else -1)
    turns = np.tile(np.eye(3), (3, 2, 1, 1))
    places = np.repeat(heads[:, None], 2, axis=1)
    goals = {"left_hand": np.array([[0.0, 0.61, 0.0], [0.0, 0.4, 0.0]])}
    free = {"left_hand": np.array([[0.0, 0.5, 0.0], [0.0, 0.4, 0.0]])}
    kept, beyond = within_arms(cast(Target, target), turns, places, free, goals)
    np.testing.assert_allclose(kept["left_hand"], [[0.0, 0.55, 0.0], [0.0, 0.4, 0.0]], atol=1e-9)
    assert beyond == pytest.approx(0.06)
    kept, beyond = within_arms(cast(Target, target), turns, places, goals, goals)
    np.testing.assert_array_equal(kept["left_hand"], goals["left_hand"])
    assert beyond == 0.0, "an arm of the actor that stretches is no touch"


def test_parallel_legs_of_which_one_is_too_long_and_one_too_short_are_both_reached() -> None:
    """All points of a circle are then equally near."""
    hips, ankles = np.zeros((2, 1, 3)), np.array([[[0.0, 0.0, -1.0]], [[0.0, 0.0, -0.45]]])
    way = within_reach(hips, ankles, np.full((2, 1), 0.8), np.full((2, 1), 0.4))
    far, near = np.linalg.norm(ankles[:, 0] - way, axis=-1)
    assert far <= 0.8 + 1e-6 and near >= 0.4 - 1e-6


def test_only_a_trunk_that_leans_from_the_hips_on_is_measured() -> None:
    hips, up = {"left_thigh": [0.1, 0.0, 0.0], "right_thigh": [-0.1, 0.0, 0.0]}, np.array([0.0, 0.0, 0.6])
    bent = 0.7 * np.array([0.0, -np.sin(np.radians(46.0)), np.cos(np.radians(46.0))])
    spine = {"spine_1": up / 6, "spine_2": up / 2}
    for heads, lean in (
        ({"head": bent}, 46.0),
        ({"head": up}, 0.0),
        ({"spine_1": bent / 6, "spine_2": bent / 2, "head": bent}, 46.0),
        ({**spine, "head": bent}, 0.0),  # a hunched back
        ({}, 0.0),  # legs alone
        ({"left_upper_arm": [0.2, 0.0, 0.2]}, 0.0),  # half of the shoulders is at the side
    ):
        roles, places = zip(*({"pelvis": [0.0, 0.05, 0.0]} | hips | heads).items(), strict=True)
        index = dict(zip(roles, range(len(roles)), strict=True))
        at_rest = SimpleNamespace(
            index=lambda role, known=index: known.get(role, -1), heads=np.array(places, float), roles=roles
        )
        assert lean_at_rest_deg(cast(Target, at_rest)) == pytest.approx(lean)
