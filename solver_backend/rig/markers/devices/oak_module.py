"""depthai where an OAK is asked for, with a named error where it is not installed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from solver_backend.exchange.errors import BackendMissing

LEAST_VERSION = 3


def depthai() -> Any:
    """Return the module ``depthai``.

    Raises:
        BackendMissing: it is not installed, or of a version before 3; it belongs to the extra ``oak``.
    """
    try:
        module = import_module("depthai")
    except ImportError as error:
        raise BackendMissing(
            "OAK cameras are read by depthai, which is not installed.",
            hint="Install it with: pip install 'manifold-mocap[oak]'.",
        ) from error
    version = str(module.__version__)
    if int(version.split(".")[0]) < LEAST_VERSION:
        raise BackendMissing(
            f"depthai {version} is installed; {LEAST_VERSION} or later is needed.",
            hint="Install it with: pip install --upgrade 'manifold-mocap[oak]'.",
        )
    return module
