"""What a reader of files is: the kind of file it knows, how it reads it, and the reading options that it can take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.reading_settings import DEFAULTS, ROWS, ReadingSettings, TimeSettings, WorldSettings
from solver_backend.exchange.solve_settings import SYNC_AUTO
from solver_backend.types import JointSet

Content = TypeVar("Content")


@dataclass(frozen=True)
class ReadOptions(ReadingSettings, TimeSettings, WorldSettings):
    """What the caller knows better than the file; a reader takes what concerns it."""

    joint_set: JointSet | None = field(default=None, kw_only=True)
    """What the keypoints are; None takes what the recording states, or recognises it."""
    sync: str = SYNC_AUTO
    """Whether cameras that started apart are moved in time, see ``SolveSettings``."""
    progress: Progress = silent
    """Called with how far reading has come."""

    def __post_init__(self) -> None:
        if self.fps is not None and not 0 < self.fps < float("inf"):
            raise JobInvalid(f"The frame rate must be a positive number, not {self.fps}.", where="fps")
        ReadingSettings.__post_init__(self)
        TimeSettings.__post_init__(self)
        WorldSettings.__post_init__(self)

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the reading options that are not at their defaults."""
        return tuple(name for name, default in DEFAULTS.items() if getattr(self, name) != default)


@dataclass(frozen=True)
class Reader(Generic[Content]):
    """One kind of file or folder."""

    kind: str
    """What it is and what it is named, for lists."""
    recognises: Callable[[Path], bool]
    """Whether a path is of this kind, answered quickly; the path need not exist."""
    read: Callable[[Path, ReadOptions], Content]
    """Read a path that was recognised; raises our own errors. ``open`` refuses options first."""
    takes: frozenset[str] = frozenset()
    """Reading options that apply to it, beside those of ``load_capture`` itself; all others are refused."""

    def open(self, path: Path, options: ReadOptions, also: frozenset[str] = frozenset()) -> Content:
        """Read a path with options that all apply to it.

        Args:
            path: that was recognised.
            options: how it is read.
            also: options that the caller applies itself.

        Raises:
            JobInvalid: an option does not apply.
            MocapError: whatever the reader raises.
        """
        applicable = self.takes | also
        refused = next((name for name in options.given if name not in applicable), None)
        if refused is not None:
            known = ", ".join(option_name(name) for name in DEFAULTS if name in applicable)
            hint = f"These options apply: {known}." if known else "No reading option applies."
            what = f"{ROWS[refused].label} ({option_name(refused)}) does not apply to {self.kind.partition(' (')[0]}."
            raise JobInvalid(what, where=str(path), hint=hint)
        return self.read(path, options)


def option_name(name: str) -> str:
    """Return a reading option as it stands on a command line."""
    return f"--{name.replace('_', '-')}"
