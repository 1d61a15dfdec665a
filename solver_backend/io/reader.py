"""Define a file reader, and the reading options that it accepts."""

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
    """Reading options that the user sets. They override what the file states."""

    joint_set: JointSet | None = field(default=None, kw_only=True)
    """Joint set of the keypoints. None uses the recording's settings, or recognises the set."""
    sync: str = SYNC_AUTO  # How to correct for cameras with different start times, see ``SolveSettings``.
    progress: Progress = silent

    def __post_init__(self) -> None:
        if self.fps is not None and not 0 < self.fps < float("inf"):
            raise JobInvalid(f"The frame rate must be a positive number, not {self.fps}.", where="fps")
        ReadingSettings.__post_init__(self)
        TimeSettings.__post_init__(self)
        WorldSettings.__post_init__(self)

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the reading options that differ from their defaults."""
        return tuple(name for name, default in DEFAULTS.items() if getattr(self, name) != default)


@dataclass(frozen=True)
class Reader(Generic[Content]):
    """A supported type of file or folder, and the functions that recognise and read it."""

    kind: str  # Description and file name, for lists.
    recognises: Callable[[Path], bool]  # Quick test for a path, which may not exist.
    read: Callable[[Path, ReadOptions], Content]
    """Function that reads a recognised path and raises our own errors. ``open`` first rejects unsupported options."""
    takes: frozenset[str] = frozenset()
    """Reading options that apply in addition to those of ``load_capture``. All others are rejected."""

    def open(self, path: Path, options: ReadOptions, also: frozenset[str] = frozenset()) -> Content:
        """Read a recognised path. Options in ``also`` are accepted too, but the caller must apply them.

        Raises:
            JobInvalid: an option does not apply.
            MocapError: errors that the reader raises.
        """
        applicable = self.takes | also
        refused = next((name for name in options.given if name not in applicable), None)
        if refused is not None:
            known = ", ".join(option_name(name) for name in DEFAULTS if name in applicable)
            hint = f"These options apply: {known}." if known else "These files do not accept reading options."
            what = f"{ROWS[refused].label} ({option_name(refused)}) does not apply to {self.kind.partition(' (')[0]}."
            raise JobInvalid(what, where=str(path), hint=hint)
        return self.read(path, options)


def option_name(name: str) -> str:
    """Return the command-line form of a reading option, such as ``--up-axis``."""
    return f"--{name.replace('_', '-')}"
