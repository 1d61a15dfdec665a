"""Base classes of the operators: conditions, undo steps, solver runs and file choosers."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from inspect import isgeneratorfunction
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import bpy
from bpy.app.handlers import persistent

from ..._exchange.errors import MocapError, sentence
from ...conventions.file_paths import absolute
from ...errors import WindowClosed
from ..layout import redraw
from ..preferences import chosen_python
from ..project_files import RELATIVE, following
from ..setting_properties import reset_unknown

if TYPE_CHECKING:
    from ...solving.run import Run

    Operator, FileHandler = bpy.types.Operator, bpy.types.FileHandler
else:
    Operator = FileHandler = object  # Blender's own classes are added as a second base of each class

UNDOABLE, INTERNAL, OPENS, PRESETS = {"REGISTER", "UNDO"}, {"INTERNAL"}, {"REGISTER"}, {"PRESET"}
"""Values of ``bl_options``: with undo, hidden from the search menu, without undo, and with saved presets."""
_INTERVAL_S = 0.1
_REDRAW_S = 1.0
"""Minimum seconds between two redraws of the progress, because slow drawing takes time from the solver."""


@dataclass(frozen=True)
class Need:
    """A condition for running an operator, and the message to show while the condition is not met."""

    message: str
    is_met: Callable[[bpy.types.Context], Any]


CAPTURE = Need("Import a capture first", lambda context: context.scene.mocap.capture.file)
CAMERAS = Need(
    "Import a capture with cameras first",
    lambda context: CAPTURE.is_met(context) and len(context.scene.mocap.capture.cameras),
)
MARKERS = Need("Import a marker recording first", lambda context: len(context.scene.mocap.capture.marker_items))
BODY = Need("Solve a capture first", lambda context: context.scene.mocap.review.armature is not None)
TAKE = Need("Solve a capture first", lambda context: context.scene.mocap.review.take is not None)
EDITABLE = Need(
    "This body is linked. Choose Object > Library Override > Make first",
    lambda context: context.scene.mocap.review.armature.is_editable,
)
OBJECT_MODE = Need("Switch to Object Mode first", lambda context: context.mode == "OBJECT")
IDLE = Need("The solver is running. Wait or cancel first", lambda context: not current.busy)


Answer = set[str] | str | None
"""Result of an operator: a message to report, None for no message, or the set that Blender expects."""


class MocapOperator(Operator):
    """Mixin for operators that change the scene in a single undo step.

    The identifier comes from the class name and the tooltip from the docstring. Modules that do the work are imported
    inside methods, because registering must not load arrays or the solver.
    """

    bl_options = UNDOABLE
    needs = tuple[Need, ...]()  # an annotation on a mixin would be evaluated for every class

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if cls.__name__.startswith("MOCAP_OT_"):
            cls.bl_idname = f"mocap.{cls.__name__.removeprefix('MOCAP_OT_')}"
            cls.bl_description = (cls.__doc__ or "").removesuffix(".")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        unmet = next((need for need in cls.needs if not need.is_met(context)), None)
        if unmet is not None:
            cls.poll_message_set(unmet.message)
        return unmet is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            return self.answer(self.work(context))
        except MocapError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def work(self, context: bpy.types.Context) -> Answer:
        """Change the scene and return a message. A raised ``MocapError`` is shown to the user."""
        raise NotImplementedError

    def answer(self, found: Answer) -> set[str]:
        """Report a returned message, and return the status set that Blender expects."""
        return found if isinstance(found, set) else self.finish(found or "")

    def finish(self, message: str = "", *, warn: Any = False) -> set[str]:
        """Report a message, as a warning if ``warn`` is true, and return Blender's ``FINISHED`` status."""
        if message:
            self.report({"WARNING"} if warn else {"INFO"}, message)
        return {"FINISHED"}

    def tell(self, *messages: str, kind: str = "INFO") -> None:
        """Show messages in Blender's status bar and info log."""
        for message in messages:
            self.report({kind}, message)

    def give_up(self, message: str, kind: str = "WARNING") -> set[str]:
        """Report why the operator does nothing, and return Blender's ``CANCELLED`` status."""
        self.report({kind}, message)
        return {"CANCELLED"}


