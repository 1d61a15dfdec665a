"""The verbs of ``python -m blender_addon``, which are declared in ``verbs.json``."""

from __future__ import annotations

import time
from argparse import Namespace
from pathlib import Path

from .._exchange.diagnostics import list_refusals
from .._exchange.errors import describe_exit_codes
from .._exchange.marker_formats import MARKER_FORMATS
from .._exchange.progress import Progress
from .._exchange.setting import Setting
from .._exchange.verb import Program
from .._exchange.verbs import read_verbs
from .._exchange.verbs import shared as _of_solver
from ..conventions.naming import LOOKS
from ..export.formats import FORMATS
from .process import require_blender
from .result import CommandResult

MODULE = "python -m blender_addon"
_CHOICES = {"FORMATS": FORMATS, "MARKER_FORMATS": MARKER_FORMATS, "REFUSALS": list_refusals(), "LOOKS": LOOKS}
"""Tables of choices that the settings in ``verbs.json`` refer to by name."""
_TABLE = Path(__file__).with_name("verbs.json")
_shared, _GROUPS, VERBS = read_verbs(_TABLE, _of_solver, _CHOICES)
_EPILOG = describe_exit_codes(
    "a file is missing, damaged or unusable, an output exists or cannot be written, or a result is implausible",
    "the solver failed, or Blender is missing or cannot render or export here",
    "A batch has the highest code of its takes.\n",
)


def program(name: str = MODULE) -> Program:
    """Return the command line program. Its help shows it as ``name``."""
    description = "Solve captures, and bake, export and render solved motions, without a window."
    return Program(name, description, VERBS, _common, _EPILOG, groups=_GROUPS)


def _common() -> tuple[Setting, ...]:
    return tuple(row for part in ("JSON", "PARENT_PIPE", "VERBOSE") for row in _shared()[part])


def run_here(args: Namespace, progress: Progress) -> CommandResult:
    """Run the verb of a command line in this process, and add the run time to its result."""
    verb, start = VERBS[args.verb], time.monotonic()
    if verb.needs_blender:
        require_blender()
    result = verb.load(__package__ or "")(args, progress)
    return {**result, "seconds": round(time.monotonic() - start, 3)}
