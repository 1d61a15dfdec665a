"""What may stand on the command line."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from itertools import groupby
from pathlib import Path

from .._exchange.diagnostics import list_refusals
from .._exchange.marker_formats import MARKER_FORMATS
from ..conventions.naming import LOOKS
from ..conventions.skeleton import NUM_BETAS
from ..export.formats import FORMATS
from .certificates import DAYS
from .exit_codes import EPILOG
from .verb_table import VERBS

_FORMATS = tuple(FORMATS)
SOLVERS_VERBS = ("solve", "calibrate", "export-markers", "motion", "add-hands")
"""Verbs whose options are the solver's own."""


def parser(program: str) -> argparse.ArgumentParser:
    """Return the parser; its help lists the verbs by task, a verb's help ends in an example.

    Args:
        program: what the command is called.
    """
    whole = argparse.ArgumentParser(
        prog=program,
        description="Solve captures, and bake, export and render solved motions, without a window.",
        epilog=f"{_list_verbs()}\n\n{EPILOG}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = whole.add_subparsers(
        dest="verb", required=True, metavar="VERB", help="what to do; VERB --help lists its options"
    )
    shared = _shared_options()
    for name, verb in VERBS.items():
        own = verbs.add_parser(
            name,
            parents=[shared[option] for option in verb.shared.split()],
            description=f"{verb.help[:1].upper()}{verb.help[1:]}.",
            epilog=f"example:\n  {program} {verb.example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if name in _OPTIONS:
            _OPTIONS[name](own)
    return whole


def _list_verbs() -> str:
    """Return the verbs by task, one a line with its help."""
    width, parts = max(map(len, VERBS)) + 2, list[str]()
    for task, rows in groupby(VERBS.items(), key=lambda item: item[1].task):
        parts.append("\n".join([f"{task}:", *(f"  {name:{width}}{verb.help}" for name, verb in rows)]))
    return "\n\n".join(parts)


def _shared_options() -> dict[str, argparse.ArgumentParser]:
    """Return the options that several verbs take, by what they are about."""
    names = ("common", "body", "look", "out", "writing", "python", "motion")
    shared = {name: argparse.ArgumentParser(add_help=False) for name in names}
    add = {name: options.add_argument for name, options in shared.items()}
    add["common"]("--json", action="store_true", help="progress and result as JSON lines on standard output")
    add["common"]("--parent-pipe", action="store_true", help=argparse.SUPPRESS)
    add["common"]("--verbose", action="store_true", help="show what Blender prints, on standard error")
    add["body"](
        "--body", type=Path, metavar="BODY.npz", help="body file; the motion's, or the add-on's own, if left out"
    )
    add["look"]("--look", choices=LOOKS, default="", help="a person, or a mannequin: one colour and no face")
    add["out"]("--out", type=Path, required=True, metavar="DIR", help="folder of the results")
    add["writing"]("--overwrite", action="store_true", help="replace existing files")
    add["python"]("--python", type=Path, help="Python to solve with, such as one that has torch")
    add["motion"]("motion", type=Path, metavar="MOTION.npz", help="motion file")
    add["motion"](
        "--capture", type=Path, metavar="CAPTURE.npz", help="capture file: adds cameras, footage and detections"
    )
    add["motion"](
        "--footage-from", type=Path, nargs="+", default=[], metavar="DIR",
        help="folders, besides the capture's, in which its footage may be; / for anywhere",
    )  # fmt: skip
    return shared


def _add_bake_options(bake: argparse.ArgumentParser) -> None:
    bake.add_argument("--no-video", action="store_true", help="leave out the preview video")
    bake.add_argument("--no-pictures", action="store_true", help="write the Blender file alone")
    bake.add_argument(
        "--keys-per-second", type=_positive, metavar="N", help="about how many keys to keep in a second, such as 2"
    )
    bake.add_argument(
        "--keys-within",
        type=_positive,
        metavar="MM",
        help="keep as few keys as possible, with every joint within this many mm",
    )
    bake.add_argument(
        "--fps",
        type=_positive,
        metavar="N",
        help="frame rate of the scene; the motion's if left out",
    )
    bake.add_argument("--asset", action="store_true", help="mark the action as an asset")


def _add_export_options(export: argparse.ArgumentParser) -> None:
    export.add_argument("source", type=Path, metavar="MOTION.npz|FILE.blend", help="motion file or Blender file")
    export.add_argument("--format", nargs="+", required=True, choices=_FORMATS, dest="formats", help="formats to write")
    export.add_argument(
        "--fps", type=_positive, metavar="N", help="frames per second of the files; the solve's if left out"
    )
    export.add_argument("--armature", default="", help="armature to export, of a Blender file")


def _add_retarget_options(retarget: argparse.ArgumentParser) -> None:
    add = retarget.add_argument
    add("source", type=Path, metavar="SOURCE", help="motion, a moving armature (.blend, .fbx, .glb, .bvh), or a folder")
    add(
        "--target", type=Path, action="append", required=True, metavar="RIG",
        help="the rig (.blend, .fbx, .glb, .vrm), which is not changed; may be repeated, each gets a folder",
    )  # fmt: skip
    add("--object", default="", metavar="NAME", help="armature of the target")
    add("--out", type=_blend_file, metavar="OUT.blend", help="file to write; MOTION_retargeted.blend if left out")
    add("--armature", default="", metavar="NAME", help="armature of the source that is the actor")
    add("--action", default="", metavar="NAME", help="action of the source; the one that it shows if left out")
    chosen = retarget.add_mutually_exclusive_group()
    chosen.add_argument("--preset", default="", help="preset of the rig's kind; detected if left out")
    chosen.add_argument("--map", type=Path, metavar="MAP.json", help="map of the rig's bones, instead of a preset")
    add("--save-map", type=Path, metavar="MAP.json", help="write the map that was used, with its map pose")
    add("--limbs", choices=("fk", "ik"), default="fk", help="FK or IK in the rig's switches; both are keyed")
    add(
        "--scale", type=_positive, default=0.0, metavar="S",
        help="scale of the travel relative to the actor's; the ratio of the legs if left out",
    )  # fmt: skip
    way = retarget.add_mutually_exclusive_group()
    way.add_argument("--in-place", action="store_true", help="remove the travel over the ground")
    way.add_argument("--root-motion", action="store_true", help="put the travel over the ground on the root bone")
    add("--frame-start", type=int, default=1, metavar="N", help="scene frame of the first frame (default 1)")
    add(
        "--export",
        nargs="+",
        choices=_FORMATS,
        default=[],
        metavar="FORMAT",
        help="for a folder: also write each clip in these formats",
    )


def _add_motion_options(motion: argparse.ArgumentParser) -> None:
    add = motion.add_argument
    add("clip", type=Path, metavar="CLIP", help="FBX, glTF, VRM, Blender file, BVH, MVNX, C3D segments or AMASS")
    add("--out", type=Path, required=True, metavar="MOTION.npz", help="motion file to write")
    add("--armature", default="", metavar="NAME", help="armature of the clip, if several move")
    add("--action", default="", metavar="NAME", help="action of the armature; the one that it shows if left out")


def _add_hands_options(hands: argparse.ArgumentParser) -> None:
    add = hands.add_argument
    add("hands_of", type=Path, metavar="MOTION.npz", help="motion to which the hands are added")
    add(
        "gloves", type=Path, nargs="+", metavar="GLOVES", help="FBX, glTF, Blender file, BVH, or CSV of MANUS or Rokoko"
    )
    add("--out", type=Path, required=True, metavar="OUT.npz", help="motion file to write")
    add("--armature", default="", metavar="NAME", help="armature of the recording, if several move")


def _add_body_options(body: argparse.ArgumentParser) -> None:
    body.add_argument(
        "--out", type=_blend_file, required=True, metavar="FILE.blend",
        help="Blender file, never replaced; its folder becomes an asset library",
    )  # fmt: skip
    body.add_argument(
        "--betas", type=_betas, default=(), metavar="B0,B1,…", help="values of the shape sliders (write --betas=-1,2)"
    )
    body.add_argument("--fingers", action="store_true", help="add finger bones, and controls that curl and spread them")


def _add_batch_options(batch: argparse.ArgumentParser) -> None:
    batch.add_argument(
        "captures", type=Path, nargs="?", metavar="FOLDER",
        help="folder of the captures: files .npz, recordings of markers, folders",
    )  # fmt: skip
    batch.add_argument(
        "--watch", type=Path, metavar="FOLDER", help="folder to watch, instead of FOLDER: solve what arrives in it"
    )
    batch.add_argument(
        "--settled",
        type=_positive,
        default=5.0,
        metavar="S",
        help="with --watch: seconds a capture must be unchanged (default 5)",
    )
    batch.add_argument(
        "--idle", type=_positive, metavar="S", help="with --watch: stop when nothing arrives for this many seconds"
    )
    _add_workers(batch, "takes")
    batch.add_argument(
        "--stretches", action="store_true", help="with --scheduler: also spread the stretches of each long take"
    )
    batch.add_argument(
        "--job", type=Path, metavar="JOB.json", help="settings of the solves: a job file without capture and out"
    )
    batch.add_argument("--strict", action="store_true", help="refuse takes whose solves have warnings")
    batch.add_argument(
        "--accept", action="append", choices=list_refusals(), default=[], metavar="CODE",
        help="accept results with this fault, which are refused otherwise; may be repeated",
    )  # fmt: skip
    batch.add_argument("--bake", action="store_true", help="write a Blender file of each take")
    batch.add_argument("--render", action="store_true", help="write a video and a contact sheet of each take")
    batch.add_argument(
        "--take-seconds", type=_positive, metavar="S", help="stop the solver of a take after this many seconds"
    )
    batch.add_argument(
        "--take-memory", type=_positive, metavar="MB", help="stop the solver of a take that uses more memory (Linux)"
    )
    batch.add_argument("--export", nargs="+", choices=_FORMATS, default=[], help="formats to export to")
    batch.add_argument(
        "--export-markers", nargs="+", choices=tuple(MARKER_FORMATS), default=[],
        help="write the cleaned markers of takes of markers",
    )  # fmt: skip


def _add_workers(verb: argparse.ArgumentParser, what: str) -> None:
    who = verb.add_mutually_exclusive_group()
    who.add_argument("--scheduler", default="", metavar="ADDRESS", help="spread over the workers of a Dask scheduler")
    who.add_argument(
        "--workers", type=_count, default=0, metavar="N", help=f"number of {what} at a time on this machine"
    )
    verb.add_argument("--tls", type=Path, metavar="FOLDER", help="certificates of a scheduler on another host")
    verb.add_argument(
        "--patience",
        type=_positive,
        default=60.0,
        metavar="S",
        help="seconds to wait for scheduler and workers (default 60)",
    )


def _add_studio_options(studio: argparse.ArgumentParser) -> None:
    add = studio.add_argument
    add("description", type=Path, metavar="SPEC.json", help="description: motions, people, camera arrays and looks")
    add("--out", type=Path, required=True, metavar="DIR", help="folder of the data set; an interrupted run resumes")
    add("--plan", action="store_true", help="check the description; report what would be made and its size")
    add(
        "--benchmark", nargs="+", default=[], metavar="METHOD",
        help="also solve by these methods and compare",
    )  # fmt: skip
    add("--places", action="store_true", help="also map the camera arrays' errors over the floor")
    add("--settings", type=Path, metavar="SETTINGS.json", help="settings of these solves, as in a job file")
    add("--colour-of", default="", metavar="SHOT", help="only render the colour pictures of a shot that was filmed")
    _add_workers(studio, "shots")


def _add_certificates_options(certificates: argparse.ArgumentParser) -> None:
    certificates.add_argument(
        "--days", type=_count, default=DAYS, metavar="N", help=f"days for which they are valid (default {DAYS})"
    )


_OPTIONS: dict[str, Callable[[argparse.ArgumentParser], None]] = {
    "bake": _add_bake_options, "export": _add_export_options, "retarget": _add_retarget_options,
    "motion": _add_motion_options, "add-hands": _add_hands_options, "body": _add_body_options,
    "batch": _add_batch_options, "studio": _add_studio_options,
    "certificates": _add_certificates_options,
}  # fmt: skip
"""What adds a verb's own options."""


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


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 1024:
        raise argparse.ArgumentTypeError(f"{text} is not a number from 1 to 1024")
    return int(text)


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"a positive number is expected, not {text}")
    return value
