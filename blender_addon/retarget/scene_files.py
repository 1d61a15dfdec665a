"""Files with characters and clips, opened as a scene: .blend, FBX, glTF, VRM and BVH."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import bpy

from .._exchange.errors import FileDamaged, FileMissing
from ..conventions.timing import set_scene_frame_rate
from .recognition import state_humanoid

_MAGIC, _JSON_CHUNK = 0x46546C67, 0x4E4F534A
_MOST_BYTES = 64 * 1024 * 1024
"""Largest length of a header. Those of large characters have some megabytes."""
_RATES = (1.0, 480.0)  # Plausible frame rates in frames per second, chosen by hand.


def read_header(path: Path) -> dict[str, Any]:
    """Return the JSON of a ``.gltf``, ``.glb`` or ``.vrm`` file (glTF 2.0, section 4.4).

    Raises ``FileDamaged`` if it is no such file.
    """
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
    """Return the median rate of the keys of a file's animations, None without keys."""
    rates = []
    accessors = _list(header.get("accessors"))
    for animation in _list(header.get("animations")):
        for sampler in _list(_dict(animation).get("samplers")):
            index = _dict(sampler).get("input")
            entry = _dict(accessors[index]) if isinstance(index, int) and 0 <= index < len(accessors) else {}
            count, ends = entry.get("count", 0), [*_list(entry.get("min"))[:1], *_list(entry.get("max"))[:1]]
            if isinstance(count, int) and count > 2 and len(ends) == 2 and ends[1] > ends[0]:
                rates.append((count - 1) / (ends[1] - ends[0]))
    rates = sorted(rate for rate in rates if _RATES[0] <= rate <= _RATES[1])
    # Most channels are sampled alike; a few sparse or doubled ones do not count.
    return round(rates[len(rates) // 2], 3) if rates else None


def humanoid(header: dict[str, Any]) -> dict[str, str]:
    """Return the nodes' names by VRM's name of the bone (VRM 0.x and 1.0), empty for other files."""
    extensions, nodes = _dict(header.get("extensions")), _list(header.get("nodes"))
    newer = _dict(_dict(_dict(extensions.get("VRMC_vrm")).get("humanoid")).get("humanBones"))
    pairs = [(human, _dict(entry).get("node")) for human, entry in newer.items()]
    older = _list(_dict(_dict(extensions.get("VRM")).get("humanoid")).get("humanBones"))
    pairs += [(str(_dict(entry).get("bone", "")), _dict(entry).get("node")) for entry in older]
    names = {
        human: str(_dict(nodes[node]).get("name", ""))
        for human, node in pairs
        if isinstance(node, int) and 0 <= node < len(nodes)
    }
    return {human: name for human, name in names.items() if human and name}


def _dict(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


SUFFIXES = (".blend", ".fbx", ".glb", ".gltf", ".vrm", ".bvh")  # Supported files.


def open_scene(path: Path) -> bpy.types.Scene:
    """Open a file and return its scene. Files of other programs are imported into an empty scene.

    The scene has the frame rate of the file's clips. Raises ``FileMissing`` or ``FileDamaged`` if it does not exist,
    its format is not supported, or Blender cannot open it.
    """
    if not path.is_file():
        raise FileMissing("There is no such file.", where=str(path), hint="Check the path.")
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        hint = f"Export it as FBX or glTF; {', '.join(SUFFIXES)} are read."
        raise FileDamaged(f"Not supported: {suffix or 'files without an ending'}.", where=str(path), hint=hint)
    rate: float | None = None
    stated: dict[str, str] = {}
    if suffix in (".glb", ".gltf", ".vrm"):
        header = read_header(path)
        rate, stated = frame_rate(header), humanoid(header)
    try:
        _open(path, suffix, rate)
    except (RuntimeError, AttributeError, TypeError, ValueError, KeyError, IndexError, AssertionError) as error:
        # Importers are Python add-ons, which raise various errors on damaged files.
        first = next((line for line in reversed(str(error).strip().splitlines()) if line.strip()), "it is damaged")
        raise FileDamaged(f"Blender cannot open the file: {first.strip()}", where=str(path)) from error
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
    else:
        bpy.ops.import_scene.gltf(filepath=name)
