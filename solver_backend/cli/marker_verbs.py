"""The verb that writes a motion's markers for other programs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.errors import CommandLineInvalid, MotionInvalid
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.progress import Progress

MARKER_VERBS = ("export-markers",)
CONTENTS = {"cleaned": "cleaned_markers", "solved": "markers"}
"""The motion file's array by what is exported: as recorded, gaps filled and swaps undone; or as the body has them."""
_SUFFIXES = (".c3d", ".trc")


def add_marker_verbs(verbs: Any, writing: argparse.ArgumentParser, common: argparse.ArgumentParser) -> None:
    """Add export-markers to the parser's verbs.

    Args:
        verbs: what ``add_subparsers`` returned.
        writing: options of verbs that write.
        common: options of all verbs.
    """
    export = verbs.add_parser(
        "export-markers", parents=[writing, common], help="write a motion's markers as C3D or TRC"
    )
    export.add_argument("motion", type=Path, metavar="MOTION.npz", help="motion that was solved from markers")
    export.add_argument("--out", type=Path, required=True, metavar="TAKE.c3d|TAKE.trc", help="file to write")
    export.add_argument(
        "--contents", choices=tuple(CONTENTS), default="cleaned",
        help="cleaned: as recorded, gaps filled and swaps undone (default); solved: where the body has them",
    )  # fmt: skip


def export_markers(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write the markers of a motion as C3D or TRC."""
    overwrite, suffix = bool(args.overwrite), args.out.suffix.lower()
    if suffix not in _SUFFIXES:
        raise CommandLineInvalid("Markers are written to files that end in .c3d or .trc.", where=str(args.out))
    check_output(args.out, overwrite=overwrite)
    from solver_backend.io.markers.c3d_writer import write_c3d
    from solver_backend.io.markers.trc_writer import write_trc
    from solver_backend.types import MarkerCloud

    positions, labels, fps = _markers(args.motion, args.contents)
    cloud = MarkerCloud(positions, fps, labels)
    progress("Writing the markers", 0, 1)
    (write_c3d if suffix == ".c3d" else write_trc)(args.out, cloud, overwrite=overwrite)
    progress("Writing the markers", 1, 1)
    frames, markers = positions.shape[:2]
    data = {"markers_file": str(args.out), "frames": frames, "fps": fps, "markers": markers, "contents": args.contents}
    text = f"{frames} frames of {markers} {args.contents} markers at {fps:g} fps"
    return Outcome(f"{text}\n  written     {args.out}", data)


def _markers(path: Path, contents: str) -> tuple[Any, tuple[str, ...], float]:
    """Return positions (F, M, 3) in metres, labels and frames per second.

    Raises:
        FileMissing, FileDamaged: the motion cannot be read.
        MotionInvalid: it was not solved from markers, or does not hold what is wanted.
    """
    from solver_backend.exchange.motion_file import FORMAT, STORED, VERSION
    from solver_backend.exchange.schema import read_fields

    key = CONTENTS[contents]
    fields = read_fields(path, tuple(dict.fromkeys((*STORED, *CONTENTS.values()))))
    fields.require_format(FORMAT, VERSION)
    labels = fields.texts("marker_labels")
    if not labels:
        raise MotionInvalid(
            "The motion was not solved from markers.", where=str(path), hint="Solve a recording of some."
        )
    if key not in fields:
        other = next((name for name, array in CONTENTS.items() if array in fields), None)
        raise MotionInvalid(
            f"The motion holds no {contents} markers.",
            where=str(path),
            hint="Solve the take again" + (f", or export the {other} ones." if other else "."),
        )
    positions = fields.shaped(key, (len(fields.arrays["poses"]), len(labels), 3), MotionInvalid)
    return positions, labels, fields.first_number("mocap_framerate", MotionInvalid)
