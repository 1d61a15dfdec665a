"""A process that was started for somebody ends with him: when standard input, a pipe he holds, comes to its end."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

from .._exchange.early_signals import CANCELLED

_GRACE_S = 5.0
"""Seconds that the run has to end by itself once its parent is gone; chosen by hand."""


def end_with_input() -> None:
    """Interrupt this process when its standard input ends, and end it for good if that takes too long."""
    threading.Thread(target=_watch, args=(sys.stdin.fileno(),), daemon=True).start()


def _watch(handle: int) -> None:
    try:
        while os.read(handle, 4096):
            pass
    except OSError:
        return
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_GRACE_S)
    os._exit(CANCELLED)
