"""Recognise a rig by presets, structure and names, and open character files."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Collection, Iterable, Mapping
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import bpy

from .._exchange.errors import FileDamaged, FileMissing, MocapError
from .._exchange.rigs.names import guess_roles
from .._exchange.rigs.skeleton import FINGERS, Skeleton, is_plausible
from .._exchange.rigs.structure import recognise
from .._exchange.torn_lines import torn_line
from ..conventions.timing import set_scene_frame_rate
from ..errors import MapInvalid
from .rig_map import RigMap, read_map

SHIPPED = Path(__file__).parent / "presets"
GUESSED, STRUCTURE = "By Names", "By Structure"
_FITS = 0.75
"""Fraction of the trunk and limb bones in a preset that a rig must have."""
_OPTIONAL = ("root", "spine_", "neck_", "_ik", "_pole", "_toe", *(f"_{finger}_" for finger in FINGERS))
"""Role names, or parts of role names, that many rigs lack."""


def preset_files(user_folder: Path | None = None) -> dict[str, Path]:
    """Return the preset files by name. A user preset replaces the bundled preset of the same name."""
    folders = [SHIPPED, *([user_folder] if user_folder is not None and user_folder.is_dir() else [])]
    return {path.stem: path for folder in folders for path in sorted(folder.glob("*.json"))}


def choose_map(skeleton: Skeleton, user_folder: Path | None = None) -> RigMap:
    """Return the best-matching preset (user presets first), or a plausible map based on structure or names."""
    bones = skeleton.names
    fitting = []
    for path in preset_files(user_folder).values():
        try:
            preset = read_map(path)
        except MocapError:
            continue  # a user's damaged file must not hide the others
        found = fit(preset, bones)
        needed = _needed(preset)
        if needed and len(needed & found.bones.keys()) >= _FITS * len(needed) and is_plausible(found.bones, skeleton):
            is_users_own = path.parent == user_folder and len(found.bones) == len(preset.bones)
            fitting.append((is_users_own, len(found.bones), found))
    if fitting:
        return max(fitting, key=lambda entry: entry[:2])[2]
    return _recognised(skeleton)


def _recognised(skeleton: Skeleton) -> RigMap:
    guess = recognise(skeleton)
    if guess.roles or guess.doubts:
        return RigMap(STRUCTURE, guess.roles, doubts=guess.doubts)
    parents = {name: skeleton.names[p] for name, p in zip(skeleton.names, skeleton.parents, strict=True) if p >= 0}
    named = guess_roles(skeleton.names, parents)
    if not is_plausible(named, skeleton):
        return RigMap(GUESSED, {}, doubts=("Neither the bone names nor the structure match a person.",))
    return RigMap(GUESSED, named)


def named_preset(name: str, bones: Iterable[str], user_folder: Path | None = None) -> RigMap:
    """Return a preset adapted to a rig's bone names. Raise ``MapInvalid`` if the preset is unknown."""
    files = preset_files(user_folder)
    if name not in files:
        raise MapInvalid(f"There is no preset '{name}'.", hint=f"Known presets: {', '.join(files)}.")
    return fit(read_map(files[name]), bones)


def fit(preset: RigMap, bones: Iterable[str]) -> RigMap:
    """Adapt a preset to bone names that differ in case or have a prefix such as ``mixamorig:``."""
    exact = set(bones)
    lower = {bone.lower(): bone for bone in exact}
    wanted = {*preset.bones.values(), *(switch.bone for switch in preset.switches), *preset.map_pose}
    best: dict[str, str] = {bone: bone for bone in wanted & exact}
    for prefix in _prefixes(preset.bones.get("pelvis", ""), lower):
        names = {bone: lower[prefix + bone.lower()] for bone in wanted if prefix + bone.lower() in lower}
        if len(names) > len(best):
            best = names
    return preset.renamed(best)


def _prefixes(anchor: str, lower: dict[str, str]) -> list[str]:
    ending = anchor.lower()
    return sorted({name[: len(name) - len(ending)] for name in lower if ending and name.endswith(ending)}, key=len)


