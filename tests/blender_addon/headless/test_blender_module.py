"""Blender is loaded whole: a signal waits for it."""

from __future__ import annotations

import os
import signal

import pytest

from blender_addon.headless.process import signals_wait


@pytest.mark.skipif(os.name == "nt", reason="os.kill ends the process there")
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
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert loaded