def operator(
    label: str,
    *needs: Need,
    options: set[str] = UNDOABLE,
    invoke: Any = None,
    draw: Any = None,
    waits: bool = True,
    **properties: Any,
) -> Callable[..., Any]:
    """Return a decorator that turns a function into the operator ``MOCAP_OT_<function>``.

    The function receives the operator, which stores the properties, and the context. Its docstring becomes the tooltip.
    A generator function becomes the ``steps`` of a ``SolverOperator``. Such an operator can start only while no other
    run is active, unless ``waits`` is False.
    """

    def make(work: Callable[..., Any]) -> type:
        has_steps = isgeneratorfunction(work)
        members: dict[str, Any] = {
            "__doc__": work.__doc__,
            "__module__": work.__module__,
            "__annotations__": properties,
        }
        members |= {"bl_label": label, "bl_options": options, "needs": (*needs, IDLE) if has_steps and waits else needs}
        members |= {name: method for name, method in (("invoke", invoke), ("draw", draw)) if method is not None}
        members["steps" if has_steps else "work"] = work
        mixin = SolverOperator if has_steps else MocapOperator
        return type(f"MOCAP_OT_{work.__name__}", (mixin, bpy.types.Operator), members)

    return make


class ViewportDrop(FileHandler):
    """Mixin for classes that handle files dropped on the 3D viewport."""

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"


def choose_file(suffixes: Sequence[str], *, several: bool = False) -> Any:
    """Return a mixin with the properties that Blender's file browser fills in.

    With ``several``, the user can choose several files or a folder, or drop files.
    """
    hidden = {"options": {"HIDDEN", "SKIP_SAVE"}}
    path: dict[str, Any] = {"options": {"HIDDEN", "SKIP_SAVE"} | RELATIVE}
    made = {
        "filepath": bpy.props.StringProperty(subtype="FILE_PATH", **path),
        "filter_glob": bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in suffixes), **hidden),
    }
    if several:
        made["directory"] = bpy.props.StringProperty(subtype="DIR_PATH", **path)
        made["files"] = bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, **hidden)
    return type("ChoosesFile", (), {"__annotations__": made})


def chosen_files(operator: bpy.types.Operator) -> list[Path]:
    """Return the files that the user selected or dropped, or else the path in the file browser's path field."""
    several = [absolute(operator.directory) / item.name for item in operator.files if item.name]
    return several or [absolute(operator.filepath or operator.directory)]


def is_chosen(operator: bpy.types.Operator) -> bool:
    """Return whether the operator already has a file and therefore needs no file browser."""
    return bool(operator.files) or bool(operator.filepath and absolute(operator.filepath).exists())


class Current:
    """The solver run that is active, and the one that ended last. There is at most one of each."""

    def __init__(self) -> None:
        self.run: Run | None = None
        self.last: Run | None = None
        self.about: tuple[str, str] = ("", "")
        """Scene and capture file of the last run. Only their panels show its result."""

    @property
    def busy(self) -> bool:
        """True while a solver run is active."""
        return self.run is not None

    def finish(self) -> None:
        """Move the active run to ``last``, so that panels show its result."""
        self.run, self.last, following.solver_reads = None, self.run, False

    def lose(self, scene: bpy.types.Scene, error: MocapError) -> None:
        """Kill the active run, and store the error for the scene that started it."""
        if self.run is not None:
            self.run.process.kill()
            self.run.error = error.as_event()
            self.finish()
            self.about = _subject(scene)

    def abandon(self) -> None:
        """Kill and forget all runs, because the file or the add-on is being closed."""
        if self.run is not None:
            self.run.process.kill()
        self.finish()
        self.last = None

    def last_for(self, scene: bpy.types.Scene, verbs: tuple[str, ...]) -> Run | None:
        """Return the last run if it ran one of these verbs for this scene's current capture."""
        if self.busy or self.last is None or self.last.verb not in verbs or self.about != _subject(scene):
            return None
        return self.last


