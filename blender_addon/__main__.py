"""``python -m blender_addon``: the add-on's work without Blender's window.

Exit codes: 0 done; 1 a named error, said on standard error; 2 wrong usage; 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
from importlib.util import find_spec
from pathlib import Path

from .command import BakeJob, run_bake
from .errors import AddonError, BlenderMissing
from .progress import StreamProgress
from .quiet import own_streams


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    options = _parser().parse_args(arguments)
    with own_streams(verbose=options.verbose) as (out, err):
        progress = StreamProgress(out if options.json else err, as_json=options.json)
        try:
            if find_spec("bpy") is None:
                raise BlenderMissing(
                    "This Python has no Blender module.", where=sys.executable, hint="Install the package 'bpy' into it."
                )
            result = run_bake(_job(options), progress)
        except AddonError as error:
            if options.json:
                progress.event(error.as_event())
            else:
                err.write(f"error: {error}\n")
            return 1
        except KeyboardInterrupt:
            err.write("interrupted: nothing was written\n")
            return 130
        if options.json:
            progress.event(result)
        else:
            for note in result["notes"]:
                err.write(f"note: {note}\n")
            out.write("\n".join(result["outputs"]) + "\n")
    return 0


def _job(options: argparse.Namespace) -> BakeJob:
    return BakeJob(
        motion=options.motion,
        out=options.out,
        capture=options.capture,
        body=options.body,
        video=not (options.no_video or options.no_pictures),
        pictures=not options.no_pictures,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m blender_addon",
        description="Bake solved motions into Blender files.",
        epilog="Exit codes: 0 done, 1 a named error, 2 wrong usage, 130 interrupted.",
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    bake = verbs.add_parser("bake", help="write an animated body, its preview video and a contact sheet")
    bake.add_argument("motion", type=Path, help="motion file (.npz)")
    bake.add_argument("--capture", type=Path, help="capture file (.npz): adds cameras, footage and detections")
    bake.add_argument("--body", type=Path, help="body file (.npz); the add-on's own if left out")
    bake.add_argument("--out", type=Path, required=True, help="folder for the outputs; existing files are not replaced")
    bake.add_argument("--no-video", action="store_true", help="leave out the preview video")
    bake.add_argument("--no-pictures", action="store_true", help="write the Blender file alone")
    bake.add_argument("--json", action="store_true", help="write progress and the result as JSON lines")
    bake.add_argument("--verbose", action="store_true", help="show what Blender prints, on standard error")
    return parser


if __name__ == "__main__":
    sys.exit(main())
