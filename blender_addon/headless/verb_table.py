"""The verbs of ``python -m blender_addon`` as ``verbs.json`` declares them."""

from __future__ import annotations

from pathlib import Path

from .._exchange.diagnostics import list_refusals
from .._exchange.errors import describe_exit_codes
from .._exchange.marker_formats import MARKER_FORMATS
from .._exchange.verb import Program, option, values
from .._exchange.verbs import SHARED as _OF_SOLVER
from .._exchange.verbs import read_verbs
from ..conventions.naming import LOOKS
from ..export.formats import FORMATS

MODULE = "python -m blender_addon"
_LOOK = "A person, or a mannequin: one colour and no face"
_CHOICES = {
    "FORMATS": option(
        "choice", "export", "FORMAT", "Formats to export to", (), choices=values(*FORMATS), many=True
    ),
    "MARKER_FORMATS": option(
        "choice", "export_markers", "FORMAT", "Write the cleaned markers of takes of markers", (),
        choices=values(*MARKER_FORMATS), many=True,
    ),
    "REFUSALS": option(
        "choice", "accept", "CODE", "Accept results with this fault, which are refused otherwise", (),
        choices=values(*list_refusals()), repeated=True,
    ),
    "LOOK": option("choice", "look", "", _LOOK, "", choices=values(*LOOKS)),
}  # fmt: skip
"""Settings whose choices are other tables."""
_TABLE = Path(__file__).with_name("verbs.json")
_SHARED, VERBS = read_verbs(_TABLE, {**_OF_SOLVER, **{name: (row,) for name, row in _CHOICES.items()}})
_EPILOG = describe_exit_codes(
    "a file is missing, damaged or unusable, or an output exists or cannot be written",
    "the solver failed, or Blender is missing, cannot render or export here",
    "A batch has the code of its worst take.\n",
)


def program(name: str = MODULE) -> Program:
    """Return the command line under a name in its help."""
    description = "Solve captures, and bake, export and render solved motions, without a window."
    common = [row for part in ("JSON", "PARENT_PIPE", "VERBOSE") for row in _SHARED[part]]
    return Program(name, description, VERBS, tuple(common), _EPILOG)
