"""Define the solver's command line."""

from __future__ import annotations

import sys
from pathlib import Path

from solver_backend.exchange.errors import describe_exit_codes
from solver_backend.exchange.verb import Program
from solver_backend.exchange.verbs import GROUPS, VERBS, shared
from solver_backend.exchange.version import VERSION

_NAME = "python -m solver_backend" if Path(sys.argv[0]).parent.name == "solver_backend" else "manifold"
PROGRAM = Program(
    _NAME,
    "Turns multi-view keypoints or optical markers into the motion of an SMPL-type body.",
    VERBS,
    lambda: tuple(shared()["COMMON"]),
    describe_exit_codes(
        "a file is missing, damaged or unusable, the output exists or cannot be written, the result is implausible, or "
        "a solve with --strict has warnings",
        "the solver failed",
    )
    + "Messages for people go to standard error.",
    f"Manifold MoCap {VERSION}",
    GROUPS,
)
parse = PROGRAM.parse
