"""The table of verbs of the solver: both programs, panels and reference pages derive from it."""

from __future__ import annotations

from ..verb import Verb, by_name
from . import captures, devices, motions

VERBS: dict[str, Verb] = by_name((*captures.VERBS, *devices.VERBS, *motions.VERBS))
"""By name, in the order in which help lists them."""
