"""What may stand on the command line."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from ..conventions.skeleton import NUM_BETAS
from ..export.formats import FORMATS
from .exit_codes import EPILOG


def parser(program: str) -> argparse.ArgumentParser:
    """Return the parser.

    Args:
        program: what the command is called.
    """
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--json", action="store_true", help="progress and result as JSON lines on standard output")
    common.add_argument("--verbose", action="store_true", help="show what Blender prints, on standard error")
    body = argparse.ArgumentParser(add_help=False)
    body.add_argument("--body", type=Path, metavar="BODY.npz", help="body file; the motion's or the add-on's own")
    out = argparse.ArgumentParser(add_help=False)
    out.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the results")
    writing = argparse.ArgumentParser(add_help=False)
    writing.add_argument("--overwrite", action="store_true", help="replace files that are there")
    python = argparse.ArgumentParser(add_help=False)
    python.add_argument("--python", type=Path, help="Python to solve with, one with torch perhaps")
    capture = argparse.ArgumentParser(add_help=False)
    capture.add_argument("motion", type=Path, metavar="MOTION.npz", help="motion file")
    capture.add_argument(
        "--capture", type=Path, metavar="CAPTURE.npz", help="capture file: adds cameras, footage and detections"
    )

    whole = argparse.ArgumentParser(
        prog=program,
        description="Solve captures, and bake, export and render solved motions, without a window.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = whole.add_subparsers(dest="verb", required=True, metavar="VERB")
    verbs.add_parser(
        "solve",
        parents=[python, common],
        help="solve a capture; takes the solver's options, such as --job JOB.json",
    )
    bake = verbs.add_parser(
        "bake", parents=[capture, body, out, writing, common],
        help="write an animated body, its preview video and a contact sheet",
    )  # fmt: skip
    bake.add_argument("--no-video", action="store_true", help="leave out the preview video")
    bake.add_argument("--no-pictures", action="store_true", help="write the Blender file alone")
    bake.add_argument(
        "--keys-per-second", type=_positive, metavar="N", help="keep about so many of the solver's keys, such as 2"
    )
    bake.add_argument("--asset", action="store_true", help="mark the action as an asset")
    verbs.add_parser(
        "render", parents=[capture, body, out, writing, common], help="write a preview video and a contact sheet alone"
    )
    export = verbs.add_parser(
        "export", parents=[body, out, writing, common], help="write a take in the formats of other programs"
    )
    formats = tuple(FORMATS)
    export.add_argument("source", type=Path, metavar="MOTION.npz|FILE.blend", help="motion file or Blender file")
    export.add_argument("--format", nargs="+", required=True, choices=formats, dest="formats", help="one or more")
    export.add_argument("--armature", default="", help="which armature of a Blender file")
    character = verbs.add_parser("body", parents=[body, common], help="write the posable body alone, as an asset")
    character.add_argument(
        "--out", type=_blend_file, required=True, metavar="FILE.blend",
        help="Blender file, not replaced if it is there; its folder becomes an asset library",
    )  # fmt: skip
    character.add_argument(
        "--betas", type=_betas, default=(), metavar="B0,B1,…", help="shape of the sliders (write --betas=-1,2)"
    )
    batch = verbs.add_parser(
        "batch", parents=[body, out, python, common], help="do all that for every capture of a folder, and resume"
    )
    batch.add_argument("captures", type=Path, metavar="FOLDER", help="holds the captures: files .npz and folders")
    batch.add_argument("--job", type=Path, metavar="JOB.json", help="job file without capture and out")
    batch.add_argument("--bake", action="store_true", help="write a Blender file of each take")
    batch.add_argument("--render", action="store_true", help="write a video and a contact sheet of each take")
    batch.add_argument("--export", nargs="+", choices=formats, default=[], help="formats to export to")
    return whole


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


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"a positive number is expected, not {text}")
    return value
