"""The live run of this Blender: what it writes is shown by a timer, on a body, a character and a face."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import bpy

from .._exchange.errors import MocapError
from ..conventions.file_paths import stored

if TYPE_CHECKING:
    from ..body.body_file import BodyFile
    from ..retarget.live_rig import LiveRig
    from ..scene.live_figure import LiveFace, LiveFigure
    from ..solving.live import LiveRun

_INTERVAL_S = 1 / 60
"""Seconds from one look at new poses to the next: with the time that a look takes, more than 30 a second."""
_PANELS_S = 0.25
"""Seconds from one time that panels are drawn to the next: nobody reads figures that change faster."""


class CurrentLive:
    """The live run of this Blender, and what shows it; there is at most one."""

    def __init__(self) -> None:
        self.run: LiveRun | None = None
        self.figure: LiveFigure | None = None
        self.on_recorded: Callable[[str], None] | None = None
        """Called with the recording at the end."""
        self.face: LiveFace | None = None
        """What the face of another program moves."""
        self.character: LiveRig | None = None
        """The rig that stands as the body does."""
        self.of_sensors = False
        """Whether the run, or the last one, is of the Rig panel's sensors; else it is of the Live panel."""
        self._panels_drawn = 0.0
        self.failure = ""
        self.recorded = ""
        """The take that the last run recorded, as the scene stores paths."""

    @property
    def busy(self) -> bool:
        """Whether a run is under way."""
        return self.run is not None

    def begin(
        self, run: LiveRun, scene: bpy.types.Scene, *, body: bool = True, fingers: bool = False,
        on_recorded: Callable[[str], None] | None = None, face: LiveFace | None = None,
        character: Callable[[BodyFile], LiveRig] | None = None,
    ) -> None:  # fmt: skip
        """Show a run in a scene from now on, with a body or points alone; report where it recorded to at its end.

        Points and cameras give no fingers, and a body without them is drawn in half the time.

        Only sensors' runs take ``on_recorded``: their recording is a folder of the rig's.

        Raises:
            MocapError, RuntimeError: what shows it cannot be made; the run is ended.
        """
        import numpy as np

        from ..body.body_file import default_body_path, read_body
        from ..body.looks import show_look
        from ..conventions.skeleton import SMPL, SMPL_HANDS
        from ..scene.live_figure import create_live_figure

        try:
            own = read_body(default_body_path(), SMPL_HANDS if fingers else SMPL)
            rig = None if character is None else character(own)
            figure = create_live_figure(scene, own, np.zeros(10), shown=body)
            show_look(bpy.data.objects[figure.mesh], scene.mocap.look)
        except (MocapError, RuntimeError):
            run.process.kill()
            run.process.wait()
            raise
        self.run, self.figure, self.on_recorded, self.of_sensors = run, figure, on_recorded, on_recorded is not None
        self.face, self.character = face, rig
        self.failure = self.recorded = ""
        if not bpy.app.timers.is_registered(self.tick):
            bpy.app.timers.register(self.tick, first_interval=_INTERVAL_S)

    def tick(self) -> float | None:
        """Show the newest pose; return seconds until the next look, None at the end."""
        run, figure = self.run, self.figure
        if run is None or figure is None:
            return None
        pose = run.poll()
        if run.betas is not None and not (run.betas == figure.betas).all():
            self._reshape(run, figure)
        if pose is not None:
            if self.face is not None and pose.face:
                self.face.show(pose.face)
            there = figure.show_points(pose.points, pose.off_m)
            if pose.rotvec is not None and pose.transl is not None:
                there = figure.pose(pose.rotvec, pose.transl) and there
                there = (self.character is None or self.character.pose(pose.rotvec, pose.transl)) and there
                figure.show_doubt(pose.rotvec, pose.transl, pose.sigma_m, unsure=pose.state == "unsure")
            if not there and not run.process.cancelling:
                self.failure = "The live body or its character was removed (undone or deleted): the run was stopped."
                run.stop()
        if run.finished:
            self._ended(run)
        if pose is not None or run.finished:
            now = time.monotonic()
            panels = run.finished or now - self._panels_drawn > _PANELS_S
            self._panels_drawn = now if panels else self._panels_drawn
            _redraw(panels=panels)
        return None if self.run is None else _INTERVAL_S

    def _reshape(self, run: LiveRun, figure: LiveFigure) -> None:
        """Give the body its shape, and let the character know of it; a rig that does not suit it ends the run."""
        assert run.betas is not None
        figure.reshape(run.betas)
        try:
            if self.character is not None:
                self.character.reshape(run.betas)
        except MocapError as error:
            self.failure = str(error)
            run.stop()

    def _ended(self, run: LiveRun) -> None:
        self.failure = self.failure or run.failure
        recorded, on_recorded = "" if run.recorded is None else stored(run.recorded), self.on_recorded
        self.run = self.on_recorded = None
        if on_recorded is None:
            self.recorded = recorded
        else:
            on_recorded(recorded)

    def abandon(self) -> None:
        """End the run at once; for leaving a file or switching the add-on off."""
        if bpy.app.timers.is_registered(self.tick):
            bpy.app.timers.unregister(self.tick)
        if self.run is not None:
            self.run.process.kill()
            self.run.process.wait()
        self.run = self.figure = self.on_recorded = self.face = self.character = None
        self.failure = self.recorded = ""


live = CurrentLive()


@bpy.app.handlers.persistent
def before_load(*_: object) -> None:
    """End the run when another file is opened."""
    live.abandon()


def _redraw(*, panels: bool) -> None:
    """Let viewports show what is new, and the panels beside them, which take far longer to draw, if asked for."""
    for window in bpy.context.window_manager.windows if bpy.context.window_manager else ():
        for area in window.screen.areas:
            for region in area.regions if area.type == "VIEW_3D" else ():
                if panels or region.type == "WINDOW":
                    region.tag_redraw()
