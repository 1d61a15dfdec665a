"""Looks: clothes, hair, light and what stands in the room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.synthesis.studio.checked_values import CheckedValues

CLOTHES = ("bare", "suit", "shirt_trousers", "tee_shorts", "tee_trousers", "tunic_leggings", "random")
HAIR = ("none", "short", "long", "random")
LIGHT = ("day", "dim", "night", "random")


@dataclass(frozen=True)
class StudioLook:
    """What a shot looks like; what is 'random' is drawn by the shot's own seed."""

    name: str
    clothes: str = "suit"
    """A key of ``CLOTHES``."""
    hair: str = "random"
    """A key of ``HAIR``."""
    light: str = "day"
    """A key of ``LIGHT``; of colour pictures alone, infrared brings its own."""
    furniture: int = 0
    """Pieces that stand about the person and hide parts of it."""
    room: bool = True
    """Walls and a ceiling; a floor alone if not."""


_PRESETS: dict[str, dict[str, Any]] = {
    "suit": {"clothes": "suit", "hair": "short"},
    "bare": {"clothes": "bare", "hair": "none"},
    "everyday": {"clothes": "random", "hair": "random", "furniture": 2},
    "cluttered": {"clothes": "random", "hair": "random", "furniture": 5},
    "night": {"clothes": "random", "hair": "random", "light": "night", "furniture": 2},
    "varied": {"clothes": "random", "hair": "random", "light": "random", "furniture": 3},
}
"""Values of a look by the name of a preset; chosen by hand."""


def read_look(description: Any) -> StudioLook:
    """Return a look from the name of a preset or an object.

    Raises:
        StudioInvalid: a key or preset is unknown, or a value is impossible.
    """
    given = {"preset": description} if isinstance(description, str) else description
    values = CheckedValues(given, "look", ("preset", *StudioLook.__dataclass_fields__))
    preset = values.choice("preset", "suit", _PRESETS) if "preset" in values else ""
    rest = {key: value for key, value in given.items() if key != "preset"}
    values = CheckedValues({"name": preset or "look", **_PRESETS.get(preset, {}), **rest}, "look", values_of_a_look())
    return StudioLook(
        values.text("name", "look"), values.choice("clothes", "suit", CLOTHES), values.choice("hair", "random", HAIR),
        values.choice("light", "day", LIGHT), values.whole("furniture", 0, 0, 20), values.flag("room", True),
    )  # fmt: skip


def values_of_a_look() -> tuple[str, ...]:
    """Return the keys of a look."""
    return tuple(StudioLook.__dataclass_fields__)


def draw_light(light: str, rng: np.random.Generator) -> str:
    """Return a light with 'random' replaced by a draw."""
    drawn = str(rng.choice([name for name in LIGHT if name != "random"]))
    return drawn if light == "random" else light
