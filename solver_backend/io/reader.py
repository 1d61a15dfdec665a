"""A reader of one kind of files, with the reading options that it accepts."""

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
    """Statements of the caller. They replace what the file states."""

    joint_set: JointSet | None = field(default=None, kw_only=True)
    """Joint set of the keypoints, None for the recording's or the recognised one."""
    sync: str = SYNC_AUTO  # Correction of cameras with different start times, see ``SolveSettings``.
    progress: Progress = silent

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

    kind: str  # Description and name of the files, for lists.
    recognises: Callable[[Path], bool]  # Quick test of a path, which need not exist.
    read: Callable[[Path, ReadOptions], Content]
    """Read a recognised path, raise our own errors. ``open`` refuses options first."""
    takes: frozenset[str] = frozenset()
    """Reading options that apply in addition to the ones of ``load_capture``. All others are refused."""

    def open(self, path: Path, options: ReadOptions, also: frozenset[str] = frozenset()) -> Content:
        """Read a recognised path. The caller applies the options in ``also``.

        Raises:
            JobInvalid: an option does not apply.
            MocapError: the reader's own errors.
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
    """Return a reading option as on a command line."""
    return f"--{name.replace('_', '-')}"