def _needed(preset: RigMap) -> set[str]:
    return {role for role in preset.bones if not any(part in role for part in _OPTIONAL)}


_MIDDLE = {"hips": "pelvis", "neck": "neck_1", "head": "head"}
_SPINE = ("spine", "chest", "upperChest")
_PARTS = {
    "Shoulder": "clavicle",
    "UpperArm": "upper_arm",
    "LowerArm": "forearm",
    "Hand": "hand",
    "UpperLeg": "thigh",
    "LowerLeg": "shin",
    "Foot": "foot",
    "Toes": "toe",
}
_FINGER = re.compile(r"(left|right)(Thumb|Index|Middle|Ring|Little)(Metacarpal|Proximal|Intermediate|Distal)")
_NEEDED = {"pelvis", "head", *(f"{side}_{part}" for side in ("left", "right") for part in ("thigh", "upper_arm"))}


def roles_of_vrm(stated: Mapping[str, str], bones: Collection[str]) -> dict[str, str]:
    """Convert a VRM humanoid map to bones by role. Return {} if the map does not cover a whole person.

    The map lists bones by VRM name, such as ``leftUpperArm``. VRM 0.x calls the bones of a thumb proximal, intermediate
    and distal. VRM 1.0 calls them metacarpal, proximal and distal.
    """
    there = {human: bone for human, bone in stated.items() if bone in bones}
    roles = {_MIDDLE[human]: bone for human, bone in there.items() if human in _MIDDLE}
    spine = [there[human] for human in _SPINE if human in there]
    roles |= {f"spine_{i + 1}": bone for i, bone in enumerate(spine)}
    for side in ("left", "right"):
        for word, part in _PARTS.items():
            if f"{side}{word}" in there:
                roles[f"{side}_{part}"] = there[f"{side}{word}"]
    fingers: dict[str, list[tuple[int, str]]] = {}
    for human, bone in there.items():
        if match := _FINGER.fullmatch(human):
            side, finger, segment = match.groups()
            name = f"{side}_{'pinky' if finger == 'Little' else finger.lower()}"
            rank = ("Metacarpal", "Proximal", "Intermediate", "Distal").index(segment)
            fingers.setdefault(name, []).append((rank, bone))
    for name, entries in fingers.items():
        roles |= {f"{name}_{i + 1}": bone for i, (_, bone) in enumerate(sorted(entries))}
    return roles if roles.keys() >= _NEEDED and len(set(roles.values())) == len(roles) else {}


_VRM = "vrm_addon_extension"  # Custom property in which the VRM add-on stores a file's humanoid.
_STATED = "stated_humanoid"  # The add-on's custom property that stores bones by VRM name, as JSON.


def map_rig(armature: bpy.types.Object, user_folder: Path | None = None) -> RigMap:
    """Return the map of a rig from its VRM data, a matching preset, its structure or its names."""
    bones = armature.data.bones
    if stated := roles_of_vrm(_stated_bones(armature), bones.keys()):
        return RigMap("VRM humanoid of the file", stated)
    heads = {bone.name: tuple(bone.head_local) for bone in bones}
    parents = {bone.name: bone.parent.name for bone in bones if bone.parent is not None}
    return choose_map(Skeleton(heads, parents), user_folder)


def state_humanoid(armature: bpy.types.Object, bones: Mapping[str, str]) -> None:
    """Store a file's VRM humanoid map (bone names by VRM name) in its armature."""
    if any(bone in armature.data.bones for bone in bones.values()):
        armature.data[_STATED] = json.dumps(dict(bones))


def _stated_bones(armature: bpy.types.Object) -> dict[str, str]:
    kept = armature.data.get(_STATED)
    if isinstance(kept, str):
        return json.loads(kept)
    kept = armature.data.get(_VRM)
    newer = _at(kept, "vrm1", "humanoid", "human_bones").items()
    older = ((entry.get("bone", ""), entry) for entry in _at(kept, "vrm0", "humanoid").get("human_bones", []))
    for pairs in (newer, older):
        if found := {str(human): str(name) for human, entry in pairs if (name := _at(entry, "node").get("bone_name"))}:
            return found
    return {}


