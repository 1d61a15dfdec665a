"""What is attacked: a reader, the sound files that mutations begin from, and how each kind of file is changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

Write = Callable[[Path], object]  # Writes sound files into an empty folder.


@dataclass(frozen=True)
class Target:
    """One reader through its public entry."""

    name: str
    sound: tuple[Write, ...]
    """One for each dialect; every one of them is read without an error."""
    read: Callable[[Path], object]
    """Reads what lies in the folder."""
    kinds: dict[str, str]
    """Kind of mutation by the ending of a file; other files stay as they are."""
    odd: tuple[Write, ...] = ()
    """More files that mutations begin from; they may be refused by name."""
    once: tuple[Write, ...] = ()
    """What is too large to be changed again and again, or is no file at all: only read as it is."""
    limit_s: float = 10.0
    """Seconds of CPU time that an input may take; the clock on the wall shows how busy the machine is."""
    sense: float = 0.0
    """Share of changes that keep a file readable and break what it means, see ``sense.broken_sense``."""

    @property
    def dialects(self) -> tuple[Write, ...]:
        """Everything that mutations begin from."""
        return self.sound + self.odd


def file(name: str, content: bytes | str) -> Write:
    """Return what writes one file."""
    data = content.encode() if isinstance(content, str) else content
    return lambda folder: (folder / name).write_bytes(data)


def large(name: str, size: int) -> Write:
    """Return what writes a file of so many zeros that take no room on the disk."""

    def write(folder: Path) -> None:
        with (folder / name).open("wb") as stream:
            stream.truncate(size)

    return write


def is_folder(name: str) -> Write:
    """Return what puts a folder where a file is expected."""
    return lambda folder: (folder / name).mkdir()


def nothing(folder: Path) -> None:
    """Write no file at all."""
