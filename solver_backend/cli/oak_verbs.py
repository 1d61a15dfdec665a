"""The verbs of OAK cameras: which are there, and colour video of several in step."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.progress import Progress

OAK_VERBS = ("oaks", "record-colour")


def add_oak_verbs(verbs: Any, common: argparse.ArgumentParser) -> None:
    """Add oaks and record-colour to the parser's verbs.

    Args:
        verbs: what ``add_subparsers`` returned.
        common: options of all verbs.
    """
    verbs.add_parser("oaks", parents=[common], help="list the OAK cameras that are plugged in or on the network")
    record = verbs.add_parser(
        "record-colour", parents=[common], help="record colour video of OAK cameras in step, for the road from videos"
    )
    record.add_argument("folder", type=Path, metavar="FOLDER", help="where NAME.mp4 are written")
    record.add_argument(
        "--oak", action="append", required=True, metavar="ID[=NAME]", help="a camera; the first is master with --wire"
    )
    record.add_argument("--seconds", type=float, default=10.0)
    record.add_argument("--fps", type=float, default=60.0)
    record.add_argument("--wire", action="store_true", help="a sync wire joins them: the first one gives the pulse")


def oaks(args: argparse.Namespace, progress: Progress) -> Outcome:
    """List the OAKs."""
    from solver_backend.rig.markers.devices.oak import listed_oaks

    found = listed_oaks()
    return Outcome("\n".join(found) or "No OAK is plugged in.", {"oaks": found})


def record_colour(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Record colour video of OAKs."""
    from solver_backend.rig.markers.devices.oak_colour import OakColour
    from solver_backend.rig.markers.devices.oak_colour import record_colour as record

    told = [text.partition("=") for text in args.oak]
    names = [name or identifier.replace(".", "_") for identifier, _, name in told]
    if len(set(names)) < len(names) or not all(names):
        raise CommandLineInvalid("Two cameras have one name, or one has none.", hint="Say --oak ID=NAME.")
    if not (0 < args.seconds <= 3600 and 0 < args.fps <= 120):
        raise CommandLineInvalid("Seconds are 0 to 3600, frames a second 0 to 120.")
    role = ("master", "slave") if args.wire else ("none", "none")
    cameras = {
        name: OakColour(name, identifier, fps=args.fps, role=role[c > 0])
        for c, (name, (identifier, _, _)) in enumerate(zip(names, told, strict=True))
    }
    progress("Colour of OAKs", 0, 1)
    with ExitStack() as stack:
        # Slaves first, so that they wait when the master begins.
        for camera in reversed(list(cameras.values())):
            stack.enter_context(camera)
        size = next(iter(cameras.values())).size
        counts = record(cameras, args.folder, size, args.fps, args.seconds)
    lines = [f"  {name:<11} {count} pictures" for name, count in counts.items()]
    return Outcome("\n".join([f"Colour of {len(counts)} cameras in {args.folder}", *lines]), {"pictures": counts})
