"""Runs one verb: parse, do, report, and return the exit code."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import traceback
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

from .._exchange.cluster_address import use_certificates
from .._exchange.diagnostics import read_diagnostics, sentence, warnings_in
from .._exchange.errors import Cancelled, MocapError
from .._exchange.outputs import full_disk
from .._exchange.plain_text import plain
from .._exchange.progress import ConsoleProgress, JsonProgress, Progress
from ..conventions.naming import PERSON_LOOK
from ..errors import BakeFailed, BatchInvalid
from .bake import BakeRequest, run_bake
from .batch.limits import TakeLimits
from .batch.request import BatchRequest, Spread
from .batch.run_batch import run_batch
from .blender_module import require_blender
from .body import BodyRequest, run_body
from .certificates import run_certificates
from .exit_codes import exit_code
from .export import ExportRequest, run_export
from .motion import HandsRequest, MotionRequest, run_add_hands, run_motion
from .parent_pipe import end_with_input
from .quiet import own_streams
from .result import CommandResult
from .retarget import run_retarget
from .retarget_clips import run_retarget_clips
from .retarget_request import RetargetRequest
from .retarget_targets import run_retarget_targets
from .solver import run_solver
from .studio import StudioRequest, run_studio
from .verb_table import MODULE, VERBS
from .verb_table import program as program_called

_BREAKS = "\n"
"""Stay in what is reported to a person: tables have several lines."""
_INTERVAL_S = 0.2
"""Least time between two progress lines of one stage."""


def main(arguments: list[str] | None = None, program: str = MODULE) -> int:
    """Run the command line and return its exit code, see ``exit_codes.EPILOG``.

    Args:
        arguments: after the program's name; the process's own if left out.
        program: what the command is called in its help.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    as_json = "--json" in arguments
    try:
        options = program_called(program).parse(arguments)
    except MocapError as error:
        return _report(error, JsonProgress(sys.stdout) if as_json else None, sys.stderr)
    if options.parent_pipe:
        end_with_input()
    with own_streams(verbose=options.verbose) as (out, err):
        lines = JsonProgress(out, _INTERVAL_S)
        progress = lines if as_json else ConsoleProgress(err, _INTERVAL_S)
        try:
            result = _done(options, progress)
        except MocapError as error:
            return _report(error, lines if as_json else None, err)
        if as_json:
            lines.event(result)
        else:
            err.writelines(f"{plain(line, keep=_BREAKS)}\n" for line in _lines_about(result))
            out.write("\n".join(result["outputs"]) + "\n")
    return result.get("exit_code", 0)


def _report(error: MocapError, lines: JsonProgress | None, err: TextIO) -> int:
    """Report an error as an event, or to a person without ``lines``, and return the exit code."""
    if lines is not None:
        lines.event(error.as_event())
    else:
        err.write(f"\nerror: {plain(error.message + (f' ({error.where})' if error.where else ''))}\n")
        err.write(f"  try: {plain(error.hint)}\n" if error.hint else "")
    return exit_code(error)


def _done(options: argparse.Namespace, progress: Progress) -> CommandResult:
    """Do the verb; interruptions and what nobody foresaw become named errors."""
    asked: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        asked.append(number)
        raise KeyboardInterrupt

    def watched(stage: str, done: int, total: int) -> None:
        if asked:  # Blender prints what is raised while it loads its own add-ons, and goes on
            raise KeyboardInterrupt
        progress(stage, done, total)

    cancelled = Cancelled(f"The {options.verb} was cancelled; nothing was left half-written.")
    before = {number: signal.signal(number, interrupt) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        return VERBS[options.verb].load(__package__ or "")(options, watched)
    except KeyboardInterrupt as stop:
        raise cancelled from stop
    except MocapError:
        raise
    except Exception as error:
        if (named := full_disk(error)) is not None:
            raise named from error
        if asked:  # a library, stopped in its midst, made an error of its own of it
            raise cancelled from error
        traceback.print_exc()
        kind = type(error).__name__
        hint = "Please report this with the log above."
        raise BakeFailed(f"The {options.verb} failed: {kind}: {error}", hint=hint) from error
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)  # Blender's own handler is unknown to Python


def _solve(options: argparse.Namespace, progress: Progress) -> CommandResult:
    result = run_solver("solve", options.rest, progress, python=options.python)
    outputs = [result[key] for key in ("motion", "report") if result.get(key)]
    found = [item for take in result.get("takes", [result]) for item in read_diagnostics(take.get("diagnostics"))]
    return result | {"outputs": outputs, "notes": [sentence(item) for item in warnings_in(found)]}


def _calibrate(options: argparse.Namespace, progress: Progress) -> CommandResult:
    result = run_solver("calibrate", options.rest, progress, python=options.python)
    return result | {"outputs": [result["subject"]], "notes": list(result.get("problems", []))}


def _export_markers(options: argparse.Namespace, progress: Progress) -> CommandResult:
    result = run_solver("export-markers", options.rest, progress, python=options.python)
    return result | {"outputs": [result["markers_file"]], "notes": []}


def _bake(options: argparse.Namespace, progress: Progress) -> CommandResult:
    require_blender()
    request = BakeRequest(
        options.motion, options.out, options.capture, options.body,
        video=not (options.no_video or options.no_pictures), pictures=not options.no_pictures,
        keys_per_second=options.keys_per_second, tolerance_mm=options.keys_within, asset=options.asset, fps=options.fps,
        overwrite=options.overwrite, look=options.look or PERSON_LOOK, footage_from=tuple(options.footage_from),
    )  # fmt: skip
    return run_bake(request, progress)


