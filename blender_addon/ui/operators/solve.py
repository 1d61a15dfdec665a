"""Solving: a job file, the solver's process, and its motion as a new action."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..._exchange.errors import MocapError
from ...conventions.file_paths import file_of, stored
from ...conventions.naming import counted
from ..project_files import bring_home
from .base import OfCapture, OfTake, SolverOperator, current

if TYPE_CHECKING:
    from ..._exchange.verb_results import PersonResult, SolveResult, TakeResult, TakesResult
    from ...review.ranges import SceneRange


class _Solves(SolverOperator):
    """What solving a take and solving a range of its frames have in common."""

    def solve(self, context: bpy.types.Context, frames: SceneRange | None) -> set[str]:
        """Write the job and start the solver."""
        from ..._exchange.job_file import write_job
        from ...animation.takes import SolvedAgain, SolveFiles
        from ..scene_job import portable_job, prepare_job

        job, path = prepare_job(context.scene, frames)
        write_job(path, portable_job(job, path.parent))
        self._files = SolveFiles(job.out, job.capture, job.report, path)
        part = job.resolve
        self._again = None if frames is None or part is None else SolvedAgain(frames.action.name, part.first, part.last)
        return self.launch(context, "solve", ["--job", str(path)], path.parent)

    def received(self, context: bpy.types.Context, result: SolveResult) -> set[str]:
        """Bake the motion as a new action."""
        from .import_results import take_motion

        action = take_motion(context, self._files, again=self._again, result=result)
        doubtful = result["unseen_frames"] + result["unsure_frames"]
        look = f"; look at {counted(doubtful, 'frame')}" if doubtful else ""
        self.report({"INFO"}, f"Solved '{action.name}' in {result['solve_s']:.1f} s{look}")
        return {"FINISHED"}

    def rescue(self, context: bpy.types.Context) -> str:
        """Bake a motion that is whole although what follows it, the report, is not."""
        from .import_results import take_motion

        if not self._files.motion.is_file():
            return ""
        action = take_motion(context, replace(self._files, report=None), again=self._again)
        return f"The motion itself is whole: it arrived as '{action.name}'."


class MOCAP_OT_solve(_Solves, OfCapture, bpy.types.Operator):
    """Solves the capture into a new take."""

    bl_idname = "mocap.solve"
    bl_label = "Solve"
    bl_description = "Solve the capture in a process of its own; the motion arrives as a new action, older takes stay"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start."""
        return self.solve(context, None)


