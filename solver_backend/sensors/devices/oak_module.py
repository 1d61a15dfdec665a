"""depthai where an OAK is asked for, with a named error where it is not installed."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

from solver_backend.exchange.errors import BackendMissing

LEAST_VERSION = 3
QUIET = {"DEPTHAI_INSTALL_SIGNAL_HANDLER": "0", "DEPTHAI_LEVEL": "off"}
"""Else it takes over the process' signals, of a full disk too, and writes among the lines on standard output that
programs read; what matters comes as exceptions."""


def depthai() -> Any:
    """Return the module ``depthai``.

    Raises:
        BackendMissing: it is not installed, or of a version before 3; it belongs to the extra ``oak``.
    """
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    try:
        module = import_module("depthai")
    except ImportError as error:
        raise BackendMissing(
            "OAK cameras are read by depthai, which is not installed.",
            hint="Install it with: pip install depthai.",
        ) from error
    version = str(module.__version__)
    if int(version.split(".")[0]) < LEAST_VERSION:
        raise BackendMissing(
            f"depthai {version} is installed; {LEAST_VERSION} or later is needed.",
            hint="Install it with: pip install --upgrade depthai.",
        )
    return module
