"""Blender's own chatter kept off the command's output."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO


@contextmanager
def own_streams(*, verbose: bool) -> Iterator[tuple[TextIO, TextIO]]:
    """Yield this program's output and error streams while what Blender's libraries print goes nowhere.

    Blender prints a few lines a rendered frame to the process's file descriptors, past Python's ``sys.stdout``, and
    the reports of its operators through it.

    Args:
        verbose: let Blender's lines through to standard error instead.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    sink = os.dup(2) if verbose else os.open(os.devnull, os.O_WRONLY)
    out, err = (os.fdopen(os.dup(fd), "w", encoding="utf-8", buffering=1) for fd in kept)
    python_streams = sys.stdout, sys.stderr
    unheard = os.fdopen(os.dup(sink), "w", encoding="utf-8")
    try:
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        sys.stdout, sys.stderr = unheard, err
        yield out, err
    finally:
        sys.stdout, sys.stderr = python_streams
        unheard.close()
        out.close()
        err.close()
        for target, fd in enumerate(kept, start=1):
            os.dup2(fd, target)
            os.close(fd)
        os.close(sink)
