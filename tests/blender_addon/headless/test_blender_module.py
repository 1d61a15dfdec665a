"""Blender is loaded whole: a signal waits for it."""

from __future__ import annotations

import os
import signal

import pytest

from blender_addon.headless.blender_module import signals_wait


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="this system has no masks of signals")
def test_a_signal_waits_until_blender_is_loaded() -> None:
    loaded = []

    def load() -> None:
        with signals_wait():
            os.kill(os.getpid(), signal.SIGINT)
            loaded.append(True)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            load()
    finally:
        signal.signal(signal.SIGINT, before)
    assert loaded
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, []) & {signal.SIGINT, signal.SIGTERM}