def _at(value: Any, *keys: str) -> Mapping:
    for key in keys:
        value = value.get(key, {}) if hasattr(value, "get") else {}
    return value if hasattr(value, "get") else {}


_FOLDER = "presets/manifold_mocap_rigs"


def user_presets_folder(*, make: bool = False) -> Path | None:
    """Return the folder of the user's presets, or None if Blender has no folder for user files."""
    folder = bpy.utils.user_resource("SCRIPTS", path=_FOLDER, create=make)
    return Path(folder) if folder else None


_MAGIC, _JSON_CHUNK = 0x46546C67, 0x4E4F534A
_MOST_BYTES = 64 * 1024 * 1024
"""Largest header in bytes. The headers of large characters take a few megabytes."""
_MOST_KEYS = 2**31  # Largest number of keys in a channel, which is glTF's largest index.
_RATES = (1.0, 480.0)  # Plausible frame rates in frames per second. Chosen by hand.
_SPARSE_HZ, _FILM_HZ = 10.0, 24.0  # Slower key rates are an animator's. Their frames reach at least the second rate.


def read_header(path: Path) -> dict[str, Any]:
    """Return the JSON header of a ``.gltf``, ``.glb`` or ``.vrm`` file (glTF 2.0, section 4.4)."""
    try:
        with path.open("rb") as stream:
            start = stream.read(20)
            if len(start) == 20 and struct.unpack_from("<I", start)[0] == _MAGIC:
                length, kind = struct.unpack_from("<II", start, 12)
                if kind != _JSON_CHUNK or length > _MOST_BYTES:
                    raise ValueError("its first chunk is not a header")
                text = stream.read(length)
            else:
                text = start + stream.read(_MOST_BYTES)
        header = json.loads(text)
    except (OSError, ValueError, RecursionError) as error:
        raise FileDamaged(f"This is not a glTF file: {error}.", where=str(path)) from error
    if not isinstance(header, dict):
        raise FileDamaged("This is not a glTF file.", where=str(path))
    return header


