"""Blender as a module of this Python: whether it is there, and its loading, into which no signal breaks."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec

from ..errors import BlenderMissing


def require_blender(*, here: bool = True) -> None:
    """Check that this Python has Blender, and load it where this process is to use it.

    Raises:
        BlenderMissing: it has not.
    """
    if find_spec("bpy") is None:
        hint = "Install the package 'bpy' into it."
        raise BlenderMissing("This Python has no Blender module.", where=sys.executable, hint=hint)
    if here:
        with signals_wait():
            import_module("bpy")


@contextmanager
def signals_wait() -> Iterator[None]:
    """Let the signals that cancel arrive at the end of the block.

    Blender runs scripts of its own while it loads. What a signal raises there it prints, goes on half loaded, and
    crashes later (seen with bpy 4.5). It loads in half a second. Windows, which has no masks, is left as it is.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
