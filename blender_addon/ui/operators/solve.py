"""Operators that solve captures and frame ranges, and that calibrate the person with the markers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from ..._exchange.errors import MocapError
from ...conventions.file_paths import file_of, stored
from ...conventions.naming import CLIP, counted
from ...solving.take_paths import next_subject
from ..preferences import chosen_python, preferences_of
from ..project_files import bring_home
from ..setting_properties import choice
from .base import CAPTURE, INTERNAL, MARKERS, TAKE, Call, Need, RunFailed, Steps, current, operator, options
from .review import pin_frame

if TYPE_CHECKING:
    from ..._exchange.verb_results import PersonResult, SolveResult
    from ...animation.takes import SolveFiles
    from ...review.ranges import SceneRange
    from ...solving.pythons import PythonFound


def _write_job(
    context: bpy.types.Context, frames: SceneRange | None, *of: Any
) -> tuple[Path, SolveFiles, tuple[int, int] | None]:
    """Write the job file of a capture. Return its path, the files of the solve, and the frames to solve again."""
    from ..._exchange.job_file import write_job
    from ...animation.takes import SolveFiles
    from ..scene_job import portable_job, prepare_job

    job, path = prepare_job(context.scene, frames, *of)
    write_job(path, portable_job(job, path.parent))
    part = job.resolve
    return path, SolveFiles(job.out, job.capture, job.report, path), part and (part.first, part.last)


def _solve(self: Any, context: bpy.types.Context, frames: SceneRange | None) -> Steps:
    """Solve a take, or a range of its frames again. A failed report does not discard the motion."""
    from ...animation.takes import SolvedAgain
    from .import_results import take_motion

    path, files, part = _write_job(context, frames)
    again = None if frames is None or part is None else SolvedAgain(frames.action.name, *part)
    try:
        result: SolveResult = yield Call("solve", options(job=path), path.parent)
    except RunFailed:
        if not files.motion.is_file():
            return ""
        action = take_motion(context, replace(files, report=None), again=again, tell=self.tell)
        return f"The motion itself is complete and was added as '{action.name}'."
    action = take_motion(context, files, again=again, result=result, tell=self.tell)
    to_review = result["unseen_frames"] + result["unsure_frames"]
    look = f". Review {counted(to_review, 'frame')}" if to_review else ""
    return f"Solved '{action.name}' in {result['solve_s']:.1f} s{look}"


@operator("Solve", CAPTURE)
def solve(self: Any, context: bpy.types.Context) -> Steps:
    """Solve the capture into a new take without blocking Blender, and keep all earlier takes."""
    return (yield from _solve(self, context, None))


def _ask_about_edits(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    try:
        frames = edited_in_range(context)
    except MocapError:
        frames = []  # the solve reports this error
    if not frames:
        return self.execute(context)
    self.edited = f"{counted(len(frames), 'frame')} edited by hand: {spans(frames)}"
    return context.window_manager.invoke_props_dialog(self, width=360)


def _draw_edits(self: Any, context: bpy.types.Context) -> None:
    self.layout.label(text=self.edited, icon="QUESTION", translate=False)
    self.layout.prop(self, "edits", expand=True)


_KEPT = choice(
    "Edits in the Range",
    "Keep your hand edits, or solve over them",
    "resolve_range.edits",
    options={"SKIP_SAVE"},
)


_OWN_FRAMES = Need(
    "This clip is not the solved take. Show its source take",
    lambda context: CLIP not in context.scene.mocap.review.take,
)


@operator("Solve Range Again", TAKE, _OWN_FRAMES, invoke=_ask_about_edits, draw=_draw_edits, edits=_KEPT, edited=str)
def resolve_range(self: Any, context: bpy.types.Context) -> Steps:
    """Solve the frames from First to Last again with the pinned poses, and keep all other frames."""
    from ...review.ranges import SceneRange

    scene, review = context.scene, context.scene.mocap.review
    if self.edits == "PIN" and (frames := edited_in_range(context)):
        shown = scene.frame_current, scene.frame_subframe
        for frame in frames:
            scene.frame_set(frame)
            pin_frame(review, frame)
        scene.frame_set(shown[0], subframe=shown[1])
    pins = tuple((pin.frame + pin.subframe, pin.job_values) for pin in review.pins)
    return (yield from _solve(self, context, SceneRange(review.take, review.first, review.last, pins)))


def edited_in_range(context: bpy.types.Context) -> list[int]:
    """Return the scene frames from First to Last that have hand edits but no pin."""
    from ...review.ranges import capture_frame, scene_frame
    from ...scene.hand_edits import edited_frames

    review = context.scene.mocap.review
    take = review.take
    ends = (capture_frame(take, frame) for frame in (review.first, review.last))
    frames = edited_frames(context.scene, review.armature, take, *ends)
    pinned = {pin.frame for pin in review.pins}
    return sorted({scene_frame(take, int(frame)) for frame in frames} - pinned)


def runs(frames: list[int]) -> list[tuple[int, int]]:
    """Return the first and last frame of each run of consecutive frames."""
    known = set(frames)
    starts = [frame for frame in frames if frame - 1 not in known]
    return list(zip(starts, (frame for frame in frames if frame + 1 not in known), strict=True))


def spans(frames: list[int]) -> str:
    """Return frame numbers as text, such as "50-52, 60"."""
    return ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in runs(frames))


@operator("Solve All", CAPTURE, scope=choice("Scope", "Solve only this capture, or all captures", "solve_all.scope"))
def solve_all(self: Any, context: bpy.types.Context) -> Steps:
    """Solve all people one after another, and store each result as an action on that person's body."""
    from .import_results import take_motion

    settings = context.scene.mocap
    jobs = [
        _write_job(context, None, capture, person)
        for capture in (list(settings.captures) if self.scope == "SCENE" else [settings.capture])
        for person in range(max(1, len(capture.people)))
    ]
    by_motion = {files.motion: files for _, files, _ in jobs}

    def bake(motion: Path, result: SolveResult | None = None) -> None:
        files = by_motion[motion]
        captures = context.scene.mocap.captures  # undo may have replaced the earlier reference
        capture = next((item for item in captures if file_of(item.file) == files.capture), None)
        take_motion(context, files, capture, result=result, tell=self.tell)

    words = [word for path, _, _ in jobs for word in options(job=path)]
    try:
        result: dict[str, Any] = yield Call("solve", words, jobs[-1][0].parent)
    except RunFailed:
        done = [motion for motion in by_motion if motion.is_file()]
        for motion in done:
            bake(motion)
        return f"{len(done)} of {counted(len(by_motion), 'take')} finished and imported." if done else ""
    takes, failed = result.get("takes", [result]), result.get("failed", [])
    for take in takes:
        bake(Path(take["motion"]), take)
    message = "; ".join(f"{item['name']}: {item['message']}" for item in failed)
    more = f". {len(failed)} failed: {message}" if failed else ""
    return self.finish(f"Solved {counted(len(takes), 'take')}{more}", warn=failed)


