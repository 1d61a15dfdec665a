"""Map of a rig: the bone for each role (body part), the FK/IK switches, and the map pose."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .._exchange.json_file import read_json_file
from .._exchange.outputs import atomic_output
from .._exchange.rigs.skeleton import CHAINS, FINGERS, SIDES, is_of_a_side, is_role
from ..errors import MapInvalid

FORMAT, VERSION = "manifold_mocap_rig_map", 1
_KEYS = {"format", "version", "label", "bones", "sides", "switches", "map_pose"}


@dataclass(frozen=True)
class Switch:
    """Custom property of a bone that has one value for FK limbs and another for IK limbs."""

    bone: str
    key: str  # Name of the property.
    fk: float
    ik: float


@dataclass(frozen=True)
class RigMap:
    """Roles of a rig's bones, its FK/IK switches and its map pose."""

    label: str
    bones: dict[str, str]  # Bone names by role.
    switches: tuple[Switch, ...] = ()
    map_pose: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)
    """Rotation (wxyz) of each bone in the armature's axes, from rest to the pose that matches the rest pose of the
    add-on's body (arms sideways, legs straight). Other bones get rotations from the directions of the limbs."""
    doubts: tuple[str, ...] = ()
    """Warnings about roles that were not recognised, one sentence each. They are not written to files."""

    def renamed(self, names: dict[str, str]) -> RigMap:
        """Return a map with new bone names. Roles of bones that are not in ``names`` are omitted."""
        bones = {role: names[bone] for role, bone in self.bones.items() if bone in names}
        switches = tuple(Switch(names[s.bone], s.key, s.fk, s.ik) for s in self.switches if s.bone in names)
        pose = {names[bone]: turn for bone, turn in self.map_pose.items() if bone in names}
        return RigMap(self.label, bones, switches, pose)


def read_map(path: Path) -> RigMap:
    """Read a rig map or preset from a JSON file. Raises ``MapInvalid`` if it is not usable."""
    return map_of(read_json_file(path), str(path))


def map_of(values: Any, where: str) -> RigMap:
    """Return the rig map in a file's JSON values. Raises ``MapInvalid`` if they are not a valid map."""
    if not isinstance(values, dict) or values.get("format") != FORMAT or values.get("version") != VERSION:
        hint = f'It must be an object with "format": "{FORMAT}" and "version": {VERSION}.'
        raise MapInvalid("The file is not a rig map.", where=where, hint=hint)
    if unknown := sorted(set(values) - _KEYS):
        hint = f"Known entries: {', '.join(sorted(_KEYS))}."
        raise MapInvalid(f"The map has unknown entries: {', '.join(unknown)}.", where=where, hint=hint)
    sides = values.get("sides", ["", ""])
    try:
        bones = dict(_flat(values["bones"], sides))
        switches = tuple(
            Switch(bone, str(entry["property"]), float(entry["fk"]), float(entry["ik"]))
            for entry in values.get("switches", [])
            for bone in _of_both(entry["bone"], sides)
        )
        pose = {bone: _quaternion(turn) for bone, turn in values.get("map_pose", {}).items()}
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        hint = "Compare it with a map written by --save-map."
        raise MapInvalid(f"The map cannot be read: {error!r}.", where=where, hint=hint) from error
    if wrong := sorted(role for role in bones if not is_role(role)):
        hint = "Roles are pelvis, spine (a list), neck (a list), head, clavicle, … (docs/how-to/retarget.md)."
        raise MapInvalid(f"The map has unknown roles: {', '.join(wrong)}.", where=where, hint=hint)
    return RigMap(str(values.get("label", Path(where).stem)), bones, switches, pose)


def map_values(rig_map: RigMap) -> dict[str, object]:
    """Convert a rig map to JSON values. ``map_of`` reads them."""
    switches = [{"bone": s.bone, "property": s.key, "fk": s.fk, "ik": s.ik} for s in rig_map.switches]
    pose = {bone: list(turn) for bone, turn in rig_map.map_pose.items()}
    values: dict[str, object] = {"format": FORMAT, "version": VERSION, "label": rig_map.label, "bones": rig_map.bones}
    return values | {"switches": switches, "map_pose": pose}


def write_map(path: Path, rig_map: RigMap, *, overwrite: bool = False) -> None:
    """Write a rig map to a JSON file. ``read_map`` reads it."""
    with atomic_output(path, overwrite=overwrite) as temporary:
        temporary.write_text(json.dumps(map_values(rig_map), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _flat(bones: dict[str, Any], sides: list[str]) -> Iterator[tuple[str, str]]:
    for part, name in bones.items():
        if part in CHAINS:
            yield from ((f"{part}_{i + 1}", str(bone)) for i, bone in enumerate(name))
        elif part in FINGERS:
            for i, bone in enumerate(name):
                numbered = (f"{side}_{part}_{i + 1}" for side in SIDES)
                yield from zip(numbered, _of_both(bone, sides), strict=True)
        elif is_of_a_side(part):
            yield from ((f"{side}_{part}", bone) for side, bone in zip(SIDES, _of_both(name, sides), strict=True))
        else:
            yield part, str(name)


def _of_both(name: str, sides: list[str]) -> list[str]:
    return [name.replace("{side}", side) for side in sides] if "{side}" in name else [name]


def _quaternion(turn: list[float]) -> tuple[float, float, float, float]:
    w, x, y, z = (float(value) for value in turn)
    length = (w * w + x * x + y * y + z * z) ** 0.5
    if not 0.5 < length < 2.0:
        raise ValueError(f"{turn} is not a quaternion")
    return w / length, x / length, y / length, z / length
