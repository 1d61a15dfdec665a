"""Presets: maps of common rigs, ours and the user's, and which of them fits a rig."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..._exchange.errors import MocapError
from ...errors import MapInvalid
from .names import guess_roles
from .rig_map import RigMap, read_map

SHIPPED = Path(__file__).parent / "presets"
GUESSED = "By Names"
_FITS = 0.75
"""Share of a preset's bones of trunk and limbs that a rig must have."""
_OPTIONAL = ("root", "spine_", "neck_", "_ik", "_pole", "_toe")
"""Roles that many rigs of a kind lack."""


def preset_files(user_folder: Path | None = None) -> dict[str, Path]:
    """Return the presets by name; one of the user's hides one of ours of that name."""
    folders = [SHIPPED, *([user_folder] if user_folder is not None and user_folder.is_dir() else [])]
    return {path.stem: path for folder in folders for path in sorted(folder.glob("*.json"))}


def choose_map(bones: Iterable[str], parents: dict[str, str], user_folder: Path | None = None) -> RigMap:
    """Return the preset that fits a rig best or, if none does, what its names say.

    Args:
        bones: names of the rig's bones.
        parents: name of each bone's parent; roots have none.
        user_folder: where the user's presets are.
    """
    bones = list(bones)
    fitting = []
    for path in preset_files(user_folder).values():
        try:
            preset = read_map(path)
        except MocapError:
            continue  # one spoilt file of the user's does not keep the others from being found
        found = fit(preset, bones)
        needed = _needed(preset)
        if needed and len(needed & found.bones.keys()) >= _FITS * len(needed):
            fitting.append((len(found.bones), found))
    if fitting:
        return max(fitting, key=lambda entry: entry[0])[1]
    return RigMap(GUESSED, guess_roles(bones, parents))


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
