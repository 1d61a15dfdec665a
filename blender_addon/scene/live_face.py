"""The face of a live run on the user's own shape keys, by name or by a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import bpy

from .._exchange.errors import FileDamaged
from .._exchange.json_file import read_json_file


@dataclass
class LiveFace:
    """A mesh, looked up each time, as undo replaces it."""

    mesh: str
    """Name of the object."""
    table: Mapping[str, str] = field(default_factory=dict)
    """Shape key of each channel, by the channel's name in lower case; others have the names of their channels."""

    def show(self, face: Mapping[str, float]) -> int:
        """Set the shape keys of channels, within the limits of their sliders; return how many there are.

        Case does not matter. Channels without a shape key change nothing, and neither does a mesh that is gone.
        """
        obj = bpy.data.objects.get(self.mesh)
        keys = getattr(obj.data, "shape_keys", None) if obj is not None else None
        if keys is None:
            return 0
        blocks = {block.name.lower(): block for block in list(keys.key_blocks)[1:]}
        found = 0
        for channel, value in face.items():
            block = blocks.get(self.table.get(channel.lower(), channel).lower())
            if block is not None:
                block.value = value
                found += 1
        return found


def read_face_table(path: Path) -> dict[str, str]:
    """Return a table of channels: a JSON object such as ``{"JawOpen": "Mouth Open"}``.

    Raises:
        FileMissing, FileDamaged: it cannot be read, or is none.
    """
    values = read_json_file(path)
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values.values()):
        raise FileDamaged(
            "This is not a table of a face.", where=str(path),
            hint='Write an object of channels and shape keys: {"JawOpen": "Mouth Open"}.',
        )  # fmt: skip
    return {channel.lower(): key for channel, key in values.items()}
