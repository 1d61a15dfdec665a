"""Define work items with several steps and a record in their own folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from ..._exchange.errors import MocapError
from ..._exchange.json_file import as_plain
from ..._exchange.progress import Progress
from .record import StepMade

if TYPE_CHECKING:
    from .request import TakeLimits

Plain = dict[str, Any]
"""Work as plain values for another process or machine, written by ``plain`` and read by ``from_plain``."""


def to_plain(value: Any) -> Plain:
    """Convert a data class to plain values with absolute paths."""
    found = {item.name: getattr(value, item.name) for item in fields(value)}
    whole = {k: v.resolve() if isinstance(v, Path) and k != "python" else v for k, v in found.items()}
    return as_plain(whole)


def from_plain(cls: Any, values: Plain, **others: Any) -> Any:
    """Recreate a data class from ``to_plain`` values. ``others`` already have their types."""
    read = {"Path": Path, "Path | None": Path, "tuple[str, ...]": tuple}
    kinds = {item.name: read.get(str(item.type)) for item in fields(cls) if item.name not in others}
    given = [(name, kind, values[name]) for name, kind in kinds.items()]
    return cls(
        **{name: value if value is None or kind is None else kind(value) for name, kind, value in given}, **others
    )


@dataclass(frozen=True)
class Step:
    """One step of an item."""

    name: str  # Name of the step, such as solve, bake or film.
    key: str  # Hash of the step's inputs.


@dataclass(frozen=True)
class Place:
    """Circumstances under which a step runs."""

    folder: Path  # Folder of the item's record.
    progress: Progress  # Receives the progress of each stage.
    stopped: Callable[[], MocapError | None] = lambda: None  # Called regularly. A returned error ends the step.
    in_child: bool = False  # Run Blender in a separate process, which parallel steps need.
    scheduler: str = ""  # Cluster that solves segments of a long take, "" for one process.


class Work(Protocol):
    """Items of one kind, their steps and all settings. Instances are immutable."""

    kind: ClassVar[str]  # Name in ``plain`` and in the progress text.

    @property
    def out(self) -> Path:
        """Folder of the records."""
        ...

    @property
    def limits(self) -> TakeLimits:
        """Limits of the solver for each item."""
        ...

    def sees(self, item: Path) -> bool:
        """Return whether this machine can read an item's files."""
        ...

    def steps(self, item: Path) -> tuple[Step, ...]:
        """Return the wanted steps of an item, in order."""
        ...

    def do_step(self, item: Path, step: str, place: Place) -> StepMade:
        """Process one step. Return its outputs as names in the folder, its notes and its figures."""
        ...

    def plain(self) -> Plain:
        """Return plain values for another process or machine, including ``kind``."""
        ...


def take_name(item: Path) -> str:
    """Return the name of an item's folder: a capture's take, or a shot."""
    return item.stem if item.is_file() else item.name
