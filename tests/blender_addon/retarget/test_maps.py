"""Maps of rigs: presets, files, and roles told from names."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path

import pytest

from blender_addon._exchange.errors import FileDamaged, FileMissing, OutputExists
from blender_addon._exchange.rigs.names import guess_roles
from blender_addon._exchange.rigs.skeleton import JOINT_OF, LIMBS, Skeleton
from blender_addon.errors import MapInvalid
from blender_addon.retarget.recognition import GUESSED, choose_map, fit, named_preset, preset_files
from blender_addon.retarget.rig_map import map_of, map_values, read_map, write_map

TREE = {
    "": ("Hips", "Spine", "Chest", "Neck", "Head"),
    "Hips": ("UpperLeg", "LowerLeg", "Foot", "Toes"),
    "Chest": ("Shoulder", "UpperArm", "LowerArm", "Hand", "Index1"),
}


def tree(named: Callable[[str, str], str]) -> dict[str, str]:
    """Return the parents of a figure whose bones are named by a part and a side, L, R or nothing."""
    parents = {named(b, ""): named(a, "") for a, b in pairwise(TREE[""])}
    for root in ("Hips", "Chest"):
        for side in "LR":
            line = [named(root, ""), *(named(part, side) for part in TREE[root])]
            parents |= {b: a for a, b in pairwise(line)}
    return parents


def bare(bones: Iterable[str], parents: dict[str, str] | None = None) -> Skeleton:
    """Return bones without places: only names tell what they are."""
    return Skeleton(dict.fromkeys(bones, (0.0, 0.0, 0.0)), parents or {})


NAMINGS: dict[str, Callable[[str, str], str]] = {
    "suffix": lambda part, side: f"{part}_{side}" if side else part,
    "dotted": lambda part, side: f"DEF-{part.lower()}.{side}" if side else f"DEF-{part.lower()}",
    "prefix": lambda part, side: f"{side.lower()}_{part}" if side else part,
    "words": lambda part, side: {"L": "Left", "R": "Right", "": ""}[side] + part,
    "biped": lambda part, side: f"Bip01 {side + ' ' if side else ''}{part}",
}


@pytest.mark.parametrize("naming", NAMINGS)
def test_roles_are_told_from_names(naming: str) -> None:
    parents = tree(NAMINGS[naming])
    bones = list(dict.fromkeys([*parents.values(), *parents]))
    found = guess_roles(bones, parents)
    name = NAMINGS[naming]
    assert set(JOINT_OF) <= set(found)
    assert found["pelvis"] == name("Hips", "") and found["left_forearm"] == name("LowerArm", "L")
    assert found["right_clavicle"] == name("Shoulder", "R") and found["right_toe"] == name("Toes", "R")
    assert (found["spine_1"], found["spine_2"]) == (name("Spine", ""), name("Chest", ""))


SIDE = {"L": "Left", "R": "Right", "": ""}
SPACES: dict[str, Callable[[str, str], str]] = {
    "file": lambda part, side: f"hero:{side + '_' if side else ''}{part}",
    "two": lambda part, side: f"scene:hero2:{part}{'_' + side if side else ''}",
    "side last": lambda part, side: f"{part}:{side}" if side else part,
    "middle last": lambda part, side: f"{part}:{side or 'M'}",
    "side between": lambda part, side: f"rig:{SIDE[side].lower() or 'mid'}:{part}",
    "side first": lambda part, side: f"{SIDE[side]}:{part}" if side else part,
    "number last": lambda part, side: f"{SIDE[side]}{part}:1",
    "human ik": lambda part, side: f"Character1_{SIDE[side]}{part}",
}


@pytest.mark.parametrize("spaces", SPACES)
def test_roles_are_told_from_names_with_colons(spaces: str) -> None:
    name = SPACES[spaces]
    parents = tree(name)
    controls = {f"ik:{SIDE[side]}{part}": name("Hips", "") for side in "LR" for part in ("Hand", "Foot")}
    bones = list(dict.fromkeys([*controls, *parents.values(), *parents]))
    found, plain = guess_roles(bones, parents | controls), tree(NAMINGS["suffix"])
    usual = guess_roles(list(dict.fromkeys([*plain.values(), *plain])), plain)
    renamed = {
        NAMINGS["suffix"](part, side): name(part, side)
        for part in {*TREE[""], *TREE["Hips"], *TREE["Chest"]}
        for side in ("", "L", "R")
    }
    assert found == {role: renamed[bone] for role, bone in usual.items()}


def test_a_limb_is_believed_as_far_as_its_bones_hang_below_each_other() -> None:
    parents = tree(NAMINGS["suffix"]) | {"LowerArm_L": "Head"}
    found = guess_roles(list(dict.fromkeys([*parents.values(), *parents])), parents)
    assert "left_forearm" not in found and "right_forearm" in found


def test_a_shoulder_above_an_arm_of_another_name_is_its_clavicle() -> None:
    arm = ["L_Shldr", "L_UpArm", "L_LoArm", "L_Hand"]
    found = guess_roles(arm, dict(zip(arm[1:], arm, strict=False)))
    assert [found[f"left_{part}"] for part in ("clavicle", "upper_arm", "forearm", "hand")] == arm
    daz = ["lShldr", "lForeArm", "lHand"]
    assert guess_roles(daz, dict(zip(daz[1:], daz, strict=False)))["left_upper_arm"] == "lShldr"


def test_names_that_say_nothing_give_no_roles() -> None:
    assert guess_roles([f"Bone.{i:03}" for i in range(20)], {}) == {}


@pytest.mark.parametrize("name", sorted(preset_files()))
def test_each_preset_is_found_on_its_own_rig_under_a_prefix_too(name: str) -> None:
    preset = read_map(preset_files()[name])
    assert all(set(roles) <= set(preset.bones) for roles in LIMBS.values())
    assert len(set(preset.bones.values())) == len(preset.bones)
    switches = [switch.bone for switch in preset.switches]
    for prefix in ("", "Hero:"):
        chosen = choose_map(bare([prefix + bone for bone in (*preset.bones.values(), *switches)]))
        assert chosen.label == preset.label
        assert chosen.bones == {role: prefix + bone for role, bone in preset.bones.items()}
        assert len(chosen.switches) == len(preset.switches)


def test_a_rig_of_no_preset_is_mapped_by_names() -> None:
    parents = tree(NAMINGS["suffix"])
    assert choose_map(bare(dict.fromkeys([*parents.values(), *parents]), parents)).label == GUESSED


def test_the_users_presets_come_first_and_a_spoilt_one_hurts_nobody(tmp_path: Path) -> None:
    (tmp_path / "spoilt.json").write_text("{", encoding="utf-8")
    mixamo = map_values(read_map(preset_files()["mixamo"])) | {"label": "Mine"}
    (tmp_path / "mixamo.json").write_text(json.dumps(mixamo), encoding="utf-8")
    bones = list(dict(mixamo["bones"]).values())
    assert choose_map(bare(bones), tmp_path).label == "Mine"
    assert named_preset("mixamo", bones, tmp_path).label == "Mine"
    with pytest.raises(MapInvalid, match=r"no preset 'mixano'.*Known presets: .*mixamo"):
        named_preset("mixano", bones)


def test_a_map_is_read_as_it_was_written(tmp_path: Path) -> None:
    preset = read_map(preset_files()["rigify"])
    whole = fit(preset, [*preset.bones.values(), *(switch.bone for switch in preset.switches)])
    posed = map_of(map_values(whole) | {"map_pose": {"hand_fk.L": [0.9, 0.0, 1.2, 0.0]}}, "here")
    write_map(tmp_path / "map.json", posed)
    again = read_map(tmp_path / "map.json")
    assert (again.label, again.bones, again.switches) == (posed.label, posed.bones, posed.switches)
    assert again.map_pose["hand_fk.L"] == pytest.approx((0.6, 0.0, 0.8, 0.0))
    with pytest.raises(OutputExists):
        write_map(tmp_path / "map.json", posed)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other"}, "a rig map"), ({"version": 2}, "a rig map"), ({"colour": 1}, "unknown entries: colour"),
        ({"bones": {"tail": "Tail"}}, "unknown roles: tail"), ({"bones": 3}, "cannot be read"),
        ({"map_pose": {"a": [0, 0, 0, 0]}}, "not a quaternion"), ({"switches": [{"bone": "a"}]}, "cannot be read"),
    ],
)  # fmt: skip
def test_what_is_no_map_is_named(change: dict[str, object], message: str) -> None:
    values = map_values(read_map(preset_files()["mixamo"])) | change
    with pytest.raises(MapInvalid, match=message):
        map_of(values, "map.json")


def test_missing_and_broken_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileMissing):
        read_map(tmp_path / "gone.json")
    (tmp_path / "broken.json").write_bytes(b"\xff{")
    with pytest.raises(FileDamaged, match="cannot be read as text"):
        read_map(tmp_path / "broken.json")
