"""Handle signals, progress, results and named errors for both command lines."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from types import FrameType
from typing import Any, TextIO

from .errors import Cancelled, ExitCode, MocapError
from .outputs import full_disk
from .plain_text import plain
from .progress import ConsoleProgress, JsonProgress, Progress

_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGBREAK") if hasattr(signal, name)]


def cancelled() -> Cancelled:
    """Return the error that a signal raises."""
    return Cancelled("The work was cancelled.", hint="No incomplete file remains.")


class Cancellation:
    """Raises an error at the first signal, and ignores further signals during clean-up."""

    def __init__(self, error: Callable[[], BaseException]) -> None:
        self.asked, self._error = False, error

    def on_signal(self, number: int, frame: FrameType | None) -> None:
        """Raise the cancellation error at the first signal. Ignore later signals."""
        if not self.asked:
            self.asked = True
            raise self._error()

    def watched(self, progress: Progress) -> Progress:
        """Wrap a progress callback so that it raises the cancellation error again if a library suppressed it."""

        def watching(stage: str, done: int, total: int) -> None:
            if self.asked:
                raise self._error()
            progress(stage, done, total)

        return watching


@contextmanager
def signals_handled(handler: Any) -> Iterator[None]:
    """Handle cancellation signals with ``handler`` during a ``with`` block, if this is the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, signal.SIG_DFL if old is None else old)  # None is Blender's own handler


@contextmanager
def cancel_on_signals(error: Callable[[], BaseException] = cancelled) -> Iterator[Cancellation]:
    """Raise an error if a cancellation signal arrives during a ``with`` block."""
    cancellation = Cancellation(error)
    with signals_handled(cancellation.on_signal):
        yield cancellation


@contextmanager
def cancelling_until_held() -> Iterator[Callable[[], None]]:
    """Yield a function that makes this process ignore cancellation signals until the ``with`` block ends.

    Call it before recordings are written, so that they are written completely.
    """
    with ExitStack() as stack:
        yield lambda: stack.enter_context(signals_handled(signal.SIG_IGN))


def cancel_at_end_of(stream: int, grace_s: float | None = None) -> None:
    """Cancel this process when its parent closes a pipe. A parent that crashes also closes the pipe.

    Args:
        stream: file descriptor of the pipe.
        grace_s: seconds from cancellation until the process is terminated. None waits indefinitely.
    """

    def watch() -> None:
        with suppress(OSError):
            while os.read(stream, 4096):
                pass
        _thread.interrupt_main(signal.SIGTERM)
        if grace_s is not None:
            time.sleep(grace_s)
            os._exit(ExitCode.CANCELLED)

    threading.Thread(target=watch, name="parent pipe", daemon=True).start()


class LenientStream:
    """A text stream for human readers. If it is closed, or its disk is full, text is dropped.

    If the program that reads the text has ended, ``BrokenPipeError`` is raised.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write text, or drop it if the stream is closed or full."""
        self._try("write", text)
        return len(text)

    def flush(self) -> None:
        """Flush the stream, unless it is closed or full."""
        self._try("flush")

    def _try(self, name: str, *arguments: str) -> None:
        try:
            getattr(self._stream, name)(*arguments)
        except BrokenPipeError:
            raise
        except (AttributeError, OSError, ValueError):
            return

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return self._stream is not None and not self._stream.closed and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:
        if name == "_stream":  # a copy starts without attributes
            raise AttributeError(name)
        return getattr(self._stream, name)


def open_standard_streams() -> None:
    """Open the null device for each standard stream that the parent process closed.

    Otherwise, the next file that is opened could become standard output.
    """
    sys.stdout, sys.stderr = (
        stream or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w") for stream in (sys.stdout, sys.stderr)
    )


class Report:
    """Reports one run, as text for people or as JSON lines for programs.

    Args:
        out: receives the result, and all JSON lines.
        err: receives all other text for people.
        interval_s: shortest time between progress lines in seconds.
    """

    def __init__(self, out: TextIO, err: TextIO | None, *, as_json: bool, interval_s: float = 0.1) -> None:
        lenient: Any = LenientStream(err)
        self._out, self._err = out, lenient
        self._lines = JsonProgress(out, interval_s) if as_json else None
        self.progress: Progress = self._lines or ConsoleProgress(self._err, interval_s)

    def result(self, data: Mapping[str, object], text: str, remarks: Iterable[str] = ()) -> None:
        """Report a result as a JSON event, or as text on standard output and remarks on standard error."""
        if self._lines is not None:
            self._lines.event({"event": "result", **data})
            return
        print(plain(text, keep="\n"), file=self._out, flush=True)
        for line in remarks:
            print(plain(line, keep="\n"), file=self._err, flush=True)

    def error(self, error: MocapError) -> int:
        """Report an error with its location and hint, and return the exit code."""
        if self._lines is not None:
            self._lines.event(error.as_event())
        else:
            start = "\n" if self._err.isatty() else ""
            red, green, end = ("\033[1;31m", "\033[32m", "\033[0m") if _has_colours(self._err) else ("", "", "")
            where = f"\n  where: {plain(error.where)}" if error.where else ""
            hint = f"\n  {green}try:{end}   {plain(error.hint)}" if error.hint else ""
            print(f"{start}{red}error:{end} {plain(error.message)}{where}{hint}", file=self._err, flush=True)
        return error.exit_code


def _has_colours(stream: Any) -> bool:
    """Return whether a stream is a terminal with colours. NO_COLOR disables them (no-color.org)."""
    plain_console = os.name == "nt" and "WT_SESSION" not in os.environ
    return stream.isatty() and not (os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or plain_console)


def name_error(error: BaseException, failed: type[MocapError], what: str, *, asked: bool) -> MocapError:
    """Convert an exception from a verb to a named error. Print the traceback if it is a program defect.

    Args:
        failed: error class for a program defect.
        what: subject of the error message for a program defect, such as "The solver".
        asked: True if a cancellation signal arrived before. In this case, any other exception is reported as
            ``Cancelled``, because a library may have replaced the error of the signal.
    """
    if isinstance(error, MocapError):
        return error
    if (named := full_disk(error)) is not None:
        return named
    if asked or isinstance(error, KeyboardInterrupt):
        return cancelled()
    traceback.print_exception(error)
    hint = "Please report this with the log above."
    return failed(f"{what} failed: {type(error).__name__}: {error}", hint=hint)
