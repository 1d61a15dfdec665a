"""Blender as a module of this Python: whether it is there, and its loading, into which no signal breaks."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from threading import current_thread, main_thread

from ..errors import BlenderMissing


def require_blender(*, here: bool = True, instead: str = "") -> None:
    """Check that this Python has Blender, and load it where this process is to use it.

    Args:
        here: this process uses it.
        instead: what else the user can do.

    Raises:
        BlenderMissing: it has not.
    """
    if find_spec("bpy") is None:
        hint = f"Install the package 'bpy' into it{instead and ', or '}{instead}."
        raise BlenderMissing("This Python has no Blender module.", where=sys.executable, hint=hint)
    if here:
        with signals_wait():
            import_module("bpy")


@contextmanager
def signals_wait() -> Iterator[None]:
    """Let the signals that cancel arrive at the end of the block.

    Blender runs scripts of its own while it loads. What a signal raises there it prints, goes on half loaded, and
    crashes later (seen with bpy 4.5). It loads in half a second. A mask would not do: other threads have none.
    """
    if current_thread() is not main_thread():
        yield
        return
    arrived: list[int] = []
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    before = {number: handler for number, handler in before.items() if handler not in (None, signal.SIG_IGN)}
    for number in before:
        signal.signal(number, lambda number, _: arrived.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in arrived[:1]:
            signal.raise_signal(number)