class MOCAP_OT_resolve_range(_Solves, OfTake, bpy.types.Operator):
    """Solves a frame range of the current take again."""

    bl_idname = "mocap.resolve_range"
    bl_label = "Solve Range Again"
    bl_description = (
        "Solve the frames from First to Last again, with the pinned poses kept; all other frames stay as they are, "
        "with your edits"
    )

    edits: bpy.props.EnumProperty(
        name="Edits in the Range",
        items=(
            ("PIN", "Pin Them", "Keep the poses of the edited frames; the frames between are solved to meet them"),
            (
                "DROP",
                "Solve Over Them",
                "Solve these frames as if nobody had edited them; the former take stays",
            ),
        ),
        options={"SKIP_SAVE"},
    )
    edited: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask what becomes of edits inside the range, where there are any."""
        try:
            frames = edited_in_range(context)
        except MocapError:
            return self.execute(context)  # which reports it
        if not frames:
            return self.execute(context)
        self.edited = f"{counted(len(frames), 'frame')} edited by hand: {spans(frames)}"
        return context.window_manager.invoke_props_dialog(self, width=360)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the question."""
        self.layout.label(text=self.edited, icon="QUESTION", translate=False)
        self.layout.prop(self, "edits", expand=True)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Pin what was edited, if it is to stay, and start."""
        from ...review.ranges import SceneRange
        from .review import pin_frame

        scene, review = context.scene, context.scene.mocap.review
        if self.edits == "PIN" and (frames := edited_in_range(context)):
            shown = scene.frame_current, scene.frame_subframe
            for frame in frames:
                scene.frame_set(frame)
                pin_frame(review, frame)
            scene.frame_set(shown[0], subframe=shown[1])
        pins = tuple((pin.frame, pin.job_values) for pin in review.pins)
        return self.solve(context, SceneRange(review.take, review.first, review.last, pins))


def edited_in_range(context: bpy.types.Context) -> list[int]:
    """Return the scene frames of the chosen range that were edited by hand and are not pinned yet.

    Raises:
        MocapError: the take's motion or body can no longer be read.
    """
    from ...review.ranges import capture_frame, scene_frame
    from ...scene.hand_edits import edited_frames

    review = context.scene.mocap.review
    take = review.take
    ends = (capture_frame(take, frame) for frame in (review.first, review.last))
    frames = edited_frames(context.scene, review.armature, take, *ends)
    pinned = {pin.frame for pin in review.pins}
    return sorted({scene_frame(take, int(frame)) for frame in frames} - pinned)


def spans(frames: list[int]) -> str:
    """Return frames as ranges, "50-52, 60"."""
    parts: list[list[int]] = []
    for frame in frames:
        if parts and frame == parts[-1][-1] + 1:
            parts[-1].append(frame)
        else:
            parts.append([frame])
    return ", ".join(f"{part[0]}-{part[-1]}" if len(part) > 1 else str(part[0]) for part in parts)


class MOCAP_OT_show_log(bpy.types.Operator):
    """Shows what the solver reported."""

    bl_idname = "mocap.show_log"
    bl_label = "Show Log"
    bl_description = "Show the solver's log as a text in a window of its own"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a run."""
        return current.run is not None or current.last is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the log into a text and open it."""
        text = write_log()
        if not bpy.app.background:
            bpy.ops.wm.window_new()
            area = context.window_manager.windows[-1].screen.areas[0]
            area.type = "TEXT_EDITOR"
            area.spaces.active.text = text
        return {"FINISHED"}


def write_log() -> bpy.types.Text:
    """Write the log of the run under way, or of the last one, into a text of the file."""
    run = current.run or current.last
    assert run is not None
    text = next((text for text in bpy.data.texts if "mocap_log" in text), None)
    if text is None:
        text = bpy.data.texts.new("MoCap Log")
        text["mocap_log"] = True
    text.clear()
    text.write("\n".join(run.log) + "\n")
    return text


class MOCAP_OT_solve_all(OfCapture, bpy.types.Operator):
    """Solves everybody that the captures show."""

    bl_idname = "mocap.solve_all"
    bl_label = "Solve All"
    bl_description = "Solve everybody one after another; each motion arrives as an action of a body of its own"

    scope: bpy.props.EnumProperty(
        name="Scope",
        items=(
            ("CAPTURE", "This Capture", "Everybody in this capture"),
            ("SCENE", "All Captures", "Everybody in every capture of the scene"),
        ),
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Write the jobs and start the solver on them."""
        from ..._exchange.job_file import write_job
        from ...animation.takes import SolveFiles
        from ..scene_job import portable_job, prepare_job

        settings = context.scene.mocap
        captures = list(settings.captures) if self.scope == "SCENE" else [settings.capture]
        self._files: dict[Path, SolveFiles] = {}
        arguments: list[str] = []
        folder = Path()
        for capture in captures:
            for person in range(max(1, len(capture.people))):
                job, path = prepare_job(context.scene, None, capture, person)
                write_job(path, portable_job(job, path.parent))
                self._files[job.out] = SolveFiles(job.out, job.capture, job.report, path)
                arguments += ["--job", str(path)]
                folder = path.parent
        return self.launch(context, "solve", arguments, folder)

    def received(self, context: bpy.types.Context, result: TakesResult | TakeResult) -> set[str]:
        """Bake each motion."""
        takes = result.get("takes", [result])
        for take in takes:
            self._bake(context, Path(take["motion"]), take)
        failed = result.get("failed", [])
        if failed:
            message = "; ".join(f"{item['name']}: {item['message']}" for item in failed)
            self.report({"WARNING"}, f"Solved {counted(len(takes), 'take')}; {len(failed)} failed: {message}")
        else:
            self.report({"INFO"}, f"Solved {counted(len(takes), 'take')}")
        return {"FINISHED"}

    def rescue(self, context: bpy.types.Context) -> str:
        """Bake what was finished before the run broke."""
        done = [motion for motion in self._files if motion.is_file()]
        for motion in done:
            self._bake(context, motion)
        return f"{len(done)} of {counted(len(self._files), 'take')} finished and arrived." if done else ""

    def _bake(self, context: bpy.types.Context, motion: Path, result: SolveResult | None = None) -> None:
        from .import_results import take_motion

        files = self._files[motion]
        captures = context.scene.mocap.captures
        capture = next((item for item in captures if file_of(item.file) == files.capture), None)
        take_motion(context, files, capture, result=result)


class MOCAP_OT_calibrate_subject(SolverOperator, bpy.types.Operator):
    """Learns a person's shape and where every marker sits, which solves then start from."""

    bl_idname = "mocap.calibrate_subject"
    bl_label = "Calibrate Subject"
    bl_description = (
        "Learn the person's shape and marker places from this recording, best one with much movement. It and the "
        "person's other recordings are then solved with them"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a recording of markers."""
        if not context.scene.mocap.capture.marker_items:
            cls.poll_message_set("Import a recording of markers first")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start."""
        from ...solving.take_paths import next_subject
        from ..scene_job import capture_file, folder_of_takes, write_layout

        settings = context.scene.mocap
        capture = capture_file(settings.capture)
        out = next_subject(folder_of_takes(context.scene, capture.parent))
        layout = write_layout(settings.capture, out.with_suffix(".layout.json"))
        by_hand = [] if layout is None else ["--layout", str(layout)]
        options = ["--out", str(out), *(["--body", settings.solve.body] if settings.solve.body else [])]
        return self.launch(context, "calibrate", [str(capture), *options, *by_hand], out.parent)

    def received(self, context: bpy.types.Context, result: PersonResult) -> set[str]:
        """Solve with this person from now on."""
        context.scene.mocap.solve.subject = stored(result["subject"])
        bring_home()
        self.report({"INFO"}, f"Calibrated: {calibrated(result)}")
        return {"FINISHED"}


def calibrated(result: PersonResult) -> str:
    """Return what a calibration found, in a line.

    Args:
        result: result event of the verb ``calibrate``.
    """
    markers = result["markers"]
    label, far = max(markers.items(), key=lambda item: item[1]["offset_mm"])
    name = label.rpartition(":")[2]
    return f"{len(markers)} markers; {name} is farthest from the place of its name, {far['offset_mm']:.0f} mm"
