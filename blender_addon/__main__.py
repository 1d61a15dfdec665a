"""``python -m blender_addon``: the add-on's work without Blender's window."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import traceback
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

from .body_command import BodyJob, run_body
from .command import BakeJob, run_bake
from .errors import AddonError, BakeFailed, BlenderMissing, Cancelled, RenderFailed
from .files.skeleton import NUM_BETAS
from .progress import StreamProgress
from .quiet import own_streams

EXIT_CODES = """\
exit codes:
  0    there is a result
  2    the command line is wrong
  3    a file is missing, damaged or unusable, or an output exists or cannot be written
  4    Blender is missing, cannot render here, or the bake broke
  130  cancelled (Ctrl-C or a termination signal); nothing was left half-written
"""
_BROKEN = (RenderFailed, BlenderMissing, BakeFailed)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code, see ``EXIT_CODES``."""
    options = _parser().parse_args(arguments)
    with own_streams(verbose=options.verbose) as (out, err):
        progress = StreamProgress(out if options.json else err, as_json=options.json)
        try:
            result = _run(options, progress)
        except AddonError as error:
            if options.json:
                progress.event(error.as_event())
            else:
                err.write(f"\nerror: {error.message}{f' ({error.where})' if error.where else ''}\n")
                err.write(f"  try: {error.hint}\n" if error.hint else "")
            return 130 if isinstance(error, Cancelled) else 4 if isinstance(error, _BROKEN) else 3
        if options.json:
            progress.event(result)
        else:
            if "joints_deviation_mm" in result:
                joints, skin = result["joints_deviation_mm"], result["skin_deviation_mm"]
                err.write(f"Blender agrees with the motion to {joints:.3f} mm (joints) and {skin:.3f} mm (skin)\n")
            err.writelines(f"note: {note}\n" for note in result["notes"])
            out.write("\n".join(result["outputs"]) + "\n")
    return 0


def _run(options: argparse.Namespace, progress: StreamProgress) -> dict[str, Any]:
    if find_spec("bpy") is None:
        hint = "Install the package 'bpy' into it."
        raise BlenderMissing("This Python has no Blender module.", where=sys.executable, hint=hint)
    signal.signal(signal.SIGTERM, _interrupt)
    signal.signal(signal.SIGINT, _interrupt)
    try:
        return options.run(options, progress)
    except KeyboardInterrupt as stop:
        raise Cancelled("The work was cancelled; nothing was written.") from stop
    except AddonError:
        raise
    except Exception as error:
        traceback.print_exc()
        kind = type(error).__name__
        raise BakeFailed(
            f"The {options.verb} broke: {kind}: {error}", hint="Please report this with the log above."
        ) from error


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _bake(options: argparse.Namespace, progress: StreamProgress) -> dict[str, Any]:
    job = BakeJob(
        motion=options.motion,
        out=options.out,
        capture=options.capture,
        body=options.body,
        video=not (options.no_video or options.no_pictures),
        pictures=not options.no_pictures,
    )
    return run_bake(job, progress)


def _body(options: argparse.Namespace, progress: StreamProgress) -> dict[str, Any]:
    return run_body(BodyJob(options.out, options.body, options.betas), progress)


def _blend_file(text: str) -> Path:
    path = Path(text)
    if path.suffix != ".blend":
        raise argparse.ArgumentTypeError(f"{text} must end in .blend")
    return path


def _betas(text: str) -> tuple[float, ...]:
    try:
        betas = tuple(float(part) for part in text.split(","))
    except ValueError:
        betas = ()
    if not 1 <= len(betas) <= NUM_BETAS or not all(map(math.isfinite, betas)):
        raise argparse.ArgumentTypeError(f"{text} is not 1 to {NUM_BETAS} numbers with commas between")
    return betas


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m blender_addon",
        description="Bake solved motions and bodies into Blender files.",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument(
        "--body", type=Path, metavar="BODY.npz", help="body file; if left out, the motion's or the add-on's own"
    )
    common.add_argument("--json", action="store_true", help="progress and result as JSON lines on standard output")
    common.add_argument("--verbose", action="store_true", help="show what Blender prints, on standard error")
    verbs = parser.add_subparsers(dest="verb", required=True)
    bake = verbs.add_parser(
        "bake", parents=[common], help="write an animated body, its preview video and a contact sheet"
    )
    bake.set_defaults(run=_bake)
    bake.add_argument("motion", type=Path, metavar="MOTION.npz", help="motion file")
    bake.add_argument(
        "--capture", type=Path, metavar="CAPTURE.npz", help="capture file: adds cameras, footage and detections"
    )
    bake.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder; existing files are not replaced")
    bake.add_argument("--no-video", action="store_true", help="leave out the preview video")
    bake.add_argument("--no-pictures", action="store_true", help="write the Blender file alone")
    body = verbs.add_parser("body", parents=[common], help="write the posable body alone, as an asset")
    body.set_defaults(run=_body)
    body.add_argument(
        "--out", type=_blend_file, required=True, metavar="FILE.blend",
        help="Blender file, not replaced if it is there; its folder becomes an asset library",
    )  # fmt: skip
    body.add_argument(
        "--betas", type=_betas, default=(), metavar="B0,B1,…", help="shape of the sliders (write --betas=-1,2)"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
