"""Pass a motion from the child process that opens another program's file to its parent process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._exchange.errors import NonFiniteData
from .._exchange.npz import array_names, write_npz
from .._exchange.schema import Fields, Shape, read_fields
from .motion.figures import Actor, Hand, Trunk

_FORMAT, _VERSION = "manifold_mocap_actor", 1
_SHAPES: dict[type, dict[str, Shape]] = {
    Actor: {"rest": (24, 3), "turns": ("F", 24, 3, 3), "joints": ("F", 24, 3), "contacts": ("F", 2), "fps": ()},
    Trunk: {"heights": (None,), "turns": (None, "F", 3, 3)},
    Hand: {"directions": (None, 3), "bends": (None, "F", 3, 3), "starts": (None, 3)},
}
"""Shape of each array field. F is the number of frames."""


@dataclass(frozen=True)
class ReadActor:
    """A motion from a file, and notes for the user."""

    actor: Actor
    notes: tuple[str, ...] = ()


def write_actor(path: Path, read: ReadActor, name: str | None = None) -> None:
    """Write an actor to a file. ``name`` replaces the actor's name."""
    actor = read.actor
    arrays: dict[str, Any] = {"format": _FORMAT, "version": _VERSION, "name": actor.name if name is None else name}
    parts = {"": actor, "trunk.": actor.trunk, **{f"hand{n}.": hand for n, hand in enumerate(actor.hands)}}
    for before, part in parts.items():
        names = _SHAPES[type(part)] if part is not None else ()
        arrays |= {before + key: value for key in names if (value := getattr(part, key)) is not None}
    arrays |= {f"hand{n}.roles": hand.roles for n, hand in enumerate(actor.hands)}
    arrays |= {f"skin.{part}": points for part, points in actor.skin.items()}
    arrays["notes"] = np.array(read.notes, str)
    write_npz(path, {key: np.array(value) for key, value in arrays.items()})


def read_actor_file(path: Path) -> ReadActor:
    """Read an actor file. Raises ``FileDamaged`` or ``NonFiniteData`` if it is not usable."""
    held = read_fields(path, array_names(path))
    held.require_format(_FORMAT, _VERSION)
    main = _part(held, Actor, "")
    trunk = Trunk(**_part(held, Trunk, "trunk.")) if "trunk.turns" in held else None
    hands: list[Hand] = []
    while (before := f"hand{len(hands)}.") + "roles" in held:
        hands.append(Hand(held.texts(f"{before}roles"), **_part(held, Hand, before)))
    skin = {key[5:]: held.numbers(key, (None, 3)) for key in held.arrays if key.startswith("skin.")}
    main |= {"fps": float(main["fps"]), "contacts": main["contacts"].astype(bool) if "contacts" in main else None}
    return ReadActor(Actor(held.text("name"), trunk=trunk, hands=tuple(hands), skin=skin, **main), held.texts("notes"))


def _part(held: Fields, kind: type, before: str) -> dict[str, Any]:
    values: dict[str, Any] = {}
    frames = len(held.numbers("joints", (None, 24, 3)))
    for key, shape in _SHAPES[kind].items():
        if key == "contacts" and key not in held:
            continue
        values[key] = held.numbers(before + key, tuple(frames if n == "F" else n for n in shape))
        if not np.isfinite(values[key]).all():
            raise NonFiniteData(f"'{before}{key}' contains NaN or infinite values.", where=str(held.path))
    return values