current = Current()


def _subject(scene: bpy.types.Scene) -> tuple[str, str]:
    return scene.name, scene.mocap.capture.file


@persistent
def after_load(*_: object) -> None:
    """Forget the previous file's runs, and reset menu choices that this version does not have."""
    for scene in bpy.data.scenes:
        reset_unknown(scene.mocap)
    current.abandon()
    following.failure = ""


class Call(NamedTuple):
    """A command that an operator starts, with the folder it runs in."""

    verb: str
    words: Sequence[str]
    folder: Path  # Working folder, which also contains the log.
    through_blender: bool = False  # True to run a verb of the add-on's command line in a second Blender.
    of_capture: bool = True  # True if the result belongs to the capture that was current at the start of the run.
    watch: Callable[[], None] = lambda: None  # Function to call regularly during the run.
    solves: bool = True  # True if the verb in a second Blender starts the solver and so needs the chosen Python.


Steps = Generator["Call | Run", Any, Answer]
"""Generator that an operator runs: it yields a command, receives the result, and returns a message.

If the command fails, the generator receives a ``RunFailed`` and returns which parts were finished.
"""


class RunFailed(Exception):
    """Signal to an operator's ``steps`` that the command they wait for has failed."""


def options(**values: Any) -> list[str]:
    """Return each keyword argument as a command-line option, except None, False and empty values."""
    given = {f"--{name.replace('_', '-')}": value for name, value in values.items() if value not in (None, False, "")}
    return [word for name, value in given.items() for word in ([name] if value is True else [name, str(value)])]


SHORT = 600
"""Longest take, in frames, to edit in this process. A second Blender takes seconds to start."""


def works_here(objects: Sequence[bpy.types.Object], frames: float = SHORT + 1) -> bool:
    """Return whether to edit objects in this Blender instead of a second one.

    This is the case for short takes, without a window, during another run, or if the objects depend on this file.
    """
    from ...scene.session import needs_this_file

    return frames <= SHORT or bpy.app.background or current.busy or needs_this_file(objects)


