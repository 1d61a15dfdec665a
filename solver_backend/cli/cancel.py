"""Ctrl-C and termination signals become an ordinary error, so that everything unwinds and tidies up."""

from __future__ import annotations

import _thread
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from solver_backend.exchange.errors import Cancelled
from solver_backend.exchange.progress import Progress

_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGBREAK") if hasattr(signal, name)]


class Cancellation:
    """Remembers that the work is to end; the first signal raises, later ones let the unwinding go on."""

    def __init__(self) -> None:
        self.asked = False

    def on_signal(self, number: int, frame: FrameType | None) -> None:
        """Raise ``Cancelled`` at the first signal."""
        if not self.asked:
            self.asked = True
            raise cancelled()

    def watched(self, progress: Progress) -> Progress:
        """Return a progress receiver that also ends the work, should the signal's error have been swallowed."""

        def watching(stage: str, done: int, total: int) -> None:
            if self.asked:
                raise cancelled()
            progress(stage, done, total)

        return watching


def cancelled() -> Cancelled:
    """Return the error that a signal becomes."""
    return Cancelled("The work was cancelled.", hint="Nothing was left half-written.")


@contextmanager
def cancel_on_signals() -> Iterator[Cancellation]:
    """Turn signals into ``Cancelled`` while the block runs (in the main thread; elsewhere signals do not arrive)."""
    cancellation = Cancellation()
    if threading.current_thread() is not threading.main_thread():
        yield cancellation
        return
    before = {number: signal.signal(number, cancellation.on_signal) for number in _SIGNALS}
    try:
        yield cancellation
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def cancelling_until_held() -> Iterator[Callable[[], None]]:
    """Yield what makes signals wait from then on until the block ends, so that what was recorded is written whole."""
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    main = threading.current_thread() is threading.main_thread()

    def hold() -> None:
        for number in _SIGNALS if main else ():
            signal.signal(number, signal.SIG_IGN)

    try:
        yield hold
    finally:
        for number, handler in before.items() if main else ():
            signal.signal(number, handler)


def cancel_at_end_of(stream: int) -> None:
    """Cancel as a termination signal would once a file descriptor ends.

    A program that starts this one keeps the other end of a pipe open: should it die, however it dies, the pipe ends.
    Closing the pipe is also a way to cancel that works alike on every system.
    """

    def watch() -> None:
        while os.read(stream, 1):
            pass
        _thread.interrupt_main(signal.SIGTERM)

    threading.Thread(target=watch, name="parent pipe", daemon=True).start()
