"""What a reader of files is: the kind of file it knows, how it recognises one, and how it reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.reading_settings import ReadingSettings
from solver_backend.exchange.solve_settings import SYNC_AUTO
from solver_backend.exchange.time_settings import TimeSettings
from solver_backend.exchange.world_settings import WorldSettings
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


@dataclass(frozen=True)
class Reader(Generic[Content]):
    """One kind of file or folder."""

    kind: str
    """What it is, for messages."""
    recognises: Callable[[Path], bool]
    """Whether a path is of this kind, answered quickly; the path need not exist."""
    read: Callable[[Path, ReadOptions], Content]
    """Read a path that was recognised; raises our own errors."""
