"""Presets: maps of common rigs, ours and the user's, and which of them fits a rig."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..._exchange.errors import MocapError
from ..._exchange.rigs.names import guess_roles
from ..._exchange.rigs.plausible import is_plausible
from ..._exchange.rigs.roles import FINGERS
from ..._exchange.rigs.skeleton import Skeleton
from ..._exchange.rigs.structure import recognise
from ...errors import MapInvalid
from .rig_map import RigMap, read_map

SHIPPED = Path(__file__).parent / "presets"
GUESSED, STRUCTURE = "By Names", "By Structure"
_FITS = 0.75
"""Share of a preset's bones of trunk and limbs that a rig must have."""
_OPTIONAL = ("root", "spine_", "neck_", "_ik", "_pole", "_toe", *(f"_{finger}_" for finger in FINGERS))
"""Roles that many rigs of a kind lack."""


def preset_files(user_folder: Path | None = None) -> dict[str, Path]:
    """Return the presets by name; one of the user's hides one of ours of that name."""
    folders = [SHIPPED, *([user_folder] if user_folder is not None and user_folder.is_dir() else [])]
    return {path.stem: path for folder in folders for path in sorted(folder.glob("*.json"))}


def choose_map(skeleton: Skeleton, user_folder: Path | None = None) -> RigMap:
    """Return the preset that fits a rig best or, if none does, what its structure or else its names indicate.

    A map whose limbs no person can have is passed over, however well its names fit. A preset of the user's whose bones
    are all there comes before ours.

    Args:
        skeleton: the rig's bones.
        user_folder: where the user's presets are.
    """
    bones = skeleton.names
    fitting = []
    for path in preset_files(user_folder).values():
        try:
            preset = read_map(path)
        except MocapError:
            continue  # one spoilt file of the user's does not keep the others from being found
        found = fit(preset, bones)
        needed = _needed(preset)
        if needed and len(needed & found.bones.keys()) >= _FITS * len(needed) and is_plausible(found.bones, skeleton):
            is_users_own = path.parent == user_folder and len(found.bones) == len(preset.bones)
            fitting.append((is_users_own, len(found.bones), found))
    if fitting:
        return max(fitting, key=lambda entry: entry[:2])[2]
    return _recognised(skeleton)


def _recognised(skeleton: Skeleton) -> RigMap:
    """Return what the structure indicates; where it does not find a person, what names do as far as it can be so."""
    guess = recognise(skeleton)
    if guess.roles or guess.doubts:
        return RigMap(STRUCTURE, guess.roles, doubts=guess.doubts)
    parents = {name: skeleton.names[p] for name, p in zip(skeleton.names, skeleton.parents, strict=True) if p >= 0}
    named = guess_roles(skeleton.names, parents)
    if not is_plausible(named, skeleton):
        return RigMap(GUESSED, {}, doubts=("Neither names nor structure show a person.",))
    return RigMap(GUESSED, named)


def named_preset(name: str, bones: Iterable[str], user_folder: Path | None = None) -> RigMap:
    """Return a preset by its name, with the names of a rig's bones.

    Raises:
        MapInvalid: there is no such preset, or it is damaged.
    """
    files = preset_files(user_folder)
    if name not in files:
        raise MapInvalid(f"There is no preset '{name}'.", hint=f"There are: {', '.join(files)}.")
    return fit(read_map(files[name]), bones)


def fit(preset: RigMap, bones: Iterable[str]) -> RigMap:
    """Return a map with the names that its bones have in a rig, without the roles that the rig has no bone for.

    A prefix that all names share, such as ``mixamorig:``, and the case of letters do not count.
    """
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
    """Return what stands before the pelvis's name in a rig, the shortest first."""
    ending = anchor.lower()
    return sorted({name[: len(name) - len(ending)] for name in lower if ending and name.endswith(ending)}, key=len)


def _needed(preset: RigMap) -> set[str]:
    return {role for role in preset.bones if not any(part in role for part in _OPTIONAL)}