class SolverOperator(MocapOperator):
    """Mixin for modal operators. Their ``steps`` wait for a run while the user can work in Blender.

    Escape is passed on to Blender, so only the Cancel button ends a run.
    """

    needs = tuple[Need, ...]([IDLE])
    _held, _timer, _shown, _scene = -1, None, 0.0, ""
    _watch = staticmethod(lambda: None)

    def steps(self, context: bpy.types.Context) -> Steps:
        """Yield a command, then add its result to the scene. A raised ``MocapError`` is shown to the user."""
        raise NotImplementedError

    def work(self, context: bpy.types.Context) -> Answer:
        self._steps = self.steps(context)
        try:
            call = next(self._steps)
        except StopIteration as end:
            return end.value
        try:
            return self._begin(context, call)
        except BaseException:
            self._steps.close()
            raise

    def _begin(self, context: bpy.types.Context, call: Call | Run) -> set[str]:
        self._scene = context.scene.name
        self._held = context.scene.mocap.capture_index if isinstance(call, Call) and call.of_capture else -1
        if not isinstance(call, Call):
            return self.follow(context, call)
        self._watch = call.watch  # pyrefly: ignore[read-only] - of this object
        if not call.through_blender:
            return self.launch(context, call.verb, list(call.words), call.folder)
        from ...headless.children import start_verb

        words = [*call.words, *options(python=chosen_python(context) if call.solves else None)]
        return self.follow(context, start_verb(call.verb, words, call.folder))

    def launch(self, context: bpy.types.Context, verb: str, arguments: list[str], folder: Path) -> set[str]:
        """Start the solver, and follow its run."""
        from ...solving.run import start

        return self.follow(context, start(verb, arguments, chosen_python(context), folder))

    def follow(self, context: bpy.types.Context, run: Run) -> set[str]:
        """Follow a run until it ends. Block if there is no window."""
        current.run = run
        following.solver_reads = True
        if bpy.app.background:
            run.process.wait()
            while not run.finished:
                run.poll()
            return self._ended(context)
        manager = context.window_manager
        self._timer = manager.event_timer_add(_INTERVAL_S, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        run = current.run
        if run is None:  # the run was abandoned
            self._stop(context)
            _show(context, None)
            return {"CANCELLED"}
        if event.type == "TIMER":
            self._watch()
            if run.poll() and time.monotonic() - self._shown > _REDRAW_S:
                self._shown = time.monotonic()
                _show(context, f"Motion capture: {run.headline} ({run.share:.0%})")
        return self._ended(context) if run.finished else {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        if not self._scene:  # a file browser or dialog was closed before the run started
            return
        hint = "Start it again, and keep its window open."
        error = WindowClosed("The run ended because its window was closed.", hint=hint)
        scene = bpy.data.scenes.get(self._scene)
        current.abandon() if scene is None else current.lose(scene, error)
        self._stop(context)

    def _ended(self, context: bpy.types.Context) -> set[str]:
        """Import the result into the scene that started the run, which the window may no longer show."""
        scene, shown, window = bpy.data.scenes.get(self._scene), context.scene, context.window
        elsewhere = window if scene is not None and scene != shown else None
        if elsewhere is not None:
            elsewhere.scene = scene
        context.scene.mocap.held = self._held
        try:
            return self._outcome(context)
        finally:
            current.about = _subject(context.scene)
            context.scene.mocap.held = -1
            if elsewhere is not None:
                elsewhere.scene = shown
            self._stop(context)

    def _outcome(self, context: bpy.types.Context) -> set[str]:
        run = current.run
        assert run is not None
        current.finish()
        _show(context, None)
        try:
            if run.result is not None:
                return self.answer(self.resume(run.result))
            error = run.error or {}
            was_cancelled = error.get("code") == "cancelled"
            if not was_cancelled and (rescued := self.resume(RunFailed())):
                return self.finish(f"{sentence(error)} {rescued}", warn=True)
            self.report({"INFO"} if was_cancelled else {"ERROR"}, sentence(error))
        except MocapError as error:
            run.error = error.as_event()
            self.report({"ERROR"}, str(error))
        return {"CANCELLED"}

    def resume(self, result: Any) -> Answer:
        """Pass a result or a ``RunFailed`` to the waiting steps, and return their message."""
        try:
            self._steps.throw(result) if isinstance(result, RunFailed) else self._steps.send(result)
        except StopIteration as end:
            return end.value
        except RunFailed:
            pass  # nothing can be saved any more
        return None

    def _stop(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        self._steps.close()  # this removes temporary files, which fails while a process has one open


@operator("Cancel", Need("Nothing is running", lambda context: current.busy), options=INTERNAL)
def cancel(self: Any, context: bpy.types.Context) -> None:
    """End the current run without leaving unfinished files, and keep all earlier takes."""
    if current.run is not None:
        current.run.cancel()


_MESSAGE = Need("There is no message", lambda context: current.last is not None and not current.busy)


@operator("Dismiss", _MESSAGE, options=INTERNAL)
def dismiss(self: Any, context: bpy.types.Context) -> None:
    """Remove this message together with its log."""
    current.last = None


def _show(context: bpy.types.Context, status: str | None) -> None:
    """Redraw the sidebars, and show a text in the status bar (None clears it)."""
    for window in context.window_manager.windows if not bpy.app.background else ():
        window.workspace.status_text_set(status)
    redraw("UI")
