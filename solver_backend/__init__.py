"""Read a recording and solve a body's motion. This package never imports bpy.

The names below are the public interface. Each is imported on first use, so that ``--help`` is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from solver_backend.exchange.version import VERSION

if TYPE_CHECKING:
    from solver_backend.body.body import Body, load_body
    from solver_backend.exchange.errors import MocapError
    from solver_backend.fitters import FrameRange, Pin, Solution, SolveSettings, resolve_range, solve
    from solver_backend.io.load import load_capture, load_motion
    from solver_backend.io.native.capture_file import write_capture
    from solver_backend.io.native.motion_file import read_motion, write_motion
    from solver_backend.priors.base import AutoencodingPrior
    from solver_backend.priors.sposer import load_sposer
    from solver_backend.report.page import write_report
    from solver_backend.synthesis.embedded.demo import demo_capture
    from solver_backend.types import Cameras, Capture, JointSet, Keypoints2D, MarkerCloud, Motion

__version__ = VERSION

_HOMES = {
    "body.body": ("Body", "load_body"),
    "exchange.errors": ("MocapError",),
    "fitters": ("FrameRange", "Pin", "Solution", "SolveSettings", "resolve_range", "solve"),
    "io.load": ("load_capture", "load_motion"),
    "io.native.capture_file": ("write_capture",),
    "io.native.motion_file": ("read_motion", "write_motion"),
    "priors.base": ("AutoencodingPrior",),
    "priors.sposer": ("load_sposer",),
    "report.page": ("write_report",),
    "synthesis.embedded.demo": ("demo_capture",),
    "types": ("Cameras", "Capture", "JointSet", "Keypoints2D", "MarkerCloud", "Motion"),
}
"""Public names by the module that defines them."""

__all__ = [
    "AutoencodingPrior", "Body", "Cameras", "Capture", "FrameRange", "JointSet", "Keypoints2D", "MarkerCloud",
    "MocapError", "Motion", "Pin", "Solution", "SolveSettings", "demo_capture", "load_body", "load_capture",
    "load_motion", "load_sposer", "read_motion", "resolve_range", "solve", "write_capture", "write_motion",
    "write_report",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"{__name__} has no {name}; it has {', '.join(__all__)}.")
