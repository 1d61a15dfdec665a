"""Interface of a batch's work: items (takes or shots) with several steps and a record in their own folder."""

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
"""Work as JSON values for another process or machine. ``plain`` writes them and ``from_plain`` reads them."""


def to_plain(value: Any) -> Plain:
    """Convert a data class to JSON values. All paths become absolute, except the interpreter's path ``python``."""
    found = {item.name: getattr(value, item.name) for item in fields(value)}
    whole = {k: v.resolve() if isinstance(v, Path) and k != "python" else v for k, v in found.items()}
    return as_plain(whole)


def from_plain(cls: Any, values: Plain, **others: Any) -> Any:
    """Recreate a data class from the values of ``to_plain``. ``others`` are fields to set as they are."""
    read = {"Path": Path, "Path | None": Path, "tuple[str, ...]": tuple}
    kinds = {item.name: read.get(str(item.type)) for item in fields(cls) if item.name not in others}
    given = [(name, kind, values[name]) for name, kind in kinds.items()]
    return cls(
        **{name: value if value is None or kind is None else kind(value) for name, kind, value in given}, **others
    )


@dataclass(frozen=True)
class Step:
    """One step in the processing of a take or shot."""

    name: str  # Name of the step, such as solve, bake or film.
    key: str  # Hash of the step's inputs.


@dataclass(frozen=True)
class Place:
    """The folder and the callbacks for a step, and the processes that it may use."""

    folder: Path  # Folder that contains the item's record.
    progress: Progress  # Receives the progress in each stage.
    stopped: Callable[[], MocapError | None] = lambda: None  # Called regularly. A returned error ends the step.
    in_child: bool = False  # Run Blender in a separate process. Parallel steps need this.
    scheduler: str = ""  # Cluster that solves segments of a long take, or "" to solve in one process.


class Work(Protocol):
    """Takes or shots to process, with their steps and all settings. Instances are immutable."""

    kind: ClassVar[str]  # Name of the kind in ``plain`` and in progress texts.

    @property
    def out(self) -> Path:
        """Folder with a subfolder and a record for each item."""
        ...

    @property
    def limits(self) -> TakeLimits:
        """Time and memory limits of the solver for each item."""
        ...

    def sees(self, item: Path) -> bool:
        """Return whether this machine can read an item's files."""
        ...

    def steps(self, item: Path) -> tuple[Step, ...]:
        """Return the requested steps of an item, in order."""
        ...

    def do_step(self, item: Path, step: str, place: Place) -> StepMade:
        """Process one step. Return its output file names and notes, and for a solve the worst person's results."""
        ...

    def plain(self) -> Plain:
        """Return the work as JSON values for another process or machine, including ``kind``."""
        ...


def take_name(item: Path) -> str:
    """Return the name of an item's folder: the name of a capture's take, or of a shot."""
    return item.stem if item.is_file() else item.name
