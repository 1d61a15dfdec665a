"""Skeletons whose names are glued to the letter of their side, and whose forearm ends in a bone named wrist."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.rigs.names import side_of_name, words_of
from solver_backend.exchange.rigs.skeleton import Skeleton
from solver_backend.exchange.rigs.structure import recognise
from solver_backend.geometry.rotations import exp_so3
from tests.support.acclaim_skeleton import CMU, KINECT, acclaim_skeleton

PARTS = {
    "clavicle": "clavicle", "upper_arm": "humerus", "forearm": "radius", "thigh": "femur", "shin": "tibia",
    "foot": "foot", "toe": "toes",
}  # fmt: skip


def expected(hand: str, side: tuple[str, str] = ("l", "r")) -> dict[str, str]:
    parts = {**PARTS, "hand": hand}
    return {
        f"{name}_{role}": letter + part
        for name, letter in zip(("left", "right"), side, strict=True) for role, part in parts.items()
    } | {"pelvis": "root", "head": "head"}  # fmt: skip


def found(skeleton: Skeleton, wanted: dict[str, str]) -> dict[str, str]:
    roles = recognise(skeleton).roles
    return {role: roles.get(role, "") for role in wanted}


@pytest.mark.parametrize(
    ("name", "side", "words"),
    [
        ("lhumerus", "left", ["humerus"]), ("rradius", "right", ["radius"]), ("rfoot", "right", ["foot"]),
        ("leftupleg", "left", ["upleg"]), ("righthand", "right", ["hand"]), ("lowerback", "", ["lowerback"]),
        ("Oberarm_li", "left", ["oberarm"]), ("Hand.rechts", "right", ["hand"]), ("main droite", "right", ["main"]),
        ("mano_izq", "left", ["mano"]), ("Coscia_sx", "left", ["coscia"]), ("spine_re_li", "", ["spine"]),
        ("ring", "", ["ring"]), ("leg", "", ["leg"]), ("root", "", ["root"]), ("lforearm", "left", ["forearm"]),
    ],
)  # fmt: skip
def test_letters_of_a_side_may_be_glued_to_the_name(name: str, side: str, words: list[str]) -> None:
    assert (side_of_name(name), list(words_of(name))) == (side, words)


@pytest.mark.parametrize("splay_deg", [0.0, 21.0])
@pytest.mark.parametrize("side", [("l", "r"), ("left", "right")])
@pytest.mark.parametrize(("after_elbow", "hand"), [(CMU, "hand"), (KINECT, "wrist")])
def test_whole_limbs_are_found_and_lengths_choose_between_wrist_and_hand(after_elbow, hand, side, splay_deg) -> None:
    wanted = expected(hand, side)
    assert found(acclaim_skeleton(after_elbow, splay_deg=splay_deg, side=side), wanted) == wanted


def test_every_skeleton_of_cmus_original_files_is_found_whole(shared_data: Path) -> None:
    files = sorted((shared_data / "motion_cmu" / "asfamc").glob("*.npz"))
    assert len(files) > 200
    wanted, seen = expected("hand"), set[bytes]()
    for path in files:
        with np.load(path) as clip:
            names, parents = [str(name) for name in clip["names"]], clip["parents"]
            offsets, tpose = clip["offsets"].astype(float), clip["tpose_rotvec"].astype(float)
        if (offsets.tobytes() + tpose.tobytes()) in seen:
            continue
        seen.add(offsets.tobytes() + tpose.tobytes())
        for rotvec in (tpose, np.zeros_like(tpose)):
            local, places, G = exp_so3(rotvec), np.zeros((len(names), 3)), np.tile(np.eye(3), (len(names), 1, 1))
            for j, parent in enumerate(parents):
                above = G[parent] if parent >= 0 else np.eye(3)
                G[j], places[j] = above @ local[j], above @ offsets[j] + (places[parent] if parent >= 0 else 0.0)
            hangs = {name: names[p] for name, p in zip(names, parents, strict=True) if p >= 0}
            assert found(Skeleton(dict(zip(names, places, strict=True)), hangs), wanted) == wanted, path.name
    assert len(seen) >= 12
