"""Set up and end this process: load Blender as a module, separate output streams, and exit."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from typing import NoReturn, TextIO

from .._exchange.command import signals_handled
from ..errors import BlenderMissing


def require_blender(*, here: bool = True, instead: str = "") -> None:
    """Load Blender if this process uses it. Raise ``BlenderMissing`` if it is not installed.

    Args:
        here: True if this process uses Blender.
        instead: alternative to suggest to the user.
    """
    if find_spec("bpy") is None:
        hint = f"Install the package 'bpy' into it{instead and ', or '}{instead}."
        raise BlenderMissing("This Python has no Blender module.", where=sys.executable, hint=hint)
    if here:
        with signals_wait():
            import_module("bpy")


@contextmanager
def signals_wait() -> Iterator[None]:
    """Delay signals that cancel the run until the end of the ``with`` block.

    Blender runs its own scripts while it loads. If a signal raises an error in them, Blender prints it, continues half
    loaded, and crashes later (seen with bpy 4.5). Loading takes half a second. Other threads ignore a signal mask.
    """
    arrived: list[int] = []
    try:
        with signals_handled(lambda number, _: arrived.append(number)):
            yield
    finally:
        for number in arrived[:1]:
            signal.raise_signal(number)


@contextmanager
def own_streams(*, verbose: bool) -> Iterator[tuple[TextIO, TextIO]]:
    """Yield this program's output and error streams, and discard the output of Blender's libraries.

    Blender prints lines about each rendered frame directly to the file descriptors of the process, and reports of
    operators through Python's ``sys.stdout``. With ``verbose``, both go to standard error.
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


def leave(code: int) -> NoReturn:
    """End the process with an exit code, without cleanup if Blender is loaded.

    If a scene had a Python driver, Blender as a module never exits, because it frees the driver after the interpreter
    that compiled it (seen with bpy 4.5). All files must have been written before.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    if "bpy" in sys.modules:
        os._exit(code)
    sys.exit(code)
