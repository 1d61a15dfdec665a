"""Every kind of capture and of motion that is read; a new one is a module and a row here."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from solver_backend.io.reader import Reader
from solver_backend.types import Capture

if TYPE_CHECKING:
    from solver_backend.io.motions.amass import AmassClip
    from solver_backend.io.motions.bvh import BvhClip
    from solver_backend.types import Motion

Content = TypeVar("Content")


@dataclass(frozen=True)
class Readers(Iterable[Reader[Content]], Generic[Content]):
    """Readers in the order in which they are asked; a module is imported when it is its turn."""

    rows: tuple[tuple[str, str], ...]
    """Module below this package, and what it calls its reader, or readers."""

    def __iter__(self) -> Iterator[Reader[Content]]:
        for module, name in self.rows:
            found: Any = getattr(importlib.import_module(f"solver_backend.io.{module}"), name)
            yield from found if isinstance(found, tuple) else (found,)


CAPTURES: Readers[Capture] = Readers(
    (
        ("own_files", "CAPTURES"),
        ("captures.detection_folders", "READER"),
        ("captures.caliscope", "READER"),
        ("captures.optical_markers", "READERS"),
    )
)
"""Asked in this order; the first that recognises a path reads it."""

MOTIONS: Readers[Motion | AmassClip | BvhClip] = Readers(
    (("motions.bvh", "READER"), ("motions.amass", "READER"), ("own_files", "MOTION"))
)
"""Asked in this order; a clip of another skeleton or body becomes a motion by what knows that body."""
