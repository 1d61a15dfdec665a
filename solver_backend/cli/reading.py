"""How a capture that stands on the command line is read."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from solver_backend.cli.arguments import given_reading
from solver_backend.exchange.progress import Progress
from solver_backend.job import joint_set_named, positive_fps
from solver_backend.types import Capture

EVERYBODY = "all"
"""What ``--person`` is for each person of a capture."""


def reading(args: argparse.Namespace) -> dict[str, Any]:
    """Return the options that set how a capture is read."""
    special = {"fps": positive_fps, "joint_set": joint_set_named}
    return {
        **{name: special[name](value) if name in special else value for name, value in given_reading(args).items()},
        **({} if args.sync is None else {"sync": args.sync}),
        **({"frames": None} if getattr(args, "resolve", None) else {}),  # then they are those to solve again
    }


def load(path: Path, options: dict[str, Any], progress: Progress) -> Capture:
    """Return a capture, everybody's where the person is ``EVERYBODY``.

    Raises:
        MocapError: see ``load_capture``.
    """
    from solver_backend.io.load import load_capture

    person = options.get("person")
    options = {**options, "person": None if person == EVERYBODY else person}
    return load_capture(path, **options, progress=progress)


def loaded(args: argparse.Namespace, progress: Progress) -> Capture:
    """Return the capture of a command line, read as its options state."""
    return load(args.capture, reading(args), progress)


def trials_of(path: Path) -> list[Path]:
    """Return the recordings of a session's folder; none for any other path."""
    if not path.is_dir():
        return []
    from solver_backend.io.detections.search import camera_sources, trials_below

    if camera_sources(path):
        return []
    return [path / trial for trial in trials_below(path)]