def frame_rate(header: dict[str, Any]) -> float | None:
    """Return a file's frame rate from the median rate of its keys, or None without a plausible rate.

    If the keys are sparse, a multiple of their rate is returned.
    """
    rates = []
    accessors = _list(header.get("accessors"))
    for animation in _list(header.get("animations")):
        for sampler in _list(_dict(animation).get("samplers")):
            index = _dict(sampler).get("input")
            entry = _dict(accessors[index]) if isinstance(index, int) and 0 <= index < len(accessors) else {}
            count, ends = entry.get("count", 0), [*_list(entry.get("min"))[:1], *_list(entry.get("max"))[:1]]
            known = all(isinstance(end, int | float) and abs(end) < 1e9 for end in ends) and isinstance(count, int)
            if known and 2 < count < _MOST_KEYS and len(ends) == 2 and ends[1] > ends[0]:
                rates.append((count - 1) / (ends[1] - ends[0]))
    rates = sorted(rate for rate in rates if _RATES[0] <= rate <= _RATES[1])
    # Most channels have the same rate. The median ignores a few sparse or doubled channels.
    rate = round(rates[len(rates) // 2], 3) if rates else None  # times are in single precision
    return rate and round(rate * (1 if rate >= _SPARSE_HZ else ceil(_FILM_HZ / rate)), 3)


def humanoid(header: dict[str, Any]) -> dict[str, str]:
    """Return the node name of each VRM bone (VRM 0.x, VRM 1.0 and VRM animations), or {} for other files."""
    extensions, nodes = _dict(header.get("extensions")), _list(header.get("nodes"))
    pairs = list(_nodes_of_bones(header).items())
    older = _list(_dict(_dict(extensions.get("VRM")).get("humanoid")).get("humanBones"))
    pairs += [(str(_dict(entry).get("bone", "")), _dict(entry).get("node")) for entry in older]
    names = {
        human: str(_dict(nodes[node]).get("name", ""))
        for human, node in pairs
        if isinstance(node, int) and 0 <= node < len(nodes)
    }
    return {human: name for human, name in names.items() if human and name}


def _nodes_of_bones(header: dict[str, Any]) -> dict[str, Any]:
    """Return the node number of each VRM bone, for VRM 1.0 characters and VRM animations."""
    extensions, found = _dict(header.get("extensions")), {}
    for name in ("VRMC_vrm", "VRMC_vrm_animation"):
        bones = _dict(_dict(_dict(extensions.get(name)).get("humanoid")).get("humanBones"))
        found |= {human: _dict(entry).get("node") for human, entry in bones.items()}
    return found


def write_skinned(path: Path, out: Path) -> Path:
    """Write a copy of a VRM animation with a skin, because without one Blender creates no armature.

    Raises:
        FileDamaged: the file has no humanoid or is not a binary glTF file.
    """
    header, data = read_header(path), path.read_bytes()
    joints = sorted({node for node in _nodes_of_bones(header).values() if isinstance(node, int)})
    if not joints or struct.unpack_from("<I", data)[0] != _MAGIC:
        raise FileDamaged("This VRM animation has no humanoid bones.", where=str(path), hint="Export the file again.")
    header["skins"] = [{"joints": joints}]
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + struct.unpack_from("<I", data, 12)[0] :]
    start = struct.pack("<IIIII", _MAGIC, 2, 20 + len(text) + len(rest), len(text), _JSON_CHUNK)
    out.write_bytes(start + text + rest)
    return out


def _dict(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


SUFFIXES = (".blend", ".fbx", ".glb", ".gltf", ".vrm", ".vrma", ".bvh")  # Suffixes of supported files.


def open_scene(path: Path) -> bpy.types.Scene:
    """Open a file, or import it into an empty scene at the file's frame rate."""
    if not path.is_file():
        raise FileMissing("There is no such file.", where=str(path), hint="Check the path.")
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        hint = f"Export it as FBX or glTF. Supported endings are {', '.join(SUFFIXES)}."
        raise FileDamaged(f"The file type is not supported ({suffix or 'no ending'}).", where=str(path), hint=hint)
    rate: float | None = None
    stated: dict[str, str] = {}
    if suffix in (".glb", ".gltf", ".vrm", ".vrma"):
        header = read_header(path)
        rate, stated = frame_rate(header), humanoid(header)
    try:
        _open(path, suffix, rate)
    except (RuntimeError, AttributeError, TypeError, ValueError, KeyError, IndexError, AssertionError) as error:
        # Importers are Python add-ons and raise various errors on damaged files.
        lines = [line.strip() for line in str(error).splitlines() if not line.startswith("Location:")]
        last = next((line for line in reversed(lines) if line), "it is damaged")
        where = torn_line(path, path.read_text(errors="replace")) if suffix == ".bvh" else str(path)
        raise FileDamaged(f"Blender cannot open the file: {last}", where=where) from error
    for rig in (o for o in bpy.data.objects if o.type == "ARMATURE" and stated):
        state_humanoid(rig, stated)
    return bpy.context.scene


def _open(path: Path, suffix: str, rate: float | None) -> None:
    name = str(path.resolve())
    if suffix == ".blend":
        bpy.ops.wm.open_mainfile(filepath=name, load_ui=False, use_scripts=False)
        return
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    if rate is not None:
        set_scene_frame_rate(bpy.context.scene, rate)
    if suffix == ".fbx":
        bpy.ops.import_scene.fbx(filepath=name)
    elif suffix == ".bvh":
        bpy.ops.import_anim.bvh(filepath=name, update_scene_fps=True, use_fps_scale=False)
    elif suffix == ".vrma":
        with TemporaryDirectory() as folder:
            made = write_skinned(path, Path(folder) / path.with_suffix(".glb").name)
            bpy.ops.import_scene.gltf(filepath=str(made), guess_original_bind_pose=False)
    else:
        bpy.ops.import_scene.gltf(filepath=name)
