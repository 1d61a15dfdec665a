"""Where the lines of a live run go: each is written whole as soon as it is there, and none ends the run."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path

from solver_backend.exchange.json_file import as_plain
from solver_backend.io.files import AppendedFile, open_appended


class Lines:
    """A file of JSON lines, or the process's own standard output, which verbs do not print to."""

    def __init__(self, path: Path | None) -> None:
        """Open the file.

        Raises:
            OutputNotWritable: it cannot be made.
        """
        self._path = path
        if path is not None:
            self._file = open_appended(path, fresh=False)
            return
        assert sys.__stdout__ is not None
        sys.__stdout__.flush()
        self._file = AppendedFile(sys.__stdout__.fileno(), "standard output")

    def write(self, line: Mapping[str, object]) -> None:
        """Write a line; where the disk is full it is lost, and counted.

        Raises:
            BrokenPipeError: whoever read the lines is gone.
        """
        self._file.append(json.dumps(as_plain(line), allow_nan=False).encode() + b"\n")

    def end_line(self) -> None:
        """End a line that a signal may have cut."""
        self._file.append(b"\n")

    def require_whole(self) -> None:
        """Make sure that every line was written.

        Raises:
            OutputNotWritable: some were not.
        """
        self._file.require_whole("Make room on the disk of the lines. What --record writes is not affected.")

    def __enter__(self) -> Lines:
        return self

    def __exit__(self, *_: object) -> None:
        if self._path is not None:
            self._file.close()
