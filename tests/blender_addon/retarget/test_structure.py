"""Roles told from structure: systems of other programs, named as they name them, not at all, and wrongly."""

from __future__ import annotations

import numpy as np
import pytest

from blender_addon._exchange.rigs.skeleton import Skeleton
from blender_addon._exchange.rigs.structure import StructureGuess, recognise
from blender_addon._exchange.so3 import matrix_from_rotvec
from blender_addon.retarget.recognition import STRUCTURE, choose_map, roles_of_vrm
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_skeletons import ForeignSkeleton, draw

_FINGERS = ("thumb", "index", "middle", "ring", "pinky")


def skeleton_of(foreign: ForeignSkeleton) -> Skeleton:
    return Skeleton(foreign.heads, foreign.parents)


def shares(foreign: ForeignSkeleton, guess: StructureGuess) -> tuple[int, int, int]:
    """Return how many roles there are, how many are right and how many wrong."""
    right = sum(guess.roles.get(role) == bone for role, bone in foreign.roles.items())
    wrong = sum(foreign.roles.get(role) != bone for role, bone in guess.roles.items())
    return len(foreign.roles), right, wrong


def is_of_the_body(role: str) -> bool:
    return not any(finger in role for finger in _FINGERS)


@pytest.mark.parametrize("arms_down", [0.0, 45.0, 80.0])
@pytest.mark.parametrize("naming", NAMINGS)
def test_every_role_of_a_body_is_found_without_names(naming: str, arms_down: float) -> None:
    foreign = (
        draw(NAMINGS[naming], arms_down).shuffled(np.random.default_rng(0)).without_names(np.random.default_rng(1))
    )
    guess = recognise(skeleton_of(foreign))
    wanted = {role: bone for role, bone in foreign.roles.items() if is_of_the_body(role)}
    assert {role: bone for role, bone in guess.roles.items() if is_of_the_body(role)} == wanted
    assert not guess.doubts and shares(foreign, guess)[2] == 0


def test_names_that_are_swapped_do_not_mislead() -> None:
    rng, total = np.random.default_rng(2), np.zeros(3, int)
    for naming in NAMINGS.values():
        foreign = draw(naming, 45.0).with_swapped_names(rng).shuffled(rng)
        chosen = choose_map(skeleton_of(foreign))
        total += shares(foreign, StructureGuess(chosen.bones, ()))
    roles, right, wrong = total
    assert right > 0.985 * roles and wrong < 0.002 * roles


@pytest.mark.parametrize(("spread", "least"), [(0.004, 0.95), (0.008, 0.7)])
def test_uneven_sides_cost_answers_not_right_ones(spread: float, least: float) -> None:
    rng, total = np.random.default_rng(1), np.zeros(3, int)
    for naming in NAMINGS.values():
        foreign = draw(naming, 45.0).placed(lambda p: p + rng.normal(size=3) * spread).without_names(rng)
        total += shares(foreign, recognise(skeleton_of(foreign)))
    assert total[1] > least * total[0] and total[2] < 0.005 * total[0]


@pytest.mark.parametrize("naming", ["mixamo", "unreal_5", "daz"])
def test_units_axes_and_facing_do_not_matter(naming: str) -> None:
    foreign = draw(NAMINGS[naming]).without_names(np.random.default_rng(0))
    R = matrix_from_rotvec(np.array([0.3, 0.5, 2.0]))
    moved = foreign.placed(lambda p: 100.0 * (R @ p) + [3.0, 2.0, 1.0])
    assert recognise(skeleton_of(moved)).roles == recognise(skeleton_of(foreign)).roles


def test_names_against_toes_are_asked_about() -> None:
    foreign = draw(NAMINGS["unreal_5"])
    swapped = {b: b[:-1] + {"l": "r", "r": "l"}[b[-1]] if b.endswith(("_l", "_r")) else b for b in foreign.heads}
    guess = recognise(skeleton_of(foreign.renamed(swapped)))
    assert not guess.roles and "names and the toes disagree" in guess.doubts[0]


def test_a_quadruped_is_named() -> None:
    heads: dict[str, tuple[float, float, float]] = {
        "hips": (0, 0.5, 0.7),
        "spine": (0, 0.2, 0.72),
        "chest": (0, -0.2, 0.72),
    }
    parents = {"spine": "hips", "chest": "spine", "neck": "chest", "head": "neck"}
    heads |= {"neck": (0, -0.4, 0.8), "head": (0, -0.6, 0.95)}
    for side, x in (("L", 0.12), ("R", -0.12)):
        for leg, root, y in (("hind", "hips", 0.5), ("fore", "chest", -0.3)):
            line = [(x, y, 0.6), (x, y + 0.03, 0.33), (x, y, 0.08), (x, y - 0.09, 0.02)]
            above = root
            for i, place in enumerate(line):
                heads[f"{leg}{i}{side}"], parents[f"{leg}{i}{side}"] = place, above
                above = f"{leg}{i}{side}"
    guess = recognise(Skeleton(heads, parents))
    assert not guess.roles and "stand on the floor" in guess.doubts[0]
    assert not choose_map(Skeleton(heads, parents)).bones


def test_no_person_is_found_where_there_is_none() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        names = [f"n{i}" for i in range(40)]
        parents = {name: names[int(rng.integers(i))] for i, name in enumerate(names) if i}
        guess = recognise(Skeleton({name: rng.normal(size=3) for name in names}, parents))
        assert not guess.roles


def test_a_preset_whose_bones_are_elsewhere_is_passed_over() -> None:
    foreign = draw(NAMINGS["unreal_4"])
    other = {"calf_l": "spine_02", "spine_02": "calf_l", "calf_r": "head", "head": "calf_r"}
    swapped = foreign.renamed({bone: other.get(bone, bone) for bone in foreign.heads})
    chosen = choose_map(skeleton_of(swapped))
    assert chosen.label == STRUCTURE and chosen.bones["left_shin"] == "spine_02" and chosen.bones["head"] == "calf_r"


def test_a_vrm_states_its_bones_itself() -> None:
    stated = {
        "hips": "a", "spine": "b", "upperChest": "c", "head": "d", "leftUpperLeg": "e", "rightUpperLeg": "f",
        "leftUpperArm": "g", "rightUpperArm": "h", "leftThumbProximal": "j", "leftThumbMetacarpal": "i",
        "leftLittleProximal": "k", "leftEye": "l", "jaw": "gone",
    }  # fmt: skip
    found = roles_of_vrm(stated, "abcdefghijkl")
    assert found["spine_2"] == "c" and found["left_thumb_1"] == "i" and found["left_thumb_2"] == "j"
    assert found["left_pinky_1"] == "k" and "l" not in found.values()
    assert not roles_of_vrm({**stated, "head": "gone"}, "abcdefghijkl")