def _render(options: argparse.Namespace, progress: Progress) -> CommandResult:
    require_blender()
    request = BakeRequest(
        options.motion, options.out, options.capture, options.body, blend=False, overwrite=options.overwrite,
        look=options.look or PERSON_LOOK, footage_from=tuple(options.footage_from),
    )  # fmt: skip
    return run_bake(request, progress)


def _export(options: argparse.Namespace, progress: Progress) -> CommandResult:
    require_blender()
    formats = tuple(dict.fromkeys(options.formats))
    request = ExportRequest(
        options.source,
        options.out,
        formats,
        options.body,
        options.armature,
        options.fps,
        options.overwrite,
        options.look,
    )
    return run_export(request, progress)


def _retarget(options: argparse.Namespace, progress: Progress) -> CommandResult:
    require_blender()
    targets = list(dict.fromkeys(options.target))
    request = RetargetRequest(
        options.source, targets[0], options.out or _beside(options.source), options.object, options.armature,
        options.action, options.preset, options.map, options.save_map, options.limbs, options.in_place,
        options.root_motion, options.body, options.scale, options.frame_start, options.overwrite,
    )  # fmt: skip
    formats = tuple(dict.fromkeys(options.export))

    def one(request: RetargetRequest, progress: Progress) -> CommandResult:
        if request.source.is_dir():
            return run_retarget_clips(request, formats, progress)
        return run_retarget(request, progress)

    return one(request, progress) if len(targets) == 1 else run_retarget_targets(request, targets, one, progress)


def _motion(options: argparse.Namespace, progress: Progress) -> CommandResult:
    require_blender()
    request = MotionRequest(
        options.clip, options.out, options.armature, options.action, tuple(options.rest), options.python
    )
    return _of_motion(run_motion(request, progress))


def _add_hands(options: argparse.Namespace, progress: Progress) -> CommandResult:
    require_blender()
    request = HandsRequest(
        options.hands_of, tuple(options.gloves), options.out, options.armature, tuple(options.rest), options.python
    )
    return _of_motion(run_add_hands(request, progress))


def _of_motion(result: Any) -> CommandResult:
    notes = [*result.get("problems", []), *result.get("notes", [])]
    return result | {"outputs": [result["motion"]], "notes": notes}


def _body(options: argparse.Namespace, progress: Progress) -> CommandResult:
    require_blender()
    return run_body(
        BodyRequest(options.out, options.body, options.betas, options.fingers, options.look or PERSON_LOOK), progress
    )


def _batch(options: argparse.Namespace, progress: Progress) -> CommandResult:
    _use_certificates(options)
    if options.bake or options.render or options.export:
        require_blender(here=not (options.workers or options.scheduler))
    if (options.captures is None) == (options.watch is None):
        raise BatchInvalid(
            "A batch needs a folder of captures, or one to watch.", hint="batch FOLDER, or --watch FOLDER."
        )
    formats = tuple(dict.fromkeys(options.export))
    request = BatchRequest(
        options.captures or options.watch, options.out, options.job, options.bake, options.render, formats,
        options.body, options.python, tuple(dict.fromkeys(options.export_markers)),
        TakeLimits(options.take_seconds, options.take_memory), options.strict, tuple(options.accept),
    )  # fmt: skip
    spread = Spread(
        options.scheduler, options.workers, options.watch is not None, options.settled, options.idle,
        options.stretches, options.patience,
    )  # fmt: skip
    return run_batch(request, progress, spread)


def _use_certificates(options: argparse.Namespace) -> None:
    if options.tls is not None:
        use_certificates(options.tls)


def _studio(options: argparse.Namespace, progress: Progress) -> CommandResult:
    _use_certificates(options)
    request = StudioRequest(
        options.description, options.out, options.plan, tuple(dict.fromkeys(options.benchmark)), options.places,
        options.python, Spread(options.scheduler, options.workers, patience_s=options.patience), options.colour_of,
        options.settings,
    )  # fmt: skip
    return run_studio(request, progress)


def _certificates(options: argparse.Namespace, progress: Progress) -> CommandResult:
    return run_certificates(options.out, options.days, options.overwrite, progress)


def _beside(source: Path) -> Path:
    return source.with_name(f"{source.stem}_retargeted.blend")


def _lines_about(result: CommandResult) -> list[str]:
    """Return what is reported to a person about a result, beside its files."""
    lines = []
    if "joints_deviation_mm" in result and "skin_deviation_mm" in result:
        joints_mm, skin_mm = result["joints_deviation_mm"], result["skin_deviation_mm"]
        lines.append(f"Blender agrees with the motion to {joints_mm:.3f} mm (joints) and {skin_mm:.3f} mm (skin)")
    if "hands_and_feet_deviation_mm" in result and "scale" in result and "map" in result:
        off_mm, scale = result["hands_and_feet_deviation_mm"], result["scale"]
        within = max(0.1, math.ceil(10 * off_mm) / 10)
        lines.append(f"{result['map']}, scaled by {scale:.3f}; Blender's hands and feet match within {within:.1f} mm")
    lines += [f"note: {note}" for note in result["notes"]]
    return lines + ([result["table"]] if "table" in result else [])