@operator("Calibrate Subject", MARKERS)
def calibrate_subject(self: Any, context: bpy.types.Context) -> Steps:
    """Estimate the person's shape and marker positions from varied movement, for all takes of this person."""
    from ..scene_job import capture_file, folder_of_takes, write_layout

    settings = context.scene.mocap
    capture = capture_file(settings.capture)
    out = next_subject(folder_of_takes(context.scene, capture.parent))
    layout = write_layout(settings.capture, out.with_suffix(".layout.json"))
    words = [str(capture), *options(out=out, body=settings.solve.body, layout=layout)]
    result: PersonResult = yield Call("markers calibrate", words, out.parent)
    context.scene.mocap.solve.subject = stored(result["subject"])
    bring_home()
    return f"Calibrated: {calibrated(result)}"


def calibrated(result: PersonResult) -> str:
    """Return the number of markers in a subject calibration, and the one farthest from its usual position, as text."""
    markers = result["markers"]
    label, worst = max(markers.items(), key=lambda item: item[1]["offset_mm"])
    name = label.rpartition(":")[2]
    return f"{len(markers)} markers. {name} is farthest from its usual position, {worst['offset_mm']:.0f} mm"


_LOG = Need("There is no log", lambda context: current.run is not None or current.last is not None)


@operator("Show Log", _LOG, options=INTERNAL)
def show_log(self: Any, context: bpy.types.Context) -> None:
    """Show the solver's log in a new window."""
    text = _write_log()
    if not bpy.app.background:
        bpy.ops.wm.window_new()
        area = context.window_manager.windows[-1].screen.areas[0]
        area.type = "TEXT_EDITOR"
        area.spaces.active.text = text


def _write_log() -> bpy.types.Text:
    run = current.run or current.last
    assert run is not None
    text = next((text for text in bpy.data.texts if "mocap_log" in text), None)
    if text is None:
        text = bpy.data.texts.new("MoCap Log")
        text["mocap_log"] = True
    text.clear()
    text.write("\n".join(run.log) + "\n")
    return text


@operator("Test Python", options=INTERNAL)
def test_python(self: Any, context: bpy.types.Context) -> str | set[str]:
    """Start the chosen Python and report its versions and devices, without installing anything."""
    from ...solving.pythons import probe_python

    preferences = preferences_of(context)
    if preferences is None:
        return {"CANCELLED"}
    preferences.found = preferences.failed = ""
    try:
        preferences.found = _describe(probe_python(chosen_python(context)))
    except MocapError as error:
        preferences.failed = str(error)
        raise
    return preferences.found.replace("\n", ", ")


def _describe(found: PythonFound) -> str:
    torch = f"PyTorch {found.torch} on {', '.join(found.devices)}" if found.torch else "without PyTorch"
    return f"Python {found.python}, NumPy {found.numpy}, {torch}\nSolver {found.solver} runs in it"
