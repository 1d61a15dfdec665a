"""How other programs name and hang the bones of a person, by their public documents and sample files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from tests.support.foreign_skeletons import FINGERS, Naming


def _by_words(
    pattern: Callable[[str, str], str], words: dict[str, str], finger: Callable[[str, int], str]
) -> Callable[[str, str], str]:
    """Return a naming of sides: words of parts, a rule for fingers, and the pattern that joins a word and a side."""

    def name(part: str, side: str) -> str:
        base, _, number = part.rpartition("_")
        if base in FINGERS:
            word = finger(base, int(number))
        elif base in ("hair", "skirt", "breast"):
            word = f"{base.title()}{number}"
        else:
            word = words.get(part, "Eye" if part == "eye" else "")
        return pattern(word, side) if word else ""

    return name


def _words(text: str) -> dict[str, str]:
    return dict(entry.split("=") for entry in text.split())


_MIXAMO = _words("clavicle=Shoulder upper_arm=Arm forearm=ForeArm hand=Hand thigh=UpLeg shin=Leg foot=Foot "
                 "toe=ToeBase toe_end=Toe_End")  # fmt: skip
_UNREAL = _words("clavicle=clavicle upper_arm=upperarm forearm=lowerarm hand=hand thigh=thigh shin=calf foot=foot "
                 "toe=ball upper_arm_twist=upperarm_twist_01 forearm_twist=lowerarm_twist_01 "
                 "thigh_twist=thigh_twist_01 shin_twist=calf_twist_01")  # fmt: skip
_VROID = _words("clavicle=Shoulder upper_arm=UpperArm forearm=LowerArm hand=Hand thigh=UpperLeg shin=LowerLeg "
                "foot=Foot toe=ToeBase")  # fmt: skip
_DAZ = _words("clavicle=Collar upper_arm=ShldrBend upper_arm_inline=ShldrTwist forearm=ForearmBend "
              "forearm_inline=ForearmTwist hand=Hand thigh=ThighBend thigh_inline=ThighTwist shin=Shin foot=Foot "
              "palm_foot=Metatarsals toe=Toe")  # fmt: skip
_RIGIFY = _words("clavicle=shoulder upper_arm=upper_arm upper_arm_inline=upper_arm_2 forearm=forearm "
                 "forearm_inline=forearm_2 hand=hand thigh=thigh thigh_inline=thigh_2 shin=shin shin_inline=shin_2 "
                 "foot=foot toe=toe")  # fmt: skip
_XSENS = _words("clavicle=Collar upper_arm=Shoulder forearm=Elbow hand=Wrist thigh=Hip shin=Knee foot=Ankle toe=Toe")
_MAX_CMU = {**_XSENS, "hip_joint": "HipJoint"}
_BIPED = _words("clavicle=Clavicle upper_arm=UpperArm forearm=Forearm hand=Hand thigh=Thigh shin=Calf foot=Foot "
                "toe=Toe0")  # fmt: skip
_ARP = _words("clavicle=shoulder upper_arm=arm_stretch forearm=forearm_stretch hand=hand thigh=thigh_stretch "
              "shin=leg_stretch foot=foot toe=toes_01")  # fmt: skip
_MAKEHUMAN = _words("clavicle=clavicle upper_arm=upperarm01 upper_arm_inline=upperarm02 forearm=lowerarm01 "
                    "forearm_inline=lowerarm02 hand=wrist thigh=upperleg01 thigh_inline=upperleg02 shin=lowerleg01 "
                    "shin_inline=lowerleg02 foot=foot toe=toe1-1")  # fmt: skip
_VRM_LIKE = _words("clavicle=Kata upper_arm=Ude forearm=Hiji hand=Te thigh=Momo shin=Hiza foot=Ashi toe=Yubi")


def _camel(prefix: str = "") -> Callable[[str, str], str]:
    return lambda word, side: f"{prefix}{side.title()}{word}"


def _suffix(mark: str) -> Callable[[str, str], str]:
    return lambda word, side: word + mark.format(s=side[0], S=side[0].upper())


def _mixamo_like(prefix: str, fingers: int = 4) -> Naming:
    middle = {"pelvis": "Hips", "spine": "Spine Spine1 Spine2", "neck": "Neck", "head": "Head", "top": "HeadTop_End"}
    return Naming(
        {part: [prefix + word for word in words.split()] for part, words in middle.items()},
        _by_words(_camel(prefix), _MIXAMO, lambda f, i: f"Hand{f.title()}{i}"), fingers=fingers,
    )  # fmt: skip


def _unreal(spine: int, neck: int, **more: object) -> Naming:
    middle = {
        "root": ["root"], "pelvis": ["pelvis"], "spine": [f"spine_{i + 1:02d}" for i in range(spine)],
        "neck": [f"neck_{i + 1:02d}" for i in range(neck)], "head": ["head"],
    }  # fmt: skip
    parts = ("upper_arm", "forearm", "thigh", "shin")
    fingers = _by_words(_suffix("_{s}"), _UNREAL, lambda f, i: f"{f}_{i:02d}" if i else f"{f}_metacarpal")
    return Naming(middle, fingers, twists=parts, **more)


def _plain(middle: dict[str, str], side: Callable[[str, str], str], **more: object) -> Naming:
    return Naming({part: words.split(",") for part, words in middle.items()}, side, **more)


NAMINGS: dict[str, Naming] = {
    "mixamo": _mixamo_like("mixamorig:"),
    "mixamo_numbered": _mixamo_like("mixamorig7:"),
    "ready_player_me": replace(_mixamo_like(""), extras=("face",)),
    "rokoko_bvh": replace(_mixamo_like("", 3), middle={
        "pelvis": ["Hips"], "spine": ["Spine", "Spine1", "Spine2", "Spine3", "Spine4"], "neck": ["Neck"],
        "head": ["Head"]}),
    "unreal_4": _unreal(3, 1, extras=("ik",)),
    "unreal_5": _unreal(5, 2, extras=("ik",), palms=True),
    "metahuman": _unreal(5, 2, extras=("face", "breasts"), palms=True),
    "vroid": _plain(
        {"root": "Root", "pelvis": "J_Bip_C_Hips", "spine": "J_Bip_C_Spine,J_Bip_C_Chest,J_Bip_C_UpperChest",
         "neck": "J_Bip_C_Neck", "head": "J_Bip_C_Head"},
        _by_words(lambda w, s: f"J_Bip_{s[0].upper()}_{w}", _VROID,
                  lambda f, i: f"{f.replace('pinky', 'little').title()}{i}"),
        extras=("hair", "skirt", "breasts", "face")),
    "vrm_own_names": _plain(
        {"pelvis": "Koshi", "spine": "Hara,Mune", "neck": "Kubi", "head": "Atama"},
        _by_words(lambda w, s: f"{'H' if s == 'left' else 'M'}.{w}", _VRM_LIKE, lambda f, i: f"{f[:2]}{i}"),
        extras=("hair",)),
    "daz": _plain(
        {"pelvis": "hip", "below": "pelvis", "spine": "abdomenLower,abdomenUpper,chestLower,chestUpper",
         "neck": "neckLower,neckUpper", "head": "head"},
        _by_words(lambda w, s: s[0] + w, _DAZ, lambda f, i: f"{f.replace('middle', 'mid').title()}{i}"),
        inline=("upper_arm", "forearm", "thigh"), extras=("face",)),
    "auto_rig_pro": _plain(
        {"root": "root", "pelvis": "root.x", "spine": "spine_01.x,spine_02.x,spine_03.x", "neck": "neck.x",
         "head": "head.x"},
        _by_words(_suffix(".{s}"), _ARP, lambda f, i: f"{f}{i}")),
    "rigify_deform": _plain(
        {"pelvis": "DEF-spine", "spine": "DEF-spine.001,DEF-spine.002,DEF-spine.003",
         "neck": "DEF-spine.004,DEF-spine.005", "head": "DEF-spine.006"},
        _by_words(lambda w, s: f"DEF-{w}.{s[0].upper()}", _RIGIFY, lambda f, i: f"f_{f}.{i:02d}"),
        inline=("upper_arm", "forearm", "thigh", "shin"), extras=("breasts",)),
    "makehuman": _plain(
        {"pelvis": "root", "spine": "spine05,spine04,spine03,spine02,spine01", "neck": "neck01,neck02,neck03",
         "head": "head"},
        _by_words(_suffix(".{S}"), _MAKEHUMAN, lambda f, i: f"finger{[*FINGERS].index(f) + 1}-{i}"),
        inline=("upper_arm", "forearm", "thigh", "shin"), extras=("face", "breasts")),
    "cmu_bvh": replace(_mixamo_like("", 1), before_thigh="hip_joint", middle={
        "pelvis": ["Hips"], "spine": ["LowerBack", "Spine", "Spine1"], "neck": ["Neck", "Neck1"], "head": ["Head"]},
        side=_by_words(_camel(), {**_MIXAMO, "toe_end": "", "hip_joint": "HipJoint"},
                       lambda f, i: "Thumb" if f == "thumb" else "HandIndex1" if f == "index" else "")),
    "cmu_max_bvh": _plain(
        {"pelvis": "Hips", "spine": "LowerBack,Chest", "neck": "Neck", "head": "Head"},
        _by_words(_camel(), _MAX_CMU, lambda f, i: ""), before_thigh="hip_joint", fingers=0),
    "xsens_bvh": _plain(
        {"pelvis": "Hips", "spine": "Chest,Chest2,Chest3,Chest4", "neck": "Neck", "head": "Head"},
        _by_words(_camel(), _XSENS, lambda f, i: ""), fingers=0),
    "biped": _plain(
        {"root": "Bip001", "pelvis": "Bip001 Pelvis", "spine": "Bip001 Spine,Bip001 Spine1,Bip001 Spine2",
         "neck": "Bip001 Neck", "head": "Bip001 Head"},
        _by_words(lambda w, s: f"Bip001 {s[0].upper()} {w}", _BIPED,
                  lambda f, i: f"Finger{[*FINGERS].index(f)}{i - 1 or ''}")),
}  # fmt: skip
"""One entry a system: names and tree by its public documents and sample files."""
