"""OpenCV where it is needed, with a named error where it is not installed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from solver_backend.exchange.errors import BackendMissing


def opencv() -> Any:
    """Return the module ``cv2``.

    Raises:
        BackendMissing: it is not installed; it belongs to the extra ``capture``.
    """
    try:
        return import_module("cv2")
    except ImportError as error:
        raise BackendMissing(
            "Pictures and videos are read by OpenCV, which is not installed.",
            hint="Install it with: pip install opencv-contrib-python-headless.",
        ) from error
